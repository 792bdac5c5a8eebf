"""What a comparison says in one sentence, and how its numbers are written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from stiff_bench.compare import Report
from stiff_bench.comparison import NORM, Comparison, Row
from stiff_bench.tables import mark_of
from stiff_bench.units import MM, percent
from stiff_bench.words import counted, marked
from stiff_protocols.record import Presentation
from stiff_protocols.types import AXES

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
            f"that of {error_label(row.error)}, {_interval(row)}"
        )


def error_label(error: str) -> str:
    """Return a kind of error for people."""
    return "3-D" if error == NORM else error.upper()


def _interval(row: Row) -> str:
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
            f"{MM * row.difference:.3f} mm ({level} interval {_interval(row)})"
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
