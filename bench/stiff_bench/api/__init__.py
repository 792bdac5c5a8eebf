"""What `import stiffbench` offers, and all that the commands call."""
