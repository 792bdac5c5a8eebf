"""The typed table: cells keep their types, and every format has all of them."""

from __future__ import annotations

import csv
import io
import json
import math
import shutil
import subprocess

import pandas as pd
import pytest

from stiff_bench.tables.table import VALUE_FIELDS, Column, Name, Quantity, Table
from stiff_bench.tables.writers import latex_text, plain_text, render

SMALL = Table(
    "small | mm",
    [
        Column("model", "text"),
        Column("seed", "text", hidden=True),
        Column("error", unit="mm", format=".2f", about={"axis": "x"}),
        Column("share", unit="%", format=".0f"),
        Column("n"),
    ],
    [
        [Name("a", "a mark"), 7, Quantity(1 / 3, 1 / 7, n=3), Quantity(low=1.0, high=2.0), 5],
        ["b", None, Quantity(status="FAILED"), None, None],
        ["c", 8, Quantity(0.5, share=(3, 5), mark="*"), Quantity(share=(1, 2)), 1_000],
    ],
    ["a note"],
    unit="mm",
    about={"dataset": "twin"},
)


def lines(*tables: Table) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(render(tables, "csv", "bench"))))


def test_people_read_value_spread_interval_share_status_and_mark_and_a_dash_for_nothing():
    view = SMALL.visible_table()
    assert view.texts() == [
        ["a [a mark]", "0.33 ± 0.14", "1 to 2", "5"],
        ["b", "FAILED", "-", "-"],
        ["c", "0.50 (3/5) *", "1/2", "1000"],
    ]
    # a heading names the unit if the title does not
    assert [*map(view.heading, view.columns)] == ["model", "error", "share [%]", "n"]
    first_row = plain_text(view).splitlines()[2]
    assert first_row.split() == ["a", "[a", "mark]", "0.33", "±", "0.14", "1", "to", "2", "5"]


def test_csv_has_a_line_per_number_at_full_precision_with_its_identity():
    records = lines(SMALL)
    assert len(records) == 9
    first = records[0]
    assert {name: first[name] for name in ("dataset", "model", "model mark", "seed", "axis")} == {
        **{"dataset": "twin", "model": "a", "model mark": "a mark", "seed": "7", "axis": "x"}
    }
    assert (float(first["value"]), float(first["spread"])) == (1 / 3, 1 / 7)
    assert (first["column"], first["unit"], first["n"]) == ("error", "mm", "3")
    assert (records[1]["low"], records[1]["high"], records[1]["value"]) == ("1.0", "2.0", "")
    assert (records[3]["value"], records[3]["status"]) == ("", "FAILED")
    assert (records[6]["part"], records[6]["whole"], records[6]["mark"]) == ("3", "5", "*")


def test_tables_with_other_columns_share_one_csv():
    second_table = Table("other", [Column("place", "text"), Column("y")], [["here", 1]])
    texts = Table("t", [Column("what", "text"), Column("where", "text")], [["x", "y"]])
    *_, last, of_texts = lines(SMALL, second_table, texts)
    assert (of_texts["what"], of_texts["where"], of_texts["value"]) == ("x", "y", "")
    assert (last["place"], last["column"], last["value"], last["model"]) == ("here", "y", "1", "")
    assert list(last)[-len(VALUE_FIELDS) :] == [*VALUE_FIELDS]
    assert render([SMALL, second_table], "github", "bench").count("- made by: ") == 1


def test_json_has_the_values_of_csv_and_no_keys_without_a_value():
    content = json.loads(render([SMALL], "json", "bench x", text="said", about={"key": 1}))
    assert (content["command"], content["text"], content["key"]) == ("bench x", "said", 1)
    (table,) = content["tables"]
    assert table["notes"] == ["a note"] and table["dataset"] == "twin"
    first, second, _ = table["rows"]
    assert first["values"][0] == {
        **{"axis": "x", "column": "error", "value": 1 / 3, "spread": 1 / 7, "n": 3, "unit": "mm"}
    }
    assert second["values"][0]["status"] == "FAILED" and second["values"][0]["value"] is None
    no_numbers = Table("t", [Column("x")], [[math.nan], [math.inf]])
    rows = json.loads(render([no_numbers], "json", "bench"))["tables"][0]["rows"]
    assert [row["values"][0]["value"] for row in rows] == [None, "inf"]


def test_latex_aligns_plain_numbers_and_braces_others_beneath_the_names_of_their_groups():
    text = render([SMALL], "latex", "bench")
    assert r"a {[}a mark] & 0.33 +- 0.14 & {1 to 2} & 5 \\" in text
    assert r"\begin{tabular}{lSSS}" in text and r"b & {FAILED} & {-} & {-} \\" in text
    latex, page = (render([grouped(2)], fmt, "bench") for fmt in ("latex", "html"))
    assert r"\multicolumn{2}{c}{group 0} & \multicolumn{2}{c}{group 1}" in latex
    assert "group 0: MAE" in page and "1.0000 ± 0.5000" in page
    many = render([grouped(4)], "latex", "bench", text="what matters")  # below each other
    parts = (r"\begin{tabular}", r"\begin{table}", r"X & ", "what matters")
    assert [many.count(part) for part in parts] == [4, 1, 4, 1]


def test_latex_keeps_double_hyphens_of_options_and_prints_minus_signs():
    assert latex_text("from -0.5 to 2 [-1] on kr10-twin, 2026-11-28: `bench run --tcp -1`") == (
        r"from $-$0.5 to 2 {[}$-$1] on kr10-twin, 2026-11-28: \texttt{bench run -{}-tcp -1}"
    )
    text = render([SMALL], "latex", "bench table 4 --format latex")
    assert r"\texttt{bench table 4 -{}-format latex}" in text


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_latex_tables_compile_within_the_text(tmp_path):
    packages = "".join(rf"\usepackage{{{name}}}" for name in ("booktabs", "graphicx", "siunitx"))
    body = render([SMALL, grouped(2), grouped(4)], "latex", "bench run --model vjm")
    document = rf"\documentclass{{article}}{packages}\begin{{document}}{body}\end{{document}}"
    (tmp_path / "tables.tex").write_text(document, encoding="utf-8")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "tables.tex"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    assert "Overfull" not in (tmp_path / "tables.log").read_text(errors="replace")


def grouped(n_groups: int) -> Table:
    """Return a table with two columns per group; a group's numbers are its place."""
    columns = [
        Column(name, format=".4f", group=f"group {k}", value=lambda _, k=k: Quantity(k + 1.0, 0.5))
        for k in range(n_groups)
        for name in ("MAE", "STDE")
    ]
    return Table.of("t", [Column("axis", "text"), *columns], [{"axis": "X"}])


def test_the_rows_of_a_frame_are_records_without_nan():
    frame = pd.DataFrame({"model": ["a", "b"], "error / VJM's": [0.5, math.nan]})
    double = Column("double", value=lambda row: row["model"] * 2)
    table = Table.of("t", [Column("model", "text"), Column("error / VJM's"), double], frame)
    assert [[*row] for row in table.rows] == [["a", 0.5, "aa"], ["b", None, "bb"]]
