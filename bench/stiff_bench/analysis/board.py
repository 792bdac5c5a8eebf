"""Scores of models over robots, one vote each: the rows of a leaderboard.

The main number of a model is its error over the VJM's: the geometric mean over robots, and for each
robot over its data sets with equal weights. Measured robots have separate columns and are never
averaged with simulated robots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame

from stiff_bench.analysis.answer import Answer
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.scored_case import ScoredCase, family_of
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.analysis.verdict import Verdict
from stiff_bench.store.names import grouped, without_options
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.record import PATH_ERROR, Presentation
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.over_robots import (
    MeanRatio,
    corrected_p_values,
    equivalence_p_value,
    mean_ratio,
    without_one,
)
from stiff_protocols.scoring.paired import LEVEL

SEED_OPTIONS = ("pretrain_seed",)
"""Options of models that only repeat a training with another seed."""
Ratio = Callable[[str, ScoredCase], float | None]
"""Function for the number of a model in a comparison; the logarithms are averaged."""


class MeasuredScore(NamedTuple):
    """Score on measured data: error over the VJM's, and the verdict against the VJM."""

    ratio: float
    verdict: Verdict | None


@dataclass(frozen=True)
class BoardRow:
    """A model over all robots.

    Attributes:
        name: model with its options.
        mark: text printed next to the name; "" for none.
        mean: error over the VJM's.
        won: number of robots on which the model has the smallest ratio.
        worst, worst_robot: largest ratio of a robot.
        without_one: smallest and largest mean with one robot left out.
        p_reference, p_best: p-values of the sign-flip tests against the VJM and the best model,
            corrected (Holm) for all models; NaN for the model itself.
        like_best: True if equivalence with the best within 5 % is significant.
        p95: 95th percentile of the error over the VJM's; None: unknown.
        noise: error over the error caused only by measurement noise; None: unknown.
        path: remaining error on tool paths over the VJM's; None: unknown.
        few: error over the VJM's with fewer poses, by heading.
        groups: error over the VJM's by group of data sets.
        measured: scores by measured data set.
        fit_s: median time of a fit, s; None: not recorded.
    """

    name: str
    mark: str
    mean: MeanRatio
    won: int
    worst: float
    worst_robot: str
    without_one: tuple[float, float]
    p_reference: float
    p_best: float
    like_best: bool
    p95: float | None
    noise: float | None
    path: float | None
    few: Mapping[str, float]
    groups: Mapping[str, float]
    measured: Mapping[str, MeasuredScore]
    fit_s: float | None

    @property
    def verdict(self) -> str:
        """Return "better", "worse" or "open" for the error over the VJM's."""
        if not self.p_reference < LEVEL:
            return "open"
        return "better" if self.mean.ratio < 1.0 else "worse"


class ControlRow(NamedTuple):
    """A learned model against its physics model or teacher.

    Attributes:
        name, control: models.
        mean: error of the model over the control's.
        p_value: p-value of the sign-flip test, corrected (Holm) for all controls.
        is_equal: True if equivalence within 5 % is significant.
    """

    name: str
    control: str
    mean: MeanRatio
    p_value: float
    is_equal: bool


@dataclass(frozen=True, eq=False, repr=False)
class Board(BriefFields):
    """Models over robots.

    Attributes:
        answer: comparisons of one protocol, on simulated and measured robots.
        few: comparisons with fewer poses on the same robots, by heading.
        groups: data sets with a separate column, by its name.
    """

    answer: Answer
    few: Mapping[str, Answer] = field(default_factory=dict)
    groups: Mapping[str, Collection[str]] = field(default_factory=dict)

    @cached_property
    def robots(self) -> dict[str, list[ScoredCase]]:
        """Return comparisons by robot, for the averaged robots."""
        return self.answer.claim_robots

    @cached_property
    def measured(self) -> dict[str, list[ScoredCase]]:
        """Return measured data sets; none if the averaged robots are the measured ones."""
        kinds = {cases[0].case.presentation.kind for cases in self.robots.values()}
        return {} if "measured" in kinds else self.answer.measured

    @cached_property
    def logs(self) -> DataFrame:
        """Return (robots, models) logarithms of error / VJM's error of complete models."""
        return self._logs(self.answer.ratio, self.robots).dropna(axis="columns")

    @cached_property
    def n_splits(self) -> dict[str, tuple[int, int]]:
        """Return numbers of scored and of all comparisons, by model with a score."""
        cases = [case for of_robot in self.robots.values() for case in of_robot]
        counts = {
            name: sum(name in case.scores for case in cases) for name in self.answer.model_names
        }
        return {name: (count, len(cases)) for name, count in counts.items() if count}

    def robot_ratio(self, robot: str, name: str) -> float:
        """Return a model's error over the VJM's on one robot."""
        return math.exp(float(self.logs[name][robot]))

    @cached_property
    def winners(self) -> dict[str, str]:
        """Return the model with the smallest ratio, by robot."""
        return {str(robot): str(name) for robot, name in self.logs.idxmin(axis="columns").items()}

    @cached_property
    def best(self) -> str:
        """Return the model with the smallest mean ratio."""
        return str(self.logs.mean().idxmin())

    @cached_property
    def rows(self) -> tuple[BoardRow, ...]:
        """Return the models with every score, best first."""
        order = self.logs.mean().sort_values(kind="stable").index
        winners = [*self.winners.values()]
        cases = [case for of_robot in self.robots.values() for case in of_robot]
        p_values = {name: self._p_values(name) for name in (REFERENCE_MODEL, self.best)}

        def tail(model: str, case: ScoredCase) -> float | None:
            return _ratio(p95_error(model, case), p95_error(REFERENCE_MODEL, case))

        def above_noise(model: str, case: ScoredCase) -> float | None:
            return _ratio(self.answer.error(model, case), self.answer.noise(case))

        def left_on_paths(model: str, case: ScoredCase) -> float | None:
            return _ratio(path_error(model, case), path_error(REFERENCE_MODEL, case))

        extra = {
            "p95": self._logs(tail, self.robots).mean(skipna=False),
            "noise": self._logs(above_noise, self.robots).mean(skipna=False),
            "path": self._logs(left_on_paths, self.robots).mean(skipna=False),
        }
        few: dict[str, Mapping[Any, float]] = {
            heading: self._logs(answer.ratio, answer.claim_robots).mean(skipna=False).to_dict()
            for heading, answer in self.few.items()
        }
        of_groups = {name: self._robots_of(datasets) for name, datasets in self.groups.items()}
        groups: dict[str, Mapping[Any, float]] = {
            name: self._logs(self.answer.ratio, robots).mean(skipna=False).to_dict()
            for name, robots in of_groups.items()
        }
        return tuple(
            BoardRow(
                name,
                self.answer.mark(name),
                mean_ratio(self.logs[name]),
                winners.count(name),
                math.exp(self.logs[name].max()),
                str(self.logs[name].idxmax()),
                _span(without_one(self.logs[name])),
                p_values[REFERENCE_MODEL].get(name, np.nan),
                p_values[self.best].get(name, np.nan),
                name != self.best and self._is_equal(name, self.best),
                **{key: _exp(values.get(name)) for key, values in extra.items()},
                few=_present(few, name),
                groups=_present(groups, name),
                measured=self._measured(name),
                fit_s=self.answer.fit_s(name, cases),
            )
            for name in map(str, order)
        )

    def controls(self, pairs: Mapping[str, str]) -> tuple[ControlRow, ...]:
        """Return models against their controls; pairs without every score are left out."""
        there = {a: b for a, b in pairs.items() if a in self.logs and b in self.logs}
        differences = {a: self.logs[a] - self.logs[b] for a, b in there.items()}
        p_values = corrected_p_values(differences)
        return tuple(
            ControlRow(
                *(name, there[name], mean_ratio(logs), p_values[name]),
                is_equal=equivalence_p_value(logs) < LEVEL,
            )
            for name, logs in differences.items()
        )

    def _p_values(self, against: str) -> dict[str, float]:
        """Return p-values against a model by rival, corrected for all models."""
        rivals = [str(name) for name in self.logs if name != against]
        return corrected_p_values({name: self.logs[name] - self.logs[against] for name in rivals})

    def _is_equal(self, model: str, rival: str) -> bool:
        return equivalence_p_value(self.logs[model] - self.logs[rival]) < LEVEL

    def _logs(self, ratio: Ratio, robots: Mapping[str, Sequence[ScoredCase]]) -> DataFrame:
        """Return (robots, models) mean logarithms; NaN if a comparison has no number."""
        names = self.answer.model_names
        rows = {
            robot: {name: _mean_log(name, cases, ratio) for name in names}
            for robot, cases in robots.items()
        }
        return DataFrame.from_dict(rows, orient="index", columns=[*names])

    def _robots_of(self, datasets: Collection[str]) -> dict[str, list[ScoredCase]]:
        """Return comparisons on these data sets by robot."""
        chosen = {
            robot: [case for case in cases if case.name.dataset in datasets]
            for robot, cases in self.robots.items()
        }
        return {robot: cases for robot, cases in chosen.items() if cases}

    def _measured(self, name: str) -> dict[str, MeasuredScore]:
        scores = {}
        for dataset, cases in self.measured.items():
            ratio = self.answer.mean_ratio(name, cases)
            if ratio is not None and all(name in case.scores for case in cases):
                verdicts = {self.answer.verdict(name, case) for case in cases}
                scores[dataset] = MeasuredScore(
                    ratio, verdicts.pop() if len(verdicts) == 1 else "open"
                )
        return scores


def without_seeds(stored: StoredResults) -> StoredResults:
    """Return stored results without the pre-training seed in model names."""

    def renamed(texts: Presentation) -> Presentation:
        return replace(texts, model=without_options(texts.model, *SEED_OPTIONS))

    results = [
        replace(result, presentation=renamed(result.presentation))
        for case in stored.cases
        for result in case.every
    ]
    return StoredResults.of_results(stored.folder, results)


def _mean_log(model: str, cases: Iterable[ScoredCase], ratio: Ratio) -> float:
    """Return the mean logarithm with one vote per data set; NaN: a number is missing.

    A model needs only one split of a data set: its error is divided by the VJM's on that split.
    """
    means = []
    for of_data in grouped(cases, lambda case: family_of(case.name)).values():
        ratios = [ratio(model, case) for case in of_data if model in case.scores]
        if not ratios or any(not value for value in ratios):
            return math.nan
        means.append(float(np.mean(np.log(np.array(ratios, dtype=float)))))
    return float(np.mean(means)) if means else math.nan


P95 = sort_key("norm-p95", None)


def p95_error(model: str, case: ScoredCase) -> float | None:
    """Return the 95th percentile of the 3-D error, mean over splits, m; None: unknown."""
    values = P95.of_splits(case.results[model]) if model in case.results else None
    return None if values is None else float(values.mean())


def path_error(model: str, case: ScoredCase) -> float | None:
    """Return the mean error that corrected commands leave on tool paths, mm."""
    values = [result.diagnostics.get(PATH_ERROR) for result in case.results.get(model, ())]
    numbers = [value for value in values if value is not None]
    return float(np.mean(numbers)) if numbers and len(numbers) == len(values) else None


def _ratio(value: float | None, reference: float | None) -> float | None:
    return None if value is None or not reference else value / reference


def _span(ratios: FloatArray) -> tuple[float, float]:
    return float(ratios.min()), float(ratios.max())


def _exp(log: float | None) -> float | None:
    return None if log is None or math.isnan(log) else math.exp(log)


def _present(columns: Mapping[str, Mapping[Any, float]], name: str) -> dict[str, float]:
    """Return the ratios of a model by heading; missing ones are omitted."""
    ratios = {heading: _exp(values.get(name)) for heading, values in columns.items()}
    return {heading: ratio for heading, ratio in ratios.items() if ratio is not None}
