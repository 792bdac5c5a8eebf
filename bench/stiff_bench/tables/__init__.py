"""Tables of numbers, and how they are printed."""
