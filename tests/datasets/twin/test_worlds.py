"""Worlds of simulated robots: energy, symmetry, truth, and independent computations of effects."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from helpers.pinocchio_twin import elastic_pinocchio, torque_and_tcp
from stiff_datasets.planning.loads import omni_forces
from stiff_datasets.robots.shipped_robots import shipped_chain
from stiff_datasets.twin.effects import (
    STRUCTURE,
    WORLDS,
    AngleStiffness,
    Balancer,
    BallBearings,
    BendingLinks,
    CoupledWrist,
    ForcePoint,
    ForceSensor,
    HosePull,
    OneSidedPlay,
    OpeningFlange,
    SoftFloor,
    TrackedPoint,
    WarmingGears,
    World,
)
from stiff_datasets.twin.robot_twin import ArmFamily, Ur5Twin, random_poses
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import shipped_constants
from stiff_protocols.contract.types import DRAWN, TRUTH, Prediction
from stiff_protocols.scoring.metrics import METRICS

ROBOTS = ("ur5", "gp180")
HALF_TURN = np.pi


def twin_of(world: World, name: str = "gp180", specimen: int = 1) -> DigitalTwin:
    return DigitalTwin.in_world(shipped_constants(name), specimen, world)


def loads(twin: DigitalTwin, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, n_joints) poses and (n, 6) wrenches at the TCP."""
    rng = np.random.default_rng(seed)
    q = random_poses(twin.constants, n, seed).q
    force = omni_forces(n, twin.constants.payload_kg, rng)
    return q, np.hstack([force, rng.normal(scale=2.0, size=(n, 3))])


def wrench_cycles(twin: DigitalTwin, n: int, steps: int) -> np.ndarray:
    """Return (n_steps, n, 6) wrenches along straight lines between random corners, closed."""
    rng, payload = np.random.default_rng(3), twin.constants.payload_kg
    corners = rng.normal(size=(5, n, 6)) * np.repeat([5.0, 0.5], 3) * payload
    corners = np.concatenate([corners, corners[:1]])
    lines = [np.linspace(a, b, steps, endpoint=False) for a, b in pairwise(corners)]
    return np.concatenate([*lines, corners[-1:]])


def motion(twin: DigitalTwin, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Return (n_steps - 1, n, 6) steps of the TCP and turns of the tool along wrenches, in order.

    Three points, 1 m from the TCP along the axes of the last joint's frame, give the turns.
    """
    plays = [twin._settled(q.T, wrench[0].T, None, np.ones((3 * q.shape[1], len(q)))).plays]
    for load in wrench[:-1]:
        state = twin._settled(q.T, load.T, plays[-1]).plays if twin.has_friction else plays[-1]
        plays.append(state)
    before, load = np.concatenate(plays, axis=2), wrench.reshape(-1, 6)
    every = np.tile(q, (len(wrench), 1))
    effects = [effect for effect in twin.effects if not isinstance(effect, TrackedPoint)]
    points = [replace(twin, effects=(*effects, TrackedPoint(axis))) for axis in np.eye(3)]
    ends = [point._settled(every.T, load.T, before) for point in points]
    structure = sum((e.displacement(twin.robot, every, load) for e in effects), 0.0 * load)
    tcp, rotation = ends[0].tcp.T, np.stack([(end.point - end.tcp).T for end in ends], axis=-1)
    tcp, rotation, structure = (
        part.reshape(*wrench.shape[:2], *part.shape[1:]) for part in (tcp, rotation, structure)
    )
    turn = np.einsum("snab,sncb->snac", rotation[1:], rotation[:-1])
    turns = np.stack([turn[..., b, c] - turn[..., c, b] for b, c in ((2, 1), (0, 2), (1, 0))], -1)
    joints = np.concatenate([np.diff(tcp, axis=0), turns / 2.0], axis=2)
    return np.asarray(joints + np.diff(structure, axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("world", [*WORLDS])
def test_no_closed_cycle_of_forces_and_moments_makes_energy(world: World) -> None:
    twin = twin_of(world)
    q = random_poses(twin.constants, 4, 5).q
    cycle = wrench_cycles(twin, len(q), 15 if twin.has_friction else 120)
    wrench = np.concatenate([cycle, cycle[1:]])  # the plays repeat from the second cycle on
    steps = (wrench[1:] + wrench[:-1]) / 2.0 * motion(twin, q, wrench)
    steps = steps[len(cycle) - 1 :].sum(axis=2)
    work = steps.sum(axis=0) / np.abs(steps).sum(axis=0)
    assert (work > 2e-3).all() if twin.has_friction else (np.abs(work) < 2e-5).all()


@pytest.mark.parametrize("world", ["clean", "structure", "unseen"])
def test_without_plays_the_tangent_compliance_is_symmetric(world: str) -> None:
    twin = twin_of(world)
    q, wrench = loads(twin, 1)
    step = 1.0  # N
    compliance = np.zeros((3, 3))
    for axis in range(3):
        ends = np.repeat(wrench, 2, axis=0)
        ends[:, axis] += [step, -step]
        above, below = twin.truth(np.repeat(q, 2, axis=0), ends)
        compliance[:, axis] = (above - below) / (2.0 * step)
    assert compliance == pytest.approx(compliance.T, abs=2e-3 * np.abs(compliance).max())


@pytest.mark.slow
def test_the_mean_over_few_states_is_that_over_all_approaches() -> None:
    twin = twin_of("friction", "ur5")
    q, wrench = loads(twin, 6)
    every = np.array([*product((-1.0, 1.0), repeat=6)])
    moved = [twin.readings(q, wrench[:, None], np.tile(s, (6, 1))).tcp[:, 0] for s in every]
    error = np.linalg.norm(twin.truth(q, wrench) - np.mean(moved, axis=0), axis=1)
    assert error.max() < 1e-3 * np.linalg.norm(twin.truth(q, wrench), axis=1).mean()


def test_loads_of_a_pose_follow_each_other_and_return_to_the_state_that_they_left() -> None:
    twin = twin_of("friction", "ur5")
    q, wrench = loads(twin, 10)
    direction = np.random.default_rng(1).choice([-1.0, 1.0], q.shape)
    single = twin.readings(q, wrench[:, None], direction)
    three = twin.readings(q, np.repeat(wrench[:, None], 3, axis=1), direction)
    np.testing.assert_array_equal(three.tcp[:, 0], single.tcp[:, 0])
    assert np.abs(single.remaining).max() > 1e-6  # the first load moves the plays
    assert np.abs(three.remaining[:, 1:]).max() < 1e-9  # the same load again does not
    cycled = twin.readings(q, wrench[:, None], direction, cycled=True)
    np.testing.assert_allclose(cycled.tcp[:, 0], three.tcp[:, 1], atol=1e-12)


# truth by independent computations


def independent_truth(
    twin: DigitalTwin, q: np.ndarray, wrench: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """Return the deflection of one row by Pinocchio and the closed forms of the effects."""
    robot, law, n = twin.robot, twin._law, len(q)
    model = elastic_pinocchio(shipped_chain(twin.constants.urdf, twin.constants.tcp_m))
    for joint, factor in enumerate(robot.masses / twin.description.masses):
        model.inertias[3 * joint + 3] = pin.Inertia(
            factor * model.inertias[3 * joint + 3].mass,
            *(model.inertias[3 * joint + 3].lever, model.inertias[3 * joint + 3].inertia),
        )
    data = model.createData()
    balancer = [effect for effect in twin.effects if isinstance(effect, Balancer)]
    coupling = [effect for effect in twin.effects if isinstance(effect, CoupledWrist)]
    angles = [effect for effect in twin.effects if isinstance(effect, AngleStiffness)]
    hoses = [effect for effect in twin.effects if isinstance(effect, HosePull)]

    def torques(theta: np.ndarray, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return torque_and_tcp(model, data, robot.tcp, q, theta, load)[:2]

    def settled(load: np.ndarray, plays: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        theta = np.zeros(3 * n)
        still = torques(np.zeros(3 * n), np.zeros(6))[0]
        for _ in range(80):
            torque, tcp = torques(theta, load)
            for effect in balancer:
                torque[3] -= effect.share * still[3]
            for effect in coupling:
                torque = effect.coupling @ torque
            for effect in hoses:
                for joint in (3, 4, 5):
                    sine = np.sin(q[joint])
                    torque[3 * joint] -= effect.torque[joint, 0] * np.copysign(sine**2, sine)
            if plays is None:
                state = torque - np.repeat(direction, 3) * law.thresholds[..., 0]
            else:
                radius = law.thresholds[..., 0]
                state = np.minimum(np.maximum(plays, torque - radius), torque + radius)
            theta = law.angle(torque[:, None], state[..., None])[:, 0]
            theta += [unseen_turn(twin, i, torque[i]) for i in range(3 * n)]
            for effect in angles:
                wave = 2.0 / np.pi * np.arcsin(np.sin(effect.periods * q + effect.phase))
                cable = np.clip(q - effect.middle, -1.0, 1.0)
                theta[::3] *= 1.0 + effect.size * (wave + cable) / 2.0
            for effect in coupling:
                theta = effect.coupling.T @ theta
        return state, tcp

    state, unloaded = settled(np.zeros(6), None)
    _, loaded = settled(wrench, state)
    return loaded - unloaded


def unseen_turn(twin: DigitalTwin, row: int, torque: float) -> float:
    """Return what the unseen effects turn an elastic coordinate in the middle of a measurement."""
    joint, tilt = divmod(row, 3)
    size, turn = abs(torque), 0.0
    for effect in twin.effects:
        if isinstance(effect, OneSidedPlay) and not tilt:
            width, taken_up = effect.width[joint, 0], effect.torque[joint, 0]
            turn += width * (1.0 - np.exp(-size / taken_up)) if width * torque > 0.0 else 0.0
        elif isinstance(effect, WarmingGears) and not tilt:
            turn += (1.0 - np.exp(-1.5)) * effect.compliance[joint, 0] * torque
        elif isinstance(effect, BallBearings) and tilt:
            rated = effect.torque[joint, 0, 0]
            approach = np.cbrt(size / rated + 0.02) ** 2 - np.cbrt(0.02) ** 2
            turn += effect.compliance[joint, tilt - 1, 0] * rated * np.copysign(approach, torque)
        elif isinstance(effect, OpeningFlange) and tilt:
            opening = effect.torque[joint, 0, 0] * (1.0 - effect.relaxed / 2.0)
            beyond = np.copysign(max(size - opening, 0.0), torque)
            turn += effect.compliance[joint, tilt - 1, 0] * beyond
    return float(turn)


@pytest.mark.slow
@pytest.mark.parametrize("world", [*WORLDS])
def test_the_truth_of_each_world_is_that_of_an_independent_computation(world: str) -> None:
    twin = twin_of(world)
    q, wrench = loads(twin, 20)
    moved = np.zeros((20, 3))
    for row in range(20):
        of_states = [independent_truth(twin, q[row], wrench[row], s) for s in twin._states]
        moved[row] = np.mean(of_states, axis=0)
    for effect in twin.effects:
        if isinstance(effect, BendingLinks):
            moved += frame_motion(twin, q, wrench)[:, :3]
        elif isinstance(effect, SoftFloor):
            tcp = twin.robot.tcp_position(q)
            moment = wrench[:, 3:] + np.cross(tcp, wrench[:, :3])
            moved += np.cross(effect.compliance * moment * [1.0, 1.0, 0.0], tcp)
    truth = twin.truth(q, wrench)
    assert truth == pytest.approx(moved, abs=1e-6 * np.abs(truth).max())


def frame_motion(twin: DigitalTwin, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Return (n, 6) what bending links move and turn the TCP, by a frame's stiffness matrix."""
    (links,) = (effect for effect in twin.effects if isinstance(effect, BendingLinks))
    moved = np.zeros((len(q), 6))
    for row in range(len(q)):
        tubes = [*segments(links, twin, q[row])]
        matrix = np.zeros((6 * len(tubes) + 6,) * 2)
        for i, (basis, length, stiffness) in enumerate(tubes):
            block, turn = slice(6 * i, 6 * i + 12), np.kron(np.eye(4), basis.T)
            matrix[block, block] += turn.T @ element_matrix(length, *stiffness) @ turn
        moved[row] = np.linalg.inv(matrix[6:, 6:])[-6:, -6:] @ wrench[row]
    return moved


def element_matrix(length: float, *stiffness: float) -> np.ndarray:
    """Return the (12, 12) matrix of a Timoshenko beam along x (Przemieniecki 1968, eq. 5.116)."""
    axial, shear_y, shear_z, twist, about_y, about_z = stiffness
    k = np.zeros((12, 12))
    for row, stretch in ((0, axial), (3, twist)):
        k[np.ix_([row, row + 6], [row, row + 6])] = stretch / length * np.array([[1, -1], [-1, 1]])
    for rows, sign, bending, shear in (
        ([1, 5, 7, 11], 1.0, about_z, shear_y),
        ([2, 4, 8, 10], -1.0, about_y, shear_z),
    ):
        phi, side = 12.0 * bending / (shear * length**2), 6.0 * length * sign
        near, far = (4.0 + phi) * length**2, (2.0 - phi) * length**2
        k[np.ix_(rows, rows)] = (
            bending
            / (length**3 * (1.0 + phi))
            * np.array(
                [
                    *([12.0, side, -12.0, side], [side, near, -side, far]),
                    *([-12.0, -side, 12.0, -side], [side, far, -side, near]),
                ]
            )
        )
    return k


def segments(links: BendingLinks, twin: DigitalTwin, q: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """Yield (3, 3) axes of the section, length and six stiffnesses of each tube."""
    robot, poses = twin.robot, twin.robot.forward(q[None])
    frames = [np.eye(3), *poses.rotations[0]]
    offsets = [*robot.placements[:, :3, 3], robot.tcp]
    widths = [np.array([0.0, 0.0, 1.0]), *robot.axes]
    for i, (frame, offset, width) in enumerate(zip(frames, offsets, widths, strict=True)):
        if not (length := float(np.linalg.norm(offset))):
            continue
        axis = offset / length
        across = width if abs(axis @ width) <= 0.9 else np.roll(width, 1)
        across = across - (axis @ across) * axis
        across = across / np.linalg.norm(across)
        h, b, t = links.height[i], links.width[i], links.wall[i]
        inner = h - 2.0 * t, b - 2.0 * t
        area = h * b - inner[0] * inner[1]
        young, shear = links.modulus[i], links.modulus[i] / (2.0 * (1.0 + links.poisson))
        twist = 4.0 * ((h - t) * (b - t)) ** 2 * t / (2.0 * (h + b - 2.0 * t))
        stiffness = np.array(
            [
                *(young * area, 0.44 * shear * area, 0.44 * shear * area, shear * twist),
                young * (h * b**3 - inner[0] * inner[1] ** 3) / 12.0,
                young * (b * h**3 - inner[1] * inner[0] ** 3) / 12.0,
            ]
        )
        sections = np.column_stack([axis, np.cross(across, axis), across])
        yield frame @ sections, length, stiffness


@pytest.mark.parametrize("name", ROBOTS)
def test_bending_links_move_and_turn_the_tcp_as_their_assembled_stiffness_matrix_says(
    name: str,
) -> None:
    twin = twin_of("structure", name)
    q, wrench = loads(twin, 5)
    links = next(effect for effect in twin.effects if isinstance(effect, BendingLinks))
    expected = frame_motion(twin, q, wrench)
    np.testing.assert_allclose(links.displacement(twin.robot, q, wrench), expected, rtol=1e-8)


def test_the_coupled_wrist_and_the_angle_change_compliance_by_their_size() -> None:
    constants = shipped_constants("gp180")
    for specimen in range(3):
        links = CoupledWrist.drawn(constants, specimen).coupling
        off = np.abs(links - np.eye(len(links)))
        assert np.count_nonzero(off) == 2
        assert 0.1 <= off[off > 0.0].min() and off.max() <= 0.3
        angle = AngleStiffness.drawn(constants, specimen)
        q = np.tile(np.linspace(-HALF_TURN, HALF_TURN, 2001), (6, 1))
        factor = angle.turned(np.ones((18, 2001)), q)[::3]
        assert (np.abs(factor - 1.0).max(axis=1) <= angle.size + 1e-9).all()
        assert (angle.size >= 0.05).all() and (angle.size <= 0.2).all()


@pytest.mark.parametrize("name", ROBOTS)
def test_unseen_effects_are_felt_and_change_over_a_measurement(name: str) -> None:
    clean, twin = twin_of("clean", name), twin_of("unseen", name)
    q, wrench = loads(twin, 40)
    truth = twin.truth(q, wrench)
    change = np.linalg.norm(truth - clean.truth(q, wrench), axis=1)
    assert 0.1 < np.median(change) / np.median(np.linalg.norm(truth, axis=1)) < 0.4
    first_and_last = np.repeat(q[:1], 2, axis=0)
    same_load = np.repeat(wrench[:1, None], 2, axis=0)
    cold, warm = twin.readings(first_and_last, same_load, np.ones_like(first_and_last)).tcp[:, 0]
    assert np.linalg.norm(warm) > 1.01 * np.linalg.norm(cold)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_floor_takes_one_to_five_per_cent_of_the_deflection(name: str) -> None:
    twin = twin_of("structure", name)
    q, wrench = loads(twin, 60)
    (floor,) = (effect for effect in twin.effects if isinstance(effect, SoftFloor))
    by_floor = np.linalg.norm(floor.displacement(twin.robot, q, wrench)[:, :3], axis=1)
    share = np.median(by_floor) / np.median(np.linalg.norm(twin.truth(q, wrench), axis=1))
    assert 0.003 < share < 0.08  # of the whole deflection; poses and structure differ


def test_a_sensor_reads_its_matrix_and_the_inverse_undoes_it() -> None:
    sensor = ForceSensor.drawn(shipped_constants("ur5"), 2)
    wrench = np.random.default_rng(0).normal(size=(5, 6))
    assert sensor.sensed(sensor.sensed(wrench), inverse=True) == pytest.approx(wrench)
    assert 0.01 <= np.abs(np.diag(sensor.matrix) - 1.0).min()


def test_a_force_beside_the_tcp_turns_it_by_its_lever() -> None:
    point = ForcePoint(np.array([0.0, 0.02, 0.0]))
    moved = point.real_wrench(np.array([[10.0, 0.0, 0.0, 0.0, 0.0, 0.0]]), np.eye(3)[None])
    assert moved[0] == pytest.approx([10.0, 0.0, 0.0, 0.0, 0.0, -0.2])


@pytest.mark.parametrize("world", [*WORLDS])
def test_a_data_set_of_a_world_has_its_truth_and_models_never_get_it(world: str) -> None:
    data = Ur5Twin(world=world).load()
    truth, noise = data.bound_deflections[TRUTH], data.bound_deflections["noise"]
    error = np.linalg.norm(truth - data.samples.deflection, axis=1).mean()
    assert 1e-6 < error < 2e-4
    assert data.sha256 == replace(data, bound_deflections={}).sha256
    assert not data.without_truth().bound_deflections
    exact = WORLDS[world] in ((), STRUCTURE)
    assert (np.abs(truth - noise).max() < 2e-5) == exact  # the force sensor's noise remains
    assert (DRAWN in data.bound_deflections) == (world in ("friction", "all"))
    again = Ur5Twin(world=world).load()
    assert again.sha256 == data.sha256


@pytest.mark.slow
def test_drawn_deflections_scatter_about_the_truth_and_their_mean_is_the_truth() -> None:
    shares = []
    for seed in range(12):
        bounds = Ur5Twin(world="friction", seed=seed).load().bound_deflections
        truth, drawn = bounds[TRUTH], bounds[DRAWN]
        shares.append(((drawn - truth) * truth).sum(axis=1) / (truth**2).sum(axis=1))
    share = np.concatenate(shares)
    assert 0.01 < share.std() < 0.1
    assert abs(share.mean()) < min(0.005, 4.0 * share.std() / np.sqrt(len(share)))


@pytest.mark.parametrize("world", ["clean", "friction"])
def test_errors_against_the_drawn_state_are_those_against_the_truth_without_friction(
    world: World,
) -> None:
    data = Ur5Twin(world=world).load()
    measured = data.samples.deflection
    prediction = Prediction(
        *(np.arange(len(measured)), 0.9 * measured, measured),
        bound_deflections=data.bound_deflections,
    )
    drawn, true = (METRICS[key].of_prediction(prediction) for key in ("drawn-norm", "true-norm"))
    assert (drawn == true) == (world == "clean")


@pytest.mark.slow
def test_specimen_seed_and_approach_give_other_data() -> None:
    hashes = {
        ArmFamily(world="all", robot=8, **options).load().sha256
        for options in ({}, {"specimen": 1}, {"seed": 1}, {"approach": "one-sided"})
    }
    assert len(hashes) == 4
