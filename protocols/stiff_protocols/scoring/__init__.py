"""Metrics, intervals and statistical tests."""
