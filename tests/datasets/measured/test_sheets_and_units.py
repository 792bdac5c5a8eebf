"""Check files with several sheets, a row of units, positions, or other column names."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from helpers.command_line import bench_here
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.query_file import read_loads
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.table_reader import sample_table
from stiff_datasets.measured.validation_report import validate
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchWarning

JOINTS = [f"q{i}_deg" for i in range(1, 7)]
DEFLECTIONS = ["dx_mm", "dy_mm", "dz_mm"]
ROBOT = ["--robot", "kr10-r1100-2"]


@pytest.fixture(scope="module")
def table(twin):
    return sample_table(twin.samples, twin.robot).iloc[:30].round(4)


@pytest.fixture(scope="module")
def tcp_mm(table, kr10):
    """Return the positions of the TCP, (30, 3) mm."""
    return 1000.0 * kr10.forward(np.deg2rad(table[JOINTS].to_numpy())).points[:, -1]


@pytest.fixture()
def book(tmp_path, table):
    """Return a function that writes an Excel file with n rows per sheet; 0: a note."""
    pytest.importorskip("openpyxl")

    def write(**sheets):
        path = tmp_path / "my.xlsx"
        with pd.ExcelWriter(path) as writer:
            for name, n_rows in sheets.items():
                rows = table.iloc[:n_rows] if n_rows else pd.DataFrame({"measured by": ["Ada"]})
                rows.to_excel(writer, sheet_name=name, index=False)
        return path

    return write


@pytest.mark.slow
def test_a_sheet_is_asked_for_where_two_hold_tables(book, kr10, tmp_path):
    path = book(Monday=9, Tuesday=4, Notes=0)
    for call in (read_samples, validate, read_loads):
        with pytest.raises(ConfigError, match=r"sheet is needed: .*'Monday', 'Tuesday'\)$"):
            call(path, kr10)
    assert len(read_samples(path, kr10, FileOptions(sheet="Tuesday"))) == 4
    assert len(sb.read_samples(path, robot="kr10-r1100-2", sheet="Monday")) == 9
    assert sb.validate(path, sheet="Monday").verdict != "invalid"
    words = ["fit", "--data", "my.xlsx", *ROBOT, "--model", "vjm", "--output", "vjm.stiff"]
    fit_process = bench_here(*words, "--sheet", "Monday", cwd=tmp_path)
    assert fit_process.returncode == 0, fit_process.stderr
    words = ["predict", "--model", "vjm.stiff", "--input", "my.xlsx", "--output", "out.csv"]
    predict_process = bench_here(*words, "--sheet", "Tuesday", cwd=tmp_path)
    assert "4 rows predicted" in predict_process.stdout, predict_process.stderr


def test_a_sheet_that_is_not_there_is_refused_with_those_that_are(book, kr10, table, tmp_path):
    path = book(Monday=5, Notes=0)
    with pytest.raises(ConfigError, match=r"'Friday': no sheet of .*'Monday', 'Notes'\)$"):
        read_samples(path, kr10, FileOptions(sheet="Friday"))
    table.to_csv(tmp_path / "my.csv", index=False)
    with pytest.raises(ConfigError, match=r"sheet 'Monday': .*my\.csv has no sheets"):
        read_samples(tmp_path / "my.csv", kr10, FileOptions(sheet="Monday"))


BARE = [name.rpartition("_")[0] for name in [*JOINTS, "fx_N", "fy_N", "fz_N"]]
BARE = ["pose_id", "load_id", "group", *BARE, "tx", "ty", "tz", "dx", "dy", "dz"]
DEG_N_NM = [*["deg"] * 6, *["N"] * 3, *["N·m"] * 3]
BRACKETED = [*[""] * 3, *(f"[{unit}]" for unit in DEG_N_NM), "[um]", "[um]", "[um]"]


def with_units_row(table, units, names):
    """Return the text of a file that has its units in the second row."""
    rows = table.copy()
    rows[DEFLECTIONS] *= 1.0 if units[-2] == "mm" else 1000.0
    rows.columns = names or rows.columns
    header, *lines = rows.to_csv(index=False).splitlines()
    return "\n".join([header, ",".join(units), *lines])


@pytest.mark.parametrize(
    ("units", "names"),
    [
        (["-", "-", "-", *DEG_N_NM, "um", "um", "um"], BARE),
        (BRACKETED, BARE),
        (["-", "", "-", *DEG_N_NM, "mm", "mm", "mm"], None),
    ],
    ids=["bare", "bracketed", "names with units too"],
)
def test_a_row_of_units_below_the_header_is_used(tmp_path, kr10, table, units, names):
    path = tmp_path / "my.csv"
    path.write_text(with_units_row(table, units, names))
    with pytest.warns(StiffBenchWarning, match="row 2 states the units"):
        samples = read_samples(path, kr10)
    expected = table[DEFLECTIONS].to_numpy() / 1000.0
    np.testing.assert_allclose(samples.deflection, expected, rtol=1e-12)
    path.write_text(path.read_text().replace("\nP", "\nQ").replace(",0.0,", ",x,", 1))
    with pytest.raises(DataError, match="row 3, column"):  # rows are still counted as in an editor
        read_samples(path, kr10)


@pytest.mark.parametrize(
    ("last", "names", "message"),
    [
        ("um", None, r"row 2: unit 'um' of .*'dx_mm'"),
        ("inch", BARE, r"missing dz_mm; .*inch"),
    ],
    ids=["another than the name's", "unknown"],
)
def test_a_row_of_units_that_cannot_be_used_is_refused(tmp_path, kr10, table, last, names, message):
    units = [*["-"] * 3, *DEG_N_NM, "um", "um", last]
    (tmp_path / "my.csv").write_text(with_units_row(table, units, names))
    with pytest.raises(DataError, match=message):
        read_samples(tmp_path / "my.csv", kr10)


def with_positions(table, tcp_mm, unit="mm", names="{axis}{number}_{unit}"):
    """Replace the table's deflections by the positions without and under load."""
    scale = {"mm": 1.0, "m": 1e-3}[unit]
    rows = table.drop(columns=DEFLECTIONS)
    before = tcp_mm.round(3)
    for number, positions in enumerate((before, before + table[DEFLECTIONS].to_numpy())):
        for i, axis in enumerate("xyz"):
            name = names.format(axis=axis, number=number, unit=unit)
            rows[name] = (scale * positions[:, i]).round(8)
    return rows


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_positions_without_and_under_load_give_the_deflection(tmp_path, kr10, table, tcp_mm, unit):
    path = tmp_path / "my.csv"
    with_positions(table, tcp_mm, unit).iloc[:9].to_csv(path, index=False)
    with pytest.warns(StiffBenchWarning, match=rf"deflections are x1_{unit} - x0_{unit}, "):
        samples = read_samples(path, kr10)
    expected = table[DEFLECTIONS].to_numpy()[:9] / 1000.0
    np.testing.assert_allclose(samples.deflection, expected, rtol=0, atol=1e-12)
    assert "deflections are" in repr(validate(path, kr10))


def test_positions_that_are_not_whole_are_named(tmp_path, kr10, table, tcp_mm):
    path, rows = tmp_path / "my.csv", with_positions(table, tcp_mm)
    for wrong_table, message in (
        (rows.drop(columns=["x0_mm", "y0_mm", "z0_mm"]), "missing x0_mm, y0_mm, z0_mm"),
        (rows.astype({"y1_mm": str}).replace({"y1_mm": {rows.y1_mm.astype(str)[3]: "?"}}), "'?'"),
        (rows.assign(z1_mm=rows.z1_mm + 60.0 * (rows.index == 0)), r"row 2, column z1_mm - z0_mm"),
        (table.drop(columns=DEFLECTIONS), r"missing dx_mm.*x1_mm"),
    ):
        wrong_table.to_csv(path, index=False)
        with pytest.raises(DataError, match=message.replace("?", r"\?")):
            read_samples(path, kr10)


@pytest.mark.parametrize("frame", ["base", "tracker", "one row"])
def test_positions_in_the_columns_of_deflections_are_refused_with_what_to_do(
    tmp_path, kr10, table, tcp_mm, frame
):
    turn = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, 0.8], [-0.8, 0.0, 0.6]])
    positions = tcp_mm @ turn.T + [2500.0, -300.0, 80.0] if frame == "tracker" else tcp_mm
    rows = table.copy()
    rows[DEFLECTIONS] += positions
    rows.iloc[: 1 if frame == "one row" else None].to_csv(tmp_path / "my.csv", index=False)
    with pytest.raises(DataError, match=r"absolute positions.*subtract.*x0_mm.*x1_mm"):
        read_samples(tmp_path / "my.csv", kr10)


@pytest.mark.parametrize(
    ("joint", "force", "torque", "deflection"),
    [
        ("Gelenk {} [Grad]", "Kraft {} [N]", "Moment {} [Nm]", "Auslenkung {} [mm]"),
        ("Achswinkel A{} (°)", "Kraft F{} (N)", "Drehmoment M{} (Nm)", "Verlagerung d{} (mm)"),
        ("Joint-Position {} / deg", "force {}", "torque T{}", "deformation {}"),
        ("Winkel q{} in °", "f{}", "t{}", "d{}"),
    ],
)
def test_columns_are_found_under_the_names_people_give_them(
    tmp_path, kr10, table, joint, force, torque, deflection
):
    kinds = {"f{}_N": force, "t{}_Nm": torque, "d{}_mm": deflection}
    user_names = {
        name.format(a): user_name.format(a) for name, user_name in kinds.items() for a in "xyz"
    }
    user_names |= {f"q{i}_deg": joint.format(i) for i in range(1, 7)}
    table.rename(columns=user_names).to_csv(tmp_path / "my.csv", index=False)
    samples = read_samples(tmp_path / "my.csv", kr10)
    np.testing.assert_allclose(np.rad2deg(samples.q), table[JOINTS], rtol=0, atol=1e-12)
    np.testing.assert_allclose(samples.wrench[:, 5], table["tz_Nm"])
    np.testing.assert_allclose(samples.deflection[:, 0] * 1000.0, table["dx_mm"], rtol=1e-12)
