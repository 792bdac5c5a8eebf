"""A comparison for machines: csv and json, at full precision. Here SI becomes mm."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

from stiff_bench.across import Across
from stiff_bench.compare import Report
from stiff_bench.comparison import NORM, Comparison, Row
from stiff_bench.comparison_notes import notes
from stiff_bench.comparison_words import sentence
from stiff_bench.estimates import Estimate, Verdict
from stiff_bench.render import csv_cells
from stiff_bench.tables import mark_of
from stiff_bench.units import MM, PRINTED
from stiff_bench.where import Place

VERDICTS: dict[Verdict, str] = {
    "a": "A better",
    "b": "B better",
    "equivalent": "equivalent",
    "open": "not told apart",
}


def verdict_text(verdict: Verdict, *, of_fits: bool) -> str:
    """Return a verdict for people.

    Args:
        verdict: which.
        of_fits: it is of the fitted models alone, not of how they are trained.
    """
    text = VERDICTS[verdict]
    return f"{text} (these fits)" if of_fits and verdict != "open" else text


def place_text(place: Place) -> str:
    """Return which place it is, with unit."""
    if place.low is None or place.high is None:
        return f"{place.factor}: {place.label}"
    unit, scale = PRINTED["m"] if place.unit == "m" else (place.unit, 1.0)
    decimals = 0 if abs(scale * place.high) >= 100.0 else 1
    low, high = (f"{scale * value:.{decimals}f}" for value in (place.low, place.high))
    return f"{place.factor} {low} to {high} {unit}"


_CONTEST = (
    *("dataset", "protocol", "condition", "seed", "splits"),
    *("data_sha256", "source_sha256", "selects_on_test", "mark_a", "mark_b"),
)
_VALUES = (
    *("mean_a_mm", "mean_b_mm", "difference_mm", "low_mm", "high_mm", "p_value"),
    *("p_a_better", "p_equivalent", "p_b_better", "verdict"),
)


def as_csv(report: Report) -> str:
    """Return one line a contest, error and method or place, at full precision."""
    out = io.StringIO()
    writer = csv.DictWriter(
        out,
        ["a", "b", *_CONTEST, "error", "method", "place", *_VALUES],
        restval="",
        lineterminator="\n",
    )
    writer.writeheader()

    def write(row: dict[str, Any]) -> None:
        writer.writerow(dict(zip(row, csv_cells(row.values()), strict=True)))

    names = {"a": report.a, "b": report.b}
    for one in report.comparisons:
        about = names | _about(one)
        for row in one.rows:
            for method, estimate in _methods(row):
                values = _plain_values(row, estimate)
                write(about | {"error": row.error, "method": method} | values)
    for place in report.where.places if report.where is not None else ():
        about = names | _about(report.comparisons[0]) | {"error": NORM, "method": "over poses"}
        write(about | {"place": place_text(place)} | _plain_values(place, place.estimate))
    return out.getvalue().rstrip("\n")


def _about(one: Comparison) -> dict[str, Any]:
    name = one.name
    return dict(
        zip(
            _CONTEST,
            (
                *(name.dataset, name.protocol, name.condition, name.seed, one.n_splits),
                *(name.data_sha256, name.source_sha256, one.selects_on_test),
                *(mark_of(one.a), mark_of(one.b)),
            ),
            strict=True,
        )
    )


def _methods(row: Row) -> list[tuple[str, Estimate]]:
    over_splits = [] if row.over_splits is None else [("over splits", row.over_splits)]
    return [*over_splits, ("over poses", row.over_poses)]


def _plain_values(row: Row | Place, estimate: Estimate) -> dict[str, Any]:
    posterior = estimate.posterior
    of_fits = isinstance(row, Place) or row.over_splits is None
    lengths = (row.mean_a, row.mean_b, row.difference, estimate.low, estimate.high)
    return dict(
        zip(
            _VALUES,
            (
                *(MM * length for length in lengths),
                estimate.p_value,
                posterior.a_better,
                posterior.equivalent,
                posterior.b_better,
                verdict_text(row.verdict, of_fits=of_fits),
            ),
            strict=True,
        )
    )


def as_json(report: Report) -> str:
    """Return everything as JSON, lengths in mm."""
    return json.dumps(_plain(report), indent=2)


def _plain(report: Report) -> dict[str, Any]:
    return {
        "command": report.command,
        "a": report.a,
        "b": report.b,
        "rope_mm": MM * report.question.rope,
        "confidence": report.question.confidence,
        "sentence": sentence(report),
        "contests": [_plain_contest(one) for one in report.comparisons],
        "over_datasets": [_plain_across(one) for one in report.across],
        "where": [
            {"kind": place.kind, "place": place_text(place), "poses": place.n_poses}
            | _plain_values(place, place.estimate)
            for place in (report.where.places if report.where is not None else ())
        ],
        "notes": notes(report),
    }


def _plain_contest(one: Comparison) -> dict[str, Any]:
    return _about(one) | {
        "task": one.a.task,
        "n_train": one.sizes.n_train,
        "n_test": one.sizes.n_test,
        "n_poses": one.n_poses,
        "errors": [
            {"error": row.error, "method": method} | _plain_values(row, estimate)
            for row in one.rows
            for method, estimate in _methods(row)
        ],
    }


def _plain_across(one: Across) -> dict[str, Any]:
    return {
        "family": one.family,
        "protocol": one.protocol,
        "condition": one.condition,
        "seed": one.seed,
        "selects_on_test": one.selects_on_test,
        "verdicts": [verdict_text(verdict, of_fits=one.of_fits) for verdict in one.verdicts],
        "mean_difference_mm": MM * one.mean_difference,
        "p_value": one.p_value,
    }
