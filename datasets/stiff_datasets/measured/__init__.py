"""Measured data: reading, checks, shipped data sets."""
