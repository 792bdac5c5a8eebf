"""Models in one contest: who takes part, their scores, ranks, and who is like the best."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from stiff_bench.collected import Competitor, Contest, ContestName, Slot
from stiff_bench.sort_key import SortKey
from stiff_bench.stored_data import StoredData, read_data
from stiff_protocols.bootstrap import PoseErrors, resampled_means
from stiff_protocols.errors import StoreError
from stiff_protocols.paired import LEVEL, corrected_t, holm
from stiff_protocols.record import CellResult
from stiff_protocols.types import FloatArray, IntArray, TextArray

NOT_RUN = "not run"
NOT_FINISHED = "run not finished"
BoolArray = NDArray[np.bool_]


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
        word, *_ = self.missing.get(model, "").split(maxsplit=1) or [""]
        return word if word in ("FAILED", "SKIPPED") else ""

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
            f"{self.name.text}: only the {len(self.slots)} of {n_all} splits count that all "
            f"models have ({', '.join(lacking)})"
        )


def field_of(
    contest: Contest, models: Sequence[str], key: SortKey, asked: Set[str] = frozenset()
) -> Field:
    """Return who of the models takes part, and with which scores.

    A model that was run on fewer splits, and has them all, takes part, and only the splits that
    all have count. One whose run did not come to its end is missing, so that it takes no split
    from the others.

    Args:
        contest: the stored results.
        models: by name.
        key: what they are ranked by.
        asked: keys of the cells that the folder's runs were asked for.

    Raises:
        StoreError: two models have no split in common, or their intervals differ in coverage.
    """
    missing = {model: reason for model in models if (reason := _why_missing(contest, model, asked))}
    present = [model for model in models if model not in missing]
    slots = tuple(contest.shared_slots(present))
    if present and not slots:
        _refuse(contest, present)
    scores = {}
    for model in present:
        found = key.of_splits(contest.results(model, slots))
        if found is None:
            missing[model] = f"no value of {key.text}"
        else:
            scores[model] = found
    field = Field(contest, slots, scores, missing)
    if key.metric.needs_interval:
        _refuse_other_coverage(field)
    return field


def complete_models(fields: Sequence[Field]) -> tuple[str, ...]:
    """Return the models that have a score in all of these contests, in the order of their names."""
    return tuple(sorted(set.intersection(*(set(field.scores) for field in fields))))


def _why_missing(contest: Contest, model: str, asked: Set[str]) -> str:
    competitor = contest.competitors.get(model)
    if competitor is None:
        return NOT_RUN
    if competitor.reasons:
        (reason, _), *_ = Counter(competitor.reasons.values()).most_common(1)
        status, _, why = reason.partition(": ")
        n_all = len(competitor.reasons) + len(competitor.done)
        said = " ".join(why.split())
        return f"{status.upper()} in {len(competitor.reasons)} of {n_all} splits: {said}"
    return NOT_FINISHED if _unfinished(contest, competitor, asked) else ""


def _unfinished(contest: Contest, competitor: Competitor, asked: Set[str]) -> bool:
    """Say whether a model was to be run on more of the others' splits and was not."""
    own = next(iter(competitor.done.values())).cell
    rows = {
        slot: result.cell.rows_sha256
        for other in contest.competitors.values()
        for slot, result in other.done.items()
    }
    return any(
        replace(own, split_index=slot[0], split_sha256=slot[1], rows_sha256=rows.get(slot, "")).key
        in asked
        for slot in contest.slots
        if slot not in competitor.done
    )


def _refuse(contest: Contest, models: Sequence[str]) -> None:
    apart = [pair for pair in combinations(models, 2) if not contest.shared_slots(pair)]
    named = apart[0] if apart else tuple(models)
    raise StoreError(
        f"{contest.name.text}: {' and '.join(named)} were run on different splits and share none, "
        "so they cannot be compared; leave one out (--model) or run it anew"
    )


def _refuse_other_coverage(field: Field) -> None:
    found = {result.cell.coverage for model in field.scores for result in field.results(model)}
    if len(found) > 1:
        shown = ", ".join(sorted(f"{coverage:g}" for coverage in found if coverage is not None))
        raise StoreError(
            f"{field.name.text}: intervals of different coverage ({shown}) cannot be compared"
        )


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
        return np.asarray(stats.rankdata(self.key.sign * self.scores))

    @cached_property
    def is_best(self) -> BoolArray:
        """(m,) whether a model has the best score, alone or with others."""
        return np.asarray(self.ranks == self.ranks.min())

    @cached_property
    def drawn_means(self) -> FloatArray | None:
        """The (B, m) mean errors on draws of the data set's poses; None: the metric has none.

        A pose that is not tested here has no rows, so that contests with different test poses of
        one data set are drawn together. NaN where a draw holds no tested pose.
        """
        if not self.key.resamples:
            return None
        poses, pose_of_row = np.unique(self.data.samples.pose_id, return_inverse=True)
        errors = [self._pose_errors(model, poses, pose_of_row) for model in self.models]
        with np.errstate(invalid="ignore"):
            return resampled_means(errors, seed=self.seed)

    def _pose_errors(self, model: str, poses: TextArray, pose_of_row: IntArray) -> PoseErrors:
        found = [r.prediction for r in self.field.results(model) if r.prediction is not None]
        pose = pose_of_row[np.concatenate([prediction.rows for prediction in found])]
        errors = np.concatenate([self.key.of_rows(prediction) for prediction in found])
        totals = np.bincount(pose, weights=errors, minlength=len(poses)).astype(np.float64)
        return PoseErrors(poses, totals[:, None], np.bincount(pose, minlength=len(poses)))

    @cached_property
    def drawn_ranks(self) -> FloatArray | None:
        """The (B, m) ranks on the same draws; NaN where a draw holds no tested pose."""
        means = self.drawn_means
        return None if means is None else np.asarray(stats.rankdata(means, axis=1))

    @cached_property
    def like_best(self) -> BoolArray | None:
        """(m,) whether a model cannot be told from the best; None where no test applies.

        To be told apart, a difference must be found by all that the results allow, as in `bench
        compare`: over splits (corrected t) and over poses (how often draws of the poses turn it
        round, the fitted models held fixed). Holm over the models, at `LEVEL`.
        """
        best = int(np.argmax(self.is_best))
        others = [index for index in range(len(self.models)) if index != best]
        p_values = [self._p_values(index, best) for index in others]
        if not all(p_values):
            return None
        like = np.ones(len(self.models), dtype=np.bool_)
        if others:
            like[others] = holm([max(found) for found in p_values]) >= LEVEL
        return like

    def _p_values(self, index: int, best: int) -> list[float]:
        found = []
        a, b = (self.field.scores[self.models[i]] for i in (index, best))
        if len(a) > 1:
            found.append(corrected_t(a - b, self._test_share).p_value)
        if self.drawn_means is not None:
            drawn = self.drawn_means[:, index] - self.drawn_means[:, best]
            drawn = drawn[np.isfinite(drawn)]
            tail = min(np.count_nonzero(drawn <= 0.0), np.count_nonzero(drawn >= 0.0))
            found.append(min(1.0, 2.0 * (1 + tail) / (1 + len(drawn))))
        return found

    @property
    def _test_share(self) -> float:
        """Part of a split's rows that it tests on; unknown training parts are all other rows."""
        results = self.field.results(self.models[0])
        n_test = np.mean([len(r.prediction.rows) for r in results if r.prediction is not None])
        trained = [result.n_train for result in results]
        n_train = np.mean(trained) if all(trained) else len(self.data.samples) - n_test
        return float(n_test / (n_test + n_train))


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
            sha256 = field.name.data_sha256
            if sha256 not in self._data:
                self._data[sha256] = read_data(self._folder / "data", sha256)
            self._found[place] = Standing(field, models, self.key, self._data[sha256], self._seed)
        return self._found[place]
