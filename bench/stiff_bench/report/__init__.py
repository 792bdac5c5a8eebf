"""One HTML page that holds all that a folder of results says, and needs no network."""
