"""Check the ten robots' constants: plausible sizes, drawn by the rule in their files."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.planning.loads import hook_wrenches, stream
from stiff_datasets.twin.effects import WORLDS
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_datasets.twin.robot_twin import ARMS, HEAVIEST, ArmFamily, Ur5Twin
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import shipped_constants
from stiff_protocols.contract.robot import STANDARD_GRAVITY

NUMBERS = range(len(ARMS))
CLASSES = [  # lighter than kg: structure over K2, tilting ratio, wall over diameter
    (10.0, 4.0, 3.0, 0.06),
    (50.0, 4.0, 4.0, 0.06),
    (np.inf, 4.0, 5.0, 0.045),
]
MIDDLE_SLOPE = 0.9  # of an RV gear's rigidity
TUBES = [0.22, 0.2, 0.14, 0.12, 0.1, 0.08, 0.06]  # diameter over reach
DIGITS = 6e-3  # three are kept


@pytest.fixture(scope="module")
def constants():
    return [shipped_constants(name) for name in ARMS]


@pytest.fixture(scope="module")
def data():
    return [ArmFamily(robot=number).load() for number in NUMBERS]


def wrist_reach(robot):
    """Return the stretched wrist's (joint 5) distance from joint 1's vertical axis, m."""
    origins = robot.forward(np.zeros((1, robot.n_joints))).points[0]
    across = robot.axes[1]  # joints 2, 3 and 5 turn about one direction at zero joint angles
    shoulder, elbow, wrist = (point - across * (across @ point) for point in origins[[1, 2, 4]])
    offset = np.linalg.norm((shoulder - origins[0])[:2])
    return float(offset + np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow))


@pytest.fixture(scope="module")
def deflections(data, constants):
    """Return the deflections by the payload on each arm's hook, (151,) mm.

    The links bend; the gears have no friction.
    """
    sizes_mm = []
    for benchmark_data, twin in zip(data, constants, strict=True):
        robot, q = twin.robot(), benchmark_data.samples.q
        weight = np.tile([0.0, 0.0, -twin.payload_kg * STANDARD_GRAVITY], (len(q), 1))
        wrench = hook_wrenches(weight, robot.forward(q).rotation @ np.array(twin.hook_m))
        truth = DigitalTwin.in_world(twin, 0, "structure").truth(q, wrench)
        sizes_mm.append(np.linalg.norm(truth, axis=1) * 1000)
    return sizes_mm


@pytest.mark.slow
def test_the_card_has_what_each_arm_is_like(constants, deflections):
    card = (files("stiff_datasets") / "data" / "arm_family.md").read_text(encoding="utf-8")
    rows = [[word.strip() for word in line.split("|")[1:-1]] for line in card.splitlines()]
    card_rows = [(row[0], *row[3:6], *row[7:]) for row in rows if row and row[0].isdecimal()]
    assert card_rows == [
        (
            *(str(number), f"{twin.payload_kg:g}", f"{wrist_reach(twin.robot()):.2f}"),
            *(
                f"{twin.robot().masses.sum():.3g}",
                f"{np.median(sizes_mm):.2f}",
                f"{sizes_mm.max():.1f}",
            ),
        )
        for number, (twin, sizes_mm) in enumerate(zip(constants, deflections, strict=True))
    ]


@pytest.mark.slow
def test_ten_robots_have_151_poses_inside_the_limits_and_loads_to_80_percent(data, constants):
    assert (
        len({benchmark_data.robot.name for benchmark_data in data})
        == len({benchmark_data.sha256 for benchmark_data in data})
        == 10
    )
    for number, (benchmark_data, twin) in enumerate(zip(data, constants, strict=True)):
        samples, robot = benchmark_data.samples, benchmark_data.robot
        assert len(set(samples.pose_id)) == len(samples) == 151
        assert (samples.q > robot.lower - 1e-5).all() and (samples.q < robot.upper + 1e-5).all()
        # the force sensor is wrong in the world `all`
        force = ArmFamily(robot=number, world="clean").load().samples.wrench[:, :3]
        share = np.linalg.norm(force, axis=1) / (twin.payload_kg * STANDARD_GRAVITY)
        assert 0.19 < share.min() < 0.25 and 0.75 < share.max() < 0.81
        direction = force / np.linalg.norm(force, axis=1, keepdims=True)
        assert np.abs(direction.mean(axis=0)).max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("number", NUMBERS)
def test_a_gears_rated_torque_is_near_the_joints_static_torque(number, data, constants):
    twin, q = constants[number], data[number].samples.q
    chain, robot = twin.chain(), twin.robot()
    model, frames = chain.model, chain.model.createData()
    poses = robot.forward(q)
    hook = poses.points[:, -1] + poses.rotation @ np.array(twin.hook_m)
    axes = np.einsum("njab,jb->nja", poses.rotations, robot.axes)
    lever = np.linalg.norm(np.cross(axes, hook[:, None] - poses.points[:, :-1]), axis=2)
    weight = [np.abs(pin.computeGeneralizedGravity(model, frames, angles)) for angles in q]
    largest = (np.array(weight) + twin.payload_kg * STANDARD_GRAVITY * lever).max(axis=0)
    ratio = twin.rated_torques / largest
    assert (ratio > 0.5).all() and (ratio < 4).all()  # 14 is the smallest size


@pytest.mark.parametrize("number", NUMBERS)
def test_the_constants_are_those_of_the_rule_in_the_files_head(number, constants):
    twin = constants[number]
    structure, tilting, wall = next(
        values for lighter, *values in CLASSES if twin.payload_kg < lighter
    )
    rng = stream("arm-family", twin.name)
    factors, tubes = np.exp(0.3 * rng.normal(size=(6, 3))), np.exp(0.1 * rng.normal(size=7))
    for joint, (stiff, tilted, _) in zip(twin.joint, factors, strict=True):
        gear, is_rv = joint.gear_figures, joint.gear_figures.kind == "RV"
        middle = gear.slopes_Nm_per_rad[1] * (MIDDLE_SLOPE if is_rv else 1.0)
        digits = 2.0 * DIGITS if is_rv else DIGITS  # an RV gear's middle slope was rounded, too
        assert joint.structure_Nm_per_rad == pytest.approx(structure * stiff * middle, rel=digits)
        assert joint.tilting_ratio == pytest.approx(np.clip(tilting * tilted, 1, 8), rel=DIGITS)
    reach = wrist_reach(twin.robot())
    assert twin.clearance_m == pytest.approx(0.2 * reach / 1.101, rel=DIGITS)
    for segment, share, factor in zip(twin.beams.segment, TUBES, tubes, strict=True):
        assert segment.outer_m == pytest.approx(share * reach * factor, rel=DIGITS)
        assert segment.wall_m == pytest.approx(wall * segment.outer_m, rel=DIGITS)


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize(("twin", "name"), [(ArmFamily, "arm_family"), (Ur5Twin, "ur5_twin")])
def test_the_card_states_the_hash_of_the_data_in_every_world(twin, name, world):
    card = (files("stiff_datasets") / "data" / f"{name}.md").read_text(encoding="utf-8")
    assert f"`{twin(world=world).load().sha256}`" in card


@pytest.mark.parametrize("twin", [ArmFamily, Ur5Twin])
def test_a_narrow_plan_keeps_two_joints_at_zero_and_pulls_along_a_line(twin):
    narrow, wide = twin(plan="narrow").load(), twin().load()
    assert not narrow.samples.q[:, [3, 5]].any() and wide.samples.q[:, [3, 5]].any()
    shares = [
        np.linalg.svd(data.samples.wrench[:, :3], compute_uv=False)[[0, -1]]
        for data in (narrow, wide)
    ]
    (first, last), (first_wide, last_wide) = shares
    assert last / first < 0.15 < last_wide / first_wide
    assert narrow.robot.name == wide.robot.name


def test_a_narrow_plan_stays_inside_the_share_of_the_payload():
    data = ArmFamily(robot=4, plan="narrow").load()
    heaviest = np.linalg.norm(data.samples.wrench[:, :3], axis=1).max()
    assert heaviest < 1.02 * HEAVIEST * shipped_constants(ARMS[4]).payload_kg * STANDARD_GRAVITY


def test_a_wide_plan_of_the_kr10_has_random_poses_and_forces_of_every_direction():
    wide_plan, default_plan = Kr10Twin(plan="wide").load(), Kr10Twin().load()
    assert len(wide_plan.samples) == len(default_plan.samples) == 151
    assert (
        wide_plan.samples.q[:, [3, 5]].all()
        and (wide_plan.samples.wrench[:, :3].min(axis=0) < 0.0).all()
    )
    singular_values = np.linalg.svd(wide_plan.samples.wrench[:, :3], compute_uv=False)
    assert singular_values[-1] / singular_values[0] > 0.5
