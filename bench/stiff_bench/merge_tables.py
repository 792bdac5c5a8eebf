"""What differs between folders that are to be joined, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from stiff_bench.contest_name import SHORT
from stiff_bench.merge_survey import Disagreement
from stiff_bench.render import TextTable
from stiff_bench.words import counted


def difference_table(found: Sequence[Disagreement]) -> TextTable:
    """Return a row for each folder and each thing of which folders say different things."""
    return TextTable(
        title="What the folders have under one name",
        header=("differs", "folder", "has", "cells", "newest run", "stiffbench"),
        rows=[
            [
                f"{one.kind}: {_name(one)}",
                str(folder),
                claim.value if " " in claim.value else claim.value[:SHORT],
                str(claim.n_cells),
                claim.run_id,
                one.versions[folder],
            ]
            for one in found
            for folder, claim in one.claims.items()
        ],
        notes=(
            "of data and splits a hash of numbers and rows, cut to eight characters; of code the "
            "model's version and that of the scoring",
            "of each folder the newest run counts that has the thing",
        ),
    )


def _name(one: Disagreement) -> str:
    """Return what differs; of several splits the first stands in the table."""
    if one.kind == "split" and one.n_subjects > 1:
        return f"{one.name} (the first of {counted(one.n_subjects, 'split')})"
    return one.name
