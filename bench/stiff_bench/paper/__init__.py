"""Studies: TOML files, what they run and their pages; the source paper's tables and figures."""
