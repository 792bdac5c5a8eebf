"""Plan a run: registry, options, and the resulting fits."""
