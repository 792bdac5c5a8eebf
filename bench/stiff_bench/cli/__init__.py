"""Commands: words of the command line in, one call, the result printed."""
