"""Check which CSV files of users are read, and which errors name the place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm, random_chain
from helpers.made_samples import CSV_HEADER as HEADER
from helpers.made_samples import CSV_ROW as GOOD
from stiff_datasets.measured.sample_columns import AFTER_COLUMNS
from stiff_datasets.measured.sample_file import read_samples
from stiff_protocols.contract.errors import DataError, StiffBenchWarning


def write(tmp_path, *lines):
    path = tmp_path / "my.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def line(**changes):
    return ",".join(
        str(changes.get(name, value))
        for name, value in zip(HEADER.split(","), GOOD.split(","), strict=True)
    )


RADIANS = [
    line(pose_id=f"P{i}", q1_deg=0.2, q2_deg=-1, q3_deg=1.2, q4_deg=0, q5_deg=0.7, q6_deg=0)
    for i in range(6)
]


def test_an_angle_a_little_beyond_a_limit_is_a_warning(tmp_path, kr10):
    path = write(tmp_path, HEADER, line(q2_deg=45.1))
    with pytest.warns(StiffBenchWarning, match=r"row 2, column q2_deg: '45\.1'.*-190..45 deg"):
        samples = read_samples(path, kr10)
    assert np.rad2deg(samples.q[0, 1]) == pytest.approx(45.1)


def test_units_are_converted_once_on_the_way_in(tmp_path, kr10):
    samples = read_samples(write(tmp_path, HEADER, GOOD), kr10)
    np.testing.assert_allclose(np.rad2deg(samples.q[0]), [10, -60, 70, 0, 40, 0])
    np.testing.assert_allclose(samples.wrench[0], [50, 10, -80, 1, 2, 0])
    np.testing.assert_allclose(samples.deflection[0], [0.5e-3, 0.1e-3, -0.9e-3])
    assert samples.pose_id.tolist() == ["P1"]


GERMAN = [text.replace(",", ";").replace(".", ",") for text in (HEADER, GOOD)]
ALIASES = "Pose,load,Group,A1,J2 [deg],q3,joint4_rad,A5,A6,Fx[kN],force_y,fz,Mx [N mm],ty,TZ_Nm,"


SPOKEN = (
    "pose,load,group,Achse 1,A2 [Grad],J3 (degrees),Joint 4/deg,q5,θ6,"
    "Kraft X,Fy / N,Fz in N,Drehmoment x [Nm],My (N·m),Mz [N*m],"
)


@pytest.mark.parametrize(
    "content",
    [
        "\n".join(GERMAN).encode(),
        "\n".join([HEADER, GOOD]).replace(",", "\t").encode("utf-16"),
        "\r\n".join(["# made by hand", "", *GERMAN, "#P2;1;all"]).encode("utf-8-sig"),
        f"{HEADER},note,T [C]\n{GOOD},windy,21".encode(),
        f"{ALIASES}dx_um,DY,dz[m]\n{GOOD}".replace(
            "0,40,0,50,10,-80,1,2,0,0.5,0.1,-0.9", "0,40,0,0.05,10,-80,1000,2,0,500,0.1,-0.0009"
        ).encode(),
        f"{SPOKEN}Auslenkung x,Verschiebung Y [mm],Δz [micron]\n{GOOD}".replace(
            "-0.9", "-900"
        ).encode(),
        "\n".join(GERMAN).encode("utf-16-le"),
        "\n".join(["sep=;", *GERMAN]).encode(),
        "\n".join(["Measured on 3 May, cell 2", "", HEADER, GOOD]).encode(),
        "\n".join(f"{text}," for text in (HEADER, GOOD)).encode(),
    ],
    ids=[
        *("German Excel", "UTF-16", "comments", "extra columns", "aliases and units"),
        *("German words", "UTF-16 without its mark", "Excel's sep", "title", "last separator"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*columns not used")
def test_a_file_is_read_as_people_write_it(tmp_path, kr10, content):
    (tmp_path / "my.csv").write_bytes(content)
    samples = read_samples(tmp_path / "my.csv", kr10)
    expected = read_samples(write(tmp_path, HEADER, GOOD), kr10)
    for name in ("q", "wrench", "deflection"):
        np.testing.assert_allclose(getattr(samples, name), getattr(expected, name), rtol=1e-14)
    assert samples.pose_id.tolist() == expected.pose_id.tolist()


def test_an_excel_file_is_read_and_its_rows_are_counted_as_excel_does(tmp_path, kr10):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    numbers = [float(cell) for cell in GOOD.split(",")[3:]]
    for row in (["# by hand"], [], HEADER.split(","), [7, 1, "all", *numbers]):
        book.active.append(row)
    book.save(tmp_path / "my.xlsx")
    samples = read_samples(tmp_path / "my.xlsx", kr10)
    assert samples.pose_id.tolist() == ["7"] and samples.wrench[0, 2] == -80
    book.active["J4"] = "much"
    book.save(tmp_path / "my.xlsx")
    with pytest.raises(DataError, match=r"my\.xlsx: row 4, column fx_N: 'much'"):
        read_samples(tmp_path / "my.xlsx", kr10)


@pytest.mark.parametrize(
    ("header", "row", "load"),
    [(*GERMAN, "-1.080,5"), (HEADER, GOOD, '"-1,080.5"')],
)
def test_thousands_are_read_where_decimals_follow_them(tmp_path, kr10, header, row, load):
    samples = read_samples(write(tmp_path, header, row.replace("-80", load)), kr10)
    assert samples.wrench[0, 2] == -1080.5


POINTS = [text.replace(",", ";") for text in (HEADER, GOOD)]
DOUBTFUL = ".* decimals or thousands"
APPROACH = [f"approach_q{i}" for i in range(1, 7)]


@pytest.mark.filterwarnings("ignore:.*columns not used")
@pytest.mark.parametrize("note", ['"tool" ', '"5" tool', '5" tool'])
def test_text_behind_or_before_a_quotation_mark_is_read(tmp_path, kr10, note):
    lines = [f"note,{HEADER}", f"{note},{GOOD}", f"calm,{line(load_id=2)}"]
    assert len(read_samples(write(tmp_path, *lines), kr10)) == 2


@pytest.mark.parametrize("name", ["my.csv", "my.xlsx", "my.parquet"])
def test_a_folder_in_place_of_a_file_is_named(tmp_path, kr10, name):
    (tmp_path / name).mkdir()
    with pytest.raises(DataError, match=rf"{name}: cannot be read: "):
        read_samples(tmp_path / name, kr10)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([""], "the file is empty"),
        ([HEADER], "no data rows"),
        ([GOOD, GOOD], r"no header: the first row holds numbers \(valid: pose_id,"),
        ([HEADER.replace("dz_mm", "dz_inch"), GOOD], "missing dz_mm; columns not used: dz_inch"),
        ([HEADER.replace("q1_deg", "q1 [rpm]"), GOOD], r"unit of 'q1 \[rpm\]' \(valid: deg, .*rad"),
        (
            [HEADER.replace("fx_N", "Fx [lbf]") + ",note", GOOD + ",windy"],
            r"missing fx_N; columns not used: note; unit of 'Fx \[lbf\]' \(valid: N, kn, ",
        ),
        (
            [GERMAN[0].replace(";q1_deg", "") + ";Temperatur [°C]", GERMAN[1].replace(";10;", ";")],
            r"header: missing q1_deg; columns not used: Temperatur \[°C\] \(valid: pose_id,",
        ),
        ([HEADER.replace(",tz_Nm", ""), GOOD.replace(",2,0,", ",2,")], "tz_Nm.*no-torque"),
        ([HEADER + ",Dx [mm]", GOOD + ",1"], "repeated dx_mm"),
        ([HEADER, GOOD, "--- end of the log"], r"row 3, column pose_id: '--- end of the log'"),
        ([HEADER, GOOD, line(pose_id="P2", fx_N="abc")], r"row 3, column fx_N: 'abc'"),
        *(
            (
                [HEADER, GOOD, line(load_id=2, dy_mm=cell)],
                rf"row 3, column dy_mm: '{cell}', expected a finite numb",
            )
            for cell in ("nan", "", "inf")
        ),
        ([HEADER, line(pose_id="")], r"row 2, column pose_id: '', expected a name"),
        ([HEADER, GOOD, GOOD], r"row 3, column pose_id,load_id: 'P1,1'"),
        (
            [HEADER, line(q2_deg=60)],
            r"column q2_deg: '60', expected -190..45 deg, the limits of joint A2",
        ),
        ([HEADER, line(q2_deg=46.1)], r"column q2_deg: '46.1', expected -190..45 deg"),
        ([HEADER, line(dx_mm=51)], r"column dx_mm: '51', expected mm within \+-50"),
        (
            [HEADER, line(dx_mm=5e-4, dy_mm=1e-4, dz_mm=-9e-4)],
            r"no deflection exceeds 0.01 mm .*look like metres",
        ),
        (
            [HEADER, GOOD, line(load_id=2, q1_deg=11)],
            r"row 3, column q1_deg: '11', expected 10, as in row 2 of the same pose 'P1'",
        ),
        (
            ["# by hand", HEADER, GOOD, GOOD.replace("-0.9", "-0,9")],
            "not a CSV table: row 4 has 19 cells, the header 18; decimal commas need semicolons",
        ),
        ([HEADER, GOOD + ",7,8"], "not a CSV table: row 2 has 20 cells, the header 18"),
        (
            [HEADER + ",note", GOOD + ',"windy', line(load_id=2) + ",calm"],
            r"row 2: .* \(a quotation mark that is not closed\?\)",
        ),
        (
            [HEADER + ",note", GOOD + ',"windy', *("x" * 999,) * 200],
            r"row 2: .* \(a quotation mark that is not closed\?\)",
        ),
        ([HEADER, *RADIANS], "these look like radians"),
        ([GERMAN[0], GERMAN[1].replace("-80", "1.080")], rf"row 2, .*'1.080', {DOUBTFUL}"),
        ([POINTS[0], POINTS[1].replace("-80", "1,080")], rf"row 2, .*'1,080', {DOUBTFUL}"),
        (
            [*GERMAN, GERMAN[1].replace("P1", "P2").replace("-80", "1.080")],
            rf"row 3, column fz_N: '1.080', {DOUBTFUL}",
        ),
        *(  # a split could separate it from the pose that looks alike
            ([HEADER, GOOD, line(pose_id=f"P{sign}1", load_id=2)], "row 3, .*pose_id: .* invisible")
            for sign in "\ufeff\u200b\u202e\u00ad\u00a0"
        ),
        *(
            (
                [HEADER, GOOD, junk, line(pose_id="P2")],
                r"row 3, column \w+: '.*', expected a row [a-z0-9 ]+$",
            )
            for junk in ("pause", "stop,motor,hot", HEADER, ",,," + ",".join(["?"] * 15))
        ),
        *(
            ([f"{HEADER},{','.join(columns)}", f"{GOOD},{cells}"], named)
            for columns, cells, named in (
                (["order"], "second", "'second'.*a number, or a time"),
                (APPROACH, "1,1,2,1,1,1", "approach_q3"),
                (APPROACH[:1], "1", "missing approach_q2"),
                (AFTER_COLUMNS[:2], "0,0", "missing after_dz_mm"),
                (AFTER_COLUMNS, "0,,0", "after_dy_mm"),
            )
        ),
    ],
)
def test_what_is_wrong_is_named_with_file_row_column_and_value(tmp_path, kr10, lines, message):
    with pytest.raises(DataError, match=message) as caught_error:
        read_samples(write(tmp_path, *lines), kr10)
    assert "my.csv" in str(caught_error.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("my.csv", None, "cannot be read: No such file"),
        ("my.parquet", None, "cannot be read: No such file"),
        ("my.xlsx", None, "cannot be read: No such file"),
        ("my.parquet", b"pose_id", "not a Parquet file"),
        ("my.xlsx", HEADER.encode(), "not an Excel file"),
        ("my.csv", bytes(range(256)), r"not a text in UTF-8 or UTF-16 \(byte 0x"),
        ("my.csv", f"{HEADER}\n{GOOD}\n".encode("utf-32"), "not a CSV table in UTF-8 or UTF-16"),
        ("my.csv", f"# \x02 Prüfstand\n{HEADER}\n".encode("cp1252"), ".*save it as 'CSV UTF-8'"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_file_that_cannot_be_read_is_named(tmp_path, kr10, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=rf"{name}: {message}"):
        read_samples(tmp_path / name, kr10)


def test_a_prismatic_joints_column_is_in_millimetres(tmp_path):
    turning = planar_arm(1, (1.0, 0.0, 0.0))
    robot = replace(turning, joint_types=("prismatic",), lower=np.zeros(1), upper=np.full(1, 2.0))
    header = "pose_id,load_id,group,q1_mm," + ",".join(HEADER.split(",")[9:])
    row = "P1,1,all,1500," + ",".join(GOOD.split(",")[9:])
    assert read_samples(write(tmp_path, header, row), robot).q.tolist() == [[1.5]]
    with pytest.raises(DataError, match=r"column q1_mm: '2500', expected 0..2000 mm"):
        read_samples(write(tmp_path, header, row.replace("1500", "2500")), robot)


@pytest.mark.parametrize(
    ("kinds", "tip", "still"),
    [
        (("prismatic", *["revolute"] * 6), False, True),
        (("revolute",) * 6 + ("prismatic",), True, False),
        (("revolute",) * 7, True, True),
    ],
)
def test_a_file_with_fewer_joints_than_the_chain_names_them_and_what_to_do(
    tmp_path, rng, kinds, tip, still
):
    path = tmp_path / "my.csv"
    path.write_text(f"{HEADER}\n{GOOD}\n")
    with pytest.raises(DataError) as error:
        read_samples(path, random_chain(rng, kinds))
    message = str(error.value)
    assert "6 joints" in message and "7 (j1, j2, j3, j4, j5, j6, j7)" in message
    assert ("--tip" in message and "'j7'" in message) == tip
    assert ("if j1 stood still" in message) == still
    assert ("--hold j7=VALUE" in message, "--hold j1=VALUE" in message) == (tip, still)


@pytest.mark.parametrize("column", ["q7_deg", "rail", "rail_mm", "rail [mm]", "Lift axis [mm]"])
def test_a_column_of_a_held_joint_is_refused_by_name(tmp_path, rng, column):
    path = tmp_path / "my.csv"
    path.write_text(f"{HEADER},{column}\n{GOOD},3\n")
    robot = random_chain(rng, ("revolute",) * 6)
    with pytest.warns(StiffBenchWarning, match="columns not used"):
        read_samples(path, robot)
    with pytest.raises(DataError) as error:
        read_samples(path, replace(robot, held=("rail=3 mm", "lift_axis=5 mm")))
    assert f"'{column}'" in str(error.value) and "--hold rail=3 mm" in str(error.value)


def test_order_approach_and_the_reading_after_the_load_are_read(tmp_path, kr10):
    names = [*APPROACH, *(f"after_d{a}_um" for a in "xyz")]
    header = ",".join([HEADER, "order", *names])
    rows = [
        ",".join([line(load_id=i), str(order), *["-1"] * 6, "4", "0", "-2"])
        for i, order in enumerate([7, 3])
    ]
    samples = read_samples(write(tmp_path, header, *rows), kr10)
    assert samples.order.tolist() == [7.0, 3.0]
    assert (samples.approach == -1.0).all() and samples.approach.shape == (2, 6)
    np.testing.assert_allclose(samples.after, [[4e-6, 0.0, -2e-6]] * 2)


@pytest.mark.parametrize(
    ("column", "times", "seconds"),
    [
        ("Time", ["2026-11-28T10:15:00", "2026-11-28T10:16:30"], [0.0, 90.0]),
        ("timestamp", ["10:16:30", "10:15:00"], [36990.0, 36900.0]),
        ("Zeit", ["12.5", "3"], [12.5, 3.0]),
    ],
)
def test_a_time_of_reading_is_an_order(column, times, seconds, tmp_path, kr10):
    rows = [f"{line(load_id=i)},{time}" for i, time in enumerate(times)]
    assert (
        read_samples(write(tmp_path, f"{HEADER},{column}", *rows), kr10).order.tolist() == seconds
    )
