"""Table 10: VJM, FT-MLP and DT-CNN, and by how much FT-MLP errs less than the VJM.

Ours have a column more: FT-MLP from a source domain drawn like the training samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from stiff_bench.paper.names import DT_CNN, FT_MLP, FT_MLP_OWN_SOURCE, VJM
from stiff_bench.paper.network_tables import fine_tuning_note
from stiff_bench.paper.results import PaperResults, SharedSplits, provenance, shared_splits
from stiff_bench.paper.study import DATASET, FAIR_PROTOCOL, PAPER_PROTOCOL, SEED
from stiff_bench.paper.table import (
    PAPER_DATA,
    Entry,
    Group,
    Labels,
    PaperTable,
    Part,
    errors_mm,
    mean_reduction,
    reduction,
)
from stiff_bench.tables.published import claimed_reductions, published_rows
from stiff_bench.tables.table import mark_of
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import metric

ERRORS = ("mae", "stde", "me")
OLD, NEW, OWN_SOURCE = "VJM", "FT-MLP", "FT-MLP, own source"
PUBLISHED_METHODS = (OLD, NEW, "DT-CNN")
METHODS = {OLD: VJM, NEW: FT_MLP, OWN_SOURCE: FT_MLP_OWN_SOURCE.name, "DT-CNN": DT_CNN}
"""Name of a method -> our model; the paper's name, where the paper has it."""
REDUCED = {f"{method} against {OLD}": method for method in (NEW, OWN_SOURCE)}
"""Column of our reductions -> the method that errs less, or not."""
ROWS: dict[Labels, tuple[str, str]] = {
    (axis.upper(), metric(key).label): (key, axis) for axis in AXES for key in ERRORS
}
"""Labels of a row -> its metric and axis."""
CLAIMED, RECOMPUTED = "claimed", "from Table 10"
_NOTES = (
    "Published: KR10 measured, one 80/20 split; FT-MLP's epoch was picked on its test part. Ours: "
    "simulated. Not comparable in absolute terms.",
    f"{FAIR_PROTOCOL}: a fifth of the training samples picks FT-MLP's epoch.",
    f"{OWN_SOURCE}: pre-trained on poses and loads like the training samples' in place of the "
    "paper's Tables 4 and 5; no published number.",
)
_REDUCTION_NOTES = (
    f"100 (1 - {NEW} / {OLD}); of ours split by split, then mean ± standard deviation over the "
    f"splits. Negative: {NEW} errs more.",
    "X MAE: 41.4 % is claimed, the published Table 10 gives 42.0 %, more than its rounding "
    "explains. ME: claimed and recomputed agree if the published maxima were rounded to two "
    "decimals.",
)
PROTOCOLS = (PAPER_PROTOCOL, FAIR_PROTOCOL)


class _OfSplits(NamedTuple):
    """Errors of a method, mm, one a split, and what must go with them."""

    values: Sequence[float]
    mark: str


OurErrors = Mapping[tuple[Labels, str], _OfSplits]
"""(row, method) -> errors."""


def table_10(results: PaperResults) -> PaperTable:
    """Return the errors of the three methods, and the reductions.

    Raises:
        StoreError: the folder has none of them under either protocol.
    """
    shared, absent = _shared(results)
    ours = {one.protocol: _our_errors(one) for one in shared}
    labels = {model: method for method, model in METHODS.items()}
    about = [note for one in shared for note in one.notes(labels=labels)]
    networks = [
        found
        for one in shared
        for model in (FT_MLP, FT_MLP_OWN_SOURCE.name)
        for found in one.results.get(model, ())
    ]
    notes = (
        *(*_NOTES, *absent, *about),
        f"FT-MLP: {fine_tuning_note(networks)}",
        provenance(results, shared),
    )
    return PaperTable(10, (_errors(ours, notes), _reductions(ours, (*_REDUCTION_NOTES, *notes))))


def _shared(results: PaperResults) -> tuple[list[SharedSplits], list[str]]:
    """Return the results under each of the protocols that has any, and why another has none.

    Raises:
        StoreError: neither has.
    """
    found, errors = list[SharedSplits](), list[StoreError]()
    for protocol in PROTOCOLS:
        try:
            found.append(shared_splits(results, METHODS.values(), protocol))
        except StoreError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    return found, [f"{error}." for error in errors]


def _our_errors(shared: SharedSplits) -> OurErrors:
    """Return the errors of each method that has results under a protocol."""
    found = dict[tuple[Labels, str], _OfSplits]()
    for method, model in METHODS.items():
        results = shared.results.get(model, ())
        each = [errors_mm(result, ERRORS) for result in results]
        for row, place in ROWS.items() if each else ():
            values = [errors[place] for errors in each]
            found[row, method] = _OfSplits(values, mark_of(results[0].shown))
    return found


def _label(protocol: str) -> str:
    return f"ours, {protocol}"


def _group(protocol: str, columns: Labels, decimals: int) -> Group:
    data = f"{DATASET} (simulated)"
    return Group(_label(protocol), "ours", columns, decimals, data, protocol, SEED)


def _errors(ours: Mapping[str, OurErrors], notes: tuple[str, ...]) -> Part:
    entries = {
        (row, "published", method.method): Entry(method.values_mm[place])
        for method in published_rows("table_10")
        for row, place in ROWS.items()
    }
    for protocol, errors in ours.items():
        for (row, method), (values, mark) in errors.items():
            entries[row, _label(protocol), method] = Entry.of(values, mark)
    return Part(
        caption="VJM, FT-MLP and DT-CNN: errors on 20 % of the poses",
        unit="mm",
        row_headings=("axis", "error"),
        rows=tuple(ROWS),
        groups=(
            Group("published", "published", PUBLISHED_METHODS, 4, PAPER_DATA),
            *(_group(protocol, tuple(METHODS), 4) for protocol in PROTOCOLS),
        ),
        entries=entries,
        notes=notes,
    )


def _reductions(ours: Mapping[str, OurErrors], notes: tuple[str, ...]) -> Part:
    """Return by how much FT-MLP errs less than the VJM: as claimed, as published, and ours."""
    claimed, methods = claimed_reductions(), published_rows("table_10")
    old, new = (next(one.values_mm for one in methods if one.method == name) for name in (OLD, NEW))
    entries = dict[tuple[Labels, str, str], Entry]()
    for row, place in ROWS.items():
        entries[row, "published", CLAIMED] = Entry(claimed[place])
        entries[row, "published", RECOMPUTED] = Entry(reduction(old[place], new[place]))
        for protocol, errors in ours.items():
            for column, method in REDUCED.items():
                found = _reduction(errors.get((row, OLD)), errors.get((row, method)))
                if found is not None:
                    entries[row, _label(protocol), column] = found
    return Part(
        caption="Reduction of FT-MLP's errors against the VJM's",
        unit="%",
        row_headings=("axis", "error"),
        rows=tuple(ROWS),
        groups=(
            Group("published", "published", (CLAIMED, RECOMPUTED), 1, PAPER_DATA),
            *(_group(protocol, tuple(REDUCED), 1) for protocol in PROTOCOLS),
        ),
        entries=entries,
        notes=notes,
    )


def _reduction(was: _OfSplits | None, now: _OfSplits | None) -> Entry | None:
    if was is None or now is None:
        return None
    return mean_reduction(was.values, now.values, now.mark)
