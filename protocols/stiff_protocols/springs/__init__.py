"""Joint springs identified from measured deflections."""
