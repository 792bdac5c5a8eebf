"""The scores of models in one case, and all verdicts on pairs of them.

Leaderboard, report page and compare (among all models) take verdicts from `ScoredCase.verdicts`.
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
from stiff_bench.tables.metric_table import bound_result_of, pooled_prediction
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.bootstrap import pose_errors
from stiff_protocols.scoring.paired import ROPE_M

SEED, SPECIMEN = "seed", "specimen"
"""Options of data sets for a repeat with new noise, and for another robot of the same type."""


def dataset_of(name: CaseName) -> str:
    """Return a data set's name without its seed."""
    return without_options(name.dataset, SEED)


def family_of(name: CaseName) -> str:
    """Return a data set's name without its seed and specimen."""
    return without_options(name.dataset, SEED, SPECIMEN)


@dataclass(frozen=True, eq=False, repr=False)
class ScoredCase(BriefFields):
    """A case with the scores of its ranked models.

    Attributes:
        case: stored results.
        key: metric that ranks the models.
        data: samples of the case's data set.
        seed: seed of the draws of poses.
        slots: splits that all ranked models have; only these count.
        results: results on these splits by ranked model, in order.
        scores: (J,) values on these splits by model, in the metric's unit; one value if the
            protocol scores all splits together.
        missing: reasons for a missing score, by model.
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
        """Return the name of the case."""
        return self.case.name

    @property
    def models(self) -> tuple[str, ...]:
        """Return the ranked models, sorted by name."""
        return tuple(sorted(self.scores))

    @cached_property
    def errors(self) -> SharedErrors:
        """Return the errors for the verdicts, with a column per model of `models`."""
        results = [self.results[model] for model in self.models]
        scores = [self.scores[model] for model in self.models]
        return shared_errors(self.key, results, scores, self.data, self.seed)

    @cached_property
    def _p_values(self) -> FloatArray | None:
        """Return (m, m) p-values of all pairs of `models`, corrected for all pairs."""
        return corrected_p_values(self.errors)

    def verdicts(
        self, pairs: Sequence[tuple[str, str]], question: Question | None = None
    ) -> list[Verdict] | None:
        """Return the verdicts on pairs of ranked models, corrected for all pairs.

        None: no test applies. The default question ignores differences up to `ROPE_M`.
        """
        if self.key.is_cost or self._p_values is None:
            return None
        place = {model: column for column, model in enumerate(self.models)}
        columns = [(place[a], place[b]) for a, b in pairs]
        p_values = [float(self._p_values[of_pair]) for of_pair in columns]
        question = question or Question(ROPE_M if self.key.metric.unit == "m" else 0.0)
        return decide_pairs(self.errors, columns, question, p_values)

    def bound_results(self, name: str) -> list[CellResult]:
        """Return results of a bound (a name of `BOUND_NAMES`) on these splits; or none."""
        for results in self.results.values():
            bounds = [bound_result_of(result, name) for result in results]
            if bounds and all(bound is not None for bound in bounds):
                return [bound for bound in bounds if bound is not None]
        return []

    def mean(self, model: str) -> float:
        """Return a model's mean over the splits, in the metric's unit."""
        return float(self.scores[model].mean())

    def like_best(self, models: Sequence[str]) -> set[str] | None:
        """Return the models that are not clearly worse than the best of them.

        None: no test applies. All given models must be ranked.
        """
        best = min(models, key=lambda model: self.key.sign * self.mean(model))
        other_models = [model for model in models if model != best]
        verdicts = self.verdicts([(best, model) for model in other_models])
        if verdicts is None:
            return None
        return {best} | {
            model for model, of in zip(other_models, verdicts, strict=True) if of != "a"
        }

    def failed(self, model: str) -> str:
        """Return "FAILED" or "SKIPPED" if a model was run without a result; else ""."""
        competitor = self.case.competitors.get(model)
        if model not in self.missing or competitor is None or not competitor.failures:
            return ""
        return _usual_failure(competitor).status.upper()

    @property
    def left_out(self) -> str:
        """Return a note on splits that do not count; "" if all count."""
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
    """Return the errors of models on the same splits, with a column per model.

    `scores` are the (J,) values of the key on J splits, or one value of splits scored together.
    Untested poses of the data set have no rows. Cases with different test poses of a data set thus
    share the draws.

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
    """Return the scores of the models that can be ranked.

    Only the splits that all ranked models have count. A model with fewer requested splits is ranked
    if it has them all. A model without a value is missing. A model with an unfinished run is
    missing, too, unless it has every split that the finished models share.

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
            "none, so they cannot be compared; leave one of them out or run it again"
        )
    for model in present:
        if len(results[model]) > len(slots):
            results[model] = case.results(model, slots)
            scores[model] = key.of_splits(results[model])
    values_by_model = {model: values for model in present if (values := scores[model]) is not None}
    counted_results = {model: results[model] for model in present}
    return ScoredCase(case, key, data, seed, slots, counted_results, values_by_model, missing)


def with_reference(scored: ScoredCase) -> ScoredCase:
    """Add the VJM's scores, which every cell contains, if the VJM was not run."""
    if REFERENCE_MODEL in scored.case.competitors or not scored.slots:
        return scored
    (first, *_) = scored.results.values()
    results = [bound_result_of(result, REFERENCE_MODEL) for result in first]
    of_reference = [result for result in results if result is not None]
    if len(of_reference) < len(results):
        return scored
    values = scored.key.of_splits(of_reference)
    done = dict(zip(scored.slots, of_reference, strict=True))
    competitor = Competitor(of_reference[0].presentation, done, failures={}, n_requested=len(done))
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
    """Return a record of a model's most frequent failure."""
    alike = grouped(competitor.failures.values(), lambda failure: failure.why_none)
    return max(alike.values(), key=len)[0]


def _unfinished(case: Case, models: Sequence[str]) -> dict[str, str]:
    """Return the models that are not ranked because their run is not finished."""
    competitors = {model: case.competitors[model] for model in models}
    unfinished = [
        model
        for model, competitor in competitors.items()
        if len(competitor.done) < competitor.n_requested
    ]
    finished = [model for model in models if model not in unfinished]
    needed = set(case.shared_slots(finished))
    return {
        model: f"{len(of_model.done)} of {of_model.n_requested} splits: run not finished"
        for model, of_model in competitors.items()
        if model in unfinished and (not finished or not needed <= of_model.done.keys())
    }


def correction_text(cases: Sequence[ScoredCase]) -> str:
    """Return a text about the correction of p-values in cases."""
    counts = {len(case.models) * (len(case.models) - 1) // 2 for case in cases}
    if counts == {1}:
        return "one pair, p needs no correction"
    number = f"{counts.pop()} " if len(counts) == 1 else ""
    return f"p corrected by Holm for all {number}pairs of models in a comparison"
