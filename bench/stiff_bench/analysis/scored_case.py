"""The scores of models in one case: who takes part, and all verdicts on pairs of them.

`ScoredCase.verdicts` is what leaderboard, report page and, of all models, compare say of a pair.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from stiff_bench.analysis.collected import Case, Competitor, test_share
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.analysis.verdict import (
    Question,
    SharedErrors,
    Verdict,
    corrected_p_values,
    decide_pairs,
)
from stiff_bench.store.names import CaseName, grouped, without_options
from stiff_bench.store.newest import Slot
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.metric_table import known_result, pooled_prediction
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.bootstrap import pose_errors
from stiff_protocols.scoring.paired import ROPE_M

SEED, SPECIMEN = "seed", "specimen"
"""Options of data sets that only repeat one, and that make another robot of its type."""


def dataset_of(name: CaseName) -> str:
    """Return a data set's name without the option that only repeats it."""
    return without_options(name.dataset, SEED)


def family_of(name: CaseName) -> str:
    """Return a data set's name without the options that make another robot of its type."""
    return without_options(name.dataset, SEED, SPECIMEN)


@dataclass(frozen=True, eq=False, repr=False)
class ScoredCase(BriefFields):
    """A case with the scores of those who take part in it.

    Attributes:
        case: the stored results.
        key: what they are ranked by.
        data: the samples of the case's data set.
        seed: of the draws of poses.
        slots: the splits that all who take part have; they alone count.
        results: model that takes part -> its results on these splits, in order.
        scores: model -> (J,) its value on each of these splits, in the metric's unit; one value
            where the protocol scores all splits together.
        missing: model -> why it has no score.
    """

    case: Case
    key: SortKey
    data: StoredData
    seed: int
    slots: tuple[Slot, ...]
    results: Mapping[str, Sequence[CellResult]]
    scores: Mapping[str, FloatArray]
    missing: Mapping[str, str]

    @property
    def name(self) -> CaseName:
        """Name of the case."""
        return self.case.name

    @property
    def models(self) -> tuple[str, ...]:
        """The models that take part, in the order of their names."""
        return tuple(sorted(self.scores))

    @cached_property
    def errors(self) -> SharedErrors:
        """Errors that the verdicts are made from, a column for each of `models`."""
        results = [self.results[model] for model in self.models]
        scores = [self.scores[model] for model in self.models]
        return shared_errors(self.key, results, scores, self.data, self.seed)

    @cached_property
    def _p_values(self) -> FloatArray | None:
        """(m, m) p-values of all pairs of `models`, corrected for one another."""
        return corrected_p_values(self.errors)

    def verdicts(
        self, pairs: Sequence[tuple[str, str]], question: Question | None = None
    ) -> list[Verdict] | None:
        """Return the verdicts on pairs of models that take part, corrected for all their pairs.

        None: no test applies. Without a question a difference of `ROPE_M` makes none in practice.
        """
        if self.key.is_cost or self._p_values is None:
            return None
        place = {model: column for column, model in enumerate(self.models)}
        columns = [(place[a], place[b]) for a, b in pairs]
        p_values = [float(self._p_values[of_pair]) for of_pair in columns]
        question = question or Question(ROPE_M if self.key.metric.unit == "m" else 0.0)
        return decide_pairs(self.errors, columns, question, p_values)

    def known(self, name: str) -> list[CellResult]:
        """Return what a simulation knows on these splits, a name of `KNOWN`; else nothing."""
        for results in self.results.values():
            bounds = [known_result(result, name) for result in results]
            if bounds and all(bound is not None for bound in bounds):
                return [bound for bound in bounds if bound is not None]
        return []

    def mean(self, model: str) -> float:
        """Return a model's mean over the splits, in the metric's unit."""
        return float(self.scores[model].mean())

    def like_best(self, models: Sequence[str]) -> set[str] | None:
        """Return which of these models are not found worse than the best of them.

        None: no test applies. All of them take part.
        """
        best = min(models, key=lambda model: self.key.sign * self.mean(model))
        others = [model for model in models if model != best]
        verdicts = self.verdicts([(best, other) for other in others])
        if verdicts is None:
            return None
        return {best} | {one for one, of in zip(others, verdicts, strict=True) if of != "a"}

    def failed(self, model: str) -> str:
        """Return "FAILED" or "SKIPPED" where a model was run and gave no result; else ""."""
        competitor = self.case.competitors.get(model)
        if model not in self.missing or competitor is None or not competitor.failures:
            return ""
        return _usual_failure(competitor).status.upper()

    @property
    def left_out(self) -> str:
        """Which splits do not count, for people; "" where all do."""
        every = {slot for model in self.scores for slot in self.case.competitors[model].done}
        n_count, n_all = len(self.slots), len(every)
        return f"only the {n_count} of {n_all} splits that all have count" * (n_all > n_count)


def shared_errors(
    key: SortKey,
    results: Sequence[Sequence[CellResult]],
    scores: Sequence[FloatArray],
    data: StoredData,
    seed: int,
) -> SharedErrors:
    """Return the errors of models on the same splits, a column each.

    `scores` are the (J,) values of the key on J splits, or one of splits scored together. A pose of
    the data set that is not tested has no rows, so that cases with different test poses of one data
    set are drawn together.

    Raises:
        DataError: the models were not tested on the same rows.
    """
    columns = np.column_stack(scores)  # (J, m)
    of_poses = None
    if key.resamples:
        predictions = [pooled_prediction(of_model) for of_model in results]
        rows = predictions[0].rows
        if not all(np.array_equal(rows, prediction.rows) for prediction in predictions):
            raise DataError("only models that were tested on the same rows can be compared")
        errors = np.column_stack([key.of_rows(prediction) for prediction in predictions])
        of_poses = pose_errors(data.samples.pose_id, errors, rows)
    return SharedErrors(
        of_splits=key.sign * columns if len(columns) > 1 else None,
        test_share=test_share(results[0], data),
        of_poses=of_poses,
        seed=seed,
    )


def scored_case(
    case: Case, models: Sequence[str], key: SortKey, data: StoredData, seed: int
) -> ScoredCase:
    """Return who of the models takes part, and with which scores.

    A model that was asked for fewer splits, and has them all, takes part, and only the splits that
    all have count. One that lacks a value is missing, and so is one whose run did not come to its
    end, unless it has every split that the finished ones share: it takes none from the others.

    Raises:
        StoreError: two models have no split in common.
    """
    results: dict[str, Sequence[CellResult]] = {
        model: case.results(model)
        for model in models
        if model in case.competitors and not case.competitors[model].failures
    }
    scores = {model: key.of_splits(of_model) for model, of_model in results.items()}
    missing = {
        model: reason for model in models if (reason := _why_missing(case, model, scores, key))
    }
    missing |= _unfinished(case, [model for model in models if model not in missing])
    present = [model for model in models if model not in missing]
    slots = tuple(case.shared_slots(present)) if present else ()
    if present and not slots:
        pairs = combinations(present, 2)
        apart = next((pair for pair in pairs if not case.shared_slots(pair)), present)
        raise StoreError(
            f"{case.name.text}: {' and '.join(apart)} were run on different splits and share "
            "none, so they cannot be compared; leave one out or run it anew"
        )
    for model in present:
        if len(results[model]) > len(slots):
            results[model] = case.results(model, slots)
            scores[model] = key.of_splits(results[model])
    known = {model: values for model in present if (values := scores[model]) is not None}
    counting = {model: results[model] for model in present}
    return ScoredCase(case, key, data, seed, slots, counting, known, missing)


def with_reference(scored: ScoredCase) -> ScoredCase:
    """Return a case with the VJM's scores, which every cell holds, where the VJM was not run."""
    if REFERENCE_MODEL in scored.case.competitors or not scored.slots:
        return scored
    (first, *_) = scored.results.values()
    results = [known_result(result, REFERENCE_MODEL) for result in first]
    of_reference = [result for result in results if result is not None]
    if len(of_reference) < len(results):
        return scored
    values = scored.key.of_splits(of_reference)
    done = dict(zip(scored.slots, of_reference, strict=True))
    competitor = Competitor(of_reference[0].shown, done, failures={}, n_asked=len(done))
    competitors = {**scored.case.competitors, REFERENCE_MODEL: competitor}
    return replace(
        scored,
        case=replace(scored.case, competitors=competitors),
        results={**scored.results, REFERENCE_MODEL: of_reference},
        scores=scored.scores if values is None else {**scored.scores, REFERENCE_MODEL: values},
    )


def _why_missing(
    case: Case, model: str, values: Mapping[str, FloatArray | None], key: SortKey
) -> str:
    competitor = case.competitors.get(model)
    if competitor is None:
        return "not run"
    if competitor.failures:
        usual, n_failed = _usual_failure(competitor), len(competitor.failures)
        where = f"{n_failed} of {n_failed + len(competitor.done)} splits"
        return f"{usual.status.upper()} in {where}: {' '.join(usual.failure.split())}"
    return f"no value of {key.text}" if values[model] is None else ""


def _usual_failure(competitor: Competitor) -> CellResult:
    """Return a record of the failure that most of its splits have."""
    alike = grouped(competitor.failures.values(), lambda one: one.why_none)
    return max(alike.values(), key=len)[0]


def _unfinished(case: Case, models: Sequence[str]) -> dict[str, str]:
    """Return which of these models take no part because their run did not come to its end."""
    found = {model: case.competitors[model] for model in models}
    unfinished = [model for model, one in found.items() if len(one.done) < one.n_asked]
    finished = [model for model in models if model not in unfinished]
    needed = set(case.shared_slots(finished))
    return {
        model: f"{len(found[model].done)} of {found[model].n_asked} splits: run not finished"
        for model in unfinished
        if not finished or not needed <= found[model].done.keys()
    }


def correction_text(cases: Sequence[ScoredCase]) -> str:
    """Return how the verdicts on pairs of models are corrected in some cases, for people."""
    counts = {len(case.models) * (len(case.models) - 1) // 2 for case in cases}
    if counts == {1}:
        return "one pair, p needs no correction"
    number = f"{counts.pop()} " if len(counts) == 1 else ""
    return f"p corrected by Holm for all {number}pairs of models in a comparison"
