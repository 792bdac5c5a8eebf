"""Tables in a terminal: lines fit, nothing is lost, and names are never markup."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from rich.cells import cell_len

from helpers.made_results import N_POSES, TWINS, MadeResults
from stiff_bench.results.columns import task_table
from stiff_bench.results.scored_task import ScoredTask
from stiff_bench.results.summary import task_headline
from stiff_bench.tables.table import SCREEN, Column, Name, Quantity, Table
from stiff_bench.tables.terminal import screen_text
from stiff_bench.tables.writers import of_format
from stiffbench import open_results

WIDTHS = (80, 100, 120)
HOSTILE = "[red]bold[/red] \x1b[31m $x$ 田"
VJM_MM = (0.2, 0.21, 0.19)


@pytest.fixture()
def made(tmp_path) -> MadeResults:
    return MadeResults(tmp_path / "runs")


def only_task(made: MadeResults) -> ScoredTask:
    (task,) = open_results(made.folder).scores().tasks
    return task


def screen_of(table: Table, width: int) -> list[str]:
    return screen_text([table], width=width, colors=False).splitlines()


def wide_table(n_columns: int) -> Table:
    numbers = [
        Column(f"protocol-{n}", unit="mm", format=".3f", group=f"data set {n // 3}")
        for n in range(n_columns)
    ]
    rows = [[Name("a-model@with=options@and=more", "a mark"), *map(float, range(n_columns))]]
    return Table("title", [Column("model", "text"), *numbers], rows, unit="mm")


@pytest.mark.parametrize("width", WIDTHS)
def test_no_line_is_wider_than_the_terminal_and_no_number_is_lost(width):
    lines = screen_of(wide_table(23), width)
    assert max(map(cell_len, lines)) <= width
    numbers = [float(word) for line in lines for word in re.findall(r"\b\d+\.\d{3}\b", line)]
    assert sorted(numbers) == [float(n) for n in range(23)]


def test_a_name_is_neither_markup_nor_a_control_sequence():
    table = Table(HOSTILE, [Column("model", "text"), Column("x")], [[HOSTILE, 1.0]], [HOSTILE])
    text = "\n".join(screen_of(table, 100))
    assert text.count("[red]bold[/red]") == 3 and "\x1b" not in text


def test_the_numbers_of_a_column_are_aligned_with_and_without_a_mark():
    column = Column("error", format=".2f")
    rows = [["a", Quantity(0.1, mark="*")], ["b", 12.34], ["c", None]]
    *_, best_row, second_row, _ = screen_of(Table("", [Column("model", "text"), column], rows), 80)
    assert best_row.index("0.10") + len("0.10") == second_row.index("12.34") + len("12.34")
    assert "* 0.10" in best_row


def test_colours_are_printed_only_on_request():
    column = Column("change", format="+.0f", is_change=True)
    table = Table("", [Column("model", "text"), column], [["a", -5.0], ["b", 5.0]])
    coloured = screen_text([table], width=80, colors=True)
    plain = screen_text([table], width=80, colors=False)
    assert "\x1b[32m" in coloured and "\x1b[31m" in coloured and "\x1b" not in plain
    assert "+5" in plain and "-5" in plain  # the sign has the same meaning


def test_models_are_sorted_by_error_and_the_change_is_against_the_vjm(made):
    made.add_each({"vjm": VJM_MM, "good": [0.1, 0.1, 0.1], "bad": [0.4, 0.4, 0.4]})
    made.add("broken", failed=(0, 1, 2))
    table = task_table(only_task(made))
    names = [row[0].text for row in table.rows]
    assert names == ["good", "vjm", "bad", "broken"]
    errors, changes = ([row[n] for row in table.rows] for n in (1, 2))
    assert all(a.value < b.value for a, b in pairwise(errors[:3]))
    assert changes[0] == pytest.approx(-50.0) and changes[1] is None
    assert errors[3].status.startswith("FAILED")


def test_a_difference_that_is_open_names_no_winner(made):
    made.add_each({"vjm": VJM_MM, "net": [0.1, 0.35, 0.2]})
    sentence = task_headline(only_task(made))
    assert "No model is reliably better" in sentence and "is better than" not in sentence


@pytest.mark.slow
def test_several_data_sets_are_one_matrix_and_verbose_adds_their_tables(made):
    for number, _ in enumerate(TWINS):
        dataset = f"data-set-{number}"
        made.add_each({"vjm": VJM_MM, "net": [0.1, 0.11, 0.09]}, dataset)
    results = open_results(made.folder)
    brief, verbose = (results.summary(verbose=on).text_as(SCREEN) for on in (False, True))
    *_, matrix = results.summary().tables
    assert len(matrix.columns) - 1 == len(TWINS) and "±" not in brief
    assert verbose.count("± sd") == len(TWINS)


def test_names_are_not_broken_where_texts_can_be():
    name, text = "vjm+sklearn:ensemble.RandomForestRegressor", "a text of many words " * 4
    columns = [Column("name", "text"), Column("says", "text")]
    assert any(name in line for line in screen_of(Table("", columns, [[name, text]]), 80))


@pytest.mark.parametrize("width", WIDTHS)
def test_a_comparison_and_its_verdict_are_on_one_line(made, width):
    made.add_each({"vjm": VJM_MM, "net": [0.1, 0.11, 0.09]})
    tables = of_format(open_results(made.folder).compare("net", "vjm").tables, SCREEN)
    lines = screen_text(tables, width=width, colors=False).splitlines()
    assert any("A better" in line and "0.100" in line for line in lines)


@pytest.mark.parametrize(("n_splits", "is_limited"), [(1, True), (3, False)])
def test_a_verdict_of_one_split_is_marked_as_of_these_fits(made, n_splits, is_limited):
    errors_mm = {"vjm": VJM_MM[:n_splits], "net": (0.1, 0.12, 0.09)[:n_splits]}
    made.add_each(errors_mm, rows=range(N_POSES) if n_splits == 1 else None)
    sentence = task_headline(only_task(made))
    assert "is better than" in sentence and ("these fits" in sentence) == is_limited
