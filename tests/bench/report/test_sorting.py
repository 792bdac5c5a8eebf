"""What a column of the page is sorted by: typed values, never their texts."""

from __future__ import annotations

import pytest

from stiff_bench.report.page import MOST_ROWS, page_table
from stiff_bench.tables.table import Cell, Column, Quantity, Table, natural_order


def orders(*cells: Cell, **about: str) -> list[str]:
    """What the cells of a column of numbers are sorted by."""
    table = Table("t", [Column("x", **about)], [[cell] for cell in cells])
    return [row[0].order for row in page_table(table).rows]


@pytest.mark.parametrize(
    ("cell", "order"),
    [
        (Quantity(0.1035, 0.013, mark="*"), "0.1035"),
        (-0.5, "-0.5"),
        (12_300, "12300"),
        (Quantity(share=(72, 73)), "72"),
        (Quantity(low=1.0, high=2.5), "1"),
        (Quantity(0.5, share=(2, 5), status="FAILED"), "0.5"),
    ],
)
def test_a_cell_is_sorted_by_its_value_its_low_end_or_the_first_number_of_its_share(cell, order):
    assert orders(cell) == [order]


def test_a_missing_value_has_no_order_so_that_it_stands_last():
    assert orders(2.0, None, Quantity(status="FAILED"), "") == ["2", "", "", ""]


def test_a_number_is_sorted_by_its_value_however_it_is_printed():
    assert orders(2e-4, 0.1, format=lambda found: "< 0.001") == ["0.0002", "0.1"]


def test_a_column_of_texts_is_sorted_as_people_count_though_it_begins_with_numbers():
    table = page_table(Table("t", [Column("x", "text")], [["n = 10"], ["n = 5"]]))
    assert table.styles == ["text"]
    assert table.rows[1][0].order < table.rows[0][0].order
    assert natural_order("B") > natural_order("a")


def test_a_long_table_is_cut_and_says_so():
    rows = [[f"m{number}", 1] for number in range(MOST_ROWS + 7)]
    table = page_table(Table("t", [Column("model", "text"), Column("x")], rows, ["kept"]))
    assert len(table.rows) == MOST_ROWS
    assert table.notes[0] == "kept"
    assert f"first {MOST_ROWS} of {MOST_ROWS + 7} rows" in table.notes[1]
