"""Definition of a fair comparison of robot stiffness models: types, splits, metrics, records."""
