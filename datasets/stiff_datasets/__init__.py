"""Samples and robots: simulated and measured data sets, and the reader for one's own."""
