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
from stiff_datasets.twin.constants import shipped_constants
from stiff_datasets.twin.effects import (
    STRUCTURE,
    WORLDS,
    AngleStiffness,
    Balancer,
    BendingLinks,
    CoupledWrist,
    ForcePoint,
    ForceSensor,
    Friction,
    SoftFloor,
)
from stiff_datasets.twin.robot_twin import ArmFamily, Ur5Twin, random_poses
from stiff_datasets.twin.world_twin import WorldTwin
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import TRUTH

ROBOTS = ("ur5", "gp180")
HALF_TURN = np.pi


def twin_of(world: str, name: str = "gp180", specimen: int = 1) -> WorldTwin:
    constants = shipped_constants(name)
    effects = tuple(effect.drawn(constants, specimen) for effect in WORLDS[world])
    return WorldTwin(constants, specimen, effects)


def loads(twin: WorldTwin, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, n_joints) poses and (n, 6) wrenches at the TCP."""
    rng = np.random.default_rng(seed)
    q = random_poses(twin.constants, n, seed).q
    force = omni_forces(n, twin.constants.payload_kg, rng)
    return q, np.hstack([force, rng.normal(scale=2.0, size=(n, 3))])


def wrench_cycle(twin: WorldTwin, rng: np.random.Generator, steps: int) -> np.ndarray:
    """Return (n, 6) wrenches along straight lines between random corners, closed."""
    corners = rng.normal(size=(5, 6)) * np.repeat([1.0, 0.1], 3) * twin.constants.payload_kg * 5.0
    corners = np.vstack([corners, corners[:1]])
    lines = [np.linspace(a, b, steps, endpoint=False) for a, b in pairwise(corners)]
    return np.vstack([*lines, corners[-1:]])


def motion(twin: WorldTwin, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Return the (n, 3) displacement of the TCP along wrenches, in order, at one pose."""
    columns, plays, rows = q[:, None], None, []
    for load in wrench:
        rest_state = twin._settled(
            columns, load[:, None], plays, None if rows else np.ones((3 * len(q), 1))
        )
        plays = rest_state.plays
        rows.append(rest_state.tcp[:, 0])
    return np.asarray(rows) + twin._structure(np.tile(q, (len(wrench), 1)), wrench)[:, :3]


@pytest.mark.parametrize("world", ["clean", "structure", "friction", "all"])
def test_no_closed_cycle_of_force_makes_energy(world: str) -> None:
    twin = twin_of(world)
    rng = np.random.default_rng(3)
    q = random_poses(twin.constants, 1, 5).q[0]
    wrench = wrench_cycle(twin, rng, 25)
    wrench[:, 3:] = 0.0
    twice = np.vstack([wrench, wrench[1:]])
    moved = motion(twin, q, twice)[len(wrench) - 1 :]
    force = twice[len(wrench) - 1 :, :3]
    mean_force = (force[1:] + force[:-1]) / 2.0
    work = float(np.sum(mean_force * np.diff(moved, axis=0)))
    scale = float(np.abs(force).max() * np.ptp(moved, axis=0).max())
    has_friction = any(isinstance(effect, Friction) for effect in twin.effects)
    assert work > -5e-4 * scale
    assert (work > 2e-3 * scale) == has_friction


@pytest.mark.parametrize("world", ["clean", "structure"])
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
    twin: WorldTwin, q: np.ndarray, wrench: np.ndarray, direction: np.ndarray
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
            if plays is None:
                state = torque - np.repeat(direction, 3) * law.thresholds[..., 0]
            else:
                radius = law.thresholds[..., 0]
                state = np.minimum(np.maximum(plays, torque - radius), torque + radius)
            theta = law.angle(torque[:, None], state[..., None])[:, 0]
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
            moved += bent(effect, twin, q, wrench)
        elif isinstance(effect, SoftFloor):
            tcp = twin.robot.tcp_position(q)
            moment = wrench[:, 3:] + np.cross(tcp, wrench[:, :3])
            moved += np.cross(effect.compliance * moment * [1.0, 1.0, 0.0], tcp)
    truth = twin.truth(q, wrench)
    assert truth == pytest.approx(moved, abs=1e-6 * np.abs(truth).max())


def bent(links: BendingLinks, twin: WorldTwin, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Return (n, 3) what bending links move the TCP, by virtual work and Simpson's rule.

    u_k = sum over segments of the integral of N n/EA + V v/(k G A) + T t/(G J) + M m/(E I), where
    the small letters are of a unit force along axis k.
    """
    moved = np.zeros((len(q), 3))
    units = np.hstack([np.eye(3), np.zeros((3, 3))])
    for row in range(len(q)):
        for start, basis, length, stiffness in segments(links, twin, q[row]):
            tcp = twin.robot.tcp_position(q[row : row + 1])[0]
            for at, share in ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6)):
                lever = tcp - (start + at * length * basis[:, 0])
                inner = [
                    np.concatenate(
                        [basis.T @ load[:3], basis.T @ (load[3:] + np.cross(lever, load[:3]))]
                    )
                    for load in (wrench[row], *units)
                ]
                moved[row] += [
                    share * length * np.sum(inner[0] * of / stiffness) for of in inner[1:]
                ]
    return moved


def segments(links: BendingLinks, twin: WorldTwin, q: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """Yield start, (3, 3) axes of the section, length and six stiffnesses of each tube."""
    robot, poses = twin.robot, twin.robot.forward(q[None])
    starts, frames = [np.zeros(3), *poses.points[0, :-1]], [np.eye(3), *poses.rotations[0]]
    offsets = [*robot.placements[:, :3, 3], robot.tcp]
    widths = [np.array([0.0, 0.0, 1.0]), *robot.axes]
    for i, (start, frame, offset, width) in enumerate(
        zip(starts, frames, offsets, widths, strict=True)
    ):
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
        yield start, frame @ sections, length, stiffness


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
    again = Ur5Twin(world=world).load()
    assert again.sha256 == data.sha256


def test_specimen_and_seed_give_other_data_and_a_world_excludes_the_old_physics() -> None:
    hashes = {
        ArmFamily(world="all", robot=8, **options).load().sha256
        for options in ({}, {"specimen": 1}, {"seed": 1}, {"approach": "one-sided"})
    }
    assert len(hashes) == 4
    with pytest.raises(ConfigError):
        ArmFamily(world="all", physics="rigid")
