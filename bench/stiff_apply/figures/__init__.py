"""Figures of corrected paths, postures and stiffness maps."""
