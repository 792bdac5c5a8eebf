"""Kinematics of a serial chain: formulas, their programs, and methods on arrays."""
