"""What `import stiffbench` offers, and all that the commands call."""

from pathlib import Path

from stiff_datasets.measured.file_options import LARGEST_POSE_TOLERANCE as LARGEST_POSE_TOLERANCE
from stiff_datasets.measured.file_options import POSE_TOLERANCE as POSE_TOLERANCE

RESULTS = Path("results/runs")
"""Where `bench run` stores results, and others read them, unless the user says otherwise."""
