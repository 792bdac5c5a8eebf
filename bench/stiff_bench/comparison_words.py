"""What a comparison says in plain words: one sentence, and the notes beneath the numbers."""

from __future__ import annotations

from collections.abc import Iterator

from stiff_bench.compare import Report
from stiff_bench.comparison import NORM, Comparison
from stiff_bench.tables import mark_of
from stiff_bench.units import percent
from stiff_bench.where import Where
from stiff_protocols.ranks import FEWEST_DATASETS
from stiff_protocols.types import AXES

MM = 1000.0


def sentence(report: Report) -> str:
    """Return the report in one sentence."""
    if len(report.comparisons) == 1:
        return _of_one(report, report.comparisons[0])
    verdicts = [one.row(NORM).verdict for one in report.comparisons]
    return (
        f"Of {len(verdicts)} contests {report.a} is better in {verdicts.count('a')} and "
        f"{report.b} in {verdicts.count('b')}; in {verdicts.count('equivalent')} they are "
        f"equivalent to within {rope_text(report)}, in {verdicts.count('open')} they "
        "cannot be told apart."
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
    parts = [_headline(report, found), *_by_axis(report, found)]
    unclear = [row.cautious for row in found.rows if row.verdict == "open"]
    if unclear:
        half = max(0.5 * (estimate.high - estimate.low) for estimate in unclear)
        splits = f"{found.splits_text} and " if found.over_splits else ""
        parts.append(
            f"with {splits}{found.n_poses} poses a difference below about {mm_text(half)} can "
            "hardly be seen"
        )
    return f"{'; '.join(parts)}."


def _headline(report: Report, found: Comparison) -> str:
    a, b, row = report.a, report.b, found.row(NORM)
    main, rope = row.cautious, rope_text(report)
    on = f"on {found.name.dataset} ({_setting(found)})"
    level = percent(report.question.confidence)
    if row.verdict == "equivalent":
        return (
            f"{a} and {b} are equivalent in practice {on}: their mean 3-D errors differ by less "
            f"than {rope} with probability {chance_text(main.posterior.equivalent)}"
        )
    if row.verdict == "open":
        return (
            f"{a} and {b} cannot be told apart {on}: the mean 3-D error of {a} less that of {b} is "
            f"{MM * row.difference:.3f} mm ({level} interval {_range(main.low, main.high)})"
        )
    better, worse, sign = (a, b, -1.0) if row.verdict == "a" else (b, a, 1.0)
    low, high = sorted((sign * main.low, sign * main.high))
    posterior = main.posterior
    chance = posterior.a_better if row.verdict == "a" else posterior.b_better
    return (
        f"{better} is better than {worse} {on}: its mean 3-D error is "
        f"{mm_text(abs(row.difference))} smaller ({level} interval {_range(low, high)}; by more "
        f"than {rope} with probability {chance_text(chance)})"
    )


def _by_axis(report: Report, found: Comparison) -> Iterator[str]:
    """Yield what holds for which axes."""
    axes = {
        verdict: [found.row(axis) for axis in AXES if found.row(axis).verdict == verdict]
        for verdict in ("a", "b", "equivalent", "open")
    }
    for verdict, name in (("a", report.a), ("b", report.b)):
        if axes[verdict]:
            each = (f"{r.error.upper()} ({mm_text(abs(r.difference))})" for r in axes[verdict])
            yield f"{name} is better in {_and(each)}"
    names = {verdict: _and(row.error.upper() for row in rows) for verdict, rows in axes.items()}
    if names["equivalent"]:
        yield f"in {names['equivalent']} they are equivalent"
    if names["open"]:
        yield f"in {names['open']} they cannot be told apart"


def _and(words: Iterator[str]) -> str:
    *first, last = [*words] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _setting(found: Comparison) -> str:
    """Return protocol, condition and number of splits."""
    name = found.name
    return ", ".join(filter(None, (name.protocol, name.condition, found.splits_text)))


def notes(report: Report) -> list[str]:
    """Return what must be read with the numbers, most important first."""
    found = [*_about_names(report)]
    for one in report.comparisons:
        where = f"{one.name.text}: " if len(report.comparisons) > 1 else ""
        found += [f"{where}{line}." for line in one.missing]
    found += report.notes
    found += _about_methods(report)
    if report.where is not None:
        found.append(_about_where(report, report.where))
    found += [caveat for one in report.comparisons for caveat in one.a.caveats]
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
    level, rope = percent(report.question.confidence), rope_text(report)
    over_splits = [one for one in report.comparisons if one.over_splits]
    if over_splits:
        yield (
            "Over splits: Nadeau and Bengio's corrected t test, and its Bayesian reading for the "
            f"probabilities; {_shares(over_splits)}."
        )
    if any(one.n_test > one.n_train for one in over_splits):
        yield (
            "Where a split tests more rows than it trains on, the correction is very careful: "
            "small differences are not found there."
        )
    if len(over_splits) < len(report.comparisons):
        yield (
            "One split, or all scored together: bootstrap over poses and Wilcoxon's signed-rank "
            "test over poses hold the fitted models fixed, so the spread over training sets is "
            "not in them."
        )
    if any(not one.train_known for one in over_splits):
        yield (
            "The number of training rows was not stored (older results): all rows that a split "
            "does not test are taken for it, which makes intervals too narrow where fewer were "
            "trained on."
        )
    if same_test := [one.name.protocol for one in report.comparisons if one.same_test]:
        yield (
            f"All splits of {', '.join(dict.fromkeys(same_test))} test the same rows, so the "
            "spread over splits is that of training sets alone; the interval over poses has the "
            "other part."
        )
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
    if report.across:
        least = 2.0 * 0.5**FEWEST_DATASETS
        yield (
            "p over data sets: Wilcoxon's signed-rank test over the data sets' differences, from "
            f"{FEWEST_DATASETS} data sets on; with {FEWEST_DATASETS} it cannot fall below "
            f"{least:.2g}. Splits of one data set never count as data sets."
        )


def _shares(comparisons: list[Comparison]) -> str:
    """Return the rows that are tested and trained on, where all splits agree."""
    rows = {(round(one.n_test), round(one.n_train)) for one in comparisons}
    if len(rows) > 1:
        return "the correction is each contest's own, from its rows tested and trained on"
    ((n_test, n_train),) = rows
    return f"{n_test} rows tested and {n_train} trained on in a split"


def _about_where(report: Report, where: Where) -> str:
    if not where.n_places:
        return "Where each is better: too few poses to say."
    return (
        f"Where: {where.n_places} parts of {where.n_factors} divisions were looked at, p is "
        f"corrected for all (Holm), the intervals are not; {report.a} is better in "
        f"{where.a_better}, {report.b} in {where.b_better}. Shown is, of each kind, the division "
        "that explains most; the fitted models are held fixed."
    )


def name_with_mark(report: Report, side: str) -> str:
    """Return the name of side "a" or "b" with all that must stand beside it."""
    name = getattr(report, side)
    marks = dict.fromkeys(mark_of(getattr(one, side)) for one in report.comparisons)
    mark = " / ".join(filter(None, marks))
    return f"{name} [{mark}]" if mark else name
