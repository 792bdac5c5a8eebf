"""What `import stiffbench` offers, and all that the commands call."""

from pathlib import Path

RESULTS = Path("results/runs")
"""Where `bench run` stores results, and others read them, unless the user says otherwise."""
