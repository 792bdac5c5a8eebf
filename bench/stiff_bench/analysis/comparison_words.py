"""What a comparison says in one sentence, and how its numbers are written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from stiff_bench.analysis.compare import Report
from stiff_bench.analysis.comparison import NORM, Comparison, Row
from stiff_bench.analysis.where import FEWEST_POSES, Where
from stiff_bench.store.names import labels
from stiff_bench.tables.metric_table import mark_of
from stiff_bench.tables.units import MM, counted, marked, percent
from stiff_protocols.contract.record import Presentation
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.ranks import FEWEST_DATASETS

SELECTS_ON_TEST = "selects on the test part"
"""Stands beside a contest whose protocol lets models do so."""
FITTED = "the fitted "
"""Stands before a model's name where a verdict is of its fits alone."""


def sentence(report: Report) -> str:
    """Return the report in one sentence, or more where some verdicts are of one training alone.

    Among several contests those that select on the test part are counted apart.
    """
    if len(report.comparisons) == 1:
        return _of_one(report, report.comparisons[0])
    fair = [one for one in report.comparisons if not one.selects_on_test]
    over_splits = [one for one in fair if one.over_splits]
    of_fits = [one for one in fair if not one.over_splits]
    parts = []
    if over_splits:
        parts.append(_counts(report, over_splits, " over several splits" if of_fits else "", ""))
    if of_fits:
        says = _counts(report, of_fits, " with one split or all scored together", FITTED)
        parts.append(f"{says[:-1]}, which says nothing about another training.")
    if n_unfair := len(report.comparisons) - len(fair):
        parts.append(
            f"Not counted: {counted(n_unfair, 'contest')} whose protocol lets models choose on the "
            "test part."
        )
    return " ".join(parts)


def _counts(report: Report, found: Sequence[Comparison], kind: str, fitted: str) -> str:
    count = Counter(one.row(NORM).verdict for one in found)
    return (
        f"Of {counted(len(found), 'contest')}{kind} {fitted}{report.a} is better in {count['a']} "
        f"and {fitted}{report.b} in {count['b']}; in {count['equivalent']} they are equivalent to "
        f"within {rope_text(report)}, in {count['open']} they cannot be told apart."
    )


def mm_text(length: float) -> str:
    """Return a length [m] for people."""
    return f"{MM * length:.3f} mm"


def rope_text(report: Report) -> str:
    """Return the region of practical equivalence for people."""
    return f"{MM * report.question.rope:g} mm"


def chance_text(chance: float) -> str:
    """Return a probability for people; no estimate is certain."""
    return "> 0.99" if chance > 0.99 else "< 0.01" if chance < 0.01 else f"{chance:.2f}"


def _range(low: float, high: float) -> str:
    return f"{MM * low:.3f} to {MM * high:.3f} mm"


def _of_one(report: Report, found: Comparison) -> str:
    fitted = "" if found.over_splits else FITTED
    names = {"a": f"{fitted}{report.a}", "b": f"{fitted}{report.b}"}
    parts = [f"{_scope(found)}{_headline(report, found, names)}", *_by_axis(found, names)]
    parts += _widest(found)
    if not found.over_splits:
        parts.append(
            "one split says nothing about another training: use --splits 5 or more"
            if found.n_splits == 1
            else "all fits share nearly one training set, which says nothing about another: use "
            "--protocol repeated-holdout"
        )
    if found.selects_on_test:
        parts.append(f"{found.name.protocol} lets models choose on the test part")
    return f"{'; '.join(parts)}."


def _widest(found: Comparison) -> Iterator[str]:
    """Yield how far the least known of the unclear differences may lie from zero."""
    unclear = [row for row in found.rows if row.verdict == "open"]
    if unclear:
        row = max(unclear, key=lambda one: one.cautious.high - one.cautious.low)
        splits = f"{found.splits_text} and " if found.over_splits else ""
        yield (
            f"with {splits}{found.n_poses} poses the widest interval of an unclear difference is "
            f"that of {error_label(row.error)}, {_interval_text(row)}"
        )


def error_label(error: str) -> str:
    """Return a kind of error for people."""
    return "3-D" if error == NORM else error.upper()


def _interval_text(row: Row) -> str:
    """Return the interval that is spoken of; the table beneath may show two."""
    return f"{_range(row.cautious.low, row.cautious.high)} over {row.cautious_over}"


def _scope(found: Comparison) -> str:
    """Say what the verdict is about, where it is not about the learners."""
    if found.over_splits:
        return ""
    return "On this one split " if found.n_splits == 1 else "With all splits scored together "


def _headline(report: Report, found: Comparison, names: Mapping[str, str]) -> str:
    a, b, row = names["a"], names["b"], found.row(NORM)
    main, rope = row.cautious, rope_text(report)
    on = f"on {found.name.dataset} ({_setting(found)})"
    level = percent(report.question.confidence)
    if row.verdict == "equivalent":
        return (
            f"{a} and {b} are equivalent in practice {on}: their mean 3-D errors differ by less "
            f"than {rope} with probability {chance_text(main.posterior.equivalent)} over "
            f"{row.cautious_over}"
        )
    if row.verdict == "open":
        return (
            f"{a} and {b} cannot be told apart {on}: the mean 3-D error of {a} less that of {b} is "
            f"{MM * row.difference:.3f} mm ({level} interval {_interval_text(row)})"
        )
    better, worse, sign = (a, b, -1.0) if row.verdict == "a" else (b, a, 1.0)
    low, high = sorted((sign * main.low, sign * main.high))
    posterior = main.posterior
    chance = posterior.a_better if row.verdict == "a" else posterior.b_better
    return (
        f"{better} is better than {worse} {on}: its mean 3-D error is "
        f"{mm_text(abs(row.difference))} smaller ({level} interval {_range(low, high)} over "
        f"{row.cautious_over}; by more than {rope} with probability {chance_text(chance)})"
    )


def _by_axis(found: Comparison, names: Mapping[str, str]) -> Iterator[str]:
    """Yield what holds for which axes."""
    axes = {
        verdict: [found.row(axis) for axis in AXES if found.row(axis).verdict == verdict]
        for verdict in ("a", "b", "equivalent", "open")
    }
    for verdict, name in names.items():
        if axes[verdict]:
            each = (f"{r.error.upper()} ({mm_text(abs(r.difference))})" for r in axes[verdict])
            yield f"{name} is better in {_and(each)}"
    in_words = {verdict: _and(row.error.upper() for row in rows) for verdict, rows in axes.items()}
    if in_words["equivalent"]:
        yield f"in {in_words['equivalent']} they are equivalent"
    if in_words["open"]:
        yield f"in {in_words['open']} they cannot be told apart"


def _and(words: Iterator[str]) -> str:
    *first, last = [*words] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _setting(found: Comparison) -> str:
    """Return protocol, condition and number of splits."""
    name = found.name
    return ", ".join(filter(None, (name.protocol, name.condition, found.splits_text)))


def name_with_mark(shown: Presentation) -> str:
    """Return a model's name with all that must stand beside it in a contest."""
    return marked(shown.model, mark_of(shown))


def contest_marks(found: Comparison) -> str:
    """Return what must stand beside a contest among others: its own mark, A's and B's."""
    a, b = mark_of(found.a), mark_of(found.b)
    marks = [f"A and B: {a}"] if a == b else [f"A: {a}" if a else "", f"B: {b}" if b else ""]
    own = SELECTS_ON_TEST if found.selects_on_test else ""
    return "; ".join(filter(None, [own, *(marks if a or b else [])]))


def notes(report: Report) -> list[str]:
    """Return what must be read with the numbers, most important first."""
    found = [*_about_names(report)]
    called = labels(one.name for one in report.comparisons)
    for one in report.comparisons:
        where = f"{called[one.name]}: " if len(report.comparisons) > 1 else ""
        found += [f"{where}{line}." for line in one.missing]
    found += report.notes
    found += _about_methods(report)
    if report.where is not None:
        found.append(_about_where(report, report.where))
    found += [caveat for one in report.comparisons for caveat in one.a.caveats]
    found += report.provenance
    return list(dict.fromkeys(found))


def _about_names(report: Report) -> Iterator[str]:
    """Yield the marks, and where the two are not in the same contest."""
    for one in report.comparisons:
        if one.a.regime != one.b.regime:
            regimes = (
                f"{shown.model}: {shown.regime or 'measured deflections train it'}"
                for shown in (one.a, one.b)
            )
            yield f"Not the same regime: {'; '.join(regimes)}."
        if one.a.picked_on_test != one.b.picked_on_test:
            picked = one.a if one.a.picked_on_test else one.b
            yield f"{one.name.protocol}: {picked.model} alone picked its epoch on the test part."
        if one.a.selects_on_test:
            yield one.a.warning


def _about_methods(report: Report) -> Iterator[str]:
    over_splits = [one for one in report.comparisons if one.over_splits]
    yield from _about_splits(over_splits)
    if len(over_splits) < len(report.comparisons):
        yield (
            "One split, or all scored together: bootstrap over poses and Wilcoxon's signed-rank "
            "test over poses hold the fitted models fixed, so the spread over training sets is "
            'not in them. "(these fits)": the verdict is of these models, not of another training.'
        )
    yield from _about_verdicts(report)
    if report.across:
        least = 2.0 * 0.5**FEWEST_DATASETS
        yield (
            "p over data sets: Wilcoxon's signed-rank test over the data sets' differences, from "
            f"{FEWEST_DATASETS} data sets on; with {FEWEST_DATASETS} it cannot fall below "
            f"{least:.2g}. Splits of one data set never count as data sets."
        )


def _about_splits(over_splits: Sequence[Comparison]) -> Iterator[str]:
    """Yield how the spread over splits was judged."""
    if over_splits:
        yield (
            "Over splits: Nadeau and Bengio's corrected t test, and its Bayesian reading for the "
            f"probabilities; {_shares(over_splits)}."
        )
    if same_test := [one.name.protocol for one in over_splits if one.same_test]:
        yield (
            f"All splits of {', '.join(dict.fromkeys(same_test))} test the same rows, so the "
            "spread over splits is that of training sets alone; the interval over poses has the "
            "other part."
        )


def _about_verdicts(report: Report) -> Iterator[str]:
    """Yield what a verdict needs, and which p-values are corrected."""
    level, rope = percent(report.question.confidence), rope_text(report)
    alpha = f"{1.0 - report.question.confidence:.2g}"
    yield (
        f"A better: p < {alpha} and no interval reaches zero, neither over splits nor over poses. "
        f"Equivalent: the difference is below {rope} with {level} probability. All else cannot be "
        'told apart, which does not mean equal; "(poses)": splits have a winner, poses have none.'
    )
    if len(report.comparisons) == 1:
        yield (
            "p of X, Y, Z is corrected for three tests (Holm); 3-D, the error's length, is a test "
            "of its own. Intervals and probabilities are of each row alone."
        )
    else:
        yield "Each contest is a test of its own; p is not corrected for their number."


def _shares(comparisons: Sequence[Comparison]) -> str:
    """Return the rows that are tested and, where it was stored, trained on; if all splits agree."""
    rows = {(round(one.sizes.n_test), round(one.sizes.n_train)) for one in comparisons}
    if len(rows) > 1:
        return "the correction is each contest's own, from the share of its rows that a split tests"
    ((n_test, n_train),) = rows
    trained = f" and {n_train} trained on" if n_train else ""
    return f"{n_test} rows tested{trained} in a split"


def _about_where(report: Report, where: Where) -> str:
    if not where.n_places:
        return (
            "Where each is better: too few poses to say; every part of a division needs "
            f"{FEWEST_POSES}."
        )
    return (
        f"Where: {where.n_places} parts of {where.n_factors} divisions were looked at, p is "
        f"corrected for all (Holm), the intervals are not; {report.a} is better in "
        f"{where.a_better}, {report.b} in {where.b_better}. Shown is, of each kind, the division "
        "that explains most; the fitted models are held fixed."
    )
