"""Figures that a journal would print, one a file: plain numbers in, a matplotlib figure out."""
