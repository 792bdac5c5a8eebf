"""`bench compare A B`: how much two models differ, axis by axis, and how sure that is."""

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
from stiff_bench.analysis.selection import EVERYTHING, Selection, competitor_meant
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
"""What is compared: the absolute error along each axis, and the length of the error vector."""


@dataclass(frozen=True)
class Row:
    """One kind of error of A and of B.

    Attributes:
        error: one of `ERRORS`.
        means: mean absolute errors of A and of B, m.
        over_splits: by the corrected t test; None where there is one split or all are pooled.
        over_poses: by the bootstrap over poses, with the fitted models held fixed.
        verdict: of all of them together; without splits it is of the fitted models alone.
    """

    error: str
    means: tuple[float, float]
    over_splits: Estimate | None
    over_poses: Estimate
    verdict: Verdict

    @property
    def difference(self) -> float:
        """A less B, m; negative where A is better."""
        return self.means[0] - self.means[1]

    @property
    def estimate(self) -> Estimate:
        """The estimate that is shown first: over splits where there is one."""
        return self.over_splits or self.over_poses

    @property
    def cautious(self) -> Estimate:
        """The estimate with the wider interval: the one to speak of where one alone is named."""
        return max(self.estimate, self.over_poses, key=lambda one: one.high - one.low)


@dataclass(frozen=True)
class Comparison:
    """A and B in one case.

    Attributes:
        a, b: what must stand beside their numbers.
        results: of A and of B, on the splits that both have.
        n_poses: that were tested.
        rows: one for each of `ERRORS`.
        missing: what A or B lacks, or both of what was asked for, one line each.
        among_all: the verdict as leaderboard and report page have it, p corrected for all pairs of
            models there; None: there are no others, or A or B does not take part in their ranking.
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
        """Name of the case."""
        return self.case.name

    @property
    def n_splits(self) -> int:
        """How many splits both have."""
        return len(self.results[0])

    def row(self, error: str) -> Row:
        """Return the row of one kind of error."""
        return self.rows[[*ERRORS].index(error)]

    @property
    def over_splits(self) -> bool:
        """Whether the spread over splits is known."""
        return self.rows[0].over_splits is not None

    @property
    def selects_on_test(self) -> bool:
        """Whether the protocol lets models choose on the test part."""
        return self.a.selects_on_test or self.b.selects_on_test


def paired_results(case: Case, a: str, b: str) -> tuple[list[CellResult], list[CellResult]]:
    """Return the results of two models of a case on the splits that both have.

    Raises:
        DataError: one has no results there, or they share no split.
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
    """Compare two models of a case on the splits that both have.

    Raises:
        DataError: one has no results there, they share no split, or one pose alone was tested.
    """
    results = paired_results(case, a, b)
    rows = np.concatenate([one.prediction.rows for one in results[0] if one.prediction])
    n_poses = len(np.unique(data.samples.pose_id[rows]))
    if n_poses < 2:
        raise DataError("a bootstrap over poses needs at least 2 poses, there is 1")
    return Comparison(
        case=case,
        a=case.competitors[a].shown,
        b=case.competitors[b].shown,
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
    except StoreError:  # two others share no split
        return None
    if len(scored.scores) < 3 or not {a, b} <= scored.scores.keys():
        return None
    verdicts = scored.verdicts([(a, b)], question)
    return verdicts[0] if verdicts else None


def _rows(
    results: Sequence[Sequence[CellResult]], data: StoredData, question: Question
) -> Iterator[Row]:
    """Yield the rows with their verdicts; over splits too where there are several."""
    means, found = [], []
    for key in ERRORS.values():
        a, b = (key.of_splits(of_model) for of_model in results)
        if a is None or b is None:
            raise DataError(f"no value of {key.text}")
        means.append((float(a.mean()), float(b.mean())))
        errors = shared_errors(key, results, [a, b], data, question.seed)
        of_methods = estimates(errors, [(0, 1)], question, all_p_values=True)
        found.append([estimate for (estimate,) in of_methods])
    # the axes are corrected for one another (Holm); the length is a question of its own
    by_method = [[*corrected(of_axes), length] for *of_axes, length in zip(*found, strict=True)]
    for error, of_both, *of_row in zip(ERRORS, means, *by_method, strict=True):
        over_splits = of_row[0] if len(of_row) > 1 else None
        yield Row(error, of_both, over_splits, of_row[-1], decide(of_row, question.confidence))


def _missing(case: Case, a: str, b: str) -> Iterator[str]:
    """Yield how many splits were never run, on how many A or B has no result, and why."""
    both = [case.competitors[name] for name in (a, b)]
    run = {slot for one in both for slot in (*one.done, *one.failures)}
    asked = max(one.n_asked for one in both)
    if len(run) < asked:
        yield f"{len(run)} of {asked} splits asked for were run"
    for one in both:
        lacking = sorted(run - one.done.keys())
        failures = [one.failures.get(slot) for slot in lacking]
        reasons = dict.fromkeys(failure.why_none if failure else "not run" for failure in failures)
        if lacking:
            yield f"{one.name} lacks {len(lacking)} of {len(run)} splits ({'; '.join(reasons)})"


@dataclass(frozen=True)
class ModelComparison:
    """Two models wherever both were run.

    Attributes:
        a, b: names.
        comparisons: one a case; at least one.
        where: all places and who is better there, if there is one case.
        notes: what could not be compared, and what was left out.
        provenance: which stiffbench made the results.
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
    """Compare two models in every case shown in which both have results on the same splits.

    Raises:
        ConfigError: a name is unknown, A is B, or they were never run on the same.
        StoreError: the folder holds no results, or corrupt ones.
    """
    stored = StoredResults.read(folder)
    a, b = (competitor_meant(word, stored.cases) for word in (a, b))
    if a == b:
        raise ConfigError(f"compare {a!r} with another model than itself")
    chosen = selection.cases_of(stored.cases)
    chosen.sort(key=lambda case: (natural_key(case.name.text), case.name))
    called = labels(one.name for one in chosen)
    run = {name: [called[one.name] for one in chosen if name in one.competitors] for name in (a, b)}
    data_of = stored.data_of
    comparisons, notes = list[Comparison](), list[str]()
    for case in chosen:
        if not {a, b} <= case.competitors.keys():
            continue
        if case.competitors[a].shown.reports_training:
            notes.append(f"not compared: {called[case.name]}: {TRAINING_MARK}.")
            continue
        data = data_of(case.name.data_sha256)
        try:
            comparisons.append(compare(case, a, b, data, question))
        except DataError as error:
            notes.append(f"not compared: {called[case.name]}: {error}.")
    if not comparisons:
        where_run = "; ".join(f"{name} was run in {_named(places)}" for name, places in run.items())
        others = "".join(f"; {line}" for line in same_name_other_data(chosen, data_of))
        raise ConfigError(
            " ".join(notes) or f"{a} and {b} have no comparison in common: {where_run}{others}"
        )
    for name, other in ((a, b), (b, a)):
        if alone := [place for place in run[name] if place not in run[other]]:
            notes.append(f"{name} alone was run in {_named(alone)}.")
    where = []
    if len(comparisons) == 1:
        (only,) = comparisons
        where = where_better(*only.results, data_of(only.name.data_sha256), question)
    shared = [one.case for one in comparisons]
    counts = {
        name: Counter(result.run_id for one in comparisons for result in one.results[number])
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
