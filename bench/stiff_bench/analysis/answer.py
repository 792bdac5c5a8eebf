"""The answer of stored results: the best model, its gain over the VJM, and the uncertainty.

Claims are about robots: data sets and protocols of a robot are averaged first. With fewer than
`FEWEST_ROBOTS` robots no claim about other robots is made.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stiff_bench.analysis.collected import Case, StoredResults, of_newest_data
from stiff_bench.analysis.scored_case import ScoredCase, family_of, scored_case, with_reference
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.analysis.verdict import Estimate, Question, Verdict, estimates
from stiff_bench.store.names import grouped
from stiff_bench.tables.metric_table import mark_of
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BOUND_NAMES
from stiff_protocols.scoring.over_robots import corrected_p_values, mean_ratio
from stiff_protocols.scoring.paired import LEVEL

FEWEST_ROBOTS = 5
"""Smallest number of robots with an interval over them."""
NOISE_FLOOR = BOUND_NAMES["noise"]


@dataclass(frozen=True)
class ModelAnswer:
    """One model against the VJM, over all selected comparisons.

    Attributes:
        name: model with its options.
        mark: text printed next to the name; "" for none.
        median_error: median over the comparisons, in the metric's unit.
        ratio: geometric mean of error / VJM's error over robots; None: not comparable.
        low, high: 95 % interval of the ratio over robots; None with fewer than `FEWEST_ROBOTS`.
        smallest, largest: ratio of a single comparison; None: not comparable.
        p_value: of the sign-flip test against the VJM over robots, corrected (Holm) for all models;
            NaN: not tested.
        counts: verdicts against the VJM; "a": the model is better, "b": worse.
        n_cases: comparisons in which the model has a score.
        fit_s: median time of a fit, s; None: not recorded.
    """

    name: str
    mark: str
    median_error: float
    ratio: float | None
    low: float | None
    high: float | None
    smallest: float | None
    largest: float | None
    p_value: float
    counts: Mapping[Verdict, int]
    n_cases: int
    fit_s: float | None

    @property
    def is_better(self) -> bool:
        """Return True if the error is significantly smaller than the VJM's over robots."""
        return self.ratio is not None and self.ratio < 1.0 and self.p_value < LEVEL


@dataclass(frozen=True, eq=False, repr=False)
class MatrixColumn(BriefFields):
    """Comparisons under one heading of the matrix: the specimens of one data set.

    Attributes:
        dataset: name without its specimen.
        protocol, condition: names.
        cases: comparisons, one per specimen and seed.
    """

    dataset: str
    protocol: str
    condition: str
    cases: tuple[ScoredCase, ...]

    @property
    def is_measured(self) -> bool:
        """Return True for measured data."""
        return _is_measured(self.cases[0])

    @property
    def text(self) -> str:
        """Return data set, protocol and condition as one line."""
        return " | ".join(filter(None, (self.dataset, self.protocol, self.condition)))


@dataclass(frozen=True, eq=False, repr=False)
class Answer(BriefFields):
    """Scores of models in several comparisons, each next to the VJM's.

    Attributes:
        key: metric of the scores.
        cases: comparisons, measured data first, then in the order in which runs requested them.
        model_names: names of the models; always with the VJM if it can be fitted.
        left_out: reasons why comparisons do not count, by comparison name.
        seed: seed of the draws of poses.
    """

    key: SortKey
    cases: tuple[ScoredCase, ...]
    model_names: tuple[str, ...]
    left_out: Mapping[str, str]
    seed: int = 0

    @classmethod
    def of(
        cls,
        stored: StoredResults,
        key: SortKey,
        cases: Sequence[Case] | None = None,
        models: Collection[str] | None = None,
        *,
        seed: int = 0,
        scored: Iterable[ScoredCase] = (),
    ) -> Answer:
        """Score models in stored results.

        Results that select on the test part or report training errors count only without
        other results.

        Args:
            stored: results with their samples.
            key: metric to score by.
            cases: cases to score; None: all of `stored`.
            models: exact names of models to score; None: all.
            seed: seed of the draws of poses.
            scored: comparisons of the same results, key and seed; their draws are reused.

        Raises:
            ConfigError: no model has a score.
            StoreError: samples are corrupt, or two models share no split.
        """
        newest = of_newest_data(stored.cases if cases is None else cases)
        fair = [case for case in newest if not case.presentation.reports_training]
        fair = [case for case in fair if not case.presentation.selects_on_test] or fair or newest
        left_out = {
            case.name.text: "selects on the test part or reports training samples"
            for case in newest
            if case not in fair
        }
        request_order = {id(case): number for number, case in enumerate(stored.cases)}
        fair.sort(key=lambda case: (case.presentation.kind != "measured", request_order[id(case)]))
        earlier = {case.name: case for case in scored}

        def score(case: Case) -> ScoredCase:
            chosen = set(case.competitors if models is None else [*models, REFERENCE_MODEL])
            names = [name for name in case.competitors if name in chosen]
            same = earlier.get(case.name)
            if same and same.scores.keys() <= {*names} <= {*same.scores, *same.missing}:
                return same
            data = stored.data_of(case.name.data_sha256)
            return with_reference(scored_case(case, names, key, data, seed))

        with_scores = [case for case in map(score, fair) if case.scores]
        if not with_scores:
            raise ConfigError(f"no model has a score of {key.text}")
        names = dict.fromkeys(name for case in with_scores for name in case.scores)
        return cls(key, tuple(with_scores), tuple(names), left_out, seed)

    def over(self, cases: Sequence[ScoredCase]) -> Answer:
        """Return the answer for some of the comparisons and the models with scores there."""
        names = [name for name in self.model_names if any(name in case.scores for case in cases)]
        return replace(self, cases=tuple(cases), model_names=tuple(names))

    @cached_property
    def robots(self) -> dict[str, list[ScoredCase]]:
        """Return comparisons by robot type; specimens and plans of a type are one robot."""
        return grouped(self.cases, lambda case: case.data.robot.name)

    @cached_property
    def datasets(self) -> dict[str, list[ScoredCase]]:
        """Return comparisons by data set without its specimen."""
        return grouped(self.cases, lambda case: family_of(case.name))

    @cached_property
    def columns(self) -> tuple[MatrixColumn, ...]:
        """Return the columns of the matrix by data set, measured ones first."""
        by_heading = grouped(
            self.cases, lambda case: (family_of(case.name), case.name.protocol, case.name.condition)
        )
        order = list(self.datasets)
        columns = [MatrixColumn(*name, tuple(of)) for name, of in by_heading.items()]
        return tuple(sorted(columns, key=lambda column: order.index(column.dataset)))

    def column_error(self, model: str, column: MatrixColumn) -> float | None:
        """Return a model's mean score over a column; None: a score is missing."""
        errors = [error for case in column.cases if (error := self.error(model, case)) is not None]
        return float(np.mean(errors)) if len(errors) == len(column.cases) else None

    def column_ratio(self, model: str, column: MatrixColumn) -> float | None:
        """Return the geometric mean of error / VJM's error; None: an error is missing."""
        ratios = [self.ratio(model, case) for case in column.cases]
        known_ratios = [ratio for ratio in ratios if ratio is not None]
        return (
            math.exp(float(np.mean(np.log(known_ratios))))
            if len(known_ratios) == len(ratios)
            else None
        )

    def column_noise(self, column: MatrixColumn) -> float | None:
        """Return the noise floor of a column, in the metric's unit; None: unknown."""
        floors = [floor for case in column.cases if (floor := self.noise(case)) is not None]
        return float(np.mean(floors)) if len(floors) == len(column.cases) else None

    def best_of(self, column: MatrixColumn) -> str | None:
        """Return the model with the best score of a column; None: no scores."""
        errors = {name: self.column_error(name, column) for name in self.model_names}
        scores = {
            name: self.key.sign * error for name, error in errors.items() if error is not None
        }
        return min(scores, key=lambda name: scores[name], default=None)

    @property
    def measured(self) -> dict[str, list[ScoredCase]]:
        """Return comparisons by measured data set."""
        return {name: cases for name, cases in self.datasets.items() if _is_measured(cases[0])}

    @cached_property
    def models(self) -> tuple[ModelAnswer, ...]:
        """Return the models, best first; models with missing scores come last."""
        answers = [self._model(name) for name in self.model_names]
        return tuple(sorted(answers, key=self._order))

    def _order(self, model: ModelAnswer) -> tuple[bool, float, str]:
        ratio = self.key.sign * model.median_error if model.ratio is None else model.ratio
        return model.n_cases < len(self.cases), ratio, model.name

    def error(self, model: str, case: ScoredCase) -> float | None:
        """Return a model's mean score in a comparison, in the metric's unit; None: no score."""
        return case.mean(model) if model in case.scores else None

    def ratio(self, model: str, case: ScoredCase) -> float | None:
        """Return error / VJM's error; None: an error is missing, or scores are not errors."""
        error, reference = self.error(model, case), self.error(REFERENCE_MODEL, case)
        if error is None or not reference or error <= 0.0 or self.key.sign < 0.0:
            return None
        return error / reference

    def best(self, case: ScoredCase) -> str:
        """Return the model with the best score in a comparison."""
        return min(case.models, key=lambda name: self.key.sign * case.mean(name))

    def verdict(
        self, model: str, case: ScoredCase, reference: str = REFERENCE_MODEL
    ) -> Verdict | None:
        """Return the verdict on a model ("a") and a reference ("b"); None: no test applies."""
        if model == reference or not {model, reference} <= case.scores.keys():
            return None
        verdicts = case.verdicts([(model, reference)])
        return None if verdicts is None else verdicts[0]

    def estimates(
        self, model: str, case: ScoredCase, reference: str = REFERENCE_MODEL
    ) -> list[Estimate]:
        """Return estimates of error(model) - error(reference), in the metric's unit.

        With several splits the first estimate is over splits; the last is over poses.
        """
        if self.key.is_cost or not {model, reference} <= case.scores.keys():
            return []
        pair = case.models.index(model), case.models.index(reference)
        return [
            estimate for (estimate,) in estimates(case.errors, [pair], Question(seed=self.seed))
        ]

    def mark(self, model: str, protocol: str = "") -> str:
        """Return the text printed next to a model's name, for one protocol or all."""
        cases = [scored.case for scored in self.cases if protocol in ("", scored.name.protocol)]
        marks = [
            mark_of(c.competitors[model].presentation) for c in cases if model in c.competitors
        ]
        return ", ".join(filter(None, dict.fromkeys(marks)))

    def fit_s(self, model: str, cases: Iterable[ScoredCase]) -> float | None:
        """Return the median fit time of a model in comparisons, s; None: not recorded."""
        costs = [result.cost for case in cases for result in case.results.get(model, ())]
        times = [cost.fit_s for cost in costs if cost is not None]
        return float(np.median(times)) if times else None

    def noise(self, case: ScoredCase) -> float | None:
        """Return the score of a perfect model (measurement noise); None: unknown."""
        values = self.key.of_splits(floor) if (floor := case.bound_results(NOISE_FLOOR)) else None
        return None if values is None else float(values.mean())

    def mean_ratio(self, model: str, cases: Iterable[ScoredCase]) -> float | None:
        """Return the geometric mean of ratios, with one vote per data set and protocol."""
        plans = grouped(cases, lambda case: (family_of(case.name), case.name.protocol))
        means = [self._mean_log(model, of_plan) for of_plan in plans.values()]
        logs = [mean for mean in means if mean is not None]
        return math.exp(float(np.mean(logs))) if logs else None

    def _mean_log(self, model: str, cases: Iterable[ScoredCase]) -> float | None:
        ratios = [ratio for case in cases if (ratio := self.ratio(model, case)) is not None]
        return float(np.mean(np.log(ratios))) if ratios else None

    @property
    def claim_robots(self) -> dict[str, list[ScoredCase]]:
        """Return the robots of the headline: measured ones if there are enough.

        Measured and simulated robots are never averaged. With fewer than `FEWEST_ROBOTS` of each
        kind the result is empty.
        """
        for is_measured in (True, False):
            robots = {
                name: of_kind
                for name, cases in self.robots.items()
                if (of_kind := [case for case in cases if _is_measured(case) == is_measured])
            }
            if len(robots) >= FEWEST_ROBOTS:
                return robots
        return {}

    @property
    def claim_scope(self) -> str:
        """Return number and kind of the headline's robots, such as "12 simulated robots"."""
        kinds = [cases[0].case.presentation.kind for cases in self.claim_robots.values()]
        return f"{len(kinds)} {kinds[0]} robots" if kinds else ""

    @cached_property
    def p_values(self) -> dict[str, float]:
        """Model with a ratio on every robot -> p-value against the VJM over robots, corrected."""
        rivals = [name for name in self.model_names if name != REFERENCE_MODEL]
        logs = {name: self._robot_logs(name) for name in rivals if self.claim_robots}
        complete = len(self.claim_robots)
        tested = {name: of_model for name, of_model in logs.items() if len(of_model) == complete}
        return corrected_p_values(tested)

    def _robot_logs(self, name: str) -> list[float]:
        """Return the logarithms of error / VJM's error of the robots on which the model ran."""
        return [
            math.log(ratio)
            for of_robot in (self.claim_robots or self.robots).values()
            if (ratio := self.mean_ratio(name, of_robot)) is not None
        ]

    def _model(self, name: str) -> ModelAnswer:
        cases = [case for case in self.cases if name in case.scores]
        ratios = [ratio for case in cases if (ratio := self.ratio(name, case)) is not None]
        logs = self._robot_logs(name)
        low, high = _interval(logs) if self.claim_robots else (None, None)
        return ModelAnswer(
            name,
            self.mark(name),
            float(np.median([case.mean(name) for case in cases])),
            math.exp(float(np.mean(logs))) if logs else None,
            *(low, high, min(ratios, default=None), max(ratios, default=None)),
            self.p_values.get(name, math.nan),
            Counter(verdict for case in cases if (verdict := self.verdict(name, case)) is not None),
            len(cases),
            self.fit_s(name, self.cases),
        )


def _is_measured(case: ScoredCase) -> bool:
    return case.case.presentation.kind == "measured"


def _interval(logs: Sequence[float]) -> tuple[float, float] | tuple[None, None]:
    """Return the bounds of a geometric mean over robots (Student's t of the logarithms)."""
    if len(logs) < FEWEST_ROBOTS:
        return None, None
    mean = mean_ratio(logs)
    return mean.low, mean.high
