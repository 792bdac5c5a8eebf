"""Write a comparison as a headline, tables and notes; lengths are converted to mm.

The columns and marks are explained in docs/definitions.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

from stiff_bench.analysis.case_text import signed_percent
from stiff_bench.analysis.collected import split_sizes
from stiff_bench.analysis.comparison import NORM, Comparison, ModelComparison, Row
from stiff_bench.analysis.scored_case import dataset_of, family_of
from stiff_bench.analysis.verdict import (
    DISAGREEMENTS,
    Estimate,
    Question,
    Verdict,
    decide,
    disagreement,
)
from stiff_bench.analysis.where import Place, best_divisions
from stiff_bench.store.names import grouped, label_parts, labels
from stiff_bench.tables.metric_table import mark_of, setting
from stiff_bench.tables.table import (
    SCREEN,
    WRITTEN,
    Column,
    Entry,
    Name,
    Quantity,
    Table,
    text_columns,
)
from stiff_bench.tables.units import MM, PRINTED, counted, percent
from stiff_protocols.scoring.paired import wilcoxon_signed_rank

VERDICTS: dict[Verdict, str] = {
    "a": "A better",
    "b": "B better",
    "equivalent": "equivalent",
    "open": "no significant difference",
}
SELECTS_ON_TEST = "selects on the test part"
"""Mark of a case whose protocol lets models choose on the test part."""
FEWEST_DATASETS = 5
"""Fewest data sets for a p value over data sets."""


def comparison_tables(report: ModelComparison) -> list[Table]:
    """Return the tables; csv has only the estimates, json all tables and all notes."""
    if len(report.comparisons) > 1:
        tables = {"cases": _cases(report)}
        if (over_datasets := _over_datasets(report)).rows:
            tables["over datasets"] = over_datasets
    else:
        tables = {"errors": _errors(report)}
        if report.where:
            tables["where"] = _places(report, best_divisions(report.where))
    *_, last_name = tables
    tables[last_name] = replace(
        tables[last_name], notes=list(dict.fromkeys(_notes(report))), brief=True
    )
    about = {"a": report.a, "b": report.b}
    file_tables = [
        replace(table, about={**about, "table": name}, formats=WRITTEN)
        for name, table in tables.items()
    ]
    estimates = replace(_estimates(report), about={**about, "table": "estimates"})
    notes = file_tables[-1].notes
    differences = replace(_differences(report), about={**about, "table": "differences"})
    on_screen = replace(differences, notes=notes, brief=True, formats=(SCREEN,))
    return [*file_tables, replace(estimates, formats=("csv", "json")), on_screen]


def sentence(report: ModelComparison) -> str:
    """Return the result in a few sentences.

    Cases that select on the test part are counted separately. If the verdicts among all models
    differ, they follow.
    """
    return " ".join(filter(None, [_describe_result(report), _among_all(report)]))


def _among_all(report: ModelComparison) -> str:
    """Return the verdicts of leaderboard and report page; "" if they are the same."""
    fair = [comparison for comparison in report.comparisons if not comparison.selects_on_test]
    verdicts = [
        (comparison, comparison.among_all)
        for comparison in fair or report.comparisons
        if comparison.among_all
    ]
    if all(comparison.row(NORM).verdict == verdict for comparison, verdict in verdicts):
        return ""
    is_usual = report.question == Question(seed=report.question.seed)  # as on the leaderboard
    source = ", as leaderboard and report page show" * is_usual
    count = Counter(verdict for _, verdict in verdicts)
    place, outcome = "of each comparison", _numbers_of(report, count)
    if len(report.comparisons) == 1:
        (verdict,) = count
        better = {"a": f"{report.a} is better", "b": f"{report.b} is better"}
        place, outcome = "here", better.get(verdict, VERDICTS[verdict])
    return f"Among all models {place}{source} (p corrected for all pairs, Holm): {outcome}."


def _describe_result(report: ModelComparison) -> str:
    """Return the result on A and B, without a correction for other models."""
    if len(report.comparisons) == 1:
        return _describe_comparison(report, report.comparisons[0])
    fair = [comparison for comparison in report.comparisons if not comparison.selects_on_test]
    over_splits = [comparison for comparison in fair if comparison.over_splits]
    of_fits = [comparison for comparison in fair if not comparison.over_splits]
    parts = []
    for comparisons, kind in (
        (over_splits, " over several splits" if of_fits else ""),
        (of_fits, " on one split or pooled splits (these fits)"),
    ):
        if comparisons:
            count = Counter(comparison.row(NORM).verdict for comparison in comparisons)
            number = counted(len(comparisons), "comparison")
            parts.append(f"Of {number}{kind}: {_numbers_of(report, count)}.")
    if n_unfair := len(report.comparisons) - len(fair):
        parts.append(
            f"Not counted: {counted(n_unfair, 'comparison')} whose protocol {SELECTS_ON_TEST}."
        )
    return " ".join(parts)


def _numbers_of(report: ModelComparison, count: Counter[Verdict]) -> str:
    return (
        f"{report.a} better in {count['a']}, {report.b} better in {count['b']}, equivalent "
        f"(within {_rope(report)}) in {count['equivalent']}, no significant difference in "
        f"{count['open']}"
    )


def _describe_comparison(report: ModelComparison, comparison: Comparison) -> str:
    name, row = comparison.name, comparison.row(NORM)
    fits = "" if comparison.over_splits else "these fits"
    splits = counted(comparison.n_splits, "split")
    on = f"on {name.dataset} ({_joined(name.protocol, name.condition, splits, fits)})"
    level, main = percent(report.question.confidence), row.cautious
    over = "splits" if main is row.over_splits else "poses"
    if row.verdict == "equivalent":
        return (
            f"{report.a} and {report.b} are equivalent {on}: their mean 3-D errors differ by less "
            f"than {_rope(report)} with probability {_chance(main.posterior.equivalent)}."
        )
    a_better = row.verdict == "a"
    low, high = (-main.high, -main.low) if a_better else (main.low, main.high)
    interval = f"{level} interval {MM * low:.3f} to {MM * high:.3f} mm over {over}"
    if row.verdict == "open":
        return (
            f"No significant difference between {report.a} and {report.b} {on}: mean 3-D error of "
            f"{report.a} minus {report.b} {MM * row.difference:.3f} mm ({interval})."
            f"{_why_open(row)}"
        )
    better, worse = (report.a, report.b) if a_better else (report.b, report.a)
    return (
        f"{better} is better than {worse} {on}: mean 3-D error {MM * abs(row.difference):.3f} mm "
        f"smaller ({interval})."
    )


def _why_open(row: Row) -> str:
    """Return a sentence if splits and poses disagree on significance, else ""."""
    if row.over_splits is None:
        return ""
    return f" {DISAGREEMENTS[disagreement(row.over_splits, row.over_poses)]}".rstrip()


def _rope(report: ModelComparison) -> str:
    return f"{MM * report.question.rope:g} mm"


def _chance(chance: float) -> str:
    """Format a probability; it is never written as 0 or 1."""
    return "> 0.99" if chance > 0.99 else "< 0.01" if chance < 0.01 else f"{chance:.2f}"


def _notes(report: ModelComparison) -> Iterator[str]:
    """Yield notes on the numbers, most important first."""
    for comparison in report.comparisons:
        if comparison.a.regime != comparison.b.regime:
            a, b = (
                presentation.regime or "trained on measured deflections"
                for presentation in (comparison.a, comparison.b)
            )
            yield f"Different training data: {comparison.a.model}: {a}; {comparison.b.model}: {b}."
        if comparison.a.picked_on_test != comparison.b.picked_on_test:
            picked = comparison.a if comparison.a.picked_on_test else comparison.b
            protocol = comparison.name.protocol
            yield f"{protocol}: only {picked.model} picked its epoch on the test part."
        if comparison.a.selects_on_test:
            yield comparison.a.warning
    if not all(comparison.over_splits for comparison in report.comparisons):
        yield (
            "these fits: one split or pooled splits do not show how results vary with the training "
            "samples; repeated-holdout with --splits 5 does."
        )
    if report.where:
        counts = Counter(place.verdict for place in report.where)
        yield (
            f"where: {len(report.where)} subgroups tested, Holm-corrected; {report.a} better in "
            f"{counts['a']}, {report.b} in {counts['b']}."
        )
    case_labels = labels(comparison.name for comparison in report.comparisons)
    for comparison in report.comparisons:
        place = f"{case_labels[comparison.name]}: " if len(report.comparisons) > 1 else ""
        yield from (f"{place}{line}." for line in comparison.missing)
    yield from report.notes
    yield from (caveat for comparison in report.comparisons for caveat in comparison.a.caveats)
    yield from report.provenance


_UNIT, _LENGTH, _DIFFERENCE = PRINTED["m"][0], ".4f", "+.4f"


def _p_text(quantity: Quantity) -> str:
    p_value = quantity.value or 0.0
    return "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"


def _chance_text(quantity: Quantity) -> str:
    return _chance(quantity.value or 0.0)


def _interval(estimate: Estimate) -> Quantity:
    return Quantity(low=MM * estimate.low, high=MM * estimate.high)


def _number_columns(
    report: ModelComparison, of: Callable[[Any], Any] = lambda row: row
) -> list[Column]:
    """Return the columns that all tables share.

    `of` converts a row of the table to an object with `means` [m] and an `estimate`.
    """

    def column(name: str, value: Callable[[Any], Entry], unit: str, spec: Any) -> Column:
        return Column(name, unit=unit, format=spec, value=lambda row: value(of(row)))

    interval = f"{percent(report.question.confidence)} interval"
    return [
        column("A", lambda row: MM * row.means[0], _UNIT, _LENGTH),
        column("B", lambda row: MM * row.means[1], _UNIT, _LENGTH),
        column("A - B", lambda row: MM * (row.means[0] - row.means[1]), _UNIT, _DIFFERENCE),
        column(interval, lambda row: _interval(row.estimate), _UNIT, _DIFFERENCE),
        column("p", lambda row: row.estimate.p_value, "", _p_text),
        column("P(A better)", lambda row: row.estimate.posterior.a_better, "", _chance_text),
        column("P(equivalent)", lambda row: row.estimate.posterior.equivalent, "", _chance_text),
        column("P(B better)", lambda row: row.estimate.posterior.b_better, "", _chance_text),
    ]


def _text_column(name: str, value: Callable[[Any], Entry], hidden: bool = False) -> Column:
    return Column(name, "text", hidden=hidden, value=value)


def _errors(report: ModelComparison) -> Table:
    (comparison,) = report.comparisons
    name = comparison.name
    a, b = (
        Name(presentation.model, mark_of(presentation))
        for presentation in (comparison.a, comparison.b)
    )
    where = setting(comparison.a, name.condition, comparison.n_splits, name.seed)
    over_poses = Column(
        *("interval over poses", "number", _UNIT, _DIFFERENCE),
        value=lambda row: _interval(row.over_poses),
    )
    return Table.of(
        f"A = {a}, B = {b} | {where} | mean error, mm",
        [
            _text_column(
                "mean error", lambda row: "3-D" if row.error == NORM else row.error.upper()
            ),
            *_number_columns(report),
            *([over_poses] if comparison.over_splits else []),
            _text_column("verdict", lambda row: _shown_verdict(row, report)),
        ],
        comparison.rows,
        unit=_UNIT,
    )


def _cases(report: ModelComparison) -> Table:
    case_labels = label_parts(comparison.name for comparison in report.comparisons)
    kinds = " and ".join(dict.fromkeys(comparison.a.kind for comparison in report.comparisons))
    return Table.of(
        f"A = {report.a}, B = {report.b} | {len(report.comparisons)} comparisons ({kinds}) | "
        "mean 3-D error, mm",
        [
            _text_column(
                "comparison",
                lambda comparison: Name(_joined(*case_labels[comparison.name]), _marks(comparison)),
            ),
            Column("splits", value=lambda comparison: comparison.n_splits),
            *_number_columns(report, lambda comparison: comparison.row(NORM)),
            _text_column(
                "verdict", lambda comparison: _shown_verdict(comparison.row(NORM), report)
            ),
        ],
        report.comparisons,
        unit=_UNIT,
    )


def _differences(report: ModelComparison) -> Table:
    """Return a row per case for a terminal: change, deciding interval and verdict."""
    case_labels = label_parts(comparison.name for comparison in report.comparisons)
    interval = f"{percent(report.question.confidence)} interval"
    return Table.of(
        f"A = {report.a}, B = {report.b} · mean 3-D error in mm",
        [
            _text_column(
                "comparison", lambda pair: Name(_joined(*case_labels[pair.name]), _marks(pair))
            ),
            *(
                Column(name, format=".3f", value=partial(_mean, number))
                for number, name in enumerate("AB")
            ),
            Column("A - B", format="+.3f", value=lambda case: MM * case.row(NORM).difference),
            Column("vs B", format=signed_percent, by_sign=-1, value=_change),
            Column(interval, format="+.3f", value=lambda case: _interval(case.row(NORM).cautious)),
            _text_column("verdict", lambda case: _brief_verdict(case.row(NORM))),
        ],
        report.comparisons,
        unit=_UNIT,
    )


def _mean(number: int, comparison: Comparison) -> float:
    return MM * comparison.row(NORM).means[number]


def _change(comparison: Comparison) -> Entry:
    a, b = comparison.row(NORM).means
    return 100.0 * (a / b - 1.0) if b else None


def _brief_verdict(row: Row) -> str:
    """Return the verdict; if splits and poses disagree, with both."""
    if row.verdict != "open" or row.over_splits is None:
        return "open" if row.verdict == "open" else _verdict(row)
    sure = disagreement(row.over_splits, row.over_poses)
    unsure = {"splits": "poses", "poses": "splits"}.get(sure, "")
    return f"open ({sure}: yes, {unsure}: no)" if sure else "open"


def _places(report: ModelComparison, places: Sequence[Place]) -> Table:
    numbers = _number_columns(report)
    return Table.of(
        "Where each is better (these fits) | mean 3-D error, mm",
        [
            _text_column("where", place_text),
            _text_column("kind", lambda place: place.factor.kind, hidden=True),
            Column("samples", value=lambda place: place.n_samples),
            Column("poses", value=lambda place: place.errors.n_tested),
            *numbers[:5],
            *(replace(column, hidden=True) for column in numbers[5:]),
            _text_column("verdict", lambda place: VERDICTS[place.verdict]),
        ],
        places,
        unit=_UNIT,
    )


def _over_datasets(report: ModelComparison) -> Table:
    """Summarize the data sets of each robot type with several data sets.

    Splits or repeats with another seed do not count as data sets. Differences of repeats are
    averaged; if repeats disagree, the verdict is open. A name used for different data is left out.
    """
    rows: list[list[Entry]] = []
    of_name = {comparison.name: comparison for comparison in report.comparisons}
    groups = grouped(
        of_name, lambda name: (family_of(name), name.protocol, name.condition, name.seed)
    )
    alike = Counter(place[:3] for place, names in groups.items() if len(names) > 1)
    for (*_, seed), names in groups.items():
        place = family_of(names[0]), names[0].protocol, names[0].condition
        group = [of_name[name] for name in names]
        datasets = [*grouped(group, lambda comparison: dataset_of(comparison.name)).values()]
        if len(datasets) < 2 or len({name.dataset for name in names}) < len(names):
            continue
        dataset_rows = [[comparison.row(NORM) for comparison in repeats] for repeats in datasets]
        differences = [
            float(np.mean([row.difference for row in repeats])) for repeats in dataset_rows
        ]
        verdicts = [{row.verdict for row in repeats} for repeats in dataset_rows]
        count = Counter(
            repeat_verdicts.pop() if len(repeat_verdicts) == 1 else "open"
            for repeat_verdicts in verdicts
        )
        fits = "" if all(comparison.over_splits for comparison in group) else "these fits"
        repeated = f"seed {seed}" if alike[place] > 1 else ""
        selects = any(comparison.selects_on_test for comparison in group)
        rows.append(
            [
                Name(_joined(*place, repeated, fits), SELECTS_ON_TEST * selects),
                len(datasets),
                *(count[verdict] for verdict in VERDICTS),
                MM * float(np.mean(differences)),
                wilcoxon_signed_rank(differences) if len(datasets) >= FEWEST_DATASETS else None,
            ]
        )
    return Table(
        "Over data sets | mean 3-D error, mm",
        [
            Column("over data sets of one robot type", "text"),
            *map(Column, ("data sets", *VERDICTS.values())),
            Column("mean A - B", unit=_UNIT, format=_DIFFERENCE),
            Column("p over data sets", format=_p_text),
        ],
        rows,
        unit=_UNIT,
    )


def _estimates(report: ModelComparison) -> Table:
    """Return the estimates of each method for each error in each case."""
    rows: list[dict[str, Any]] = []
    for comparison in report.comparisons:
        name, (n_train, n_test) = comparison.name, split_sizes(comparison.results[0])
        about = {
            **asdict(name),
            **{"splits": comparison.n_splits, "selects_on_test": comparison.selects_on_test},
            **{"mark_a": mark_of(comparison.a), "mark_b": mark_of(comparison.b)},
            **{"n_train": n_train, "n_test": n_test, "n_poses": comparison.n_poses},
        }
        for row in comparison.rows:
            for method, estimate in (
                ("over splits", row.over_splits),
                ("over poses", row.over_poses),
            ):
                labels_of_row = {"error": row.error, "method": method, "verdict": _verdict(row)}
                if estimate is not None:
                    rows.append(
                        {**about, **labels_of_row, "numbers": replace(row, over_splits=estimate)}
                    )
    *texts, numbers = rows[0]
    return Table.of(
        "Estimates by each method | mean error, mm",
        [*text_columns(*texts), *_number_columns(report, itemgetter(numbers))],
        rows,
        unit=_UNIT,
    )


def _marks(comparison: Comparison) -> str:
    """Return the marks of a case in a table: of its protocol, of A and of B."""
    a, b = mark_of(comparison.a), mark_of(comparison.b)
    marks = [f"A and B: {a}"] if a and a == b else [f"A: {a}" if a else "", f"B: {b}" if b else ""]
    return "; ".join(filter(None, [SELECTS_ON_TEST if comparison.selects_on_test else "", *marks]))


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _verdict(row: Row) -> str:
    """Return the verdict in words, with a mark if it holds only for these fits."""
    of_fits = row.over_splits is None and row.verdict != "open"
    return f"{VERDICTS[row.verdict]}{' (these fits)' if of_fits else ''}"


def _shown_verdict(row: Row, report: ModelComparison) -> str:
    """Return the verdict, with a mark if only the splits decide."""
    if row.over_splits is None or row.verdict != "open":
        return _verdict(row)
    of_splits = decide([row.over_splits], report.question.confidence)
    return f"{_verdict(row)}{' (poses)' if of_splits in ('a', 'b') else ''}"


def place_text(place: Place) -> str:
    """Return the name of a place, with unit."""
    name, unit = place.factor.name, place.factor.unit
    if isinstance(place.values, str):
        return f"{name}: {place.values}"
    unit, scale = PRINTED["m"] if unit == "m" else (unit, 1.0)
    decimals = 0 if abs(scale * place.values[1]) >= 100.0 else 1
    low, high = (f"{scale * value:.{decimals}f}" for value in place.values)
    return f"{name} {low} to {high} {unit}"
