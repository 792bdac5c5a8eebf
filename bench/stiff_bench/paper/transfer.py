"""`bench reproduce transfer`: what do simulated data add to a few measured poses?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from stiff_bench.paper.effects import ABOUT_KNOWN, Errors, ratio_table, stored_errors
from stiff_bench.paper.pages import write_study
from stiff_bench.paper.study import TRANSFER_DATA
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Table

_ABOUT = (
    "models have their default recipes, or the options in their names; protocol `holdout`, seed 0: "
    "one split on each simulated robot, five on the measured FANUC",
    "`mlp-pretrained`, `dt-cnn` and `adann-2r` without `supervision` learn no measured deflection: "
    "the labels only identify the VJM that makes their simulated data",
    "`preset=paper`: the source paper's poses and loads, of the KR10 alone",
    ABOUT_KNOWN,
)


def transfer_table(errors: Errors) -> Table:
    """Return each model's 3-D error relative to the VJM's, best on the default twin first."""
    columns = {head: [one.name for one in data] for head, data in TRANSFER_DATA.items()}
    note = "Mean ± standard deviation over the specimens of a twin, and over the arms."
    return ratio_table(errors, columns, "default", [note])


def write_transfer(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write OUTPUT/transfer.md and .csv; arguments and errors as in `write_study`."""
    table = transfer_table(stored_errors(output / "transfer" / "runs"))
    return write_study(
        output / "transfer",
        "What do simulated data add to a few measured poses?",
        _ABOUT,
        lambda fmt: render([table], fmt, command),
        command=command,
        n_missing=n_missing,
    )
