"""How models stand in one contest: their ranks, and who is like the best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stiff_bench.analysis.collected import Competitor, Contest, split_sizes
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.database import read_data
from stiff_bench.store.names import ContestName, grouped
from stiff_bench.store.newest import Slot
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.table import pooled_prediction
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray, IntArray, TextArray
from stiff_protocols.scoring.bootstrap import PoseErrors, resampled_means
from stiff_protocols.scoring.paired import LEVEL, corrected_t, holm, ranked, wilcoxon_signed_rank

NOT_RUN = "not run"
NOT_FINISHED = "run not finished"


@dataclass(frozen=True, eq=False)
class Field:
    """Who takes part in a contest.

    Attributes:
        contest: the stored results.
        slots: the splits that all who take part have; no other counts.
        scores: model -> (J,) its value on each of these splits, in the metric's unit; one value
            where the protocol scores all splits together.
        missing: model -> why it has no score.
    """

    contest: Contest
    slots: tuple[Slot, ...]
    scores: Mapping[str, FloatArray]
    missing: Mapping[str, str]

    @property
    def name(self) -> ContestName:
        """What all results share."""
        return self.contest.name

    def mean(self, model: str) -> float:
        """Return a model's mean over the splits, in the metric's unit."""
        return float(self.scores[model].mean())

    def results(self, model: str) -> list[CellResult]:
        """Return a model's results on the splits that count."""
        return self.contest.results(model, self.slots)

    def failed(self, model: str) -> str:
        """Return "FAILED" or "SKIPPED" where a model was run and gave no result; else ""."""
        competitor = self.contest.competitors.get(model)
        if model not in self.missing or competitor is None or not competitor.failures:
            return ""
        return _usual_failure(competitor).status.upper()

    @property
    def left_out(self) -> str:
        """Which splits do not count, for people; "" where all do."""
        present = {model: self.contest.competitors[model].done for model in self.scores}
        n_all = len({slot for done in present.values() for slot in done})
        if n_all == len(self.slots):
            return ""
        lacking = [
            f"{model} lacks {n_all - len(done)}"
            for model, done in present.items()
            if len(done) < n_all
        ]
        return (
            f"only the {len(self.slots)} of {n_all} splits count that all models have "
            f"({', '.join(lacking)})"
        )


def field_of(
    contest: Contest, models: Sequence[str], key: SortKey, asked: Set[str] = frozenset()
) -> Field:
    """Return who of the models takes part, and with which scores.

    A model that was asked for fewer splits, and has them all, takes part, and only the splits that
    all have count. One that lacks a value is missing, and so is one whose run did not come to its
    end, unless it has every split that the finished ones share: it takes none from the others.

    Args:
        contest: the stored results.
        models: by name.
        key: what they are ranked by.
        asked: keys of the cells that the folder's runs were asked for.

    Raises:
        StoreError: two models have no split in common.
    """
    whole = {
        model: key.of_splits(contest.results(model))
        for model in models
        if model in contest.competitors and not contest.competitors[model].failures
    }
    missing = {
        model: reason for model in models if (reason := _why_missing(contest, model, whole, key))
    }
    missing |= _unfinished(contest, [model for model in models if model not in missing], asked)
    present = [model for model in models if model not in missing]
    slots = tuple(contest.shared_slots(present)) if present else ()
    if present and not slots:
        _refuse(contest, present)
    found = {
        model: whole[model]
        if len(slots) == len(contest.competitors[model].done)
        else key.of_splits(contest.results(model, slots))
        for model in present
    }
    scores = {model: values for model, values in found.items() if values is not None}
    return Field(contest, slots, scores, missing)


def complete_models(fields: Sequence[Field]) -> tuple[str, ...]:
    """Return the models that have a score in all of these contests, in the order of their names."""
    return tuple(sorted(set.intersection(*(set(field.scores) for field in fields))))


def _why_missing(
    contest: Contest, model: str, values: Mapping[str, FloatArray | None], key: SortKey
) -> str:
    competitor = contest.competitors.get(model)
    if competitor is None:
        return NOT_RUN
    if competitor.failures:
        usual = _usual_failure(competitor)
        n_failed = len(competitor.failures)
        n_all = n_failed + len(competitor.done)
        said = " ".join(usual.failure.split())
        return f"{usual.status.upper()} in {n_failed} of {n_all} splits: {said}"
    return f"no value of {key.text}" if values[model] is None else ""


def _usual_failure(competitor: Competitor) -> CellResult:
    """Return a record of the failure that most of its splits have."""
    alike = grouped(competitor.failures.values(), lambda one: one.why_none)
    return max(alike.values(), key=len)[0]


def _unfinished(contest: Contest, models: Sequence[str], asked: Set[str]) -> dict[str, str]:
    """Return which of these models take no part because their run did not come to its end."""
    why = {model: _why_unfinished(contest, contest.competitors[model], asked) for model in models}
    finished = [model for model in models if not why[model]]
    needed = set(contest.shared_slots(finished))
    return {
        model: reason
        for model, reason in why.items()
        if reason and not (finished and needed <= contest.competitors[model].done.keys())
    }


def _why_unfinished(contest: Contest, competitor: Competitor, asked: Set[str]) -> str:
    n_done = len(competitor.done)
    if n_done < competitor.n_asked:
        return f"{n_done} of {competitor.n_asked} splits asked for: {NOT_FINISHED}"
    return NOT_FINISHED if _asked_for_more(contest, competitor, asked) else ""


def _asked_for_more(contest: Contest, competitor: Competitor, asked: Set[str]) -> bool:
    """Say whether a model was to be run on more of the others' splits and was not."""
    own = {result.cell.coverage: result.cell for result in competitor.done.values()}
    return any(
        replace(cell, split_index=slot[0], split_sha256=slot[1], rows_sha256=rows_sha256).key
        in asked
        for slot, rows_sha256 in contest.rows_sha256.items()
        if slot not in competitor.done
        for cell in own.values()
    )


def _refuse(contest: Contest, models: Sequence[str]) -> None:
    apart = [pair for pair in combinations(models, 2) if not contest.shared_slots(pair)]
    named = apart[0] if apart else tuple(models)
    raise StoreError(
        f"{contest.name.text}: {' and '.join(named)} were run on different splits and share none, "
        "so they cannot be compared; leave one out (--model) or run it anew"
    )


BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Standing:
    """How some models stand in a contest; all of them take part in it.

    Attributes:
        field: the contest.
        models: in the order of the arrays.
        key: what they are ranked by.
        data: the samples of the contest's data set.
        seed: of the draws of poses.
    """

    field: Field
    models: tuple[str, ...]
    key: SortKey
    data: StoredData
    seed: int

    @cached_property
    def scores(self) -> FloatArray:
        """The (m,) means over the splits, in the metric's unit."""
        return np.array([self.field.mean(model) for model in self.models])

    @cached_property
    def ranks(self) -> FloatArray:
        """The (m,) ranks among these models: 1 is the best, ties share their mean rank."""
        return ranked(self.key.sign * self.scores)

    @cached_property
    def is_best(self) -> BoolArray:
        """(m,) whether a model has the best score, alone or with others."""
        return np.asarray(self.ranks == self.ranks.min())

    @cached_property
    def _pose_errors(self) -> list[PoseErrors] | None:
        """The models' errors on all poses of the data set; None: the metric is no mean over rows.

        A pose that is not tested here has no rows, so that contests with different test poses of
        one data set are drawn together.
        """
        if not self.key.resamples:
            return None
        poses, pose_of_row = np.unique(self.data.samples.pose_id, return_inverse=True)
        return [self._errors_of(model, poses, pose_of_row) for model in self.models]

    def _errors_of(self, model: str, poses: TextArray, pose_of_row: IntArray) -> PoseErrors:
        found = pooled_prediction(self.field.results(model))
        pose, errors = pose_of_row[found.rows], self.key.of_rows(found)
        totals = np.bincount(pose, weights=errors, minlength=len(poses)).astype(np.float64)
        return PoseErrors(poses, totals[:, None], np.bincount(pose, minlength=len(poses)))

    @cached_property
    def drawn_means(self) -> FloatArray | None:
        """The (B, m) mean errors on draws of the data set's poses; None: the metric has none.

        NaN where a draw holds no tested pose.
        """
        if self._pose_errors is None:
            return None
        with np.errstate(invalid="ignore"):
            return resampled_means(self._pose_errors, seed=self.seed)

    @cached_property
    def drawn_ranks(self) -> FloatArray | None:
        """The (B, m) ranks on the same draws; NaN where a draw holds no tested pose."""
        means = self.drawn_means
        return None if means is None else ranked(means)

    @cached_property
    def like_best(self) -> BoolArray | None:
        """(m,) whether a model cannot be told from the best; None: no test applies, as to costs.

        The rule of `bench compare`: a difference is found by the corrected t over splits, or by
        Wilcoxon's test over poses where there is one split or all are scored together; p is
        corrected for all models (Holm, at `LEVEL`). And where poses can be drawn, no more than
        `LEVEL` of the draws, both tails together, turn it round. Draws are not corrected: among
        many models Holm would ask for rarer events than they hold.
        """
        if self.key.is_cost:
            return None
        best = int(np.argmax(self.is_best))
        others = [index for index in range(len(self.models)) if index != best]
        p_values = [self._p_value(index, best) for index in others]
        known = [p for p in p_values if p is not None]
        if len(known) < len(others):
            return None
        like = np.ones(len(self.models), dtype=np.bool_)
        if others:
            apart_in_draws = [self._apart_in_draws(index, best) for index in others]
            like[others] = (holm(known) >= LEVEL) | ~np.array(apart_in_draws)
        return like

    def _p_value(self, index: int, best: int) -> float | None:
        """Return the p-value of a difference, not corrected; None where no test applies."""
        a, b = (self.field.scores[self.models[i]] for i in (index, best))
        if len(a) > 1:
            results = self.field.results(self.models[0])
            share = split_sizes(results, len(self.data.samples)).test_share
            return corrected_t(a - b, share).p_value
        if self._pose_errors is None:
            return None
        one, other = self._pose_errors[index], self._pose_errors[best]
        tested = one.counts > 0
        return wilcoxon_signed_rank((one.totals - other.totals)[tested, 0] / one.counts[tested])

    def _apart_in_draws(self, index: int, best: int) -> bool:
        if self.drawn_means is None:
            return True
        drawn = self.drawn_means[:, index] - self.drawn_means[:, best]
        drawn = drawn[np.isfinite(drawn)]
        tail = min(np.count_nonzero(drawn <= 0.0), np.count_nonzero(drawn >= 0.0))
        return bool(2.0 * (1 + tail) / (1 + len(drawn)) < LEVEL)


class Standings:
    """Standings of one leaderboard: each is computed once, and each data set read once.

    Args:
        key: what models are ranked by.
        folder: of the results.
        seed: of the draws of poses.
    """

    def __init__(self, key: SortKey, folder: Path, seed: int) -> None:
        """Store the arguments."""
        self.key = key
        self._seed = seed
        self._folder = folder
        self._data: dict[str, StoredData] = {}
        self._found: dict[tuple[ContestName, tuple[str, ...]], Standing] = {}

    def of(self, field: Field, models: tuple[str, ...]) -> Standing:
        """Return how these models stand in a contest."""
        place = (field.name, models)
        if place not in self._found:
            data = self._data_of(field.name.data_sha256)
            self._found[place] = Standing(field, models, self.key, data, self._seed)
        return self._found[place]

    def robot_name(self, data_sha256: str) -> str:
        """Return the name of the robot in a data set."""
        return self._data_of(data_sha256).robot

    def _data_of(self, sha256: str) -> StoredData:
        if sha256 not in self._data:
            self._data[sha256] = read_data(self._folder, sha256)
        return self._data[sha256]
