"""What a column of the page is sorted by."""

from __future__ import annotations

import pytest

from stiff_bench.report.scores import MOST_ROWS, natural_order, number_in, page_table
from stiff_bench.tables.render import TextTable


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("0.1035 ± 0.0130 *", 0.1035),
        ("-0.5", -0.5),
        ("72/72", 72.0),
        ("10 of 45", 10.0),
        ("1.00 to 2.50", 1.0),
        ("1.9e-08", 1.9e-8),
        ("< 0.001", 0.001),
        ("12,300 (1 to 2)", 12300.0),
        ("568 us (101 to 992)", 568e-6),
        ("2 s", 2.0),
        ("5 : 1 of 9", 5.0),
    ],
)
def test_a_cell_is_sorted_by_the_number_that_it_begins_with(text, number):
    assert number_in(text) == pytest.approx(number)


@pytest.mark.parametrize(
    "text", ["2026-11-22T03:50:07", "7adefb5b", "3.11.7", "5 specimens of x", "kr10", "-", ""]
)
def test_dates_commits_and_versions_are_no_numbers(text):
    assert number_in(text) is None


def test_a_column_of_numbers_and_missing_ones_is_numeric_and_the_missing_have_no_order():
    table = page_table(
        TextTable("t", ("model", "mean"), [["b", "2.0 *"], ["a", "-"], ["c", "FAILED"]], ())
    )
    assert table.kinds == ("text", "number")
    assert [row[1].order for row in table.rows] == ["2", "", ""]


def test_a_column_with_one_text_among_numbers_is_sorted_as_text():
    table = page_table(TextTable("t", ("model", "x"), [["b", "2"], ["a", "two"]], ()))
    assert table.kinds[1] == "text"


def test_numbers_in_texts_sort_as_people_count():
    assert natural_order("n = 5") < natural_order("n = 10")
    assert natural_order("B") > natural_order("a")


def test_a_long_table_is_cut_and_says_so():
    rows = [[f"m{number}", "1"] for number in range(MOST_ROWS + 7)]
    table = page_table(TextTable("t", ("model", "x"), rows, ["kept"]))
    assert len(table.rows) == MOST_ROWS
    assert table.notes[0] == "kept"
    assert f"first {MOST_ROWS} of {MOST_ROWS + 7} rows" in table.notes[1]
