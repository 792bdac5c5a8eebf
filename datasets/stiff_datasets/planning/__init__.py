"""Which poses and loads to measure."""
