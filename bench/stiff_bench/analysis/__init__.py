"""Say which poses to measure, and which rows are far from the measured ones."""
