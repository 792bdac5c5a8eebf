"""The source paper's tables as CSV, with the paper's own rounding; data alone, no code."""
