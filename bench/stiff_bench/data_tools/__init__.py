"""What the `bench data` commands do."""
