"""Digital twins: simulated robots and their data sets."""
