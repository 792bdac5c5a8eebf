"""A fitted model on a robot: corrected paths and programs, postures, stiffness maps."""
