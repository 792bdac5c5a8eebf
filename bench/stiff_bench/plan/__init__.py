"""What a run was asked for: registry, options, and the cells that follow."""
