"""Check the findings of `validate` in data with one planted problem, and without."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from helpers.made_samples import samples_with
from stiff_datasets.measured.anomalies import external_axis_findings, range_findings
from stiff_datasets.measured.fault_hypotheses import reading
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.identifiability import regressor
from stiff_datasets.measured.outliers_and_drift import find_outliers, outlier_findings
from stiff_datasets.measured.sample_columns import DEFLECTION_COLUMNS, WRENCH_COLUMNS
from stiff_datasets.measured.sample_file import read_samples, samples_of
from stiff_datasets.measured.table_reader import sample_table, sheet_of
from stiff_datasets.measured.validation_report import validate
from stiff_models.physics.vjm import identify_joints
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import Robot, Samples

KR10_STIFFNESS = np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])  # N m/rad
TOOL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Measurement:
    samples: Samples
    robot: Robot
    path: Path

    def report(self, **changes):
        samples = dataclasses.replace(self.samples, **changes)
        return self.report_of(sample_table(samples, self.robot))

    def table(self):
        return sample_table(self.samples, self.robot)

    def report_of(self, table):
        table.to_csv(self.path, index=False)
        return validate(self.path, self.robot, FileOptions(no_torque=True))


@pytest.fixture(params=["fanuc", "twin"])
def measurement(request, tmp_path):
    """Return either robot's data, for findings that use the physics."""
    data = request.getfixturevalue(request.param)
    return Measurement(data.samples, data.robot, tmp_path / "my.csv")


@pytest.fixture()
def fanucs(fanuc, tmp_path):
    """Return nine poses, too few for a diagnosis, for findings in single rows."""
    return Measurement(fanuc.samples.take(np.arange(9)), fanuc.robot, tmp_path / "my.csv")


def read(measurement, deflection):
    samples = measurement.samples
    return reading(measurement.robot, samples.q, samples.wrench, deflection)


def messages(findings):
    return [finding.message for finding in findings]


def only(findings, words):
    """Return the only finding whose message has these words."""
    (match,) = [finding for finding in findings if words in finding.message]
    return match


@pytest.mark.slow
def test_a_wrench_in_the_tool_frame_with_other_axes_is_named(measurement):
    robot = measurement.robot
    tool = robot.forward(measurement.samples.q).rotation @ robot.flange[:3, :3]
    parts = np.split(measurement.samples.wrench, 2, axis=1)
    turned_parts = [np.einsum("ba,ncb,nc->na", TOOL, tool, part) for part in parts]
    report = measurement.report(wrench=np.hstack(turned_parts))
    words = "expressed in the flange frame and had to be read with x, y, z taken from its"
    assert only(report.warnings, f"wrench looks as if it were {words}")


@pytest.mark.parametrize("column", ["q1_deg", "fx_N", "dy_mm", "after_dx_mm"])
def test_a_number_beyond_any_robot_is_the_only_error_and_no_model_is_fitted_to_it(
    fanuc, tmp_path, column
):
    measurement = Measurement(fanuc.samples.take(np.arange(20)), fanuc.robot, tmp_path / "my.csv")
    after = dict.fromkeys(("after_dx_mm", "after_dy_mm", "after_dz_mm"), 0.0)
    table = measurement.table().assign(**after)
    table.loc[3, column] = 1e100
    (error,) = measurement.report_of(table).errors
    assert error.rows == (5,) and column in error.message and "1e+100" in error.message


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "grams"), (0.001, "tonnes")])
def test_masses_in_another_unit_are_named_and_no_other_unit_is_blamed(twin, tmp_path, factor, unit):
    robot = dataclasses.replace(twin.robot, masses=factor * twin.robot.masses)
    report = Measurement(twin.samples.take(np.arange(60)), robot, tmp_path / "my.csv").report()
    assert only(report.warnings, unit)
    assert not any("as is usual" in message for message in messages(report.warnings))


SLIPS = {
    "ten times too large": np.full(3, 10.0),
    "of the opposite sign": np.full(3, -1.0),
    "dz_mm ten times too large": np.array([1.0, 1.0, 10.0]),
}


@pytest.mark.parametrize(("slip", "factors"), SLIPS.items())
@pytest.mark.parametrize("rank", [0, 10, -1])
def test_a_slip_of_the_pen_in_a_small_a_usual_or_a_large_deflection_is_named(
    measurement, slip, factors, rank
):
    deflection = measurement.samples.deflection.copy()
    clear = np.abs(deflection[:, 2]) > 0.4 * np.linalg.norm(deflection, axis=1)
    rows = np.flatnonzero(clear)
    row = rows[np.argsort(np.linalg.norm(deflection[rows], axis=1))[rank]]
    deflection[row] *= factors
    (finding,) = outlier_findings(
        np.arange(len(deflection)), find_outliers(read(measurement, deflection))
    )
    assert finding.rows == (row,)
    assert rank == 0 or f"({slip}?)" in finding.message  # small ones are hardly told from zero


@pytest.mark.parametrize("n", [10, 20])
def test_clean_data_have_no_outliers_however_few_they_are(measurement, n):
    deflection = measurement.samples.deflection
    for seed in range(5):
        rows = np.random.default_rng(seed).permutation(len(deflection))[:n]
        assert not find_outliers(read(measurement, deflection).take(rows)).odd.any()


@pytest.mark.slow
def test_copies_of_a_row_of_its_deflection_or_of_the_whole_table_are_found(fanucs):
    table, copy_message = fanucs.table(), "the same three deflections"
    n = len(table)
    repeated_table = pd.concat([table, table.loc[[4]].assign(pose_id="again")])
    report = fanucs.report_of(repeated_table)
    for words in ("the same joint angles and the same wrench", copy_message):
        assert only(report.warnings, words).rows == (n + 2,)
    near_message = only(report.warnings, "2 pose_ids name 1 pose").message
    assert f"{table.pose_id[4]!r} (row 6) and 'again' (row {n + 2})" in near_message
    doubled_table = pd.concat([table, table.assign(load_id="2")])
    rows = tuple(range(n + 2, 2 * n + 2))
    assert only(fanucs.report_of(doubled_table).warnings, copy_message).rows == rows
    deflection = fanucs.samples.deflection.copy()
    deflection[7] = deflection[2]
    assert only(fanucs.report(deflection=deflection).warnings, copy_message).rows == (9,)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fx_N": 5001.0}, "force above 5000 N"),
        (dict.fromkeys(DEFLECTION_COLUMNS, 0.0), "no deflection at all under a load"),
        (dict.fromkeys(WRENCH_COLUMNS, 0.0), "deflection without a load"),
    ],
)
def test_legal_but_odd_rows_are_named(fanucs, changes, words):
    table = fanucs.table()
    table.loc[3, [*changes]] = [*changes.values()]
    samples = samples_of(fanucs.path, table, fanucs.robot, "")
    assert only(range_findings(samples, np.arange(len(table)) + 2), words).rows == (5,)


@pytest.mark.parametrize(
    ("factor", "words"), [(1e-4, "every force is below 1 N"), (0.0, "every wrench is zero")]
)
def test_forces_in_another_unit_and_no_forces_are_noticed(fanucs, factor, words):
    assert only(fanucs.report(wrench=fanucs.samples.wrench * factor).warnings, words)


def test_a_column_that_stops_at_one_value_is_named_with_the_value_and_its_rows(twin):
    wrench = twin.samples.wrench.copy()
    limit = np.sort(wrench[:, 0])[15]
    expected_rows = np.flatnonzero(wrench[:, 0] <= limit)
    wrench[:, 0] = np.maximum(wrench[:, 0], limit)
    samples = dataclasses.replace(twin.samples, wrench=wrench)
    finding = only(range_findings(samples, np.arange(len(wrench))), "reach its limit")
    assert f"fx_N is exactly {limit:.6g} in 16 rows" in finding.message
    assert finding.rows == tuple(expected_rows)


@pytest.mark.parametrize(
    ("column", "values", "axis_moves"),
    [
        ("E1", [0.0, 500.0], True),
        ("A7 [deg]", [10.0, 20.0], True),
        ("rail_mm", [0.0, 1.0], True),
        ("External axis 1", [0.0, 1.0], True),
        ("E1", [500.0, 500.01], False),
        ("tracker", [0.0, 500.0], False),
        ("A1_temperature", [20.0, 35.0], False),
        ("E2", ["left", "right"], False),
    ],
)
def test_a_column_like_an_axis_that_moves_is_a_warning(fanucs, column, values, axis_moves):
    table = fanucs.table().assign(**{column: np.resize(values, len(fanucs.samples))})
    sheet = sheet_of(fanucs.path, table)
    findings = [*external_axis_findings(sheet, [column], fanucs.robot, sheet.lines)]
    assert [finding.level for finding in findings] == ["warning"] * axis_moves
    assert all(f"column {column} looks like an axis" in finding.message for finding in findings)


def test_without_masses_the_size_of_the_deflections_says_a_range_of_units(fanucs):
    robot = dataclasses.replace(fanucs.robot, masses=np.zeros(6))
    measured = dataclasses.replace(fanucs, robot=robot)
    report = measured.report(deflection=fanucs.samples.deflection * 100.0)
    (message,) = messages(report.errors)
    assert "0.001 inch, 1/100 mm or micrometres" in message


def test_repeats_that_differ_are_found(fanucs, rng):
    table = fanucs.table().loc[np.repeat(np.arange(9), 4)].reset_index(drop=True)
    table["load_id"] = [str(i) for i in range(len(table))]
    deflections = ["dx_mm", "dy_mm", "dz_mm"]
    table[deflections] += rng.normal(scale=0.01, size=(len(table), 3))
    table["fx_N"] += rng.normal(scale=0.1, size=len(table))
    assert "repeats: 9 loads" in only(fanucs.report_of(table).facts, "repeats").message
    table.loc[9, "dy_mm"] += 0.4  # of the third group
    finding = only(fanucs.report_of(table).warnings, "repeats of a load differ")
    assert finding.rows == (10, 11, 12, 13)


@pytest.mark.slow
def test_validate_and_the_vjm_name_the_same_joints(kr10, tmp_path, rng):
    q = np.tile(rng.uniform(-1.0, 1.0, 6), (40, 1))
    q[:, :2] = rng.uniform(-1.0, 0.0, (40, 2))  # A1 and A2 move
    wrench = np.tile([0.0, 0.0, -60.0, 0.0, 0.0, 0.0], (40, 1))
    deflection = kr10.joint_deflection(1.0 / KR10_STIFFNESS, q, wrench)
    samples = samples_with(q, wrench, deflection + rng.normal(scale=1e-4, size=(40, 3)))
    report = Measurement(samples, kr10, tmp_path / "my.csv").report()
    names = identify_joints(kr10, samples).unidentifiable
    assert 1 < len(names) < 6
    assert only(report.warnings, f"the stiffness of joints {', '.join(names)} cannot be identified")
    assert all(f"{name} " in only(report.facts, "k of the prior").message for name in names)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0, 5])
def test_a_negative_stiffness_is_called_negative_and_not_unidentifiable(joint, twin, tmp_path):
    stiffness = np.where(np.arange(6) == joint, -KR10_STIFFNESS, KR10_STIFFNESS)
    samples, robot = twin.samples, twin.robot
    deflection = robot.joint_deflection(1.0 / stiffness, samples.q, samples.wrench)
    report = Measurement(samples, robot, tmp_path / "my.csv").report(deflection=deflection)
    (warning,) = report.warnings
    assert warning.message == f"infinite or negative stiffness: {robot.joint_names[joint]}"


def test_every_error_is_listed_and_there_is_no_other_finding(fanucs):
    table = fanucs.table().astype(object)
    table.loc[2, "fx_N"], table.loc[7, "dz_mm"], table.loc[8, "pose_id"] = "abc", 51.0, ""
    report = fanucs.report_of(table)
    assert [(finding.level, finding.rows) for finding in report.errors] == [
        *(("error", (4,)), ("error", (9,)), ("error", (10,)))
    ]
    assert report.warnings == report.facts == ()
    lines = repr(report).splitlines()
    assert lines[0] == f"{fanucs.path}: invalid, 3 errors"
    assert "  - row 4, column fx_N: 'abc', expected a finite number" in lines


def test_an_angle_a_little_beyond_a_limit_is_a_warning_but_not_suspicious(kr10, tmp_path, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(9, 6))
    q[4, 2] = kr10.upper[2] + np.deg2rad(0.1)
    wrench = rng.normal(scale=[50.0] * 3 + [5.0] * 3, size=(9, 6))
    deflection = regressor(kr10, q, wrench) @ (1.0 / KR10_STIFFNESS)
    exact = Measurement(samples_with(q, wrench, deflection), kr10, tmp_path / "my.csv")
    report = exact.report()
    assert report.verdict == "ok"
    (finding,) = report.warnings
    assert finding.level == "note" and "row 6, column q3_deg" in finding.message
    q[4, 2] += np.deg2rad(1.0)
    assert exact.report(q=q).verdict == "invalid"


@pytest.mark.parametrize("empty", [np.nan, 0.0, "-", "?", "NaN", " n/a ", "TODO"])
def test_a_plan_that_is_not_filled_in_is_one_error(fanucs, empty):
    table = fanucs.table().assign(dx_mm=empty, dy_mm=empty, dz_mm=empty)
    report = fanucs.report_of(table)
    (error,) = report.errors
    assert all(part in error.message for part in ("not filled in", "9 of 9 rows", "rows 2-10"))
    assert "dx_mm, dy_mm, dz_mm" in error.message
    assert report.warnings == report.facts == ()
    with pytest.raises(DataError, match=r"my\.csv: plan not filled in yet[^\n]*"):
        read_samples(fanucs.path, fanucs.robot)


def test_a_file_with_one_filled_axis_is_of_readings_along_it(fanucs):
    table = fanucs.table().assign(dy_mm=np.nan, dz_mm=np.nan)
    report = fanucs.report_of(table)
    assert not report.errors
    assert "9 numbers in 9 rows: along x 9, y 0, z 0" in only(report.facts, "read as").message


def test_a_plan_without_names_and_wrenches_is_one_error(fanucs):
    columns = ["fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm", "dx_mm", "dy_mm", "dz_mm"]
    table = fanucs.table().drop(columns=["pose_id", "load_id", "group"])
    (error,) = fanucs.report_of(table.assign(**dict.fromkeys(columns, ""))).errors
    assert "9 of 9 rows" in error.message


def test_a_cell_that_is_missing_in_a_complete_file_is_an_error_of_its_row(fanucs):
    table = fanucs.table().astype(object)
    table.loc[3, "dz_mm"] = ""
    (error,) = fanucs.report_of(table).errors
    assert error.rows == (5,) and "dz_mm" in error.message


def test_of_a_plan_that_is_filled_in_by_half_the_other_half_is_checked(fanucs):
    table = fanucs.table().astype({"dx_mm": object})
    table.loc[[3, 6, 7, 8], ["dx_mm", "dy_mm", "dz_mm"]] = np.nan
    report = fanucs.report_of(table)
    finding = only(report.warnings, "plan not filled in")
    assert "4 of 9 rows have no dx_mm, dy_mm, dz_mm (rows 5, 8-10)" in finding.message
    assert "5, 5 poses" in only(report.facts, "samples: ").message
    with pytest.raises(DataError, match="4 of 9 rows have no dx_mm"):
        read_samples(fanucs.path, fanucs.robot, FileOptions(no_torque=True))
    table.loc[2, "fx_N"] = 5e6
    report = fanucs.report_of(table)
    assert [error.rows for error in report.errors] == [(4,)]
    assert [finding.message] == messages(report.warnings)


def test_a_file_that_cannot_be_read_is_an_error_of_the_report(fanucs):
    report = validate(fanucs.path, fanucs.robot)
    assert messages(report.errors) == ["cannot be read: No such file or directory"]
    assert repr(report).splitlines()[0] == f"{fanucs.path}: invalid, 1 error"


def test_a_better_model_lists_the_rows_that_it_predicts_worst_when_left_out(fanucs, monkeypatch):
    monkeypatch.setattr("stiff_datasets.measured.validation_report.MIN_CURVE_POSES", 9)
    errors = np.full((9, 3), 1e-4)
    errors[6] *= 10.0
    fanucs.report()
    facts = validate(
        fanucs.path, fanucs.robot, identify_parts=lambda *_: (errors, {"force point": "here"})
    ).facts
    assert "explained" in only(facts, "springs with curves").message
    assert only(facts, "their largest residuals").message.startswith(
        f"their largest residuals: row 8 {1e3 * np.linalg.norm(errors[6]):.3g}"
    )
    assert only(facts, "force point").message == "force point: here"
    errors[3] = np.nan
    facts = validate(
        fanucs.path, fanucs.robot, identify_parts=lambda *_: (errors, {"force point": "here"})
    ).facts
    assert not any("curves" in fact.message for fact in facts)
