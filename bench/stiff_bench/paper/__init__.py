"""The source paper's tables and figures, made again from stored results."""
