"""Tables 2 and 3: the VJM identified on all samples, which needs no stored results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from stiff_bench.paper.names import VJM
from stiff_bench.paper.study import DATASET
from stiff_bench.paper.table import PAPER_DATA, Entry, Group, Labels, PaperTable, Part, Unit
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import loaded
from stiff_bench.tables.published import published_rows, published_stiffness
from stiff_bench.tables.units import MM
from stiff_datasets.twin.calibrate import VjmFigures
from stiff_protocols.contract.types import AXES, BenchmarkData
from stiff_protocols.scoring.metrics import metric

SPECIMENS = range(5)
ERRORS = ("mae", "stde", "me")
KILO = 1e3
"""Of Table 3: it is in 10^3 N m/rad."""
_CALIBRATED_LABEL = f"ours, {DATASET}"
_SPECIMENS_LABEL = f"ours, specimens {SPECIMENS[0]} to {SPECIMENS[-1]}"
_MARK = "in-sample fit"
_NOTES = (
    "Published: the VJM of the measured KR10 R1100-2. Ours: of a simulated one. Not comparable in "
    "absolute terms.",
    f"Ours: the VJM fitted to all 151 samples of {DATASET} and read on the same "
    "samples, as in the paper: a fit, not a test; no protocol, data seed 0.",
    f"Specimens: mean ± standard deviation over {len(SPECIMENS)} robots of the type "
    f"({DATASET}@specimen={SPECIMENS[0]} to {SPECIMENS[-1]}); {DATASET} alone is specimen 0.",
    f"The constants of {DATASET} (specimen 0) were calibrated against the published figures of "
    "Tables 2 and 3: that they are near says nothing about any model.",
)


def table_2() -> PaperTable:
    """Return the VJM's errors by axis, on the samples it was fitted to."""
    published, figures = published_rows("table_2")[0], _figures()
    columns = tuple(metric(key).label for key in ERRORS)
    rows: tuple[Labels, ...] = tuple((axis.upper(),) for axis in AXES)
    at = {
        (row, column): (key, i)
        for i, row in enumerate(rows)
        for key, column in zip(ERRORS, columns, strict=True)
    }
    caption = "VJM on the samples it was identified on: errors by axis"
    return _table(
        number=2,
        caption=caption,
        unit="mm",
        heading="axis",
        decimals=3,
        published={place: published.values_mm[key, AXES[i]] for place, (key, i) in at.items()},
        ours=lambda one, place: float(getattr(one, at[place][0])[at[place][1]]) * MM,
        figures=figures,
    )


def table_3() -> PaperTable:
    """Return the identified joint stiffnesses."""
    published = published_stiffness()
    joints: dict[Labels, int] = {(joint,): number for number, joint in enumerate(published)}
    return _table(
        number=3,
        caption="VJM: joint stiffness identified on all samples",
        unit="10^3 Nm/rad",
        heading="joint",
        decimals=2,
        published={((joint,), "stiffness"): value / KILO for joint, value in published.items()},
        ours=lambda one, place: float(one.stiffness[joints[place[0]]]) / KILO,
        figures=_figures(),
    )


@cache
def _figures() -> tuple[VjmFigures, ...]:
    """Return the VJM's figures on each specimen; the first is the data set as it stands."""
    info = build_registry().datasets[DATASET]
    choices = [Choice.of(info, {"specimen": number}) for number in SPECIMENS]
    return tuple(_figures_on(loaded(choice)) for choice in choices)


def _figures_on(data: BenchmarkData) -> VjmFigures:
    """Return the figures of the VJM on the samples that it is fitted to."""
    samples = data.samples
    model = build_registry().model(VJM).load()().fit(samples, robot=data.robot)
    names = [f"stiffness {joint} [Nm/rad]" for joint in data.robot.joint_names]
    return VjmFigures.of(
        model.predict(samples.q, samples.wrench) - samples.deflection,
        np.array([model.diagnostics_[name] for name in names]),
    )


def _table(
    *,
    number: int,
    caption: str,
    unit: Unit,
    heading: str,
    decimals: int,
    published: Mapping[tuple[Labels, str], float],
    ours: Callable[[VjmFigures, tuple[Labels, str]], float],
    figures: Sequence[VjmFigures],
) -> PaperTable:
    """Return a table of one part.

    Args:
        number: in the paper.
        caption: of the table.
        unit: of all its numbers.
        heading: of the column that names a row.
        decimals: to print.
        published: (row, column) -> value, in the unit.
        ours: says the same of one specimen's figures.
        figures: one a specimen.
    """
    rows = tuple(dict.fromkeys(row for row, _ in published))
    columns = tuple(dict.fromkeys(column for _, column in published))
    groups = (
        Group("published", "published", columns, decimals, PAPER_DATA),
        Group(_CALIBRATED_LABEL, "ours", columns, decimals, f"{DATASET} (simulated)"),
        Group(
            *(_SPECIMENS_LABEL, "ours", columns, decimals), f"{DATASET}@specimen=0..4 (simulated)"
        ),
    )
    entries = dict[tuple[Labels, str, str], Entry]()
    for (row, column), value in published.items():
        of_specimens = [ours(one, (row, column)) for one in figures]
        for group, entry in zip(
            groups,
            (Entry(value), Entry.of(of_specimens[:1], _MARK), Entry.of(of_specimens, _MARK)),
            strict=True,
        ):
            entries[row, group.label, column] = entry
    part = Part(caption, unit, (heading,), rows, groups, entries, _NOTES)
    return PaperTable(number, (part,))
