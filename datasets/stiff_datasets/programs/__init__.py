"""Robot programs: motion targets read out of a maker's language, and written back in place."""
