"""The source paper's tables and figures, made again from stored results."""

from pathlib import Path

PAPER_RESULTS = Path("results/paper/runs")
"""Where `bench reproduce` stores what the paper's tables and figures show."""
