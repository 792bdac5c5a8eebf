"""A forecast for people: a table of its cells, and a line that sums up."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from datetime import timedelta

from stiff_bench.forecast import Forecast, Part, computing_s
from stiff_bench.grouped import grouped
from stiff_bench.render import TextTable, csv_cells, render_texts
from stiff_bench.words import counted


def render_forecast(found: Forecast, fmt: str, command: str) -> str:
    """Return a forecast as "github", "latex" or "html"; as "csv" or "json" with all its parts."""
    if fmt == "json":
        sums = {"cells": found.n_cells, "cached": found.n_cached, "unknown": found.n_unknown}
        content = {"command": command, **sums, "seconds": found.seconds, **asdict(found)}
        return json.dumps(content, indent=2)
    if fmt == "csv":
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(item.name for item in fields(Part))
        writer.writerows(csv_cells(asdict(part).values()) for part in found.parts)
        return out.getvalue().rstrip("\n")
    return render_texts([forecast_table(found)], fmt, command)


def forecast_table(found: Forecast) -> TextTable:
    """Return the numbers of cells by model, by data set and by protocol."""
    return TextTable(
        title="What the run would compute",
        header=("", "cells", "cached", "to compute", "computing time"),
        rows=[*_rows(found.parts), _row("all", found.parts)],
        notes=(
            "times in h:min:s, one cell after another, are those of the newest stored cells of the "
            "same model: their median on the same data set, else on all others",
            "a pre-training that the cache held when they were computed is not in them",
        ),
    )


def forecast_line(found: Forecast) -> str:
    """Return e.g. "40 cells, 10 cached, 30 to compute; about 0:02:30 with 2 jobs; ..."."""
    n_missing = found.n_cells - found.n_cached
    words = [
        f"{counted(found.n_cells, 'cell')}, {found.n_cached} cached, {n_missing} to compute",
        f"{_time(found)} with {counted(found.jobs, 'job')}",
        "memory not known"
        if found.memory_bytes is None
        else f"about {found.memory_bytes / 2**20:.0f} MiB in each process",
    ]
    return "; ".join(words)


def _time(found: Forecast) -> str:
    if not found.n_unknown:
        return f"about {_clock(found.seconds)}"
    unknown = f"{counted(found.n_unknown, 'cell')} of which no time is known"
    if not found.seconds:
        return f"time not known: {unknown}"
    return f"at least {_clock(found.seconds)}, without {unknown},"


def _rows(parts: Sequence[Part]) -> Iterator[list[str]]:
    for kind, heading in (("model", "model"), ("dataset", "data set"), ("protocol", "protocol")):
        for name, of_name in grouped(parts, lambda part, kind=kind: getattr(part, kind)).items():  # type: ignore[misc]
            yield _row(f"{heading} {name}", of_name)


def _row(name: str, parts: Sequence[Part]) -> list[str]:
    n_cells, n_cached = (sum(getattr(p, count) for p in parts) for count in ("n_cells", "n_cached"))
    missing = [part for part in parts if part.n_missing]
    known = [part for part in missing if part.cell_s is not None]
    time = f"{'' if len(known) == len(missing) else 'over '}{_clock(computing_s(known))}"
    return [
        name,
        str(n_cells),
        str(n_cached),
        str(n_cells - n_cached),
        time if known or not missing else "not known",
    ]


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
