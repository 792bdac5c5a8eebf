"""Check a workshop's files: readings along a direction, masses, pulls, and rows of states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stiff_bench.api.data_sets import Dataset, read_samples
from stiff_bench.api.measuring import validate
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.types import BenchmarkData

pytestmark = pytest.mark.filterwarnings("ignore::stiff_protocols.contract.errors.StiffBenchWarning")
N = 8
POINT = {"point_x_mm": 60.0, "point_y_mm": 30.0, "point_z_mm": 80.0}  # 30 mm from the TCP


@pytest.fixture
def columns(rng):
    """Return joint positions, a mass, and gauge readings along z and y in turn."""
    q = rng.uniform(-60.0, 40.0, size=(N, 6)).round(3)
    table = {f"q{joint + 1}_deg": q[:, joint] for joint in range(6)}
    upwards = np.arange(N) % 2 == 0
    table |= {"mass_kg": np.linspace(2.0, 8.0, N).round(2), "reading_mm": 0.1 + 0.05 * np.arange(N)}
    return table | {"reading_x": 0.0, "reading_y": 3.0 * ~upwards, "reading_z": 1.0 * upwards}


def read(tmp_path, columns, robot, **options):
    file = tmp_path / "gauge.csv"
    pd.DataFrame(columns).to_csv(file, index=False)
    return read_samples(file, robot=robot, **options).samples


def refusal(tmp_path, columns, robot, **options):
    with pytest.raises(DataError) as error:
        read(tmp_path, columns, robot, **options)
    return str(error.value)


def test_a_reading_is_one_number_along_its_direction(tmp_path, columns, kr10):
    samples = read(tmp_path, columns, kr10)
    np.testing.assert_allclose(samples.values[:, 0], columns["reading_mm"] / 1e3)
    np.testing.assert_allclose(samples.directions[0], [[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(samples.directions[1], [[0.0, 1.0, 0.0]])


def test_a_hanging_mass_is_its_weight_and_its_torque_about_the_tcp(tmp_path, columns, kr10):
    weight = STANDARD_GRAVITY * columns["mass_kg"]
    at_tcp = read(tmp_path, columns, kr10)
    np.testing.assert_allclose(at_tcp.wrench[:, 2], -weight)
    assert not at_tcp.wrench[:, [0, 1, 3, 4, 5]].any()
    hook = (0.0, 0.05, 0.2)
    samples = read(tmp_path, columns, kr10, hook=hook)
    at_hook = replace(kr10, tcp=kr10.flange[:3, :3] @ hook + kr10.flange[:3, 3])
    tau = [
        np.einsum("nki,nk->ni", arm.jacobian(samples.q), wrench)
        for arm, wrench in ((kr10, samples.wrench), (at_hook, at_tcp.wrench))
    ]
    np.testing.assert_allclose(tau[0], tau[1], atol=1e-9)


def test_a_rope_pulls_along_its_direction_and_a_row_has_a_mass_or_a_pull(tmp_path, columns, kr10):
    pulled = np.arange(N) % 2 == 1
    columns |= {"mass_kg": np.where(pulled, np.nan, columns["mass_kg"])}
    columns |= {"pull_N": np.where(pulled, 50.0, np.nan), "pull_x": 0.0, "pull_y": 2.0, "pull_z": 0}
    samples = read(tmp_path, columns, kr10)
    np.testing.assert_allclose(samples.wrench[1, :3], [0.0, 50.0, 0.0])
    assert samples.wrench[0, 2] < 0.0 == samples.wrench[0, 1]


def test_loaded_less_unloaded_readings_are_of_the_loading_that_the_file_names(
    tmp_path, columns, kr10
):
    value = columns.pop("reading_mm")
    columns |= {"reading0_mm": 1.0, "reading1_mm": 1.0 + value, "reading2_mm": 1.02}
    first = read(tmp_path, columns, kr10)
    second = read(tmp_path, columns | {"loading": "second"}, kr10)
    mean = read(tmp_path, columns | {"loading": "mean"}, kr10)
    for samples, less in ((first, 0.0), (second, 0.02), (mean, 0.01)):
        np.testing.assert_allclose(samples.values[:, 0], (value - less) / 1e3, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(first.after, axis=1), 2e-5, atol=1e-12)


def test_a_row_a_state_is_the_same_as_a_row_a_load(tmp_path, columns, kr10):
    expected = read(tmp_path, columns, kr10)
    table = pd.DataFrame(columns).assign(pose_id=[f"P{i}" for i in range(N)])
    unloaded = table.assign(state="unloaded", mass_kg=0.0, reading_mm=0.5)
    loaded = table.assign(state="loaded", reading_mm=table["reading_mm"] + 0.5)
    rows = pd.concat([unloaded, loaded]).sort_index(kind="stable")
    samples = read(tmp_path, rows, kr10)
    np.testing.assert_allclose(samples.values, expected.values, atol=1e-12)
    np.testing.assert_array_equal(samples.wrench, expected.wrench)
    text = refusal(tmp_path, loaded, kr10)
    assert "column state" in text and "unloaded" in text


def test_states_of_a_tracker_are_its_positions(tmp_path, kr10, twin):
    frame = Dataset.from_samples(twin.samples.take(np.arange(N)), kr10).frame()
    moved = frame[["dx_mm", "dy_mm", "dz_mm"]].to_numpy()
    frame = frame.drop(columns=["dx_mm", "dy_mm", "dz_mm"])
    tcp = 1e3 * kr10.tcp_position(twin.samples.q[:N])
    rows = [
        frame.assign(state=state, **dict(zip(("x_mm", "y_mm", "z_mm"), xyz.T, strict=True)))
        for state, xyz in (("unloaded", tcp), ("loaded", tcp + moved))
    ]
    samples = read(tmp_path, pd.concat(rows).sort_index(kind="stable"), kr10)
    np.testing.assert_allclose(1e3 * samples.deflection, moved, atol=1e-9)


def test_empty_cells_are_axes_that_were_not_read(tmp_path, kr10, twin):
    frame = Dataset.from_samples(twin.samples.take(np.arange(N)), kr10).frame()
    frame.loc[frame.index % 2 == 0, ["dx_mm", "dy_mm"]] = np.nan
    frame.loc[1, "dx_mm"] = np.nan
    samples = read(tmp_path, frame, kr10)
    assert samples.is_read.sum(axis=1).tolist() == [1, 2, 1, 3, 1, 3, 1, 3]
    np.testing.assert_allclose(samples.deflection[0], [0.0, 0.0, frame["dz_mm"][0] / 1e3])
    again = Dataset.from_samples(samples, kr10).frame()
    pd.testing.assert_frame_equal(
        again[["dx_mm", "dy_mm", "dz_mm"]], frame[["dx_mm", "dy_mm", "dz_mm"]], check_dtype=False
    )


def test_a_column_of_zeros_is_refused(tmp_path, kr10, twin, columns):
    frame = Dataset.from_samples(twin.samples.take(np.arange(N)), kr10).frame()
    text = refusal(tmp_path, frame.assign(dx_mm=0.0), kr10)
    assert "dx_mm" in text and "leave the cells empty" in text
    assert "leave the cells empty" in refusal(tmp_path, columns | {"reading_mm": 0.0}, kr10)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"reading_mm": "x"}, ("row 2", "reading_mm", "finite number")),
        ({"mass_kg": -1.0}, ("row 2", "mass_kg", "at least 0")),
        ({"mass_kg": np.nan}, ("row 2", "mass_kg")),
        ({"reading_y": 0.0, "reading_z": 0.0}, ("row 2", "reading_x", "direction")),
        ({"fx_N": 1.0}, ("fx_N", "one of them")),
        ({"dx_mm": 1.0}, ("dx_mm", "one of them")),
        ({"pull_N": 5.0}, ("pull_x", "missing")),
        ({"loading": "third"}, ("row 2", "loading", "first, second, mean")),
        ({"loading": "second", "reading0_mm": 0.0}, ()),
        ({"point_x_mm": 20.0}, ("missing point_y_mm, point_z_mm",)),
        ({**POINT, "point_y_mm": [None, *[1.0] * (N - 1)]}, ("row 2", "point_y_mm", "empty")),
        ({**POINT, "point_x_mm": 2e5}, ("row 2", "point_x_mm", "100000 mm")),
        ({**POINT, "point_z_mm": "0.1.2"}, ("row 2", "point_z_mm", "finite number")),
    ],
)
def test_a_wrong_cell_is_named_with_its_row_and_column(changed, words, tmp_path, columns, kr10):
    if not words:
        assert len(read(tmp_path, columns | changed, kr10)) == N
        return
    text = refusal(tmp_path, columns | changed, kr10)
    assert all(word in text for word in words), text


def test_the_point_that_the_gauge_touches_is_a_lever_from_the_tcp(tmp_path, columns, kr10):
    x = np.where(np.arange(N) == 3, np.nan, 60.0)  # no point: the TCP
    samples = read(
        tmp_path,
        columns
        | POINT
        | {"point_x_mm": x + 5.0 * np.arange(N)}
        | {
            name: np.where(np.isnan(x), np.nan, POINT[name])
            for name in ("point_y_mm", "point_z_mm")
        },
        kr10,
    )
    at_tcp = read(tmp_path, columns, kr10)
    assert at_tcp.levers.size == 0
    for row, lever in enumerate(samples.levers):
        point = [0.06 + 0.005 * row, 0.03, 0.08] if row != 3 else kr10.tcp_on_flange
        arm = replace(kr10, tcp=kr10.flange[:3, :3] @ point + kr10.flange[:3, 3])
        q = samples.q[[row]]
        np.testing.assert_allclose(
            lever, (arm.tcp_position(q) - kr10.tcp_position(q))[0], atol=1e-9
        )
    np.testing.assert_array_equal(samples.wrench, at_tcp.wrench)
    np.testing.assert_array_equal(samples.values, at_tcp.values)
    empty = columns | dict.fromkeys(POINT, "")
    assert BenchmarkData(read(tmp_path, empty, kr10), kr10).sha256 == (
        BenchmarkData(at_tcp, kr10).sha256
    )


def test_readings_of_a_point_are_exported_with_it(tmp_path, columns, kr10):
    samples = read(tmp_path, columns | POINT, kr10)
    frame = Dataset.from_samples(samples, kr10).frame()
    np.testing.assert_allclose(frame[[*POINT]], np.tile([*POINT.values()], (N, 1)), atol=1e-5)
    again = Dataset.from_frame(frame, kr10).samples
    np.testing.assert_array_equal(again.levers, samples.levers)
    np.testing.assert_allclose(again.values, samples.values, atol=1e-15)
    three = replace(samples, directions=np.tile(np.eye(3), (N, 1, 1)))
    with pytest.raises(DataError, match="several readings"):
        Dataset.from_samples(three, kr10).frame()


def test_states_of_one_pose_are_joined_point_by_point(tmp_path, columns, kr10):
    columns |= {"reading_y": 0.0, "reading_z": 1.0}
    table = pd.concat([pd.DataFrame(columns | POINT | {"point_x_mm": x}) for x in (60.0, 90.0)])
    table = table.assign(pose_id=[f"P{i % N}" for i in range(2 * N)], load_id=np.arange(2 * N))
    unloaded = table.assign(state="unloaded", reading_mm=table["point_x_mm"])
    loaded = table.assign(state="loaded", reading_mm=table["reading_mm"] + table["point_x_mm"])
    samples = read(tmp_path, pd.concat([unloaded, loaded]), kr10)
    expected = read(tmp_path, table, kr10)
    np.testing.assert_allclose(samples.values, expected.values, atol=1e-12)
    np.testing.assert_array_equal(samples.levers, expected.levers)


def test_a_point_without_a_reading_is_refused(tmp_path, kr10, twin):
    frame = Dataset.from_samples(twin.samples.take(np.arange(N)), kr10).frame()
    text = refusal(tmp_path, frame.assign(**POINT), kr10)
    assert "point_x_mm" in text and "--tcp" in text


def test_a_plan_of_readings_without_readings_is_not_filled_in(tmp_path, columns, kr10):
    text = refusal(tmp_path, columns | {"reading_mm": np.nan}, kr10)
    assert "not filled in" in text and "reading_mm" in text


def test_one_dial_gauge_along_z_needs_two_columns_less(tmp_path, kr10, twin):
    frame = Dataset.from_samples(twin.samples.take(np.arange(N)), kr10).frame()
    samples = read(tmp_path, frame.assign(dx_mm="", dy_mm=""), kr10)
    assert samples.directions.shape == (N, 1, 3)


def test_validate_names_an_axis_that_moved_in_a_file_of_readings(tmp_path, columns, kr10):
    file = tmp_path / "gauge.csv"
    pd.DataFrame(columns | {"e1_mm": 100.0 * np.arange(N)}).to_csv(file, index=False)
    warnings = [finding.message for finding in validate(file, robot=kr10).warnings]
    assert any("e1_mm" in message and "an axis that moved" in message for message in warnings)


def test_validate_reports_on_readings_and_names_joints_that_no_weight_turns(
    tmp_path, columns, kr10
):
    file = tmp_path / "gauge.csv"
    pd.DataFrame(columns).to_csv(file, index=False)
    report = validate(file, robot=kr10)
    assert report.verdict == "suspicious"
    assert any("no load turns A1" in finding.message for finding in report.warnings)
    assert any("along x 0, y 4, z 4" in finding.message for finding in report.facts)
    pd.DataFrame(columns | POINT).to_csv(file, index=False)
    facts = [finding.message for finding in validate(file, robot=kr10).facts]
    assert any("points 30 to 30 mm from the TCP" in message for message in facts)
