"""The page that `bench perf` prints and writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from stiff_bench.perf_history import RUNS, SLOWDOWN, History, n_runs, worse_by
from stiff_bench.perf_report import A_SECOND, RATIO, Finding, PerfReport, Timing
from stiff_bench.render import TextTable, render_texts
from stiff_bench.words import counted

FACTS = ("processor", "cores", "gpu", "python", "torch", "numpy", "pin", "commit", "dirty")


def perf_page(
    report: PerfReport,
    history: History,
    *,
    environment: Mapping[str, str],
    pictures: Sequence[Path],
    command: str,
) -> str:
    """Return the page in markdown.

    Args:
        report: what was measured.
        history: of the runs before.
        environment: of the machine and the code.
        pictures: files beside the page.
        command: that makes the page.
    """
    processor = environment["processor"]
    tables = [
        _rates_table(report, history, processor),
        _findings_table("Times as fast as the peer", report, history, processor, ratios=True),
        _findings_table("Other figures", report, history, processor, ratios=False),
    ]
    facts = "; ".join(f"{key}: {environment.get(key) or 'none'}" for key in FACTS)
    return "\n\n".join(
        [
            "# Performance",
            f"Measured {report.date[:10]}. {facts}. One thread a process.",
            render_texts([table for table in tables if table.rows], "github", command),
            *(f"![{picture.stem.replace('_', ' ')}]({picture.name})" for picture in pictures),
            *_list("Not measured", report.skipped),
            *_list("Failed", report.failed),
        ]
    )


def _rates_table(report: PerfReport, history: History, processor: str) -> TextTable:
    def cells(timing: Timing) -> tuple[str, ...]:
        rate, each = timing.finding, _duration(1.0 / timing.rate)
        before = _before(rate, history.expected(rate, processor), "slower now")
        return (
            timing.path,
            timing.who,
            _rate(rate.value, rate.unit),
            f"{each} a {timing.unit}",
            before,
        )

    return TextTable(
        title="Rates on this machine",
        header=("path", "who", "rate", "time", "before"),
        rows=[cells(timing) for timing in report.timings],
        notes=("the fastest round of each; machines differ, so compare ratios and not these.",),
    )


def _findings_table(
    title: str, report: PerfReport, history: History, processor: str, *, ratios: bool
) -> TextTable:
    found = [finding for finding in report.findings if (finding.unit == RATIO) == ratios]
    earlier = n_runs(history, processor)
    notes = [
        f"before: median of the last {RUNS} at most of {counted(earlier, 'run')} before this one "
        f'on this processor; "lower now" (or "worse now") from {SLOWDOWN:.0%} on. '
        "The rates say whether we became slower or a peer faster."
    ]
    return TextTable(
        title=title,
        header=("path", "who / peer" if ratios else "figure", "value", "target", "met", "before"),
        rows=[_cells(finding, history.expected(finding, processor)) for finding in found],
        notes=notes,
    )


def _cells(finding: Finding, expected: float | None) -> tuple[str, ...]:
    met = {None: "", True: "yes", False: "no"}[finding.met]
    before = _before(finding, expected, "lower now" if finding.unit == RATIO else "worse now")
    value = _value(finding.value, finding.unit)
    return finding.path, finding.what, value, _target(finding), met, before


def _before(finding: Finding, expected: float | None, remark: str) -> str:
    if expected is None:
        return "-"
    text = (_rate if finding.unit.endswith(A_SECOND) else _value)(expected, finding.unit)
    return f"{text} ({remark})" if worse_by(finding, expected) > SLOWDOWN else text


def _rate(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}"


def _target(finding: Finding) -> str:
    bounds = [
        f"{sign} {_value(bound, finding.unit)}"
        for sign, bound in (("≥", finding.at_least), ("≤", finding.at_most))
        if bound is not None
    ]
    return ", ".join(bounds)


def _value(value: float, unit: str) -> str:
    """Return three digits and the unit."""
    digits = f"{value:#.3g}".rstrip(".") if 1e-4 <= abs(value) < 1000.0 else f"{value:,.6g}"
    return digits + unit if unit == RATIO else f"{digits} {unit}".strip()


def _duration(seconds: float) -> str:
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6)):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _list(title: str, reasons: Mapping[str, str]) -> list[str]:
    if not reasons:
        return []
    return [f"## {title}", "\n".join(f"- `{name}`: {why}" for name, why in reasons.items())]
