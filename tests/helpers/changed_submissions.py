"""Print the submissions that are new or have changed since the board's fits of them, for CI."""

from __future__ import annotations

from pathlib import Path

from stiff_bench.results.fresh_robots import read_entries
from stiff_bench.submissions.submission import read_submission

RESULTS = Path(__file__).parents[2] / "results"


def changed_submissions(results: Path) -> list[Path]:
    """Return the folders of submissions whose hash no fits on fresh robots have."""
    evaluated = {fits["submission"] for fits in read_entries(results / "leaderboard").values()}
    folders = sorted(path for path in (results / "submissions").iterdir() if path.is_dir())
    return [folder for folder in folders if read_submission(folder).sha256 not in evaluated]


if __name__ == "__main__":
    print(*changed_submissions(RESULTS), sep="\n")
