"""Submissions to the leaderboard: `bench submit`, `bench verify`, and the status of each model."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from stiff_bench.api.evaluation import run_of_study
from stiff_bench.api.records import records_of
from stiff_bench.paper.study_file import find_study
from stiff_bench.parameter_types import Form
from stiff_bench.plan.cells import installed
from stiff_bench.plan.registry import use_only
from stiff_bench.store.database import ResultStore, read_manifests, read_results
from stiff_bench.submissions.card import read_card
from stiff_bench.submissions.published_results import place_of
from stiff_bench.submissions.statuses import SHIPPED
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
    wrong_files,
)
from stiff_bench.submissions.verification import Check, outcome_of, place_of_record, verify
from stiff_bench.submissions.verification import Refits as Refits
from stiff_bench.tables.units import counted, first_few
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import RunManifest

STUDY = "leaderboard"


def submit(
    card: Path,
    output: Path,
    *,
    lite: bool,
    results: Path,
    study: str = STUDY,
    command: str = "",
    **how: Any,
) -> Submission:
    """Write a submission to the leaderboard.

    The missing fits are computed first. The folder holds the card, the code, a record per fit with
    its predictions, the environment, and a manifest with hashes.

    Args:
        card: card of the model: plugin file next to it, authors, licence and reference.
        output: new folder for the submission.
        lite: fits of the short version of the study (four robots), or of all of it; required.
        results: folder of results: fits that it holds are not computed again.
        study: study, or a file such as my_study.toml.
        command: command of the run, stored with the results.
        how: options of `chosen_execution`.

    Raises:
        ConfigError: the card is wrong, or a fit failed.
        StoreError: the folder exists or cannot be written.
    """
    read = read_card(card)
    scope: Scope = "lite" if lite else "full"
    check_output(output)
    plugin = card.parent / read.plugin
    if (plugin.parent / "__init__.py").exists():
        raise ConfigError(f"{plugin}: is part of a package; give a file outside of packages")
    use_only([plugin])
    study_run = run_of_study(
        study, models=[read.model], lite=lite, output=results, command=command, **how
    )
    names = {
        task.presentation.model for task in study_run.tasks if task.model.info.key not in SHIPPED
    }
    if len(names) != 1:
        raise ConfigError(f"{card}: {read.model!r} is a model of stiffbench; name your own")
    (name,) = names
    fits = [fit for fit in study_run.compute().fits if fit.presentation.model == name]
    if failed := [
        f"{fit.presentation.dataset}: {fit.why_none}" for fit in fits if fit.status != "ok"
    ]:
        raise ConfigError(
            f"{counted(len(failed), 'fit')} of {name} without a result; a submission needs all: "
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
    return write_submission(output, card, records_of(results, fits), environments, manifest)


@dataclass
class VerificationRun:
    """Checks of a submission; iterate to run them.

    Attributes:
        folder: folder of the submission.
        study: name or file of the study.
        refits: choice and limits of the fits to compute again.
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
        """Return the outcome of the finished checks."""
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


def add_submission(
    folder: Annotated[Path, Form("DIR")],
    results: Annotated[Path, Form("DIR")] = Path("results/leaderboard/runs"),
) -> int:
    """Add the fits of a verified submission to results, and return their number.

    The fits are not computed again. `bench reproduce leaderboard --write-only` then has a column of
    status: verified or reported.

    Args:
        folder: folder of a submission that `bench verify` has verified or reported.
        results: folder of results to add to, with the VJM on the same splits.

    Raises:
        ConfigError: the submission was changed or not verified (`bench verify --write`), or the
            VJM has no result on one of its splits.
        StoreError: the results cannot be read or written.
    """
    submission = read_submission(folder)
    if problems := wrong_files(folder, submission.manifest):
        raise ConfigError(f"{folder}: {first_few(problems)}")
    if read_verification(folder) is None:
        command = shlex.join(["bench", "verify", str(folder), "--write"])
        raise ConfigError(f"{folder}: not verified: run `{command}` first")
    baseline = {
        place_of(result.cell, result.presentation): result
        for result in read_results(results)
        if result.cell.model == REFERENCE_MODEL and result.status == "ok"
    }
    fits = []
    for record in submission.records:
        of_vjm = baseline.get(place_of_record(record))
        if of_vjm is None or of_vjm.cell.split_sha256 != record.split_sha256:
            raise ConfigError(f"{results}: no result of the VJM on {record.place_text}")
        fits.append(record.result(of_vjm))
    store = ResultStore(results)
    store.write_cells(fits)
    for run_id in {fit.run_id for fit in fits}:
        keys = tuple(fit.cell.key for fit in fits if fit.run_id == run_id)
        environment = next(fit.environment for fit in submission.records if fit.run_id == run_id)
        command = shlex.join(["bench", "results", "add", str(folder)])
        store.write_manifest(
            RunManifest(run_id, command, submission.manifest.created, "finished", environment, keys)
        )
    return len(fits)
