"""Analyze stored results: comparisons, rankings, leaderboards."""
