"""HTML page of all results of a folder, without network access."""
