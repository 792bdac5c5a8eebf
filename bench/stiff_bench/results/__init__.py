"""Stored results as frames, tables and sentences."""
