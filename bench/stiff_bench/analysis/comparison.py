"""`bench compare A B`: the difference of two models per axis, and its uncertainty."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiff_bench.analysis.collected import (
    Case,
    StoredResults,
    left_out_notes,
    same_name_other_data,
)
from stiff_bench.analysis.scored_case import scored_case, shared_errors, with_reference
from stiff_bench.analysis.selection import EVERYTHING, Selection, resolve_model_name
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.analysis.verdict import (
    Estimate,
    Question,
    Verdict,
    corrected,
    decide,
    estimates,
)
from stiff_bench.analysis.where import Place, where_better
from stiff_bench.store.names import CaseName, labels, natural_key
from stiff_bench.store.samples import StoredData
from stiff_bench.store.versions import differing_libraries, sources
from stiff_bench.tables.metric_table import TRAINING_MARK
from stiff_bench.tables.units import first_few
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError
from stiff_protocols.contract.record import CellResult, Presentation
from stiff_protocols.contract.types import AXES

NORM = "norm"
ERRORS = {**{axis: sort_key("mae", axis) for axis in AXES}, NORM: sort_key(NORM, None)}
"""Compared errors: the absolute error along each axis, and the length of the error vector."""


@dataclass(frozen=True)
class Row:
    """One kind of error of A and of B.

    Attributes:
        error: one of `ERRORS`.
        means: mean absolute errors of A and of B, m.
        over_splits: estimate of the corrected t test; None with one split or pooled splits.
        over_poses: estimate of the bootstrap over poses, with the fitted models held fixed.
        verdict: verdict of all estimates; without splits it holds only for the fitted models.
    """

    error: str
    means: tuple[float, float]
    over_splits: Estimate | None
    over_poses: Estimate
    verdict: Verdict

    @property
    def difference(self) -> float:
        """Return A minus B, m; negative if A is better."""
        return self.means[0] - self.means[1]

    @property
    def estimate(self) -> Estimate:
        """Return the estimate over splits if there is one, else over poses."""
        return self.over_splits or self.over_poses

    @property
    def cautious(self) -> Estimate:
        """Return the estimate with the wider interval, for texts with a single interval."""
        return max(
            self.estimate, self.over_poses, key=lambda estimate: estimate.high - estimate.low
        )


@dataclass(frozen=True)
class Comparison:
    """A and B in one case.

    Attributes:
        a, b: labels and warnings that are printed with their numbers.
        results: results of A and of B on their common splits.
        n_poses: number of tested poses.
        rows: one row per entry of `ERRORS`.
        missing: lines about requested splits without a result of A or B.
        among_all: verdict on leaderboard and report page, with p corrected for all pairs of models.
            None without other models, or if A or B is not ranked.
    """

    case: Case
    a: Presentation
    b: Presentation
    results: tuple[Sequence[CellResult], Sequence[CellResult]]
    n_poses: int
    rows: tuple[Row, ...]
    missing: tuple[str, ...]
    among_all: Verdict | None

    @property
    def name(self) -> CaseName:
        """Return the name of the case."""
        return self.case.name

    @property
    def n_splits(self) -> int:
        """Return the number of common splits."""
        return len(self.results[0])

    def row(self, error: str) -> Row:
        """Return the row of one kind of error."""
        return self.rows[[*ERRORS].index(error)]

    @property
    def over_splits(self) -> bool:
        """Return True if the spread over splits is known."""
        return self.rows[0].over_splits is not None

    @property
    def selects_on_test(self) -> bool:
        """Return True if the protocol lets models use the test part for a choice."""
        return self.a.selects_on_test or self.b.selects_on_test


def paired_results(case: Case, a: str, b: str) -> tuple[list[CellResult], list[CellResult]]:
    """Return the results of two models on their common splits of a case.

    Raises:
        DataError: a model has no results there, or they share no split.
    """
    for name in (a, b):
        if not case.competitors[name].done:
            first = next(iter(case.competitors[name].failures.values()))
            raise DataError(f"{name} has no result ({first.why_none})")
    slots = case.shared_slots([a, b])
    if not slots:
        raise DataError(f"{a} and {b} have no result on the same split")
    return case.results(a, slots), case.results(b, slots)


def compare(case: Case, a: str, b: str, data: StoredData, question: Question) -> Comparison:
    """Compare two models on their common splits of a case.

    Raises:
        DataError: a model has no results there, they share no split, or only one pose was tested.
    """
    results = paired_results(case, a, b)
    rows = np.concatenate([result.prediction.rows for result in results[0] if result.prediction])
    n_poses = len(np.unique(data.samples.pose_id[rows]))
    if n_poses < 2:
        raise DataError("a bootstrap over poses needs at least 2 poses, there is 1")
    return Comparison(
        case=case,
        a=case.competitors[a].presentation,
        b=case.competitors[b].presentation,
        results=results,
        n_poses=n_poses,
        rows=tuple(_rows(results, data, question)),
        missing=tuple(_missing(case, a, b)),
        among_all=_among_all(case, a, b, data, question),
    )


def _among_all(case: Case, a: str, b: str, data: StoredData, question: Question) -> Verdict | None:
    try:
        every = [*case.competitors]
        scored = with_reference(scored_case(case, every, ERRORS[NORM], data, question.seed))
    except StoreError:  # two other models share no split
        return None
    if len(scored.scores) < 3 or not {a, b} <= scored.scores.keys():
        return None
    verdicts = scored.verdicts([(a, b)], question)
    return verdicts[0] if verdicts else None


def _rows(
    results: Sequence[Sequence[CellResult]], data: StoredData, question: Question
) -> Iterator[Row]:
    """Yield the rows with their verdicts; with several splits also over splits."""
    means, row_estimates = [], []
    for key in ERRORS.values():
        a, b = (key.of_splits(of_model) for of_model in results)
        if a is None or b is None:
            raise DataError(f"no value of {key.text}")
        means.append((float(a.mean()), float(b.mean())))
        errors = shared_errors(key, results, [a, b], data, question.seed)
        of_methods = estimates(errors, [(0, 1)], question, all_p_values=True)
        row_estimates.append([estimate for (estimate,) in of_methods])
    # the axes are corrected for each other (Holm); the length is a separate question
    by_method = [
        [*corrected(of_axes), length] for *of_axes, length in zip(*row_estimates, strict=True)
    ]
    for error, of_both, *of_row in zip(ERRORS, means, *by_method, strict=True):
        over_splits = of_row[0] if len(of_row) > 1 else None
        yield Row(error, of_both, over_splits, of_row[-1], decide(of_row, question.confidence))


def _missing(case: Case, a: str, b: str) -> Iterator[str]:
    """Yield lines about splits without a result of A or B, with the reasons."""
    competitors = [case.competitors[name] for name in (a, b)]
    run = {slot for competitor in competitors for slot in (*competitor.done, *competitor.failures)}
    n_requested = max(competitor.n_requested for competitor in competitors)
    if len(run) < n_requested:
        yield f"{len(run)} of {n_requested} requested splits were run"
    for competitor in competitors:
        missing_slots = sorted(run - competitor.done.keys())
        failures = [competitor.failures.get(slot) for slot in missing_slots]
        reasons = dict.fromkeys(failure.why_none if failure else "not run" for failure in failures)
        if missing_slots:
            n_missing = f"{len(missing_slots)} of {len(run)} splits"
            yield f"{competitor.name} has no result on {n_missing} ({'; '.join(reasons)})"


@dataclass(frozen=True)
class ModelComparison:
    """Two models in all cases in which both were run.

    Attributes:
        a, b: names.
        comparisons: one per case; at least one.
        where: all subgroups with the better model, if there is only one case.
        notes: cases that were not compared, and results that do not count.
        provenance: versions of stiffbench that made the results.
    """

    a: str
    b: str
    question: Question
    comparisons: tuple[Comparison, ...]
    where: tuple[Place, ...]
    notes: tuple[str, ...]
    provenance: tuple[str, ...]


def compare_folder(
    folder: Path,
    a: str,
    b: str,
    question: Question,
    selection: Selection = EVERYTHING,
) -> ModelComparison:
    """Compare two models in every selected case with common splits.

    Raises:
        ConfigError: a name is unknown, A is B, or they have no case in common.
        StoreError: the folder holds no results, or corrupt ones.
    """
    stored = StoredResults.read(folder)
    a, b = (resolve_model_name(word, stored.cases) for word in (a, b))
    if a == b:
        raise ConfigError(f"both models are {a!r}; give two different models")
    chosen = selection.cases_of(stored.cases)
    chosen.sort(key=lambda case: (natural_key(case.name.text), case.name))
    case_labels = labels(case.name for case in chosen)
    run = {
        name: [case_labels[case.name] for case in chosen if name in case.competitors]
        for name in (a, b)
    }
    data_of = stored.data_of
    comparisons, notes = list[Comparison](), list[str]()
    for case in chosen:
        if not {a, b} <= case.competitors.keys():
            continue
        if case.competitors[a].presentation.reports_training:
            notes.append(f"not compared: {case_labels[case.name]}: {TRAINING_MARK}.")
            continue
        data = data_of(case.name.data_sha256)
        try:
            comparisons.append(compare(case, a, b, data, question))
        except DataError as error:
            notes.append(f"not compared: {case_labels[case.name]}: {error}.")
    if not comparisons:
        where_run = "; ".join(f"{name} was run in {_named(places)}" for name, places in run.items())
        data_notes = "".join(f"; {line}" for line in same_name_other_data(chosen, data_of))
        raise ConfigError(
            " ".join(notes) or f"{a} and {b} have no comparison in common: {where_run}{data_notes}"
        )
    for name, other_name in ((a, b), (b, a)):
        if places := [place for place in run[name] if place not in run[other_name]]:
            notes.append(f"only {name} was run in {_named(places)}.")
    where = []
    if len(comparisons) == 1:
        (comparison,) = comparisons
        where = where_better(*comparison.results, data_of(comparison.name.data_sha256), question)
    shared = [comparison.case for comparison in comparisons]
    counts = {
        name: Counter(
            result.run_id for comparison in comparisons for result in comparison.results[number]
        )
        for number, name in enumerate((a, b))
    }
    return ModelComparison(
        a=a,
        b=b,
        question=question,
        comparisons=tuple(comparisons),
        where=tuple(where),
        notes=(
            *notes,
            *same_name_other_data(shared, data_of),
            *left_out_notes(shared),
            *differing_libraries(stored.runs, counts),
        ),
        provenance=(sources(folder, stored.runs, counts[a] + counts[b]),),
    )


def _named(names: Sequence[str]) -> str:
    return first_few([f"({name})" for name in names]) or "none of these"
