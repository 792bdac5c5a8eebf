"""A ranking of postures: the best posture, the given posture, and a table of all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stiff_apply.posture_math import Direction, RatedPosture
from stiff_bench.api.model import MEAN_ERROR, half_width_name
from stiff_bench.plan.cells import DEFAULT_COVERAGE
from stiff_datasets.measured.sample_columns import MM_PER_M, counted
from stiff_protocols.contract.screen import MOST_ROWS, Screen, ShownObject

if TYPE_CHECKING:
    from stiff_bench.figures.prepared_figure import Prepared


SCREEN_COLUMNS = (
    *("rank", "turn_deg", "branch", "along_mm", "across_mm", "extrapolates", "given"),
)
"""Columns of the table that fit a terminal."""


@dataclass(frozen=True, eq=False, repr=False)
class RankedPostures(ShownObject):
    """Postures for a task, with the smallest predicted deflection first.

    Attributes:
        title: model, robot and task.
        direction: "along" or "across" the axis of the tool.
        table: rows per posture (for a path: means over its points), in deg and mm.
        best: posture with the smallest deflection.
        given: posture to compare with; None if the robot cannot take it.
        given_words: origin of the given posture, or the reason why there is none.
        coverage: coverage of the intervals; None: no intervals.
        n_compared: number of postures inside the limits and away from singularities.
        mean_error: stored mean error of the model at left-out poses, m; None: not stored.
    """

    title: str
    direction: Direction
    table: pd.DataFrame
    best: RatedPosture
    given: RatedPosture | None
    given_words: str
    coverage: float | None
    n_compared: int
    mean_error: float | None

    @property
    def saving(self) -> float:
        """Return the mean deflection that the best posture saves, m; NaN if unknown."""
        return float(self.given.size.mean() - self.best.size.mean()) if self.given else np.nan

    @property
    def uncertainty(self) -> float:
        """Return the half width of the saving's interval, m; NaN if unknown.

        The errors of both postures are assumed to be independent.
        """
        if self.given is None or self.given.half_width is None or self.best.half_width is None:
            return np.nan
        return float(np.hypot(self.given.half_width.mean(), self.best.half_width.mean()))

    @property
    def is_within_uncertainty(self) -> bool:
        """Return True if the uncertainty exceeds the saving; False if it is unknown."""
        return bool(abs(self.saving) <= self.uncertainty)

    def view(self) -> Screen:
        """Return a screen with the best postures."""
        best = self.best
        mean = "" if len(best.q) == 1 else "mean "
        size = MM_PER_M * best.size.mean()
        title = (
            f"best posture: turn {best.turn:g} deg, {best.branch}; {size:.4g} mm {mean}"
            f"{self.direction} the axis"
        )
        if self.given is not None:
            old = self.given.size.mean()
            share = self.saving / old if old > 0.0 else 0.0
            saving = f"{MM_PER_M * abs(self.saving):.4f} mm ({abs(share):.0%})"
            word = "less" if self.saving >= 0.0 else "more"
            title += f", {saving} {word} than the {MM_PER_M * old:.4g} mm of the given one"
        columns = [name for name in self.table if name in SCREEN_COLUMNS]
        rows = [
            [_cell(name, row[name]) for name in columns]
            for row in self.table.head(MOST_ROWS).to_dict("records")
        ]
        n_more = len(self.table) - len(rows)
        notes = [f"... and {n_more} more; --output has the whole table"] if n_more else []
        return Screen(title, [*self._facts()], columns, rows, notes)

    def _facts(self) -> Iterator[tuple[str, str]]:
        best = self.best
        yield "task", self.title
        words = self.given_words
        if self.given is not None:
            words = f"turn {self.given.turn:g} deg, {self.given.branch}; {words}"
        yield "given posture", words
        if self.mean_error is not None:
            yield MEAN_ERROR, f"{MM_PER_M * self.mean_error:.3g} mm in 3-D"
        if self.coverage is None:
            yield half_width_name(DEFAULT_COVERAGE), "not computed; add --coverage 0.9"
        elif np.isfinite(self.uncertainty):
            half = MM_PER_M * self.uncertainty
            verdict = "is within it" if self.is_within_uncertainty else "is larger"
            yield (
                half_width_name(self.coverage),
                f"{half:.3g} mm, of the saving: the saving {verdict}",
            )
        if len(best.q) == 1:
            joints = self.table.filter(regex=r"^q\d+_").iloc[0]
            values = ", ".join(f"{value:.2f}" for value in joints)
            yield "joints", f"{values} ({', '.join(sorted({*joints.index.str.split('_').str[1]}))})"
        yield "extrapolates", self._extrapolation()
        yield "compared", f"{counted(self.n_compared, 'posture')} inside limits, not singular"

    def _extrapolation(self) -> str:
        """Return a text on postures beyond the training range."""
        words = [word for word in self.best.extrapolates if word]
        if not words:
            return "no, the best posture is inside the training range"
        kinds = ", ".join(sorted({*" ".join(words).split()}))
        text = f"the best posture is beyond the training range: {kinds}"
        if len(self.best.q) > 1:
            text += f" ({len(words)} of {len(self.best.q)} points)"
        alike = self.table[self.table["extrapolates"] == ""]
        if alike.empty:
            return f"{text}; all others are, too"
        first = alike.iloc[0]
        size = f"{first[f'{self.direction}_mm']:.4g} mm"
        return f"{text}; the best posture inside it has rank {first['rank']}, {size}"

    def plot(self) -> Prepared:
        """Return the picture: deflection over the turn."""
        from stiff_apply.figures.posture_picture import posture_picture

        words = f"{self.direction} the axis"
        return posture_picture(self.title, words, self.table, self.best, self.given)


def _cell(name: str, value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "given" if value else ""
    if isinstance(value, float):
        return f"{value:.4f}" if name in ("along_mm", "across_mm") else f"{value:.1f}"
    return str(value)
