"""What the benchmarks measured: ratios to peers, other figures, and their targets."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from stiff_bench.grouped import grouped

RATIO = "x"
A_SECOND = "/s"


@dataclass(frozen=True)
class Curve:
    """A line in a picture: see `tests/perf_case.py`."""

    who: str
    ours: bool
    picture: str
    x: Sequence[float]
    y: Sequence[float]
    x_label: str
    y_label: str
    note: str


@dataclass(frozen=True)
class Timing:
    """One benchmark.

    Attributes:
        path: what is done, at what size: the benchmark's group.
        who: stiffbench, or the peer.
        ours: whether it is ours.
        rate: how much of its work it does a second, by its fastest round; the others were
            disturbed.
        unit: of the work.
        at_least: peer -> how many times its rate is to be reached.
    """

    path: str
    who: str
    ours: bool
    rate: float
    unit: str
    at_least: Mapping[str, float]

    @property
    def finding(self) -> Finding:
        """Return the rate as a figure, for the history."""
        return Finding(self.path, self.who, self.rate, self.unit + A_SECOND)


@dataclass(frozen=True)
class Finding:
    """A figure that is compared with its target and with earlier runs.

    Attributes:
        path: what is done, at what size.
        what: the pair that a ratio compares, or the quantity.
        value: the ratio, or the quantity.
        unit: "x" of a ratio.
        at_least, at_most: the target; None: there is none.
    """

    path: str
    what: str
    value: float
    unit: str
    at_least: float | None = None
    at_most: float | None = None

    @property
    def met(self) -> bool | None:
        """Say whether the target is met; None: there is none."""
        if self.at_least is None and self.at_most is None:
            return None
        return (self.at_least is None or self.value >= self.at_least) and (
            self.at_most is None or self.value <= self.at_most
        )

    @property
    def more_is_better(self) -> bool:
        """Say in which direction the value is good: rates, ratios, what has a lower bound."""
        return self.unit == RATIO or self.unit.endswith(A_SECOND) or self.at_least is not None


@dataclass(frozen=True)
class PerfReport:
    """One run of the benchmarks.

    Attributes:
        timings: every benchmark, in the order of the files.
        findings: ratios first, then other figures.
        curves: for the pictures.
        skipped: benchmark -> why it was not measured.
        failed: benchmark -> its error.
        date: UTC, ISO 8601.
    """

    timings: tuple[Timing, ...]
    findings: tuple[Finding, ...]
    curves: tuple[Curve, ...]
    skipped: Mapping[str, str]
    failed: Mapping[str, str]
    date: str


def read_report(benchmarks: Path, outcomes: Path) -> PerfReport:
    """Read what pytest-benchmark (JSON) and pytest (JUnit XML) wrote about one run.

    The first file is missing or empty where no benchmark ended well.
    """
    text = benchmarks.read_text(encoding="utf-8") if benchmarks.exists() else ""
    found: dict[str, Any] = json.loads(text) if text else {"benchmarks": [], "datetime": ""}
    entries = [entry for entry in found["benchmarks"] if "who" in entry["extra_info"]]
    timings = [_timing(entry) for entry in entries]
    return PerfReport(
        timings=tuple(timings),
        findings=(*_ratios(timings), *(one for entry in entries for one in _figures(entry))),
        curves=tuple(_curve(entry) for entry in entries if "curve" in entry["extra_info"]),
        skipped=dict(_outcomes(outcomes, "skipped")),
        failed=dict(_outcomes(outcomes, "failure")) | dict(_outcomes(outcomes, "error")),
        date=found["datetime"],
    )


def _timing(entry: Mapping[str, Any]) -> Timing:
    about = entry["extra_info"]
    return Timing(
        path=entry["group"],
        who=about["who"],
        ours=about["ours"],
        rate=about["work"] / entry["stats"]["min"],
        unit=about["unit"],
        at_least=about.get("at_least", {}),
    )


def _ratios(timings: Sequence[Timing]) -> Iterator[Finding]:
    for path, found in grouped(timings, lambda timing: timing.path).items():
        peers = [timing for timing in found if not timing.ours]
        for mine in (timing for timing in found if timing.ours):
            for peer in peers:
                yield Finding(
                    path=path,
                    what=f"{mine.who} / {peer.who}",
                    value=mine.rate / peer.rate,
                    unit=RATIO,
                    at_least=mine.at_least.get(peer.who),
                )


def _figures(entry: Mapping[str, Any]) -> Iterator[Finding]:
    about = entry["extra_info"]
    for figure in about.get("figures", []):
        yield Finding(
            path=entry["group"],
            what=figure["what"] if about["who"] in figure["what"] else _told(about, figure),
            value=figure["value"],
            unit=figure["unit"],
            at_least=figure["at_least"],
            at_most=figure["at_most"],
        )


def _told(about: Mapping[str, Any], figure: Mapping[str, Any]) -> str:
    return f"{about['who']}: {figure['what']}"


def _curve(entry: Mapping[str, Any]) -> Curve:
    about = entry["extra_info"]
    return Curve(who=about["who"], ours=about["ours"], **about["curve"])


def _outcomes(path: Path, kind: str) -> Iterator[tuple[str, str]]:
    if not path.exists():
        return
    for case in ElementTree.parse(path).iter("testcase"):
        for outcome in case.iter(kind):
            yield case.get("name", ""), _first_line(outcome.get("message", ""))


def _first_line(message: str) -> str:
    return next(iter(message.splitlines()), "")
