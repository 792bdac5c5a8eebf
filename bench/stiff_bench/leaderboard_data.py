"""A leaderboard -> CSV or JSON at full precision, in the units that tables are printed in."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from stiff_bench.board_columns import ColumnValue
from stiff_bench.cost_table import ModelCost, model_costs
from stiff_bench.field import Field
from stiff_bench.leaderboard import Leaderboard, Section
from stiff_bench.rank_analysis import RankAnalysis
from stiff_bench.render import csv_cells
from stiff_bench.units import PRINTED
from stiff_bench.words import counted
from stiff_protocols.metrics import METRICS

_CSV_HEADER = (
    *("selects_on_test", "model", "mark", "dataset", "data_sha256", "protocol", "condition"),
    *("seed", "splits", "quantity", "value", "low", "high", "unit", "note"),
)


def as_csv(board: Leaderboard) -> str:
    """Return a line for each mean rank, each model's score in each contest, and each cost.

    A missing score is a line without a value, with the reason.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_CSV_HEADER)
    for section in board.sections:
        for rows in (_csv_ranks(section, board), _csv_scores(section, board), _csv_costs(section)):
            writer.writerows(map(csv_cells, rows))
    return out.getvalue().rstrip("\n")


def _csv_ranks(section: Section, board: Leaderboard) -> Iterator[list[object]]:
    quantity = f"mean rank of {board.key.text}"
    for model in section.ranked:
        about = [section.selects_on_test, model.name, model.mark, *[""] * 6, quantity]
        yield [*about, *_numbers(model.mean_rank, model.low, model.high), "", ""]
    for missing in section.unranked:
        about = [section.selects_on_test, missing.name, missing.mark, *[""] * 6, quantity]
        note = f"{len(missing.missing)} of {len(section.fields)} contests missing"
        yield [*about, "", "", "", "", note]


def _csv_scores(section: Section, board: Leaderboard) -> Iterator[list[object]]:
    unit, factor = PRINTED[board.key.metric.unit]
    for field in section.fields:
        name = field.name
        place = [name.dataset, name.data_sha256, name.protocol, name.condition, name.seed]
        for model in section.marks:
            mark = section.mark_under(name.protocol, model)
            about = [section.selects_on_test, model, mark, *place, len(field.slots), board.key.text]
            if model in field.scores:
                yield [*about, repr(field.mean(model) * factor), "", "", unit, field.left_out]
            else:
                yield [*about, "", "", "", unit, field.missing[model]]


def _csv_costs(section: Section) -> Iterator[list[object]]:
    for model in model_costs(section):
        note = f"median, lowest and highest of {counted(model.n_cells, 'cell')}"
        for key, spread in model.costs.items():
            unit, factor = PRINTED[METRICS[key].unit]
            about = [section.selects_on_test, model.name, model.mark, *[""] * 6, key]
            values = (spread.median * factor, spread.low * factor, spread.high * factor)
            yield [*about, *_numbers(*values), unit, note]


def _numbers(*values: float) -> list[str]:
    return ["" if math.isnan(value) else repr(value) for value in values]


def as_json(board: Leaderboard, command: str, provenance: Sequence[str]) -> str:
    """Return everything that the tables show and every score behind them."""
    content = {
        "command": command,
        "provenance": list(provenance),
        "sort_key": board.key.text,
        "direction": board.key.metric.direction,
        "notes": list(board.notes),
        "sections": [_section(section, board) for section in board.sections],
    }
    return json.dumps(_without_nan(content), indent=2, allow_nan=False)


def _section(section: Section, board: Leaderboard) -> dict[str, Any]:
    unit, factor = PRINTED[board.key.metric.unit]
    return {
        "selects_on_test": section.selects_on_test,
        "caveats": list(section.caveats),
        "ranked": [asdict(model) for model in section.ranked],
        "unranked": [
            {"name": model.name, "mark": model.mark, "missing": len(model.missing)}
            for model in section.unranked
        ],
        "contests": [_contest(field, section, factor) for field in section.fields],
        "columns": [
            {
                "family": column.family,
                "protocol": column.protocol,
                "condition": column.condition,
                "datasets": list(column.datasets),
                "seeds": list(column.seeds),
                "unit": unit,
                "values": {model: _scaled(v, factor) for model, v in column.values.items()},
            }
            for column in section.columns
        ],
        "analyses": [_analysis(analysis) for analysis in section.analyses],
        "costs": [_cost(model) for model in model_costs(section)],
    }


def _cost(model: ModelCost) -> dict[str, Any]:
    costs = {}
    for key, spread in model.costs.items():
        unit, factor = PRINTED[METRICS[key].unit]
        scaled = {name: value * factor for name, value in asdict(spread).items()}
        costs[key] = {**scaled, "unit": unit}
    return {"name": model.name, "mark": model.mark, "cells": model.n_cells, "costs": costs}


def _contest(field: Field, section: Section, factor: float) -> dict[str, Any]:
    shown = [model for model in section.marks if model in field.missing]
    return {
        **asdict(field.name),
        "splits": len(field.slots),
        "splits_left_out": field.left_out,
        "scores": {model: field.mean(model) * factor for model in field.scores},
        "missing": {model: field.missing[model] for model in shown},
    }


def _scaled(value: ColumnValue, factor: float) -> dict[str, Any]:
    return {**asdict(value), "mean": value.mean * factor, "std": value.std * factor}


def _analysis(analysis: RankAnalysis) -> dict[str, Any]:
    found = {
        "protocol": analysis.protocol,
        "condition": analysis.condition,
        "robots": [robot.text for robot in analysis.robots],
        "models": list(analysis.models),
        "why_none": analysis.why_none,
    }
    outcome = analysis.outcome
    if outcome is None:
        return found
    return found | {
        "mean_ranks": outcome.mean_ranks.tolist(),
        "friedman_p": outcome.friedman_p,
        "critical_difference": outcome.critical_difference,
        "nemenyi": outcome.nemenyi.tolist(),
        "conover": None if outcome.conover is None else outcome.conover.tolist(),
        "groups": [[analysis.models[i] for i in group] for group in outcome.groups],
    }


def _without_nan(value: Any) -> Any:
    """Return the content with null for NaN, which JSON has not."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
