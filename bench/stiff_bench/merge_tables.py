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
            "hashes are cut to eight characters: of a data set's numbers, of a split's rows, of "
            "the source files and library versions that compute a model's cells",
            "of each folder the newest run counts that has the thing",
        ),
    )


def _name(one: Disagreement) -> str:
    """Return what differs; of several splits the first stands in the table."""
    if one.kind == "split" and one.n_subjects > 1:
        return f"{one.name} (the first of {counted(one.n_subjects, 'split')})"
    return one.name
