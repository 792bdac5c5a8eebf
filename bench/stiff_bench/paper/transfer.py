"""`bench reproduce transfer`: what do simulated data add to a few measured poses?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stiff_bench.paper.effects import ABOUT_KNOWN, Errors, ratio_table, relative, stored_errors
from stiff_bench.paper.pages import listed, provenance, written
from stiff_bench.paper.study import TRANSFER_DATA, TRANSFER_FOLDER
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Table
from stiff_models.catalog import REFERENCE_MODEL


def transfer_table(errors: Errors) -> Table:
    """Return each model's 3-D error relative to the VJM's, best on the default twin first."""
    columns = {head: [one.name for one in data] for head, data in TRANSFER_DATA.items()}
    ratios = relative(errors, columns)
    heads = {head: head for head in columns if head in ratios[REFERENCE_MODEL]}
    of = errors[REFERENCE_MODEL]
    vjm = {head: float(np.mean([of[one] for one in columns[head] if one in of])) for head in heads}
    note = "Mean ± standard deviation over the specimens of a twin, and over the arms."
    return ratio_table(ratios, heads, next(iter(heads)), vjm, [note])


def write_transfer(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write OUTPUT/transfer.md and .csv; yield each file.

    Args:
        output: the folder; results are in OUTPUT/transfer/runs.
        command: that made them.
        n_missing: how many of the study's results are not stored.

    Raises:
        StoreError: nothing is stored, a file cannot be written, or a stored one is damaged.
    """
    folder = output / TRANSFER_FOLDER / "runs"
    table = transfer_table(stored_errors(folder))
    yield written(output / "transfer.csv", render([table], "csv", command))
    page = [
        "# What do simulated data add to a few measured poses?",
        listed(*_ABOUT, *provenance(folder, command, n_missing)),
        render([table], "github", command),
    ]
    yield written(output / "transfer.md", "\n\n".join(page))


_ABOUT = (
    "models have their default recipes, or the options in their names; protocol `holdout`, seed 0: "
    "one split on each simulated robot, five on the measured FANUC",
    "`mlp-pretrained`, `dt-cnn` and `adann-2r` without `supervision` learn no measured deflection: "
    "the labels only identify the VJM that makes their simulated data",
    "`preset=paper`: the source paper's poses and loads, of the KR10 alone",
    ABOUT_KNOWN,
)
