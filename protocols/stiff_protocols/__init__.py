"""What a fair comparison of robot stiffness models is: types, splits, metrics, records."""
