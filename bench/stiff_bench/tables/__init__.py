"""Build tables of numbers and print them."""
