"""Evaluate a submission here: on the board's robots, and on robots drawn after it was sent."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Collection
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property, partial
from hashlib import sha256
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.paper.study_file import Study, StudyRun
from stiff_bench.plan.fits import FitTask, fit_tasks, installed
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import Registry, build_registry
from stiff_bench.results.fresh_robots import (
    COMMON_WORLDS,
    SIDES,
    fresh_over_named,
    logs_in_worlds,
    rank_agreement,
)
from stiff_bench.results.load import StoredResults
from stiff_bench.results.scored_task import sort_key
from stiff_bench.results.scores import Scores, ratio_frame
from stiff_bench.run.execution import Execution
from stiff_bench.run.fit import FitOutcome
from stiff_bench.run.machine import environment
from stiff_bench.run.runner import run_fits
from stiff_bench.store.database import ResultStore, has_results, read_results
from stiff_bench.submissions.sealed_fit import About, SealedModel
from stiff_bench.tables.table import Column, Table
from stiff_bench.tables.units import counted
from stiff_datasets.twin.fresh_arms import FreshArms
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError, ModelError
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.record import Fit
from stiff_protocols.scoring.over_robots import MeanRatio, mean_ratio

if TYPE_CHECKING:
    from pandas import DataFrame

METRIC = "true-norm"
FRESH_ROBOTS, FRESH_ROBOTS_LITE = 12, 4
WORLDS, WORLDS_LITE = ("friction", "structure", "all", "unseen"), ("all", "unseen")
RIVALS_LITE = (REFERENCE_MODEL, "vjm-full", "curve-springs")
RIVALS = (*RIVALS_LITE, "bayes-springs")
"""Models that the submission's is compared with."""
PROTOCOL = "holdout"
CHECKED_SAMPLES = 40
"""Number of samples of the conformance checks."""
SEED_BITS = 64


@dataclass(frozen=True)
class Draw:
    """The draw of the fresh robots: nobody knew them when the submission was sent.

    Attributes:
        submission: SHA-256 of the submission.
        commit: a commit that is later than the submission, or the version of stiffbench.
        nonce: random number, drawn when the fits start.
        n_robots: number of robots.
    """

    submission: str
    commit: str
    nonce: str
    n_robots: int

    @property
    def seeds(self) -> list[int]:
        """Return the seeds of the robots."""
        words = (f"{self.submission}/{self.commit}/{self.nonce}/{i}" for i in range(self.n_robots))
        return [int(sha256(text.encode()).hexdigest(), 16) % 2**SEED_BITS for text in words]


def new_draw(submission: str, n_robots: int) -> Draw:
    """Return a draw with a new random number."""
    commit = environment().get("commit", installed("stiffbench"))
    return Draw(submission, commit, secrets.token_hex(16), n_robots)


@dataclass(frozen=True, eq=False)
class Verification:
    """The scores of a submission's model.

    Attributes:
        model: name of the model.
        draw: of the fresh robots.
        named, fresh: scores on the board's robots and on the fresh ones.
    """

    model: str
    draw: Draw
    named: Scores
    fresh: Scores

    @cached_property
    def _logs(self) -> dict[str, DataFrame]:
        """Return (robots, models) logarithms on named and fresh robots, and in each world."""
        return {
            **{side: self._logs_of(side, None) for side in SIDES},
            **{world: self._logs_of("fresh", (world,)) for world in WORLDS},
        }

    def _logs_of(self, side: str, worlds: Collection[str] | None) -> DataFrame:
        scores = self.named if side == "named" else self.fresh
        return logs_in_worlds(scores, worlds or {*scores.rows["world"]})

    @cached_property
    def frame(self) -> DataFrame:
        """Return the `ratio_frame` of named robots, fresh robots and worlds, best first."""
        frame = ratio_frame(self._logs)
        best_first: Any = [("fresh", "ratio")]
        return frame.sort_values(best_first).rename_axis("model").reset_index()

    @cached_property
    def fresh_over_named(self) -> MeanRatio:
        """Return `fresh_over_named` of the model, in the worlds that both have."""
        common = (self._logs_of(side, COMMON_WORLDS) for side in SIDES)
        return fresh_over_named(self.model, *common)

    @property
    def is_better_on_named(self) -> bool:
        """True if the model loses on fresh robots, beyond the interval."""
        return self.fresh_over_named.low > 1.0

    def table(self) -> Table:
        """Return the table of named and fresh robots."""
        columns = [
            Column("model", "text"),
            *(Column(side, "text", value=partial(_text, side=side)) for side in SIDES),
            *(
                Column(world, format=".2f", value=itemgetter((world, "ratio")))
                for world in WORLDS
                if self.frame[world, "ratio"].notna().any()
            ),
        ]
        change = self.fresh_over_named
        notes = [
            "named, fresh: error against the true robot over the VJM's, geometric mean over robots "
            "with its 95 % interval; then the worlds of the fresh robots",
            f"fresh robots: {self.draw.n_robots}, drawn by the nonce {self.draw.nonce} after the "
            "submission was sent",
            f"Kendall's rank agreement of named and fresh: {rank_agreement(self.frame):.2f}",
            f"error against the best spring model, fresh over named: {change.ratio:.2f} "
            f"({change.low:.2f} to {change.high:.2f})",
        ]
        if self.is_better_on_named:
            notes.append(f"{self.model} does better on named than on fresh robots")
        return Table.of(self.model, columns, self.frame, notes)

    def record(self) -> dict[str, Any]:
        """Return what the board shows of the fresh robots, as JSON."""
        of_model = self.frame[self.frame["model"] == self.model].iloc[0]
        common = mean_ratio(self._logs_of("fresh", COMMON_WORLDS)[self.model])
        change = self.fresh_over_named
        return {
            "submission": self.draw.submission,
            "commit": self.draw.commit,
            "nonce": self.draw.nonce,
            "seeds": self.draw.seeds,
            "date": datetime.now(UTC).date().isoformat(),
            "stiffbench": installed("stiffbench"),
            "fresh": [common.ratio, common.low, common.high],
            "worlds": {world: of_model[world, "ratio"] for world in WORLDS},
            "fresh_over_named": [change.ratio, change.low, change.high],
            "rank_agreement": rank_agreement(self.frame),
        }


def _text(row: dict[Any, Any], side: str) -> str:
    ratio, low, high = (row[side, key] for key in ("ratio", "low", "high"))
    ends = "" if low is None else f" ({low:.2f} to {high:.2f})"
    return f"{ratio:.2f}{ends}"


class StandIn:
    """Stand for a model whose code runs in sealed processes only."""

    def fit(self, train: object, **about: object) -> StandIn:
        """Raise ModelError: it is never fitted here."""
        raise ModelError("this model is fitted in a sealed process")

    def predict(self, q: object, wrench: object) -> object:
        """Raise ModelError: it never predicts here."""
        raise ModelError("this model predicts in a sealed process")

    def chooses_epoch(self) -> bool:
        """Return True; the line of the model says whether it needs validation rows."""
        return True


@dataclass(eq=False, kw_only=True)
class SealedProcesses(Execution):
    """Compute the fits of a submission's model, each in a sealed process."""

    model: SealedModel

    def fit(self, model: Choice[ModelInfo], given: FitInput) -> FitOutcome:
        """Return the outcome of a fit of the submission's model; `model` only stands for it."""
        return self.model.fit(given)


def verify(
    model: SealedModel,
    study: Study,
    *,
    lite: bool,
    results: Path,
    execution: Execution,
    command: str,
    write: bool = False,
) -> Verification:
    """Evaluate a submission's model on the board's robots and on fresh ones.

    Args:
        model: the submission's model.
        study: the board's study; its first run has the named robots.
        lite: the short version.
        results: stored fits of the board; missing ones of other models are computed.
        execution: of the other models' fits.
        command: command of the run, stored with the results.
        write: True to store the model's fits on the board's robots in `results`.

    Raises:
        ConfigError: the model fails a check, or a fit.
        StoreError: the results cannot be read or written.
    """
    about = _checked(model)
    catalogue = build_registry()
    info = ModelInfo(
        key=about.key,
        target=StandIn,
        summary=model.submission.card.summary,
        uses_validation=about.uses_validation,
    )
    catalogue.add([info], str(model.submission.folder))
    draw = new_draw(model.submission.sha256, FRESH_ROBOTS_LITE if lite else FRESH_ROBOTS)
    sealed = SealedProcesses(model=model)
    stored = read_results(results) if has_results(results) else []
    scores: dict[str, Scores] = {}
    with tempfile.TemporaryDirectory(prefix="bench-verify-") as folder:
        for side in SIDES:
            named = (study.lite_version() if lite else study).run[0]
            run = named if side == "named" else _fresh_run(draw, lite)
            run_of_rivals = replace(run, models=RIVALS_LITE if lite else RIVALS)
            rivals = {_plain_key(t.fit): t for t in _tasks(study, run_of_rivals, catalogue)}
            there = [f for f in stored if _plain_key(f.fit) in rivals and f.status == "ok"]
            stored_keys = {_plain_key(fit.fit) for fit in there}
            missing = [task for key, task in rivals.items() if key not in stored_keys]
            of_submission = [
                replace(
                    task,
                    fit=replace(task.fit, model_version=model.submission.sha256[:12]),
                    presentation=replace(task.presentation, model=about.name),
                )
                for task in _tasks(study, replace(run, models=(about.key,)), catalogue)
            ]
            place = results if write and side == "named" else Path(folder) / side
            computed = run_fits(of_submission, command, ResultStore(place), sealed).results
            if failed := [fit for fit in computed if fit.status != "ok"]:
                dataset = failed[0].presentation.dataset
                raise ConfigError(
                    f"{model.submission.folder}: no result on {dataset}: {failed[0].failure}"
                )
            store = ResultStore(Path(folder) / f"{side} rivals")
            of_rivals = run_fits(missing, command, store, execution).results
            every_fit = StoredResults.of_results(place, [*there, *of_rivals, *computed])
            scores[side] = Scores.of(every_fit, sort_key(METRIC), every_fit.tasks)
    return Verification(about.name, draw, **scores)


def _plain_key(fit: Fit) -> str:
    """Return the key of a fit without intervals."""
    return replace(fit, coverage=None, interval_version=0).key


def _fresh_run(draw: Draw, lite: bool) -> StudyRun:
    """Return the run on the fresh robots."""
    words = [
        f"fresh-arms@seed={seed}" + f"@world={world}" * (world != "all")
        for world in (WORLDS_LITE if lite else WORLDS)
        for seed in draw.seeds
    ]
    return StudyRun(models=(), datasets=tuple(words), protocols=(PROTOCOL,), splits=1)


def _tasks(study: Study, run: StudyRun, catalogue: Registry) -> list[FitTask]:
    """Return the fits of a run."""
    return [*fit_tasks(*replace(study, run=(run,)).plans(catalogue, output=Path(), command=""))]


def _checked(model: SealedModel) -> About:
    """Return what the model says of itself; ConfigError if it cannot be evaluated."""
    data = FreshArms().load().without_truth()
    few = replace(data, samples=data.samples.take(np.arange(CHECKED_SAMPLES)))
    about = model.described(few)
    folder = model.submission.folder
    if about.failure:
        raise ConfigError(f"{folder}: {about.failure}")
    if about.failed_checks:
        n_failed, texts = len(about.failed_checks), "; ".join(about.failed_checks)
        raise ConfigError(f"{folder}: fails {counted(n_failed, 'check')}: {texts[:2000]}")
    return about
