"""Journal figures, one per file: numbers in, matplotlib figure out."""
