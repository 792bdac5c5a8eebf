"""Write an answer as a headline, sentences and tables, in mm and %."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

from stiff_bench.analysis.answer import (
    FEWEST_ROBOTS,
    NOISE_FLOOR,
    Answer,
    MatrixColumn,
    ModelAnswer,
)
from stiff_bench.analysis.scored_case import ScoredCase
from stiff_bench.analysis.verdict import Verdict
from stiff_bench.store.names import grouped
from stiff_bench.tables.metric_table import number_format
from stiff_bench.tables.table import BEST_MARK, Column, Entry, Name, Quantity, Table
from stiff_bench.tables.units import PRINTED, counted, duration, first_few, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.scoring.paired import LEVEL

MATRIX_FORMAT = ".3f"
"""Format of errors in mm: 0.001 mm is below the noise of every instrument."""


class Sentence(NamedTuple):
    """One line of the answer: a label and a text."""

    label: str
    text: str


@dataclass(frozen=True)
class DatasetAnswer:
    """The best model of one data set.

    Attributes:
        dataset: name without its specimen.
        model: model with the smallest error / VJM's error among models with every score.
        ratio: error / VJM's error, geometric mean over the data set's comparisons.
        counts: verdicts on the model against the VJM; "a": the model is better.
        n_cases: number of comparisons.
    """

    dataset: str
    model: str
    ratio: float
    counts: Counter[Verdict]
    n_cases: int

    @property
    def is_better(self) -> bool:
        """Return True if the model wins more comparisons with the VJM than it loses."""
        return self.ratio < 1.0 and self.counts["a"] > self.counts["b"]


def dataset_answers(answer: Answer) -> list[DatasetAnswer]:
    """Return the best model of each data set, preferably one that beats the VJM."""
    answers = []
    for dataset, cases in answer.datasets.items():
        ratios = {
            name: ratio
            for name in answer.model_names
            if all(name in case.scores for case in cases)
            and (ratio := answer.mean_ratio(name, cases)) is not None
        }
        if not ratios:
            continue
        models = [
            DatasetAnswer(dataset, name, ratio, _verdicts(answer, name, cases), len(cases))
            for name, ratio in ratios.items()
        ]
        winners = [model for model in models if model.is_better]
        answers.append(min(winners or models, key=lambda model: model.ratio))
    return answers


def _verdicts(answer: Answer, model: str, cases: Sequence[ScoredCase]) -> Counter[Verdict]:
    return Counter(v for case in cases if (v := answer.verdict(model, case)) is not None)


def change(ratio: float) -> str:
    """Return a ratio to the VJM's error as a change.

    >>> change(0.512), change(1.06)
    ('49 % less', '6 % more')
    """
    return f"{abs(1.0 - ratio) * 100.0:.0f} % {'less' if ratio <= 1.0 else 'more'}"


def headline(answer: Answer) -> str:
    """Return the answer in one line: over robots, or per data set."""
    best, robots = recommended(answer), answer.claim_robots
    if best is None or best.ratio is None:
        return _by_score(answer)
    if robots:
        over = answer.claim_scope
        if not best.is_better or best.high is None or best.low is None:
            return f"No model is reliably better than the VJM over {over}"
        interval = f"{100 * (1 - best.high):.0f} to {100 * (1 - best.low):.0f} %"
        return (
            f"Use {best.name}: {change(best.ratio)} error than the VJM ({interval}, "
            f"{percent(1.0 - LEVEL)} interval over {over})"
        )
    by_dataset = dataset_answers(answer)
    if len(by_dataset) == 1:
        return _dataset_headline(by_dataset[0])
    sure = [best_model for best_model in by_dataset if best_model.is_better]
    if not sure:
        return "No model is reliably better than the VJM on any of these data sets"
    names = grouped(sure, lambda best_model: best_model.model)
    most_first = sorted(names.items(), key=lambda item: -len(item[1]))
    parts = [
        f"{model} on {first_few([f'{best.dataset} ({_won(best)})' for best in of_model], 2)}"
        for model, of_model in most_first
    ]
    none_on = [best_model.dataset for best_model in by_dataset if best_model not in sure]
    none = f"; none on {first_few(none_on, 2)}" if none_on else ""
    return f"Better than the VJM: {first_few(parts, 3)}{none}"


def _won(best: DatasetAnswer) -> str:
    return f"{best.counts['a']} of {counted(best.n_cases, 'comparison')}"


def _dataset_headline(best: DatasetAnswer) -> str:
    on = f"on {best.dataset}"
    if not best.is_better:
        return f"No model is reliably better than the VJM {on}"
    won = f" (better in {_won(best)})" if best.n_cases > 1 else ""
    return f"Use {best.model} {on}: {change(best.ratio)} error than the VJM{won}"


def _by_score(answer: Answer) -> str:
    counts = Counter(answer.best(case) for case in answer.cases)
    (model, n_best), *_ = counts.most_common()
    return f"{model} has the best {answer.key.text} in {n_best} of {len(answer.cases)} comparisons"


def recommended(answer: Answer) -> ModelAnswer | None:
    """Return the best complete model except the VJM; None: there is none."""
    complete = [model for model in answer.models if model.n_cases == len(answer.cases)]
    return next((model for model in complete if model.name != REFERENCE_MODEL), None)


def sentences(answer: Answer) -> list[Sentence]:
    """Return the sentences after the headline: certainty, gain, exceptions, data."""
    best = recommended(answer)
    if best is None or best.ratio is None or best.smallest is None or best.largest is None:
        return [Sentence("Data", _data(answer))]
    tested = sum(best.counts.values())
    sure = (
        f"{best.name} is better than the VJM in {best.counts['a']} of "
        f"{counted(tested, 'comparison')}, worse in {best.counts['b']}; "
        f"{best.counts['open'] + best.counts['equivalent']} show no significant difference."
    )
    if not tested:
        sure = "No test applies: there is one split, and poses cannot be resampled."
    unit, factor = PRINTED[answer.key.metric.unit]
    errors = sorted(factor * case.mean(best.name) for case in answer.cases)
    span = change(best.ratio)
    if len(answer.cases) > 1 and change(best.smallest) != change(best.largest):
        most, least = change(best.smallest), change(best.largest)
        same = most.split()[-1] == least.split()[-1]
        nearer, farther = (least, most) if best.largest <= 1.0 else (most, least)
        span = f"{nearer.split()[0]} to {farther}" if same else f"{most} to {least}"
    remaining = " to ".join(dict.fromkeys(f"{error:.2f}" for error in (errors[0], errors[-1])))
    lines = [
        Sentence("How sure", sure),
        Sentence(
            "Gain" if best.largest <= 1.0 else "Change",
            f"{span} error than the VJM; {remaining} {unit} of error remain.",
        ),
    ]
    if exceptions := _exceptions(answer, best.name):
        lines.append(Sentence("But", exceptions))
    return [*lines, Sentence("Data", _data(answer))]


def _exceptions(answer: Answer, model: str) -> str:
    """Return the comparisons in which another model is significantly better; "" for none."""
    unit, factor = PRINTED[answer.key.metric.unit]
    parts = []
    for column in answer.columns:
        rival = answer.best_of(column)
        if rival is None or rival in (model, REFERENCE_MODEL):
            continue
        if all(answer.verdict(rival, case, model) == "a" for case in column.cases):
            errors = [answer.column_error(name, column) for name in (rival, model)]
            smaller, larger = (f"{factor * (error or 0.0):.2f}" for error in errors)
            parts.append(
                f"on {_short_heading(answer, column)} {rival} is better ({smaller} against "
                f"{larger} {unit})"
            )
    text = first_few(parts, 2)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _short_heading(answer: Answer, column: MatrixColumn) -> str:
    """Return a column's name, without its protocol if there is only one."""
    plans = {(column.protocol, column.condition) for column in answer.columns}
    return column.dataset if len(plans) == 1 else column.text.replace(" | ", ", ")


def _data(answer: Answer) -> str:
    """Return a text on the measured data and on the scope of the claim."""
    measured, n_sets = answer.measured, len(answer.datasets)
    text = "All data are simulated."
    if measured:
        samples = {name: len(cases[0].data.measured) for name, cases in measured.items()}
        sample_counts = first_few(
            [f"{name}, {counted(n, 'sample')}" for name, n in samples.items()], 2
        )
        verb = "is" if len(measured) == 1 else "are"
        text = f"{len(measured)} of {counted(n_sets, 'data set')} {verb} measured ({sample_counts})"
        text = f"{text}: {_on_measured(answer, [*chain.from_iterable(measured.values())])}."
    if not answer.claim_robots:
        number = counted(len(answer.robots), "robot")
        text += f" {number}: too few for a claim about other robots (at least {FEWEST_ROBOTS})."
    return text


def _on_measured(answer: Answer, cases: Sequence[ScoredCase]) -> str:
    """Return a text on the models that beat the VJM on measured data."""
    better = [
        name
        for name in answer.model_names
        if any(answer.verdict(name, case) == "a" for case in cases)
    ]
    if not better:
        return "there, no model is reliably better than the VJM"
    return f"there, {first_few(better)} {'is' if len(better) == 1 else 'are'} better than the VJM"


def matrix_table(answer: Answer) -> Table:
    """Return mean scores by model, data set and protocol; the best ones are marked."""
    unit, factor = PRINTED[answer.key.metric.unit]
    written = MATRIX_FORMAT if unit == "mm" else number_format(answer.key.metric)

    def cell(error: float | None, is_best: bool = False) -> Entry:
        return None if error is None else Quantity(factor * error, mark=BEST_MARK * is_best)

    columns = [
        Column(
            " ".join(filter(None, (column.protocol, column.condition))),
            unit=unit,
            format=written,
            group=f"{column.dataset} (measured)" if column.is_measured else column.dataset,
        )
        for column in answer.columns
    ]
    best = [answer.best_of(column) for column in answer.columns]
    rows: list[list[Entry]] = [
        [
            Name(model.name, model.mark),
            *(
                cell(answer.column_error(model.name, column), model.name == of_column)
                for column, of_column in zip(answer.columns, best, strict=True)
            ),
        ]
        for model in answer.models
    ]
    floors = [answer.column_noise(column) for column in answer.columns]
    if any(floor is not None for floor in floors):
        rows.append([NOISE_FLOOR, *map(cell, floors)])
    return Table(
        f"{answer.key.text}, mean over splits; {BEST_MARK}: best of the column",
        [Column("model", "text"), *columns],
        rows,
        unit=unit,
    )


def model_table(answer: Answer) -> Table:
    """Return a row per model: median error, change, verdicts and fit time."""
    unit, factor = PRINTED[answer.key.metric.unit]
    interval = Column(
        f"{percent(1.0 - LEVEL)} interval over robots",
        unit="%",
        format="+.0f",
        value=lambda model: Quantity(low=_percent(model.low), high=_percent(model.high)),
    )
    return Table.of(
        headline(answer),
        [
            Column("model", "text", value=lambda model: Name(model.name, model.mark)),
            Column(
                "median error",
                unit=unit,
                format=number_format(answer.key.metric),
                value=lambda model: factor * model.median_error,
            ),
            Column(
                *("vs VJM", "number", "%", "+.0f"),
                by_sign=-1,
                value=lambda model: _percent(model.ratio),
            ),
            *([interval] if answer.claim_robots else []),
            Column("better", value=lambda model: model.counts["a"]),
            Column("worse", value=lambda model: model.counts["b"]),
            Column("open", value=lambda model: model.counts["open"] + model.counts["equivalent"]),
            Column(
                *("fit", "number", "s"),
                format=lambda fit: duration(fit.value),
                value=lambda model: model.fit_s,
            ),
        ],
        answer.models,
        [sentence.text for sentence in sentences(answer)],
    )


def _percent(ratio: float | None) -> float | None:
    return None if ratio is None else 100.0 * (ratio - 1.0)
