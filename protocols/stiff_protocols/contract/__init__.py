"""What the packages agree on: types, errors, interfaces, records."""
