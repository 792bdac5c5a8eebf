"""Check Excel files: formulas, errors, merged cells, far cells, and files that grow."""

from __future__ import annotations

import functools
import io
import re
import tracemalloc
import zipfile

import numpy as np
import pytest

from helpers.made_samples import CSV_HEADER as HEADER
from helpers.made_samples import CSV_ROW as GOOD
from stiff_datasets.measured.excel_file import MAX_CELLS, MAX_UNPACKED_BYTES
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.validation_report import validate
from stiff_protocols.contract.errors import DataError, StiffBenchWarning

openpyxl = pytest.importorskip("openpyxl")
NAMES, CELLS = HEADER.split(","), ["P1", "1", "all", *map(float, GOOD.split(",")[3:])]
SHEET = "xl/worksheets/sheet1.xml"

pytestmark = pytest.mark.filterwarnings("ignore:.*(no pose_id|name 1 pose|above the header)")


@pytest.fixture()
def book(tmp_path):
    """Return a function that writes rows, then changes of cells and of the sheet's XML."""

    def write(*rows, cells=None, xml=None):
        workbook, path = openpyxl.Workbook(), tmp_path / "my.xlsx"
        for row in rows or (NAMES, CELLS, ["P2", *CELLS[1:]]):
            workbook.active.append(row)
        for place, value in (cells or {}).items():
            workbook.active[place] = value
        content = io.BytesIO()
        workbook.save(content)
        with zipfile.ZipFile(content) as source, zipfile.ZipFile(path, "w", 8) as target:
            for name in source.namelist():
                text = source.read(name)
                target.writestr(name, xml(text) if xml and name == SHEET else text)
        return path

    return write


@pytest.mark.parametrize("place", ["P3", "J3", "D3", "A3"])
def test_a_formula_without_its_value_is_named_with_what_to_do(book, kr10, place):
    path = book(cells={place: "=X3-M3"})
    column = NAMES[ord(place[0]) - ord("A")]
    with pytest.raises(DataError, match=rf"row 3, column {column}: '=X3-M3'.*save .* in Excel"):
        read_samples(path, kr10)


def test_columns_of_formulas_without_values_are_no_plan(book, kr10):
    path = book(cells={f"{column}{row}": "=Z1" for column in "PQR" for row in (2, 3)})
    report = validate(path, kr10)
    assert [finding.rows for finding in report.errors] == [(2, 3)] * 3
    assert not any("plan" in finding.message for finding in report.errors)


def test_a_formula_with_its_value_is_read_and_one_with_an_empty_value_is_empty(book, kr10):
    stored = functools.partial(re.sub, rb"<f>1\+1</f><v ?/?>(</v>)?", b"<f>1+1</f><v>2</v>")
    path = book(cells={"P2": "=1+1"}, xml=stored)
    assert read_samples(path, kr10).deflection[0, 0] == pytest.approx(0.002)
    cells = {f"{column}{row}": "=1+1" for column in "PQR" for row in (2, 3)}

    def computed(text):
        for place in cells:
            text = text.replace(f'<c r="{place}"'.encode(), f'<c r="{place}" t="str"'.encode())
        return text

    with pytest.raises(DataError, match="plan not filled in yet"):
        read_samples(book(cells=cells, xml=computed), kr10)


@pytest.mark.parametrize("error", ["#DIV/0!", "#N/A", "#REF!", "#VALUE!", "#NAME?", "#NUM!"])
def test_an_error_is_shown_with_its_text_row_and_column(book, kr10, error):
    with pytest.raises(DataError, match=rf"row 3, column dx_mm: '{error}'".replace("?", r"\?")):
        read_samples(book(cells={"P3": error}), kr10)
    first = book(NAMES[3:], CELLS[3:], [error, *CELLS[4:]])
    with pytest.raises(DataError, match=rf"row 3, column q1_deg: '{error}'".replace("?", r"\?")):
        read_samples(first, kr10)


def test_merged_cells_above_positions_say_which_are_loaded(book, kr10):
    above = ["Achswinkel [°]", *[None] * 5, "Last [N, Nm]", *[None] * 5]
    above += ["unbelastet [mm]", None, None, "belastet [mm]", None, None]
    header = ["A1", "A2", "A3", "A4", "A5", "A6", "Fx", "Fy", "Fz", "Mx", "My", "Mz", *"XYZXYZ"]
    row = [*CELLS[3:15], 100.0, 200.0, 300.0, 100.5, 200.1, 299.1]
    with pytest.warns(StiffBenchWarning, match="deflections are belastet X .mm. - unbelastet X"):
        samples = read_samples(book(above, header, row), kr10)
    np.testing.assert_allclose(1000.0 * samples.deflection[0], [0.5, 0.1, -0.9])
    with pytest.raises(DataError, match="X, Y, Z stand twice"):
        read_samples(book(header, row), kr10)


def test_a_number_too_large_for_a_computer_is_refused(book, kr10):
    for number in (b"1e400", b"9" * 400):
        path = book(xml=functools.partial(re.sub, b"<v>50</v>", b"<v>%s</v>" % number))
        with pytest.raises(DataError, match="row 2, column fx_N"):
            read_samples(path, kr10)


@pytest.mark.slow
def test_a_far_cell_is_named_and_needs_little_memory(book, kr10):
    path = book(cells={"XFD200000": 1})
    tracemalloc.start()
    with pytest.warns(StiffBenchWarning) as warnings:
        assert len(read_samples(path, kr10)) == 2
    assert any("200000" in str(warning.message) for warning in warnings)
    assert any("column XFD" in str(warning.message) for warning in warnings)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2**28


def test_hidden_sheets_are_read_only_by_name(book, kr10):
    path = book()
    workbook = openpyxl.load_workbook(path)
    old = workbook.copy_worksheet(workbook.active)
    old.title, old.sheet_state, old["P2"] = "old", "hidden", 0.25
    workbook.save(path)
    assert read_samples(path, kr10).deflection[0, 0] == pytest.approx(0.0005)
    named = read_samples(path, kr10, FileOptions(sheet="old"))
    assert named.deflection[0, 0] == pytest.approx(0.00025)


def test_a_large_number_is_shown_as_excel_shows_it(book, kr10):
    with pytest.raises(DataError, match="row 3, column dx_mm: '1e\\+200'"):
        read_samples(book(cells={"P3": 1e200}), kr10)


def test_an_empty_name_asks_about_merged_cells(book, kr10):
    with pytest.raises(DataError, match=r"row 3, column pose_id: '', .*merged cells"):
        read_samples(book(NAMES, CELLS, ["", *CELLS[1:]]), kr10)


def test_an_older_excel_file_or_one_with_a_password_is_named(tmp_path, kr10):
    (tmp_path / "my.xlsx").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 500)
    with pytest.raises(DataError, match="password"):
        read_samples(tmp_path / "my.xlsx", kr10)


@pytest.mark.parametrize(
    ("old", "new", "row"),
    [
        (b'<row r="3">', b'<row r="2">', 2),
        (b'<row r="3">', b'<row r="02">', 2),
        (b'<row r="3">', b'<row r="1">', 1),
        (b'<row r="1">', b'<row r="0">', 0),
        (b'r="P3"', b'r="P2"', 3),
        (b'r="P3"', b'r="O3"', 3),
        (b'r="R3"', b'r="C3"', 3),
    ],
    ids=["twice", "with a zero", "late", "row 0", "of another row", "cell twice", "late cell"],
)
def test_rows_and_cells_that_would_replace_others_are_refused_with_sheet_and_row(
    book, kr10, old, new, row
):
    def changed(text):
        text = re.sub(rb'<row r="(\d)"[^>]*>', rb'<row r="\1">', text)
        assert old in text
        return text.replace(old, new, 1)

    with pytest.raises(DataError, match=rf"my\.xlsx: sheet 'Sheet', row {row}\b"):
        read_samples(book(xml=changed), kr10)


def test_rows_and_cells_without_their_place_follow_each_other(book, kr10):
    path = book(xml=lambda text: re.sub(rb'(<(?:row|c)) r="\w+"', rb"\1", text))
    np.testing.assert_allclose(read_samples(path, kr10).deflection[:, 0], 0.0005)


def repeated(text, part, n):
    return text.replace(b"</sheetData>", part * n + b"</sheetData>")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "n"),
    [
        (b" " * 2**20, MAX_UNPACKED_BYTES // 2**20),
        (b"<row><c><v>1</v></c></row>" * 1000, MAX_CELLS // 1400),
        (b'<row r="99999999999"><c><v>1</v></c></row>', 1),
        (b"".join(b'<row r="%d"><c r="XFD%d"/></row>' % (i, i) for i in range(9, 109)), 1),
        (b"<x " + b" ".join(b"a%d='1'" % i for i in range(30_000)) + b"/>", 1),
    ],
    ids=["blanks", "rows", "far row", "wide rows", "attributes"],
)
def test_a_file_that_grows_when_it_is_unpacked_is_refused(book, kr10, part, n):
    path = book(xml=lambda text: repeated(text, part, n))
    with pytest.raises(DataError, match=r"my\.xlsx: "):
        read_samples(path, kr10)
