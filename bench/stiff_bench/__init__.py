"""The engine: registry, command line, runner, store and tables."""
