"""Tables and sentences of a comparison of two models; lengths are converted to mm.

The columns and marks are explained in docs/definitions.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from stiff_bench.results.columns import signed_percent
from stiff_bench.results.comparison import NORM, Comparison, Difference, ModelComparison
from stiff_bench.results.metric_tables import setting
from stiff_bench.results.notes import mark_of
from stiff_bench.results.scored_task import dataset_of, family_of, split_sizes
from stiff_bench.results.significance import Estimate, Question, Verdict, decide, disagreement
from stiff_bench.results.summary import DISAGREEMENTS
from stiff_bench.store.names import grouped, label_parts, labels
from stiff_bench.tables.table import SCREEN, WRITTEN, Column, Entry, Name, Quantity, Table
from stiff_bench.tables.table import text_columns as texts
from stiff_bench.tables.units import MM, PRINTED, counted, percent
from stiff_protocols.scoring.paired import wilcoxon_signed_rank

VERDICTS: dict[Verdict, str] = {
    "a": "A better",
    "b": "B better",
    "equivalent": "equivalent",
    "open": "no significant difference",
}
SELECTS_ON_TEST = "selects on the test part"
"""Mark of a task whose protocol lets models choose on the test part."""
FEWEST_DATASETS = 5
"""Fewest data sets for a p value over data sets."""


def comparison_tables(report: ModelComparison) -> list[Table]:
    """Return the tables; csv has only the estimates, json all tables and all notes."""
    tables = {"errors": _errors(report)}
    if len(report.comparisons) > 1:
        tables = {"cases": _tasks(report)}
        if (over_datasets := _over_datasets(report)).rows:
            tables["over datasets"] = over_datasets
    *_, last_name = tables
    notes = list(dict.fromkeys(_notes(report)))
    tables[last_name] = replace(tables[last_name], notes=notes, brief=True)
    about = {"a": report.a, "b": report.b}
    file_tables = [
        replace(table, about={**about, "table": name}, formats=WRITTEN)
        for name, table in tables.items()
    ]
    estimates = replace(_estimates(report), about={**about, "table": "estimates"})
    differences = replace(_differences(report), about={**about, "table": "differences"})
    on_screen = replace(differences, notes=notes, brief=True, formats=(SCREEN,))
    return [*file_tables, replace(estimates, formats=("csv", "json")), on_screen]


# sentences


def comparison_text(report: ModelComparison) -> str:
    """Return the result in a few sentences.

    Tasks that select on the test part are counted separately. If the verdicts among all models
    differ, they follow.
    """
    return " ".join(filter(None, [_result_text(report), _among_all_text(report)]))


def _fair(report: ModelComparison) -> list[Comparison]:
    return [comparison for comparison in report.comparisons if not comparison.selects_on_test]


def _among_all_text(report: ModelComparison) -> str:
    """Return the verdicts of leaderboard and report page; "" if they are the same."""
    verdicts = [
        (comparison, comparison.among_all)
        for comparison in _fair(report) or report.comparisons
        if comparison.among_all
    ]
    if all(comparison.norm.verdict == verdict for comparison, verdict in verdicts):
        return ""
    is_usual = report.question == Question(seed=report.question.seed)  # as on the leaderboard
    source = ", as leaderboard and report page show" * is_usual
    count = Counter(verdict for _, verdict in verdicts)
    place, outcome = "of each comparison", _count_text(report, count)
    if len(report.comparisons) == 1:
        (verdict,) = count
        better = {"a": f"{report.a} is better", "b": f"{report.b} is better"}
        place, outcome = "here", better.get(verdict, VERDICTS[verdict])
    return f"Among all models {place}{source} (p corrected for all pairs, Holm): {outcome}."


def _result_text(report: ModelComparison) -> str:
    """Return the result on A and B, without a correction for other models."""
    if len(report.comparisons) == 1:
        return _task_text(report, report.comparisons[0])
    fair = _fair(report)
    over_splits = [comparison for comparison in fair if comparison.over_splits]
    of_fits = [comparison for comparison in fair if not comparison.over_splits]
    parts = []
    for comparisons, kind in (
        (over_splits, " over several splits" if of_fits else ""),
        (of_fits, " on one split or pooled splits (these fits)"),
    ):
        if comparisons:
            count = Counter(comparison.norm.verdict for comparison in comparisons)
            number = counted(len(comparisons), "comparison")
            parts.append(f"Of {number}{kind}: {_count_text(report, count)}.")
    if n_unfair := len(report.comparisons) - len(fair):
        parts.append(
            f"Not counted: {counted(n_unfair, 'comparison')} whose protocol {SELECTS_ON_TEST}."
        )
    return " ".join(parts)


def _count_text(report: ModelComparison, count: Counter[Verdict]) -> str:
    return (
        f"{report.a} better in {count['a']}, {report.b} better in {count['b']}, equivalent "
        f"(within {_rope(report)}) in {count['equivalent']}, no significant difference in "
        f"{count['open']}"
    )


def _task_text(report: ModelComparison, comparison: Comparison) -> str:
    name, norm = comparison.name, comparison.norm
    fits = "" if comparison.over_splits else "these fits"
    splits = counted(comparison.n_splits, "split")
    on = f"on {name.dataset} ({_joined(name.protocol, name.condition, splits, fits)})"
    level, main = percent(report.question.confidence), norm.cautious
    over = "splits" if main is norm.over_splits else "poses"
    if norm.verdict == "equivalent":
        return (
            f"{report.a} and {report.b} are equivalent {on}: their mean 3-D errors differ by less "
            f"than {_rope(report)} with probability {_chance(main.posterior.equivalent)}."
        )
    a_better = norm.verdict == "a"
    low, high = (-main.high, -main.low) if a_better else (main.low, main.high)
    interval = f"{level} interval {MM * low:.3f} to {MM * high:.3f} mm over {over}"
    if norm.verdict == "open":
        apart = ""
        if norm.over_splits is not None:
            apart = f" {DISAGREEMENTS[disagreement(norm.over_splits, norm.over_poses)]}".rstrip()
        return (
            f"No significant difference between {report.a} and {report.b} {on}: mean 3-D error of "
            f"{report.a} minus {report.b} {MM * norm.difference:.3f} mm ({interval}).{apart}"
        )
    better, worse = (report.a, report.b) if a_better else (report.b, report.a)
    return (
        f"{better} is better than {worse} {on}: mean 3-D error {MM * abs(norm.difference):.3f} mm "
        f"smaller ({interval})."
    )


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
    task_labels = labels(comparison.name for comparison in report.comparisons)
    for comparison in report.comparisons:
        place = f"{task_labels[comparison.name]}: " if len(report.comparisons) > 1 else ""
        yield from (f"{place}{line}." for line in comparison.missing)
    yield from report.notes
    yield from (caveat for comparison in report.comparisons for caveat in comparison.a.caveats)
    yield from report.provenance


# columns


_UNIT, _LENGTH, _DIFFERENCE = PRINTED["m"][0], ".4f", "+.4f"


def _p_text(quantity: Quantity) -> str:
    p_value = quantity.value or 0.0
    return "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"


def _chance_text(quantity: Quantity) -> str:
    return _chance(quantity.value or 0.0)


def _interval(estimate: Estimate) -> Quantity:
    return Quantity(low=MM * estimate.low, high=MM * estimate.high)


def _number_columns(
    report: ModelComparison, of: Callable[[Any], Difference] = lambda row: row
) -> list[Column]:
    """Return the columns that all tables share; `of` returns the difference of a row."""

    def column(name: str, value: Callable[[Difference], Entry], unit: str, spec: Any) -> Column:
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


def _text_column(name: str, value: Callable[[Any], Entry]) -> Column:
    return Column(name, "text", value=value)


def _task_column(report: ModelComparison) -> Column:
    parts = label_parts(comparison.name for comparison in report.comparisons)
    return _text_column(
        "comparison",
        lambda comparison: Name(_joined(*parts[comparison.name]), _marks(comparison)),
    )


# tables


def _errors(report: ModelComparison) -> Table:
    comparison = report.comparisons[0]
    a, b = (
        Name(presentation.model, mark_of(presentation))
        for presentation in (comparison.a, comparison.b)
    )
    name = comparison.name
    place = setting(comparison.a, name.condition, comparison.n_splits, name.seed)
    over_poses = Column(
        *("interval over poses", "number", _UNIT, _DIFFERENCE),
        value=lambda row: _interval(row.over_poses),
    )
    return Table.of(
        f"A = {a}, B = {b} | {place} | mean error, mm",
        [
            _text_column(
                "mean error", lambda row: "3-D" if row.error == NORM else row.error.upper()
            ),
            *_number_columns(report),
            *([over_poses] if comparison.over_splits else []),
            _text_column("verdict", lambda row: _shown_verdict(row, report)),
        ],
        comparison.differences.values(),
        unit=_UNIT,
    )


def _tasks(report: ModelComparison) -> Table:
    kinds = " and ".join(dict.fromkeys(comparison.a.kind for comparison in report.comparisons))
    return Table.of(
        f"A = {report.a}, B = {report.b} | {len(report.comparisons)} comparisons ({kinds}) | "
        "mean 3-D error, mm",
        [
            _task_column(report),
            Column("splits", value=lambda comparison: comparison.n_splits),
            *_number_columns(report, lambda comparison: comparison.norm),
            _text_column("verdict", lambda comparison: _shown_verdict(comparison.norm, report)),
        ],
        report.comparisons,
        unit=_UNIT,
    )


def _differences(report: ModelComparison) -> Table:
    """Return a row per task for a terminal: change, deciding interval and verdict."""
    interval = f"{percent(report.question.confidence)} interval"
    return Table.of(
        f"A = {report.a}, B = {report.b} · mean 3-D error in mm",
        [
            _task_column(report),
            *(
                Column(name, format=".3f", value=partial(_mean, number))
                for number, name in enumerate("AB")
            ),
            Column("A - B", format="+.3f", value=lambda pair: MM * pair.norm.difference),
            Column("vs B", format=signed_percent, is_change=True, value=_change),
            Column(interval, format="+.3f", value=lambda pair: _interval(pair.norm.cautious)),
            _text_column("verdict", lambda pair: _brief_verdict(pair.norm)),
        ],
        report.comparisons,
        unit=_UNIT,
    )


def _mean(number: int, comparison: Comparison) -> float:
    return MM * comparison.norm.means[number]


def _change(comparison: Comparison) -> Entry:
    a, b = comparison.norm.means
    return 100.0 * (a / b - 1.0) if b else None


def _brief_verdict(row: Difference) -> str:
    """Return the verdict; if splits and poses disagree, with both."""
    if row.verdict != "open" or row.over_splits is None:
        return "open" if row.verdict == "open" else _verdict(row)
    sure = disagreement(row.over_splits, row.over_poses)
    unsure = {"splits": "poses", "poses": "splits"}.get(sure, "")
    return f"open ({sure}: yes, {unsure}: no)" if sure else "open"


def _over_datasets(report: ModelComparison) -> Table:
    """Summarize the data sets of each robot type with several data sets.

    Splits or repeats with another seed do not count as data sets. Differences of repeats are
    averaged; if repeats disagree, the verdict is open. A name used for different data is left out.
    """
    rows: list[list[Entry]] = []
    by_name = {comparison.name: comparison for comparison in report.comparisons}
    groups = grouped(
        by_name, lambda name: (family_of(name), name.protocol, name.condition, name.seed)
    )
    alike = Counter(place[:3] for place, names in groups.items() if len(names) > 1)
    for (*_, seed), names in groups.items():
        place = family_of(names[0]), names[0].protocol, names[0].condition
        group = [by_name[name] for name in names]
        datasets = [*grouped(group, lambda comparison: dataset_of(comparison.name)).values()]
        if len(datasets) < 2 or len({name.dataset for name in names}) < len(names):
            continue
        norms = [[comparison.norm for comparison in repeats] for repeats in datasets]
        differences = [float(np.mean([norm.difference for norm in repeats])) for repeats in norms]
        verdicts = [{norm.verdict for norm in repeats} for repeats in norms]
        count = Counter(of.pop() if len(of) == 1 else "open" for of in verdicts)
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
    """Return the estimates of each method for each error in each task."""
    rows: list[dict[str, Any]] = []
    for comparison in report.comparisons:
        name, (n_train, n_test) = comparison.name, split_sizes(comparison.results[0])
        about = {
            **asdict(name),
            **{"splits": comparison.n_splits, "selects_on_test": comparison.selects_on_test},
            **{"mark_a": mark_of(comparison.a), "mark_b": mark_of(comparison.b)},
            **{"n_train": n_train, "n_test": n_test, "n_poses": comparison.n_poses},
        }
        for row in comparison.differences.values():
            methods = {"over splits": row.over_splits, "over poses": row.over_poses}
            for method, estimate in methods.items():
                facts = {"error": row.error, "method": method, "verdict": _verdict(row)}
                if estimate is not None:
                    numbers = replace(row, over_splits=estimate)
                    rows.append({**about, **facts, "numbers": numbers})
    *names, _ = rows[0]
    return Table.of(
        "Estimates by each method | mean error, mm",
        [*texts(*names), *_number_columns(report, lambda row: row["numbers"])],
        rows,
        unit=_UNIT,
    )


def _marks(comparison: Comparison) -> str:
    """Return the marks of a task in a table: of its protocol, of A and of B."""
    a, b = mark_of(comparison.a), mark_of(comparison.b)
    marks = [f"A and B: {a}"] if a and a == b else [f"A: {a}" if a else "", f"B: {b}" if b else ""]
    return "; ".join(filter(None, [SELECTS_ON_TEST if comparison.selects_on_test else "", *marks]))


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _verdict(row: Difference) -> str:
    """Return the verdict in words, with a mark if it holds only for these fits."""
    of_fits = row.over_splits is None and row.verdict != "open"
    return f"{VERDICTS[row.verdict]}{' (these fits)' if of_fits else ''}"


def _shown_verdict(row: Difference, report: ModelComparison) -> str:
    """Return the verdict, with a mark if only the splits decide."""
    if row.over_splits is None or row.verdict != "open":
        return _verdict(row)
    of_splits = decide([row.over_splits], report.question.confidence)
    return f"{_verdict(row)}{' (poses)' if of_splits in ('a', 'b') else ''}"
