"""Check text tables of other programs: blanks, encodings, minus signs, merged cells, sizes."""

from __future__ import annotations

from io import StringIO

import numpy as np
import pytest

from helpers.made_samples import CSV_HEADER as HEADER
from helpers.made_samples import CSV_ROW as GOOD
from stiff_apply.path_file import read_path
from stiff_apply.tool_task import tool_of
from stiff_datasets.measured.descriptors import describe
from stiff_datasets.measured.query_file import read_loads
from stiff_datasets.measured.sample_file import read_samples
from stiff_protocols.contract.errors import DataError

NUMBER_HEADER, NUMBERS = HEADER.split(",", 3)[3], GOOD.split(",", 3)[3]
JOINTS, WRENCH, DEFLECTION = [10, -60, 70, 0, 40, 0], [50, 10, -80, 1, 2, 0], [0.5, 0.1, -0.9]

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*(no pose_id|columns not used|Windows-1252|deflections are|above the header)"
)


@pytest.fixture()
def read(tmp_path, kr10):
    """Return a function that writes a file and reads its samples."""

    def write_and_read(content: str | bytes, reader=read_samples):
        path = tmp_path / "my.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return reader(path, kr10)

    return write_and_read


def assert_good(samples):
    np.testing.assert_allclose(np.rad2deg(samples.q[-1]), JOINTS, atol=1e-12)
    np.testing.assert_allclose(samples.wrench[-1], WRENCH)
    np.testing.assert_allclose(1000.0 * samples.deflection[-1], DEFLECTION)


def saved(**options) -> str:
    """Return the text of `numpy.savetxt` of the good row."""
    text = StringIO()
    row = np.array([[float(cell) for cell in NUMBERS.split(",")]])
    np.savetxt(text, row, header=NUMBER_HEADER.replace(",", options["delimiter"]), **options)
    return text.getvalue()


ALIGNED = [text.replace(",", "   ") for text in (NUMBER_HEADER, NUMBERS)]


@pytest.mark.parametrize(
    "text",
    [
        saved(delimiter="  ", fmt="%12.4f", comments=""),
        saved(delimiter=" ", fmt="%.18e"),
        saved(delimiter=",", fmt="%.4f"),
        saved(delimiter="\t", fmt="%9.4f"),
        "\n".join(["Cell 2, May", "", *ALIGNED]),
        "\n".join(ALIGNED).replace("fx_N", "Kraft X").replace("fy_N", "Kraft Y"),
        "\n".join(ALIGNED).replace(".", ","),
        "\n".join([NUMBER_HEADER.replace(",", "\t\t"), NUMBERS.replace(",", "\t")]),
        "\n".join(text.replace(",", " ") for text in (NUMBER_HEADER, NUMBERS)),
        "\n".join(text.replace(",", " \t ") for text in (NUMBER_HEADER, NUMBERS)),
    ],
    ids=[
        *("savetxt", "savetxt, header as a remark", "with commas", "with tabs", "title"),
        *("names with blanks", "decimal commas", "two tabs", "blanks", "tabs and blanks"),
    ],
)
def test_columns_that_blanks_or_tabs_separate_are_read(read, text):
    assert_good(read(text))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([ALIGNED[0], ALIGNED[1][4:]], r"row 2 has 14 cells, the header 15; blanks"),
        ([ALIGNED[0], "P 1  " + ALIGNED[1]], r"row 2 has 17 cells, the header 15; blanks"),
        ([ALIGNED[1], ALIGNED[1]], "no header: the first row holds numbers"),
        ([ALIGNED[0].replace("dz_mm", "dz"), ALIGNED[1][:-4] + "x"], "row 2, column dz: 'x'"),
    ],
)
def test_a_table_with_blanks_that_cannot_be_told_is_refused(read, lines, message):
    with pytest.raises(DataError, match=message):
        read("\n".join(lines))


@pytest.mark.parametrize("sign", ["\u2212", "\u2013", "\u2012", "\u2010", "\ufe63", "\uff0d"])
def test_a_typographic_minus_sign_is_a_minus_sign(read, sign):
    assert_good(read(f"{HEADER}\n{GOOD}".replace("-", sign)))
    small = GOOD.replace("0.1", f"1e{sign}1").replace("-80", f'"{sign}1,080.5"')
    assert read(f"{HEADER}\n{small}").wrench[0, 2] == -1080.5
    loads = read(f"{HEADER}\n{GOOD}".replace("-", sign), read_loads)
    assert loads.wrench[0].tolist() == WRENCH
    with pytest.raises(DataError, match="fx_N: '5\u22120'"):
        read(f"{HEADER}\n{GOOD}".replace(",50,", ",5\u22120,"))


def test_paths_have_typographic_minus_signs_too_and_descriptors_refuse_them(read, tmp_path, kr10):
    header = "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,fx_N,fy_N,fz_N"
    text = f"{header}\n500,-100,600,0,-90,0,1,2,-3".replace("-", "\u2212")

    def reader(path, robot):
        return read_path(path, robot, tool_of(robot, None))

    table = read(text, reader)
    np.testing.assert_allclose(table.path.position[0], [0.5, -0.1, 0.6])
    assert table.path.wrench[0, 2] == -3.0
    (tmp_path / "my.csv").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match="row 2 has a number with a typographic minus"):
        describe(tmp_path / "my.csv")


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1", "utf-16", "utf-8-sig"])
def test_names_and_units_are_read_in_the_encodings_of_windows(read, encoding):
    text = f"{HEADER}\n{GOOD}".replace("P1", "Prüfling Ä").replace("q1_deg", "q1 [°]")
    samples = read(text.replace("dx_mm", "dx [µm]").replace(",0.5,", ",500,").encode(encoding))
    assert_good(samples)
    assert samples.pose_id.tolist() == ["Prüfling Ä"]


def test_an_encoding_that_the_file_does_not_state_is_named(read):
    with pytest.warns(match=r"my\.csv: not UTF-8 \(byte 0xfc .*Windows-1252"):
        read(f"{HEADER}\n{GOOD}".replace("P1", "Prüfling").encode("cp1252"))


POSITIONS = ["100.0,200.0,300.0", "100.5,200.1,299.1"]
TWICE = NUMBER_HEADER.replace("dx_mm,dy_mm,dz_mm", "X,Y,Z,X,Y,Z")
ROW_TWICE = f"{NUMBERS.rsplit(',', 3)[0]},{','.join(POSITIONS)}"
MERGED = f"{',' * 12}{{}},,,{{}},,"


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_merged_cells_above_positions_say_which_are_loaded(read, separator):
    for order, sign in ((("unbelastet [mm]", "belastet [mm]"), 1), (("loaded", "Unloaded"), -1)):
        lines = [MERGED.format(*order), TWICE, ROW_TWICE]
        samples = read("\n".join(lines).replace(",", separator))
        np.testing.assert_allclose(1000.0 * samples.deflection[0], sign * np.array(DEFLECTION))


def test_merged_cells_name_forces_and_deflections_with_their_units(read):
    above = f"Gelenk,{',' * 5}Kraft [kN],,,Moment [Nm],,,Verformung [µm],,"
    row = NUMBERS.replace("50,10,-80", "0.05,0.01,-0.08").replace("0.5,0.1,-0.9", "500,100,-900")
    assert_good(read("\n".join([above, "1,2,3,4,5,6,X,Y,Z,X,Y,Z,X,Y,Z", row])))


@pytest.mark.parametrize(
    ("above", "factors"),
    [
        ("Joint angles [rad],,,,,,Forces [kN],,,,,,Deflections [um],,", (np.pi / 180, 1e-3, 1e3)),
        (",,,,,,Force (kN),,,Torque,,,,,", (1, 1e-3, 1)),
        ("Gelenkwinkel in rad,,,,,,,,,,,,,,", (np.pi / 180, 1, 1)),
        ("Robot 3 with payload 5 kg,,,,,,,,,,,,,,", (1, 1, 1)),
    ],
)
def test_the_unit_of_a_label_above_names_without_units_counts(read, above, factors):
    header = "q1,q2,q3,q4,q5,q6,Fx,Fy,Fz,Mx,My,Mz,dx,dy,dz"
    angle, force, deflection = factors
    numbers = [angle * q for q in JOINTS], [force * f for f in WRENCH[:3]], WRENCH[3:]
    row = [*numbers[0], *numbers[1], *numbers[2], *(deflection * d for d in DEFLECTION)]
    assert_good(read("\n".join([above, header, ",".join(map(repr, row))])))


def test_a_unit_of_a_label_that_names_no_quantity_is_never_ignored(read):
    text = f"{',' * 6}Loads [kN],,,,,,,,\nq1,q2,q3,q4,q5,q6,Fx,Fy,Fz,Mx,My,Mz,dx,dy,dz\n{NUMBERS}"
    with pytest.raises(DataError, match=r"unit of 'Fx \[Loads \[kN\]\]' \(valid: N, "):
        read(text)


def test_a_unit_of_a_label_that_contradicts_the_columns_own_is_refused(read):
    labelled = f"Angles [rad],,,,,,{',' * 9}\n{NUMBER_HEADER}\n{NUMBERS}"
    with pytest.raises(DataError, match=r"q1_deg \[Angles \[rad\]\]"):
        read(labelled)


def test_columns_that_blanks_align_may_have_single_blanks_between_long_names(read):
    rows = [f"{NUMBER_HEADER}".split(","), NUMBERS.split(",")]
    assert_good(read("\n".join(" ".join(f"{cell:>6}" for cell in row) for row in rows)))
    assert_good(read("\n".join("|".join(row) for row in rows)))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a", "git lfs pull"),
        (b"\n<!DOCTYPE html><html>", "web page"),
        (b"PK\x03\x04\x14\x00\x06\x00", "needs the ending .xlsx"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "save it as .xlsx"),
    ],
)
def test_another_file_in_place_of_a_table_is_named_with_the_next_step(read, content, words):
    with pytest.raises(DataError, match=words):
        read(content + b"\0" * 100)


@pytest.mark.parametrize("above", ["", "Messung 3", MERGED.format("vorher", "nachher")])
def test_positions_that_stand_twice_are_never_guessed(read, above):
    with pytest.raises(DataError, match=r"X, Y, Z stand twice: .*x0_mm.*unloaded.*x1_mm.*loaded"):
        read("\n".join([above, TWICE, ROW_TWICE]))


@pytest.mark.parametrize("number", ["1e100", "-1e300", "1e400", "9" * 90])
@pytest.mark.parametrize("column", ["q1_deg", "fx_N", "tz_Nm", "dy_mm"])
def test_numbers_beyond_any_robot_are_refused_with_row_and_column(read, number, column):
    cells = dict(zip(HEADER.split(","), GOOD.split(","), strict=True)) | {column: number}
    text = "\n".join([HEADER, GOOD, ",".join(cells.values()).replace("P1,1", "P2,1")])
    for reader in (read_samples,) if column == "dy_mm" else (read_samples, read_loads):
        with pytest.raises(DataError, match=rf"row 3, column {column}: '{number[:50]}"):
            read(text, reader)


def test_positions_beyond_any_instrument_are_refused_though_their_difference_is_small(read):
    header = TWICE.replace("X,Y,Z,X,Y,Z", "x0_mm,y0_mm,z0_mm,x1_mm,y1_mm,z1_mm")
    with pytest.raises(DataError, match="row 2, column x0_mm: '1e100'"):
        read(f"{header}\n{ROW_TWICE.replace('100.0', '1e100').replace('100.5', '1e100')}")


def test_an_error_of_excel_at_the_begin_of_a_line_is_no_remark(read):
    for error in ("#DIV/0!", "#N/A", "#BEZUG!"):
        bad = NUMBERS.replace("10", error, 1)
        with pytest.raises(DataError, match=f"row 3, column q1_deg: '{error}'"):
            read("\n".join([NUMBER_HEADER, NUMBERS, bad, "# end"]))


LONG = 400_000


@pytest.mark.parametrize(
    "text",
    [
        f"{HEADER.replace('dz_mm', '[' * 100_000)}\n{GOOD}",
        f"{HEADER[:-5]}{' x' * 60_000}\n{GOOD}",
        f"{HEADER}\n{GOOD.replace('50', '9' * 100_000 + 'x')}".replace(",", ";"),
        f"{HEADER}\n{GOOD.replace('50', '1.' * 60_000)}".replace(",", ";"),
        f"{'9' * LONG}x\n{GOOD}",
        " " * LONG + "x" + " " * LONG + "\ty",
        f"{','.join(f'c{i}' for i in range(LONG // 4))}\n{GOOD}",
        f"{HEADER}\n{'1,' * LONG}",
        "q1 q2 q3 " * (LONG // 9) + "\n1",
    ],
    ids=[
        *("brackets", "blanks in a name", "digits", "points", "one cell", "blanks"),
        *("names", "cells", "names between blanks"),
    ],
)
def test_enormous_lines_are_refused_in_a_short_error(read, text):
    with pytest.raises(DataError) as error:
        read(text)
    assert len(str(error.value)) < 3000
