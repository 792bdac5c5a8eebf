"""Status of each model: verified or reported."""

from __future__ import annotations

from pathlib import Path

from stiff_bench.store.database import read_results
from stiff_bench.store.names import Variant
from stiff_bench.submissions.submission import (
    MANIFEST,
    Submission,
    read_submission,
    read_verification,
)
from stiff_models.model_catalog import MODELS

SUBMISSIONS = Path("results/submissions")
"""Folder of the submissions in the repository."""
SHIPPED = {info.key for info in MODELS}
"""Keys of the models of stiffbench."""


def submissions_in(folder: Path = SUBMISSIONS) -> list[Submission]:
    """Return the submissions below a folder, in the order of their names."""
    return [read_submission(path.parent) for path in sorted(folder.glob(f"*/{MANIFEST}"))]


def model_statuses(results: Path, submissions: Path = SUBMISSIONS) -> dict[str, str]:
    """Return "verified" or "reported" by model, for the leaderboard's column.

    The models of stiffbench are verified: their results are computed by the repository's own
    commands. Another model is verified if `bench verify --write` verified a submission of this
    model with the same version.

    Args:
        results: folder of results.
        submissions: folder with a folder per submission.

    Raises:
        StoreError: the results cannot be read.
        DataError: a submission is wrong.
    """
    verified = {
        (record.model, record.model_version)
        for submission in submissions_in(submissions)
        if (stored := read_verification(submission.folder)) and stored.outcome == "verified"
        for record in submission.records
    }
    statuses: dict[str, str] = {}
    for result in read_results(results):
        name, version = result.presentation.model, result.cell.model_version
        if result.cell.model in SHIPPED or (name, version) in verified:
            statuses.setdefault(name, "verified")
        else:
            statuses[name] = "reported"
    return statuses


def board_statuses(results: Path, submissions: Path = SUBMISSIONS) -> dict[str, str]:
    """Return `model_statuses` if models of others are among the results; else nothing."""
    statuses = model_statuses(results, submissions)
    return statuses if any(Variant.of_word(name).key not in SHIPPED for name in statuses) else {}
