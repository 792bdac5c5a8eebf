"""Published results to compare with, records, and submissions with their verification."""
