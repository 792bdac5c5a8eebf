"""Robot programs: read motion targets in a manufacturer's language, and write them back."""
