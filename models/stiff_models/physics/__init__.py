"""Physical models: kinematics, springs, virtual joint models."""
