"""The shipped studies: what `bench reproduce NAME` runs, and what stands on its page."""
