"""Measurement plans: reachable, better than chance, and in the schema of measured data."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from helpers.made_robots import planar_arm, track_lines, tree_urdf
from helpers.made_samples import samples_with
from stiff_datasets.measured.identifiability import regressor
from stiff_datasets.measured.query_file import Loads
from stiff_datasets.measured.sample_columns import DEFLECTION_COLUMNS
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.planning.design import ProcessDesign, SpringDesign
from stiff_datasets.planning.plan import (
    MIN_POSE_DISTANCE,
    MeasurementPlan,
    candidate_plan,
    check_plan_file,
    chosen_plan,
    plan_table,
    unmeasured,
    write_plan,
)
from stiff_datasets.planning.plan_gain import plan_gain, variance_gain
from stiff_datasets.planning.poses import paper_poses
from stiff_datasets.planning.reachable import (
    CLEARANCE,
    LIMIT_MARGINS,
    LOWEST_HEIGHT,
    arm_distances,
    keeps_clear,
)
from stiff_datasets.robots.shipped_robots import named_robot
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError

ROBOTS = {"kr10-r1100-2": (10.0, 0.2), "fanuc-r2000ic": (165.0, 0.5)}  # payload kg, clearance m
CRITERIA = ("d-optimal", "i-optimal")


def plan_of(robot, n_poses, *, criterion="d-optimal", **options):
    """Choose a plan from new candidates."""
    pool = candidate_plan(robot, **options)
    design = SpringDesign(regressor(robot, pool.q, pool.wrench), criterion)
    return chosen_plan(pool, n_poses, design)[0]


@pytest.fixture(scope="module", params=ROBOTS)
def case(request):
    """Return a robot and the options of its plans."""
    payload, clearance = ROBOTS[request.param]
    options = {"candidates": 300, "seed": 4, "payload_kg": payload, "clearance": clearance}
    return named_robot(request.param).robot(), options


def between(start, end, n=150):
    return start + np.linspace(0.0, 1.0, n)[:, None] * (end - start)


def sampled_clearances(robot, q):
    """Return the smallest distance to the base column and height of sampled points.

    The points lie on the arm from joint 3 on.
    """
    (points,) = robot.forward(q[None]).points
    arm = np.concatenate([between(*ends) for ends in itertools.pairwise(points[2:])])
    column = between(np.zeros(3), points[1])
    return np.linalg.norm(arm[:, None] - column, axis=2).min(), arm[:, 2].min()


def test_a_chosen_plan_keeps_limits_clearances_and_payload(case):
    robot, options = case
    plan = plan_of(robot, 40, **options)
    assert plan.q.shape == (40, 6)
    angles = plan_table(plan, robot).filter(regex="^q").to_numpy()
    assert (angles >= np.rad2deg(robot.lower) + 2.0).all()
    assert (angles <= np.rad2deg(robot.upper) - 2.0).all()
    base, height = np.transpose([sampled_clearances(robot, q) for q in plan.q])
    assert base.min() >= options["clearance"] and height.min() >= LOWEST_HEIGHT
    force = np.linalg.norm(plan.wrench[:, :3], axis=1)
    np.testing.assert_allclose(force, 0.8 * options["payload_kg"] * 9.81)
    assert not plan.wrench[:, 3:].any()


def test_clearances_are_those_of_points_sampled_on_the_arm(case, rng):
    robot, _ = case
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), size=(60, 6))
    points = robot.forward(q).points
    sampled_distances = np.array([sampled_clearances(robot, row) for row in q])
    reach = 3.0  # m, longer than either robot; sampling is coarser than this over 150
    base, height = arm_distances(points)
    np.testing.assert_allclose(base, sampled_distances[:, 0], atol=reach / 150)
    assert (base <= sampled_distances[:, 0] + 1e-12).all()
    np.testing.assert_allclose(height, sampled_distances[:, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("elbow", "tcp", "expected"),
    [
        ((1.0, -1.0, 0.5), (1.0, 1.0, 0.5), 1.0),  # skew, nearest inside both
        ((-1.0, 0.0, 0.5), (1.0, 0.0, 0.5), 0.0),  # through the column
        ((0.3, 0.0, 0.2), (0.3, 0.0, 0.8), 0.3),  # parallel
        ((0.3, 0.0, 1.4), (0.3, 0.0, 3.0), 0.5),  # parallel, above the column's top
        ((0.0, 0.0, 1.5), (0.0, 0.0, 3.0), 0.5),  # in line with it
        ((3.0, 4.0, 0.5), (3.0, 4.0, 0.5), 5.0),  # of no length
    ],
)
def test_the_distance_to_a_column_of_one_metre_has_its_closed_form(elbow, tcp, expected):
    points = np.array([[(0.0, 0.0, 0.3), (0.0, 0.0, 1.0), elbow, tcp]])
    assert arm_distances(points)[0][0] == pytest.approx(expected, abs=1e-12)


def test_a_plan_is_better_than_every_random_one_by_the_criterion_it_was_chosen_by(case):
    robot, options = case
    pool = candidate_plan(robot, **options)
    d_optimal, i_optimal = (
        plan_gain(
            regressor(robot, plan.q, plan.wrench),
            regressor(robot, pool.q, pool.wrench),
            robot.joint_names,
        )
        for plan in (plan_of(robot, 30, criterion=criterion, **options) for criterion in CRITERIA)
    )
    assert d_optimal.efficiency > d_optimal.efficiency_over_best > 1.2
    assert d_optimal.plan.worst_error < d_optimal.random_best.worst_error
    assert i_optimal.plan.worst_error < i_optimal.random_best.worst_error


def test_joints_of_more_than_a_turn_are_drawn_within_half_a_turn_of_their_middle():
    robot = replace(
        planar_arm(4, (0.0, 1.0, 0.0)),
        joint_types=("revolute", "revolute", "revolute", "prismatic"),
        lower=np.array([-1.0, -np.inf, -1.0, -1.0]),
        upper=np.array([5.5, np.inf, 5.5, 5.5]),
    )
    plan = candidate_plan(robot, 200, seed=0, payload_kg=5.0)
    q, middle = plan.q, (5.5 - 1.0) / 2
    assert (np.abs(q[:, 0] - middle) <= np.pi).all()
    assert np.abs(q[:, 1]).max() <= np.pi and np.ptp(q[:, :3], axis=0).min() > 5.0
    assert q[:, 3].max() > middle + np.pi  # a slide's metres are not an angle
    assert q[:, 3].min() >= -1.0 + LIMIT_MARGINS[1] and q[:, 3].max() <= 5.5 - LIMIT_MARGINS[1]
    table = plan_table(plan, robot)
    assert table["q2_deg"].abs().max() <= 180.0
    np.testing.assert_allclose(table["q4_mm"], q[:, 3] * 1000, atol=1e-4)


def test_a_joint_of_a_small_range_keeps_a_tenth_of_it_from_its_limits():
    limits = np.radians([90.0, 90.0, 5.0, 90.0])
    robot = replace(planar_arm(4, (0.0, 1.0, 0.0)), lower=-limits, upper=limits)
    q = candidate_plan(robot, 200, seed=0, payload_kg=5.0).q
    assert np.abs(np.rad2deg(q)).max(axis=0) == pytest.approx([88.0, 88.0, 4.0, 88.0], abs=2.0)
    assert (np.abs(np.rad2deg(q)).max(axis=0) <= [88.0, 88.0, 4.0, 88.0]).all()


def test_every_row_of_a_filled_in_plan_is_a_valid_sample(tmp_path, kr10):
    plan = plan_of(kr10, 50, criterion="i-optimal", candidates=120, payload_kg=10.0, seed=0)
    path = tmp_path / "plan.csv"
    write_plan(path, plan, kr10)
    with pytest.raises(DataError, match=r"not filled in.*dx_mm"):
        read_samples(path, kr10)
    filled_plan = pd.read_csv(path, dtype={"load_id": str}).fillna(0.25)
    filled_plan.to_csv(path, index=False)
    samples = read_samples(path, kr10)
    np.testing.assert_allclose(samples.q, plan.q, atol=np.deg2rad(1e-4))
    np.testing.assert_allclose(samples.wrench, plan.wrench, atol=1e-3)
    for name in ("pose_id", "group"):
        assert getattr(samples, name).tolist() == getattr(plan, name).tolist()
    assert set(samples.load_id) == {"1"}
    np.testing.assert_allclose(samples.deflection, 0.25e-3)


def test_the_papers_poses_keep_the_default_clearances(kr10):
    base, height = arm_distances(kr10.forward(paper_poses(kr10).q).points)
    assert base.min() == pytest.approx(0.2234, abs=1e-4)
    assert height.min() == pytest.approx(0.2, abs=1e-4)


def test_angles_are_not_rounded_out_of_the_limits(kr10):
    """The upper limit of A2, 0.785398163397448 rad, is slightly less than 45 deg."""
    q = np.stack([kr10.lower, kr10.upper])
    ids = np.array(["1", "2"])
    table = plan_table(MeasurementPlan(q, np.zeros((2, 6)), ids, ids), kr10)
    angles = table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy()
    assert (angles[0] >= np.rad2deg(kr10.lower)).all()
    assert (angles[1] <= np.rad2deg(kr10.upper)).all()
    np.testing.assert_allclose(np.deg2rad(angles), q, atol=np.deg2rad(1.1e-4))
    np.testing.assert_array_equal(angles, angles.round(4))
    assert table[list(DEFLECTION_COLUMNS)].isna().all(axis=None)


def test_a_file_that_exists_is_not_overwritten_and_others_are_refused_before_the_work(tmp_path):
    path = tmp_path / "plan.csv"
    check_plan_file(path)
    path.write_text("measured for a week")
    with pytest.raises(StoreError, match=r"plan\.csv: exists and is not overwritten"):
        check_plan_file(path)
    with pytest.raises(StoreError, match=r"cannot be written: the folder .* does not exist"):
        check_plan_file(tmp_path / "absent" / "plan.csv")
    with pytest.raises(ConfigError, match=r"unsupported extension .*use \.csv"):
        check_plan_file(tmp_path / "plan.parquet")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_poses": 101}, r"poses is 101, expected 2 \(for 6 joints\) to 100"),
        ({"payload_kg": 0.0}, "payload_kg is 0, expected a number above 0"),
        ({"payload_kg": np.nan}, "payload_kg is nan"),
        ({"clearance": -0.1}, "clearance is -0.1, expected m, 0 or more"),
        ({"clearance": np.inf}, "clearance is inf"),
        ({"clearance": 5.0}, "0 of 5000 random poses of kr10_r1100_2 keep a clearance of 5 m"),
        ({"clearance": 0.9}, r"\d+ of 5000 .* expected 100 candidates: give a smaller"),
    ],
)
def test_what_cannot_be_planned_is_refused(kr10, changes, message):
    arguments = {"n_poses": 10, "candidates": 100, "seed": 0, "payload_kg": 10.0} | changes
    with pytest.raises(ConfigError, match=message):
        plan_of(kr10, **arguments)


def test_an_arm_on_a_track_keeps_clear_of_its_own_cart_all_along_it(tmp_path):
    robot = read_robot(tree_urdf(tmp_path / "track.urdf", track_lines()))
    plan = candidate_plan(robot, 100, seed=0, payload_kg=5.0)
    assert plan.q[:, 0].min() < 0.2 and plan.q[:, 0].max() > 3.8
    columns = plan_table(plan, robot).columns
    assert "q1_mm" in columns and "q7_deg" in columns
    for cart in (0.0, 4.0):
        q = np.column_stack([np.full(100, cart), plan.q[:, 1:]])
        assert keeps_clear(robot, q, CLEARANCE).all()
    low = np.array([[2.0, 0.0, np.pi, 0.0, 0.0, 0.0, 0.0]])  # folded back through the cart
    assert not keeps_clear(robot, low, CLEARANCE).any()


# ---- after a measurement ---------------------------------------------------------------------


def measured_at(plan, **names):
    """Return the plan's poses and loads with a deflection, which no design uses."""
    return samples_with(plan.q, plan.wrench, np.full((len(plan.q), 3), 1e-4), **names)


@pytest.fixture(scope="module")
def measured_case(case):
    """Return a robot's candidates, its workspace, and 15 measured poses."""
    robot, options = case
    drawn_plan = candidate_plan(robot, **(options | {"candidates": 500}))
    measured_samples = measured_at(
        candidate_plan(robot, **(options | {"candidates": 15, "seed": 77}))
    )
    return robot, drawn_plan.take(slice(150, None)), drawn_plan.take(slice(150)), measured_samples


def spring_design(measured_case, criterion):
    robot, pool, workspace, measured = measured_case
    regressors = [regressor(robot, loads.q, loads.wrench) for loads in (pool, workspace, measured)]
    return SpringDesign(regressors[0], criterion, *regressors[1:])


def test_the_variance_of_a_prediction_is_that_of_simulated_measurements(measured_case, rng):
    """Compare with the spread of least-squares predictions over many draws of the noise."""
    design = spring_design(measured_case, "i-optimal")
    rows = design.choose(5)
    sample_rows = np.concatenate([design.measured, design.candidates[rows]]).reshape(-1, 6)
    noise = rng.normal(scale=np.sqrt(design.noise), size=(len(sample_rows), 4000))
    errors = design.workspace.reshape(-1, 6) @ np.linalg.lstsq(sample_rows, noise, rcond=None)[0]
    assert design.variance(rows) == pytest.approx(errors.var(), rel=0.05)
    assert design.variance(rows) < design.variance(rows[:2]) < design.variance(rows[:0])


def test_a_measured_pose_is_not_proposed_again_and_new_ones_are_numbered_on(kr10):
    pool = candidate_plan(kr10, 60, seed=0, payload_kg=10.0)
    first = SpringDesign(regressor(kr10, pool.q, pool.wrench), "d-optimal")
    plan, rows = chosen_plan(pool, 9, first)
    reached_angles = plan.q + np.deg2rad(0.3)  # a controller's log
    reached_angles[0, 5] += 2.0 * np.pi
    measured = measured_at(replace(plan, q=reached_angles))
    remaining_pool = unmeasured(pool, measured, kr10)
    assert sorted(remaining_pool.pose_id) == sorted(np.delete(pool.pose_id, rows))
    next_design = SpringDesign(
        regressor(kr10, remaining_pool.q, remaining_pool.wrench), "d-optimal"
    )
    next_plan, _ = chosen_plan(
        remaining_pool, 51, next_design, measured=measured_at(plan, pose_id=plan.pose_id)
    )
    assert next_plan.pose_id[[0, -1]].tolist() == ["P10", "P60"]
    assert np.abs(next_plan.q[:, None] - plan.q).max(axis=2).min() > MIN_POSE_DISTANCE


class Wave:
    """Model a process of q1 with a kernel of length 0.5 rad and three samples."""

    at = np.array([-1.0, -0.9, 2.0])
    noise = 0.01

    def covariance(self, q, wrench, other_q, other_wrench):
        def kernel(a, b):
            return np.exp(-0.5 * ((a[:, None] - b) / 0.5) ** 2)

        first, second = q[:, 0], other_q[:, 0]
        sample_covariance = kernel(self.at, self.at) + self.noise * np.eye(3)
        explained_covariance = kernel(first, self.at) @ np.linalg.solve(
            sample_covariance, kernel(self.at, second)
        )
        return np.stack(
            [scale * (kernel(first, second) - explained_covariance) for scale in (1.0, 4.0, 0.0)]
        )

    def noise_variance(self):
        return self.noise * np.array([1.0, 4.0, 1.0])


def lines(q1):
    return Loads(np.outer(q1, np.eye(6)[0]), np.ones((len(q1), 6)))


def test_each_choice_for_a_process_is_the_best_step_by_brute_force(rng):
    design = ProcessDesign(Wave(), lines(rng.uniform(-3, 3, 40)), lines(np.linspace(-2, 3, 30)))
    chosen_rows = design.choose(6).tolist()
    for k in range(6):
        free_rows = [i for i in range(40) if i not in chosen_rows[:k]]
        variances = [design.variance(np.array([*chosen_rows[:k], i])) for i in free_rows]
        assert chosen_rows[k] == free_rows[int(np.argmin(variances))]
    assert design.noise == pytest.approx(0.02)
    gain = variance_gain(design, np.array(chosen_rows), 40)
    assert gain.plan < gain.random_best < gain.random_mean < gain.before
    assert gain.ratio == pytest.approx(
        (gain.before - gain.plan) / (gain.before - gain.random_mean), rel=1e-12
    )
