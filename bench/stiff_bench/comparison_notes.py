"""What must be read with the numbers of a comparison: the notes beneath them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stiff_bench.compare import Report
from stiff_bench.comparison import Comparison
from stiff_bench.comparison_words import rope_text
from stiff_bench.contest_name import labels
from stiff_bench.units import percent
from stiff_bench.where import FEWEST_POSES, Where
from stiff_protocols.ranks import FEWEST_DATASETS


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
