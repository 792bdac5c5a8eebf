"""Stiffness model families, one plugin file each, and the parts that they share."""
