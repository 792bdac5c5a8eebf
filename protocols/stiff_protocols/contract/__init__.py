"""Common types, errors, interfaces and records of the packages."""
