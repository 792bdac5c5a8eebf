"""Results on disk: one SQLite file a folder."""
