"""Compare models on the board's named robots and on fresh ones, drawn after the models.

All numbers are errors against the true robot over the VJM's; see `scores.robot_logs`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.results.columns import MODEL_KEY, ratio_column
from stiff_bench.results.scores import RATIO_ENDS, Scores, ratio_frame, robot_logs
from stiff_bench.tables.table import Column, Table
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.scoring.over_robots import MeanRatio, mean_ratio
from stiff_protocols.scoring.paired import LEVEL

if TYPE_CHECKING:
    from pandas import DataFrame

COMMON_WORLDS = ("friction", "structure", "all")
"""Worlds of named and fresh robots."""
UNSEEN = "unseen"
"""World of fresh robots only, whose effects no model has a group for."""
SIDES = ("named", "fresh")
SMALLEST_RATIO = 1e-6
"""Of an error over the VJM's: no model has none, unless it knows the truth."""
FLAG = "worse than on named"
FILE = "fresh.json"
"""File next to a board's results: what each submission did on fresh robots."""


def read_entries(folder: Path) -> dict[str, Any]:
    """Return the records of `bench verify` by the submission's model; {} without any.

    Raises:
        StoreError: the file does not hold JSON.
    """
    file = folder / FILE
    try:
        return dict(json.loads(file.read_text(encoding="utf-8"))) if file.exists() else {}
    except ValueError as error:
        raise StoreError(f"{file} does not hold JSON: {error}") from None


def logs_in_worlds(scores: Scores, worlds: Collection[str]) -> DataFrame:
    """Return (robots, models) mean logarithms of the error over the VJM's in some worlds."""
    rows = scores.rows[scores.rows["world"].isin(worlds)]
    if rows.empty:
        return rows.iloc[:, :0]
    ratios = rows["error ratio"].where(rows["error"] > 0.0, SMALLEST_RATIO)
    rows = rows.assign(**{"error ratio": ratios.clip(lower=SMALLEST_RATIO)})
    return robot_logs(rows, "error ratio")


def fresh_over_named(model: str, named: DataFrame, fresh: DataFrame) -> MeanRatio:
    """Return the error over the best other model's on fresh robots, over the same on named ones.

    The interval is Welch's. `named` and `fresh` are (robots, models) logarithms of the error over
    the VJM's.
    """
    from scipy import stats

    first, second = (_against_rival(model, logs) for logs in (fresh, named))
    if len(second) < 2:  # the short version of `bench verify` has few named robots
        return mean_ratio(first - second.mean())
    change = float(first.mean() - second.mean())
    squares = np.array([of.var(ddof=1) / len(of) for of in (first, second)])  # standard errors
    half = 0.0
    if (square := float(squares.sum())) > 0.0:
        freedom = square**2 / float((squares**2 / [len(first) - 1, len(second) - 1]).sum())
        half = float(stats.t.ppf(1.0 - 0.5 * LEVEL, freedom)) * math.sqrt(square)
    bounds = math.exp(change - half), math.exp(change + half)
    return MeanRatio(math.exp(change), *bounds, len(first))


def _against_rival(model: str, logs: DataFrame) -> np.ndarray[Any, Any]:
    """Return (robots,) ln of the error over the best other model's."""
    rivals = logs.drop(columns=[model]).mean()
    return (logs[model] - logs[rivals.idxmin()]).dropna().to_numpy()


def fresh_frame(
    named: Scores, fresh: Scores, entries: Mapping[str, Mapping[str, Any]]
) -> DataFrame:
    """Return a row per model with scores on named and on fresh robots, best on named ones first.

    Columns: `model`, the columns of `ratio_frame` for named, fresh and unseen, and (change,
    "ratio"), (change, "low"), (change, "high") of `fresh_over_named`.

    Args:
        named: scores on the board's robots.
        fresh: scores on fresh robots.
        entries: submission's model -> its record of `bench verify`, with fresh robots of its own.
    """
    from pandas import Series  # slow, and few commands score over robots

    sides = {
        name: logs_in_worlds(of, COMMON_WORLDS)
        for name, of in zip(SIDES, (named, fresh), strict=True)
    }
    frame = ratio_frame({**sides, UNSEEN: logs_in_worlds(fresh, (UNSEEN,))})
    changes = {
        str(model): fresh_over_named(str(model), sides["named"], sides["fresh"])
        for model in sides["named"].columns.intersection(sides["fresh"].columns)
    }
    for key in RATIO_ENDS:
        frame["change", key] = Series({m: getattr(of, key) for m, of in changes.items()})
    for model in entries.keys() & {*frame.index}:
        entry = entries[model]
        for key, ratio, change in zip(
            RATIO_ENDS, entry["fresh"], entry["fresh_over_named"], strict=True
        ):
            frame.loc[model, [("fresh", key), ("change", key)]] = ratio, change
        frame.loc[model, [(UNSEEN, "ratio")]] = entry["worlds"][UNSEEN]
    fresh_ratios: Any = [("fresh", "ratio"), (UNSEEN, "ratio")]
    scored = frame[frame["named", "ratio"].notna()].dropna(subset=fresh_ratios, how="all")
    by_named: Any = [("named", "ratio")]
    return scored.sort_values(by_named).rename_axis("model").reset_index()


def rank_agreement(frame: DataFrame, side: str = "fresh") -> float:
    """Return Kendall's tau between the models' ratios on named robots and in another part."""
    from scipy.stats import kendalltau

    sides: Any = [("named", "ratio"), (side, "ratio")]
    return float(kendalltau(*frame[sides].dropna().to_numpy().T).statistic)


def flag_of(row: Mapping[Any, Any]) -> str:
    """Return `FLAG` if a model does better on named than on fresh robots; else ""."""
    return FLAG if row.get(("change", "low"), 0.0) > 1.0 else ""


def fresh_tables(frame: DataFrame) -> list[Table]:
    """Return the table of named and fresh robots from a `fresh_frame`; [] without models."""
    if frame.empty:
        return []

    def part(name: str, heading: str) -> Column:
        ends = (name, "low"), (name, "high")
        return ratio_column(heading, (name, "ratio"), ends, color=(name, "ratio"))

    rows = frame.to_dict("records")
    agreements = ", ".join(
        f"{rank_agreement(frame, side):.2f} of {name} "
        f"({counted(int(frame[side, 'ratio'].count()), 'model')})"
        for side, name in (("fresh", "fresh robots"), (UNSEEN, f"the world {UNSEEN}"))
    )
    return [
        Table.of(
            "Error over the VJM's on robots that were drawn after the models were written",
            [
                MODEL_KEY,
                part("named", "named robots"),
                part("fresh", "fresh robots"),
                part(UNSEEN, f"fresh robots, {UNSEEN}"),
                ratio_column(
                    "fresh over named", ("change", "ratio"), (("change", "low"), ("change", "high"))
                ),
                *[Column("flag", "text", value=flag_of)] * any(map(flag_of, rows)),
            ],
            rows,
            [
                f"named and fresh: worlds {', '.join(COMMON_WORLDS)}; in brackets: 95 % interval "
                "over robots.",
                "fresh over named: error over the best other model's on fresh robots, over the "
                "same on named ones; Welch's interval.",
                f"Kendall's rank agreement with the named robots: {agreements}.",
            ],
            about={"table": "fresh"},
        )
    ]
