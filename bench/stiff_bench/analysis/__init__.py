"""What stored results say: comparisons, rankings, leaderboards."""
