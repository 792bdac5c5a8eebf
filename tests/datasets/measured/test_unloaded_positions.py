"""Check what `validate` names, and --register undoes, where geometry contradicts itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import stiffbench as sb
from helpers.command_line import bench_here
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    LOADED_COLUMNS,
    UNLOADED_COLUMNS,
    WRENCH_COLUMNS,
    joint_columns,
)
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.validation_report import validate
from stiff_protocols.contract.controller import Controller
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchWarning
from stiff_protocols.kinematics.serial_chain import unit_deflections

STIFFNESS = np.array([5.1e4, 6.3e4, 5.0e4, 4.5e3, 8.9e3, 3.1e3])  # N m/rad
CENTRE = np.deg2rad([0.0, -70.0, 70.0, 0.0, 0.0, 0.0])
WIDTH = np.deg2rad([100.0, 25.0, 30.0, 120.0, 80.0, 150.0])
TURN = Rotation.from_rotvec(np.deg2rad(67.0) * np.array([0.3, -0.5, 1.0]) / np.sqrt(1.34))
SHIFT = np.array([2310.0, -1700.0, 440.0])  # mm
CASES = Path(__file__).parents[4] / "shared" / "cases" / "data"


@dataclass(frozen=True)
class Measurement:
    """60 loads that springs of the joints explain, with noise of 0.02 mm."""

    robot: sb.Robot
    q: np.ndarray
    wrench: np.ndarray
    tcp_mm: np.ndarray
    deflection_mm: np.ndarray
    path: Path

    def table(self, q=None):
        table = pd.DataFrame(np.rad2deg(self.q if q is None else q))
        table.columns = joint_columns(self.robot)
        return table.assign(**dict(zip(WRENCH_COLUMNS, self.wrench.T, strict=True)))

    def with_deflections(self, q=None, turn=None):
        moved = self.deflection_mm if turn is None else turn.apply(self.deflection_mm)
        return self.table(q).assign(**dict(zip(DEFLECTION_COLUMNS, moved.T, strict=True)))

    def with_positions(self, q=None, unloaded=None, turn=None, shift=0.0):
        unloaded = self.tcp_mm if unloaded is None else unloaded
        table = self.table(q)
        for columns, points in (
            (UNLOADED_COLUMNS, unloaded),
            (LOADED_COLUMNS, unloaded + self.deflection_mm),
        ):
            points = (points if turn is None else turn.apply(points)) + shift
            table = table.assign(**dict(zip(columns, points.T, strict=True)))
        return table

    def report(self, table, robot=None, **options):
        table.to_csv(self.path, index=False)
        return validate(self.path, robot or self.robot, FileOptions(**options))


@pytest.fixture()
def measurement(kr10, tmp_path):
    rng = np.random.default_rng(2)
    q = CENTRE + WIDTH * rng.uniform(-1.0, 1.0, (60, 6))
    wrench = np.hstack([rng.normal(0.0, 50.0, (60, 3)), rng.normal(0.0, 4.0, (60, 3))])
    deflection = unit_deflections(kr10.jacobian(q), wrench) @ (1.0 / STIFFNESS)
    deflection_mm = 1000.0 * deflection + rng.normal(0.0, 0.02, (60, 3))
    tcp_mm = 1000.0 * kr10.forward(q).points[:, -1]
    robot = replace(kr10, controller=None, lower=np.full(6, -6.0), upper=np.full(6, 6.0))
    return Measurement(robot, q, wrench, tcp_mm, deflection_mm, tmp_path / "my.csv")


def text_of(report):
    return "\n".join(finding.message for finding in (*report.errors, *report.warnings))


def fact_of(report, name):
    (message,) = [fact.message for fact in report.facts if fact.message.startswith(name)]
    return message


def coupled(q, sign):
    return q + np.where(np.arange(6) == 2, sign * q[:, [1]], 0.0)


def with_zero(q, joint, degrees):
    return q + np.deg2rad(degrees) * (np.arange(6) == joint)


@pytest.mark.parametrize(("sign", "word"), [(1.0, "J3 + J2"), (-1.0, "J3 - J2")])
def test_a_joint_3_that_is_measured_from_the_ground_is_named(measurement, sign, word):
    text = text_of(measurement.report(measurement.with_deflections(coupled(measurement.q, sign))))
    assert "joint A3 looks as if it were measured from the ground" in text
    assert word in text


@pytest.mark.slow
def test_a_wrist_joint_that_moves_with_another_is_named(measurement):
    q = measurement.q - np.where(np.arange(6) == 5, measurement.q[:, [4]], 0.0)
    text = text_of(measurement.report(measurement.with_deflections(q)))
    assert "joint A6 looks as if it were coupled to joint A5 (J6 - J5; add q5_deg" in text


@pytest.mark.slow
def test_angles_that_the_urdf_maps_from_its_controller_are_named(measurement):
    controller = Controller(np.ones(6), np.zeros(6), np.eye(4), np.eye(4), j3_from_ground=True)
    robot = replace(measurement.robot, controller=controller)
    table = measurement.with_deflections(coupled(measurement.q, -1.0))
    text = text_of(measurement.report(table, robot))
    assert "the controller's, with joint 3 measured from the ground" in text


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "degrees"), [(1, -10.0), (4, 15.0), (2, 50.0), (3, 4.0)])
def test_a_zero_that_is_off_is_named_with_its_angle(measurement, joint, degrees):
    q = with_zero(measurement.q, joint, degrees)
    text = text_of(measurement.report(measurement.with_deflections(q)))
    start = f"joint A{joint + 1} looks as if its zero were "
    angle = float(text.partition(start)[2].split()[0])
    assert angle == pytest.approx(-degrees, abs=0.6)


def test_right_positions_are_ok_and_less_than_a_nanometre_away(measurement):
    report = measurement.report(measurement.with_positions())
    assert report.verdict == "ok"
    assert "0 mm (median)" in fact_of(report, "unloaded positions")


@pytest.mark.slow
@pytest.mark.parametrize("also_deflections", [False, True])
def test_positions_that_contradict_the_angles_name_the_distance_and_the_joint(
    measurement, also_deflections
):
    table = measurement.with_positions(coupled(measurement.q, 0.5))
    if also_deflections:
        table = table.drop(columns=[*LOADED_COLUMNS])
        table[[*DEFLECTION_COLUMNS]] = measurement.deflection_mm
    tcp = 1000.0 * measurement.robot.forward(coupled(measurement.q, 0.5)).points[:, -1]
    distance = np.linalg.norm(tcp - measurement.tcp_mm, axis=1)
    words = f"up to {distance.max():.0f} mm (median {np.median(distance):.0f} mm)"
    assert words in text_of(measurement.report(table))
    ground = text_of(measurement.report(measurement.with_positions(coupled(measurement.q, 1.0))))
    assert "A3 looks as if it were measured from the ground" in ground


@pytest.mark.slow
def test_a_zero_is_told_from_positions_alone(measurement):
    q = with_zero(measurement.q, 3, -2.5)
    text = text_of(measurement.report(measurement.with_positions(q, turn=TURN, shift=SHIFT)))
    assert "joint A4 looks as if its zero were +2.5 deg off" in text
    assert "another frame" in text


def test_another_tcp_is_told_from_positions(measurement):
    shift = np.array([0.012, 0.0, -0.02])
    tcp = measurement.robot.tcp + measurement.robot.flange[:3, :3] @ shift
    moved_robot = replace(measurement.robot, tcp=tcp)
    text = text_of(measurement.report(measurement.with_positions(), moved_robot))
    assert "the TCP looks as if it lay (-12, 0, 20) mm from the given one" in text.replace(
        "-0", "0"
    )


def test_a_tracker_frame_is_named_and_undone_only_in_the_report(measurement):
    table = measurement.with_positions(turn=TURN, shift=SHIFT)
    report = measurement.report(table)
    (warning,) = report.warnings
    for part in ("another frame (turned 67 deg about (0.26, -0.43, 0.86)", "(2.31, -1.7, 0.44) m"):
        assert part in warning.message
    assert "99." in fact_of(report, "joint springs")
    with pytest.warns(StiffBenchWarning):
        given = read_samples(measurement.path, measurement.robot).deflection
    assert given * 1000.0 == pytest.approx(TURN.apply(measurement.deflection_mm), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("also_deflections", [False, True])
def test_register_turns_deflections_to_the_base_frame(measurement, also_deflections):
    table = measurement.with_positions(turn=TURN, shift=SHIFT)
    if also_deflections:
        table = table.drop(columns=[*LOADED_COLUMNS])
        table[[*DEFLECTION_COLUMNS]] = TURN.apply(measurement.deflection_mm)
    assert measurement.report(table, register=True).verdict == "ok"
    data = sb.read_samples(measurement.path, robot=measurement.robot, register=True).data
    moved_mm = 1000.0 * data.samples.deflection
    assert moved_mm == pytest.approx(measurement.deflection_mm, abs=1e-6)


@pytest.mark.slow
def test_deflections_with_the_bases_axes_are_not_turned_for_the_positions_frame(measurement):
    table = measurement.with_positions(turn=TURN, shift=SHIFT).drop(columns=[*LOADED_COLUMNS])
    table[[*DEFLECTION_COLUMNS]] = measurement.deflection_mm
    report = measurement.report(table)
    assert "the base's axes already" in text_of(report)
    assert "99." in fact_of(report, "joint springs")


@pytest.mark.slow
def test_register_refuses_what_does_not_tell_a_frame(measurement):
    in_line = measurement.with_positions().iloc[[0] * 6]
    tables = {
        "has no positions": measurement.with_deflections(),
        "positions differ": in_line,
        "(median) from": measurement.with_positions(unloaded=measurement.tcp_mm[::-1]),
    }
    for words, table in tables.items():
        assert measurement.report(table, register=True).verdict == "invalid"
        with pytest.raises(DataError, match="--register") as error:
            read_samples(measurement.path, measurement.robot, FileOptions(register=True))
        assert words in str(error.value)


@pytest.mark.slow
def test_a_shift_an_uncalibrated_robot_and_a_missing_position_are_ok(measurement):
    noise = np.random.default_rng(0).normal(0.0, 1.8, (60, 3))
    tables = {
        "a frame shifted by (0, 0, 0.33) m": measurement.with_positions(shift=(0.0, 0.0, 330.0)),
        "2.": measurement.with_positions(unloaded=measurement.tcp_mm + noise),
        "0 mm": measurement.with_positions().drop(columns=[*LOADED_COLUMNS]),
    }
    tables["0 mm"][[*DEFLECTION_COLUMNS]] = measurement.deflection_mm
    tables["0 mm"].loc[4, "x0_mm"] = np.nan
    for words, table in tables.items():
        report = measurement.report(table)
        assert report.verdict == "ok"
        assert words in fact_of(report, "unloaded positions")


def test_one_position_that_is_far_off_is_named_with_its_row(measurement):
    unloaded = measurement.tcp_mm.copy()
    unloaded[7] += (0.0, 40.0, 0.0)
    table = measurement.with_positions(unloaded=unloaded, turn=TURN, shift=SHIFT)
    *_, far = measurement.report(table).warnings
    assert far.rows == (9,)
    assert "by 40 mm" in far.message


@pytest.mark.slow
def test_positions_of_a_left_handed_frame_are_named(measurement):
    table = measurement.with_positions()
    table[["y0_mm", "y1_mm"]] *= -1.0
    assert "the sign of y flipped" in measurement.report(table).warnings[0].message


def test_a_command_registers_a_file_and_requires_one(measurement):
    table = measurement.with_positions(turn=TURN, shift=SHIFT).iloc[:9]  # too few for springs
    table.to_csv(measurement.path, index=False)
    robot = ("--robot", "kr10-r1100-2", "--tcp", "0.06,0,0.08")
    for option, words in (((), "another frame"), (("--register",), "positions registered")):
        command = ("data", "validate", str(measurement.path), *robot, *option)
        assert words in bench_here(*command, cwd=measurement.path.parent).stdout
    with pytest.raises(ConfigError, match="register"):
        sb.plan_poses(measurement.path.with_name("plan.csv"), register=True)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not part of the repository")
@pytest.mark.parametrize(
    ("file", "urdf", "words"),
    [
        ("02_*/teach_pendant.csv", "arm.urdf", "measured from the ground (J3 + J2"),
        ("02_*/*_axes.csv", "arm_*.urdf", "joint 3 measured from the ground: convert"),
        ("04_*/positions.csv", "arm.urdf", "up to 733 mm (median 255 mm)"),
        ("05_*/tracker_frame.csv", "arm.urdf", "turned 67 deg about (0.26, -0.43, 0.86)"),
        ("23_*/joint2_minus10.csv", "arm.urdf", "joint_2 looks as if its zero were +10.0 deg"),
        ("23_*/joint5_plus15.csv", "arm.urdf", "joint_5 looks as if its zero were -15.1 deg"),
    ],
)
def test_the_mistake_in_each_case_is_named(file, urdf, words):
    (path,) = CASES.glob(file)
    (robot,) = path.parent.glob(urdf)
    report = validate(path, sb.read_robot(robot, tcp=(0.06, 0.0, 0.08)))
    assert report.verdict == "suspicious"
    assert words in report.warnings[0].message
