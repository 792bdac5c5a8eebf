"""Options that are chosen on the training side."""
