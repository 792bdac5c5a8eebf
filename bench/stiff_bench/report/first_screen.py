"""First screen of the report: answer, models and error matrix.

SI is converted to mm and % here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from stiff_bench.analysis.answer import Answer, MatrixColumn, ModelAnswer
from stiff_bench.analysis.answer_text import Sentence, headline, sentences
from stiff_bench.tables.metric_table import number_format
from stiff_bench.tables.table import Name
from stiff_bench.tables.units import PRINTED, counted, duration, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.scoring.paired import LEVEL

FIRST_MODELS, FIRST_COLUMNS = 10, 12
"""Numbers of models and matrix columns before the others are unfolded."""
STEPS = 4
"""Number of colours on each side of the VJM; the last is half or double its error."""
WIDTH, MARGIN = 360, 18
"""Width of an interval chart and its margin on each side, px."""
MOST_DOUBLINGS = 4
"""Largest power of two on the axis of the interval charts."""
Tick = tuple[float, str]
"""Position on the axis, px, and its label."""


class Chart(NamedTuple):
    """One model's ratio to the VJM's error on a logarithmic axis.

    Attributes:
        dot, low, high: positions, px.
        text: the same numbers in words.
    """

    dot: float
    low: float
    high: float
    text: str


class ModelRow(NamedTuple):
    """One line of the models; all texts as printed."""

    name: str
    error: str
    change: str
    chart: Chart | None
    better: str
    worse: str
    fit: str


class MatrixCell(NamedTuple):
    """One error of the matrix as text, with its colour's CSS class; `is_best` of its column."""

    text: str
    style: str = ""
    is_best: bool = False


@dataclass(frozen=True)
class MatrixPart:
    """Matrix columns that fit side by side.

    Attributes:
        datasets, protocols: names with the number of their columns, from left to right.
        conditions: condition of each column; empty if no protocol has any.
        labels: full name of each column.
        rows: model -> a cell per column.
        noise: noise floor per column; empty if none is known.
    """

    datasets: Sequence[tuple[str, int]]
    protocols: Sequence[tuple[str, int]]
    conditions: Sequence[str]
    labels: Sequence[str]
    rows: Sequence[tuple[str, Sequence[MatrixCell]]]
    noise: Sequence[MatrixCell]

    @property
    def is_coloured(self) -> bool:
        """True if any cell compares with the VJM."""
        return any(cell.style for _, cells in self.rows for cell in cells)


@dataclass(frozen=True)
class FirstScreen:
    """Content of the first screen of a folder.

    Attributes:
        headline, sentences: the answer.
        chips: short facts.
        error_heading: metric with its unit.
        chart_heading: meaning of dot and line.
        ticks: ticks on the axis of all charts.
        models: rows of the models, best first.
        matrix_title: metric, unit and what the rows and columns are.
        matrix: parts of at most `FIRST_COLUMNS` columns.
        more: text of the button for all models and columns; "" if all are visible.
    """

    headline: str
    sentences: Sequence[Sentence]
    chips: Sequence[str]
    error_heading: str
    chart_heading: str
    ticks: Sequence[Tick]
    models: Sequence[ModelRow]
    matrix_title: str
    matrix: Sequence[MatrixPart]
    more: str = ""


def first_screen(answer: Answer) -> FirstScreen:
    """Return the texts and chart positions of an answer."""
    ratios = [
        ratio
        for model in answer.models
        for ratio in (model.ratio, model.low, model.high, model.smallest, model.largest)
        if ratio is not None
    ]
    axis = Axis.over(ratios)
    n_measured, n_sets = len(answer.measured), len(answer.datasets)
    kinds = {"measured": n_measured, "simulated": n_sets - n_measured}
    data = ", ".join(f"{number} {kind}" for kind, number in kinds.items() if number)
    unit, _ = PRINTED[answer.key.metric.unit]
    n_models, n_columns = len(answer.models), len(answer.columns)
    more = [
        *([f"{n_models} models"] if n_models > FIRST_MODELS else []),
        *([f"{n_columns} columns"] if n_columns > FIRST_COLUMNS else []),
    ]
    return FirstScreen(
        headline(answer),
        sentences(answer),
        [f"Data: {data}", f"Score: {answer.key.text}"],
        f"median {answer.key.metric.label}{f' [{unit}]' if unit else ''}",
        _chart_heading(answer),
        axis.ticks,
        [_model_row(answer, model, axis) for model in answer.models],
        f"{answer.key.text} by data set and protocol",
        [
            _matrix_part(answer, answer.columns[first : first + FIRST_COLUMNS])
            for first in range(0, n_columns, FIRST_COLUMNS)
        ],
        f"Show all {' and '.join(more)}" if more else "",
    )


@dataclass(frozen=True)
class Axis:
    """Logarithmic axis of all charts, from 2^first to 2^last times the VJM's error."""

    first: int
    last: int

    @classmethod
    def over(cls, ratios: Sequence[float]) -> Axis:
        """Return the axis from 0.5 to 4, longer if ratios are outside."""
        powers = [math.log2(ratio) for ratio in ratios] or [0.0]
        first = max(-MOST_DOUBLINGS, min(-1, math.floor(min(powers))))
        return cls(first, min(MOST_DOUBLINGS, max(2, math.ceil(max(powers)))))

    def at(self, ratio: float) -> float:
        """Return the position of a ratio, px; ratios outside are at the end."""
        share = (math.log2(ratio) - self.first) / (self.last - self.first)
        return round(MARGIN + (WIDTH - 2 * MARGIN) * min(1.0, max(0.0, share)), 1)

    @property
    def ticks(self) -> list[Tick]:
        """Position and label of each power of two."""
        return [
            (self.at(2.0**power), f"1/{2**-power}" if power < 0 else f"{2**power}x")
            for power in range(self.first, self.last + 1)
        ]


def _chart_heading(answer: Answer) -> str:
    if answer.claim_robots:
        return (
            f"error / VJM's error: mean and {percent(1.0 - LEVEL)} interval over "
            f"{answer.claim_scope}"
        )
    return f"error / VJM's error: mean and range over {counted(len(answer.cases), 'comparison')}"


def _model_row(answer: Answer, model: ModelAnswer, axis: Axis) -> ModelRow:
    _, factor = PRINTED[answer.key.metric.unit]
    is_reference = model.name == REFERENCE_MODEL
    tested = sum(model.counts.values())
    change = "-" if model.ratio is None else f"{100.0 * (model.ratio - 1.0):+.0f} %"
    return ModelRow(
        str(Name(model.name, model.mark)),
        f"{factor * model.median_error:{_number_format(answer)}}",
        "baseline" if is_reference else change,
        _chart(model, axis),
        f"{model.counts['a']} / {tested}" if tested else "-",
        f"{model.counts['b']}" if tested else "-",
        duration(model.fit_s),
    )


def _chart(model: ModelAnswer, axis: Axis) -> Chart | None:
    if model.ratio is None:
        return None
    bounds = (model.low, model.high)
    if None in bounds:
        bounds = (model.smallest, model.largest)
    low, high = (model.ratio if bound is None else bound for bound in bounds)
    text = f"{model.ratio:.2f} times the VJM's error, {low:.2f} to {high:.2f}"
    return Chart(axis.at(model.ratio), axis.at(low), axis.at(high), text)


def ratio_style(ratio: float | None) -> str:
    """Return the CSS class of a ratio to the VJM's error; "" for none.

    >>> ratio_style(0.4), ratio_style(0.85), ratio_style(1.0), ratio_style(1.5)
    ('less-4', 'less-1', 'same', 'more-2')
    """
    if ratio is None:
        return ""
    step = round(min(1.0, max(-1.0, math.log2(ratio))) * STEPS)
    return "same" if step == 0 else f"{'less' if step < 0 else 'more'}-{abs(step)}"


CLEAR_ERROR = 0.05
"""Smallest error that two decimals show well, mm."""


def _number_format(answer: Answer) -> str:
    """Return the format of scores: mm with two decimals if no error is too small."""
    unit, factor = PRINTED[answer.key.metric.unit]
    errors = [
        answer.column_error(model.name, column)
        for model in answer.models
        for column in answer.columns
    ]
    smallest = min((factor * error for error in errors if error is not None), default=0.0)
    is_clear = unit == "mm" and smallest >= CLEAR_ERROR
    return ".2f" if is_clear else number_format(answer.key.metric)


def _spans(headings: Sequence[tuple[str, ...]]) -> list[tuple[str, int]]:
    """Return the last text of each heading, and its number of columns."""
    return [(heading[-1], len(list(same))) for heading, same in groupby(headings)]


def _matrix_part(answer: Answer, columns: Sequence[MatrixColumn]) -> MatrixPart:
    _, factor = PRINTED[answer.key.metric.unit]
    written = _number_format(answer)

    def text(error: float | None) -> str:
        return "-" if error is None else f"{factor * error:{written}}"

    best = [answer.best_of(column) for column in columns]
    datasets = [
        f"{column.dataset} (measured)" if column.is_measured else column.dataset
        for column in columns
    ]
    conditions = [column.condition for column in columns]
    floors = [answer.column_noise(column) for column in columns]
    return MatrixPart(
        _spans([(name,) for name in datasets]),
        _spans([(name, column.protocol) for name, column in zip(datasets, columns, strict=True)]),
        conditions if any(conditions) else [],
        [column.text for column in columns],
        [
            (
                str(Name(model.name, model.mark)),
                [
                    MatrixCell(
                        text(answer.column_error(model.name, column)),
                        ratio_style(answer.column_ratio(model.name, column)),
                        model.name == of_column,
                    )
                    for column, of_column in zip(columns, best, strict=True)
                ],
            )
            for model in answer.models
        ],
        [MatrixCell(text(floor)) for floor in floors] if floors.count(None) < len(floors) else [],
    )
