"""Compute fits: in this process, in separate processes, or on a cluster."""
