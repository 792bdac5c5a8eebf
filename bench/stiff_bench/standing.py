"""How models stand in one contest: their ranks, and who is like the best."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stiff_bench.contest_name import ContestName
from stiff_bench.field import Field
from stiff_bench.sort_key import SortKey
from stiff_bench.split_sizes import split_sizes
from stiff_bench.store import read_data
from stiff_bench.stored_data import StoredData
from stiff_bench.tables import pooled_prediction
from stiff_protocols.bootstrap import PoseErrors, resampled_means
from stiff_protocols.mean_ranks import ranked
from stiff_protocols.paired import LEVEL, corrected_t, holm, wilcoxon_signed_rank
from stiff_protocols.types import FloatArray, IntArray, TextArray

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
