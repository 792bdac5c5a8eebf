"""The source paper's tables beside ours, by their numbers.

Tables 2 and 3 are of a VJM that is fitted on the spot, 10 of the paper's three methods; 6 to 9 are
those of `network_tables`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from stiff_bench.paper.network_tables import NETWORK_TABLES, network_table
from stiff_bench.paper.results import Found, PaperResults, named_results
from stiff_bench.paper.study import (
    DATASET,
    DT_CNN,
    FAIR_PROTOCOL,
    FT_MLP,
    FT_MLP_OWN_SOURCE,
    METRICS,
    PAPER_PROTOCOL,
    VJM,
)
from stiff_bench.paper.table import (
    COMPARE,
    Errors,
    Group,
    Labels,
    Numbers,
    Unit,
    errors_mm,
    mean_reduction,
    paper_table,
    reduction,
)
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import loaded
from stiff_bench.tables.metric_table import mark_of, mean_over
from stiff_bench.tables.published import claimed_reductions, published_errors, published_stiffness
from stiff_bench.tables.table import Quantity, Table
from stiff_bench.tables.units import MM
from stiff_datasets.twin.calibrate import VjmFigures
from stiff_protocols.contract.errors import StoreError, unknown_name
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import metric

TABLES = (2, 3, 6, 7, 8, 9, 10)
"""Numbers of the tables that are made."""
FITTED_HERE = frozenset({2, 3})
"""Tables that need no stored results: a model is fitted in a second."""


def build(number: int, results: PaperResults) -> list[Table]:
    """Return a table of the paper beside ours, in one part or two.

    Args:
        number: of the table in the paper.
        results: that ours come from, but for a table of `FITTED_HERE`.

    Raises:
        ConfigError: the paper's table of that number is not made here.
        StoreError: the results have nothing of it.
    """
    if number not in TABLES:
        raise unknown_name("table of the paper", str(number), map(str, TABLES))
    if number in FITTED_HERE:
        return [_table_2() if number == 2 else _table_3()]
    return [network_table(number, results)] if number in NETWORK_TABLES else _table_10(results)


def read_table(number: int, folder: Path | None) -> list[Table]:
    """Return `build`'s table; folder, None and errors are those of `named_results`."""
    return build(number, named_results(folder, f"table {number}", fitted=number in FITTED_HERE))


SPECIMENS = range(5)
KILO = 1e3
"""Of Table 3: it is in 10^3 N m/rad."""
_IN_SAMPLE = "in-sample fit"
_VJM_NOTES = (
    COMPARE,
    f"The VJM is fitted to all 151 samples of {DATASET} and evaluated on the same ones, as in the "
    "paper: not a test; data seed 0.",
    f"Specimens: mean ± standard deviation over {len(SPECIMENS)} robots of the type; {DATASET} is "
    "specimen 0, whose constants were calibrated against the published Tables 2 and 3.",
)
Places = Mapping[tuple[Labels, str], float]
"""(row, column) -> value."""


def _table_2() -> Table:
    """Return the VJM's errors by axis, on the samples it was fitted to."""
    places: dict[tuple[Labels, str], tuple[str, int]] = {
        ((axis.upper(),), metric(key).label): (key, i)
        for i, axis in enumerate(AXES)
        for key in METRICS
    }
    values = published_errors("table_2")["VJM"]
    published = {place: values[key, AXES[i]] for place, (key, i) in places.items()}
    ours: list[Places] = [
        {place: float(getattr(one, key)[i]) * MM for place, (key, i) in places.items()}
        for one in _vjm_figures()
    ]
    caption = "VJM on the samples it was identified on: errors by axis"
    return _vjm_table(2, caption, "mm", "axis", 3, [published, *ours])


def _table_3() -> Table:
    """Return the identified joint stiffnesses."""
    published: dict[tuple[Labels, str], float] = {
        ((joint,), "stiffness"): value / KILO for joint, value in published_stiffness().items()
    }
    ours = [
        dict(zip(published, (one.stiffness / KILO).tolist(), strict=True)) for one in _vjm_figures()
    ]
    caption = "VJM: joint stiffness identified on all samples"
    return _vjm_table(3, caption, "10^3 Nm/rad", "joint", 2, [published, *ours])


@cache
def _vjm_figures() -> tuple[VjmFigures, ...]:
    """Return the figures of the VJM on the samples that it is fitted to, specimen by specimen."""
    registry, found = build_registry(), list[VjmFigures]()
    for number in SPECIMENS:
        data = loaded(Choice.of(registry.datasets[DATASET], {"specimen": number}))
        samples = data.samples
        model = registry.model(VJM).load()().fit(samples, robot=data.robot)
        error = model.predict(samples.q, samples.wrench) - samples.deflection
        names = [f"stiffness {joint} [Nm/rad]" for joint in data.robot.joint_names]
        found.append(VjmFigures.of(error, np.array([model.diagnostics_[name] for name in names])))
    return tuple(found)


def _vjm_table(
    number: int, caption: str, unit: Unit, heading: str, decimals: int, values: list[Places]
) -> Table:
    """Return the paper's VJM, the first of `values`, beside ours of each specimen."""
    published, *ours = values
    columns = tuple(dict.fromkeys(column for _, column in published))

    def over(specimens: list[Places]) -> Numbers:
        return {at: mean_over([one[at] for one in specimens], _IN_SAMPLE) for at in published}

    label = f"ours, specimens {SPECIMENS[0]} to {SPECIMENS[-1]}"
    groups = [
        Group.published(columns, published, decimals),
        Group(f"ours, {DATASET}", columns, decimals, over(ours[:1])),
        Group(label, columns, decimals, over(ours), f"{DATASET}@specimen=0..4 (simulated)"),
    ]
    rows = dict.fromkeys(row for row, _ in published)
    return paper_table(number, caption, unit, (heading,), rows, groups, _VJM_NOTES)


OLD, NEW, OWN_SOURCE = "VJM", "FT-MLP", "FT-MLP, own source"
METHODS = {OLD: VJM, NEW: FT_MLP, OWN_SOURCE: FT_MLP_OWN_SOURCE.name, "DT-CNN": DT_CNN}
"""Name of a method -> our model; the paper's name, where the paper has it."""
REDUCED = {f"{method} against {OLD}": method for method in (NEW, OWN_SOURCE)}
"""Column of our reductions -> the method that errs less, or not."""
ROWS_10: dict[Labels, tuple[str, str]] = {
    (axis.upper(), metric(key).label): (key, axis) for axis in AXES for key in METRICS
}
"""Labels of a row -> its metric and axis."""
CLAIMED, RECOMPUTED = "claimed", "from Table 10"
_OWN_SOURCE_NOTE = (
    f"{OWN_SOURCE}: pre-trained on poses and loads like the training samples'. {FAIR_PROTOCOL}: a "
    "fifth of the training samples picks the epoch; the paper picked it on the test part."
)
_REDUCTION_NOTE = (
    f"100 (1 - {NEW} / {OLD}); of ours split by split, then mean ± standard deviation. Negative: "
    f"{NEW} is worse."
)


def _table_10(results: PaperResults) -> list[Table]:
    """Return the errors of the paper's methods, and by how much FT-MLP errs less than the VJM.

    Raises:
        StoreError: the folder has none of them under either protocol.
    """
    published = published_errors("table_10")
    of_paper = {
        (row, method): values[place]
        for method, values in published.items()
        for row, place in ROWS_10.items()
    }
    claimed = claimed_reductions()
    reductions = {(row, CLAIMED): claimed[place] for row, place in ROWS_10.items()} | {
        (row, RECOMPUTED): reduction(published[OLD][place], published[NEW][place])
        for row, place in ROWS_10.items()
    }
    of_errors = [Group.published(tuple(published), of_paper)]
    of_reductions = [Group.published((CLAIMED, RECOMPUTED), reductions, 1)]
    shown, absent = list[Found](), list[StoreError]()
    for protocol in (PAPER_PROTOCOL, FAIR_PROTOCOL):
        errors, reduced = dict[tuple[Labels, str], Quantity](), dict[tuple[Labels, str], Quantity]()
        try:
            found = results.on_shared_splits(METHODS.values(), protocol)
            shown.append(found)
            errors, reduced = _of_methods(found)
        except StoreError as error:
            absent.append(error)
        of_errors.append(Group.ours(protocol, tuple(METHODS), 4, errors))
        of_reductions.append(Group.ours(protocol, tuple(REDUCED), 1, reduced))
    if not shown:
        raise absent[0]
    labels = {model: method for method, model in METHODS.items()}
    notes = [
        COMPARE,
        " ".join(found.about for found in shown),
        *(f"{error}." for error in absent),
        *(note for found in shown for note in found.absences(labels=labels)),
        results.provenance(shown),
    ]
    headings = ("axis", "error")
    caption = "VJM, FT-MLP and DT-CNN: errors on 20 % of the poses"
    saving = "Reduction of FT-MLP's errors against the VJM's"
    return [
        paper_table(
            *(10, caption, "mm", headings, ROWS_10, of_errors), notes=[_OWN_SOURCE_NOTE, *notes]
        ),
        paper_table(
            *(10, saving, "%", headings, ROWS_10, of_reductions), notes=[_REDUCTION_NOTE, *notes]
        ),
    ]


def _of_methods(
    found: Found,
) -> tuple[dict[tuple[Labels, str], Quantity], dict[tuple[Labels, str], Quantity]]:
    """Return the errors of the methods under a protocol, and the reductions."""
    models = {method: model for method, model in METHODS.items() if model in found.results}
    each: dict[str, list[Errors]] = {
        method: [errors_mm(result, METRICS) for result in found.results[model]]
        for method, model in models.items()
    }
    mark = {method: mark_of(found.results[model][0].shown) for method, model in models.items()}
    errors = {
        (row, method): mean_over([one[place] for one in of_method], mark[method])
        for method, of_method in each.items()
        for row, place in ROWS_10.items()
    }
    reductions = {}
    for column, method in REDUCED.items():
        for row, place in ROWS_10.items() if method in each and OLD in each else ():
            was, now = ([one[place] for one in each[name]] for name in (OLD, method))
            reduced = mean_reduction(was, now, mark[method])
            if reduced is not None:
                reductions[row, column] = reduced
    return errors, reductions
