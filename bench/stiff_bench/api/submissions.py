"""Submissions to the leaderboard: `bench submit`, `bench verify`, and the status of each model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from stiff_bench.api.evaluation import run_of_study
from stiff_bench.api.records import records_of
from stiff_bench.api.registered import use_only
from stiff_bench.paper.study_file import find_study
from stiff_bench.plan.cells import installed
from stiff_bench.store.database import read_manifests, read_results
from stiff_bench.submissions.card import read_card
from stiff_bench.submissions.submission import (
    MANIFEST,
    Manifest,
    Outcome,
    Scope,
    Submission,
    Verification,
    check_output,
    file_sha256,
    read_submission,
    read_verification,
    write_submission,
    write_verification,
)
from stiff_bench.submissions.verification import Check, outcome_of, verify
from stiff_bench.submissions.verification import Refits as Refits
from stiff_bench.tables.units import counted, first_few
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import ConfigError

STUDY = "leaderboard"
SUBMISSIONS = Path("results/submissions")
"""Folder of the submissions in the repository."""


def submit(
    card_file: Path,
    output: Path,
    *,
    scope: Scope,
    results: Path,
    study: str = STUDY,
    command: str = "",
    **how: Any,
) -> Submission:
    """Compute what is missing of a model's fits, and write its submission.

    Args:
        card_file: the card; it names the model and the plugin file next to it.
        output: folder of the submission, which must not exist.
        scope: "lite" or "full".
        results: folder that keeps the results.
        study: name, or file.
        command: for the record.
        how: the options of `chosen_execution`.

    Raises:
        ConfigError: the card is wrong, or a fit failed.
        StoreError: the folder exists or cannot be written.
    """
    card = read_card(card_file)
    check_output(output)
    plugin = card_file.parent / card.plugin
    if (plugin.parent / "__init__.py").exists():
        raise ConfigError(f"{plugin}: is part of a package; give a file outside of packages")
    use_only([plugin])
    lite = scope == "lite"
    study_run = run_of_study(
        study, models=[card.model], lite=lite, output=results, command=command, **how
    )
    names = {task.shown.model for task in study_run.tasks if task.model.info.key not in SHIPPED}
    if len(names) != 1:
        raise ConfigError(f"{card_file}: model = {card.model!r}: a model of stiffbench, not yours")
    (name,) = names
    fits = [fit for fit in study_run.compute().cells if fit.shown.model == name]
    if failed := [f"{fit.shown.dataset}: {fit.why_none}" for fit in fits if fit.status != "ok"]:
        raise ConfigError(
            f"{counted(len(failed), 'fit')} of {name} without a result, which a submission needs: "
            f"{first_few(failed)}"
        )
    run_ids = {fit.run_id for fit in fits}
    environments = {
        run.run_id: {"command": run.command, "started": run.started, **run.environment}
        for run in read_manifests(results)
        if run.run_id in run_ids
    }
    manifest = Manifest(
        stiffbench=installed("stiffbench"),
        study=find_study(study).name,
        scope=scope,
        model=name,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        files={},
    )
    return write_submission(output, card_file, records_of(results, fits), environments, manifest)


SHIPPED = {info.key for info in MODELS}
"""Keys of the models of stiffbench."""


@dataclass
class VerificationRun:
    """Checks of a submission, as they are made.

    Attributes:
        folder: of the submission.
        study: name, or file.
        refits: choice and limits of the fits that are computed again.
    """

    folder: Path
    study: str
    refits: Refits

    def __post_init__(self) -> None:
        self.checks: list[Check] = []

    def __iter__(self) -> Iterator[Check]:
        """Yield each check."""
        for check in verify(self.folder, find_study(self.study), self.refits):
            self.checks.append(check)
            yield check

    @property
    def outcome(self) -> Outcome:
        """Outcome of the checks that were made."""
        return outcome_of(self.checks)

    def write(self) -> None:
        """Store the outcome in the folder of the submission."""
        write_verification(
            self.folder,
            Verification(
                outcome=self.outcome,
                manifest_sha256=file_sha256(self.folder / MANIFEST),
                stiffbench=installed("stiffbench"),
                date=datetime.now(UTC).date().isoformat(),
                seed=self.refits.seed,
                checks=[str(check) for check in self.checks],
            ),
        )


def submissions_in(folder: Path = SUBMISSIONS) -> list[Submission]:
    """Return the submissions below a folder, in the order of their names."""
    return [read_submission(path.parent) for path in sorted(folder.glob(f"*/{MANIFEST}"))]


def model_statuses(results: Path, submissions: Path = SUBMISSIONS) -> dict[str, str]:
    """Return model -> "verified" or "reported", for the leaderboard's column.

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
        name, version = result.shown.model, result.cell.model_version
        if result.cell.model in SHIPPED or (name, version) in verified:
            statuses.setdefault(name, "verified")
        else:
            statuses[name] = "reported"
    return statuses
