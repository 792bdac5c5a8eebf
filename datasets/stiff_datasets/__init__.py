"""Simulated and measured data sets, robots, and the reader of user files."""
