"""Kinematics of a serial chain: formulas, the programs they become, and methods on arrays."""
