"""Simulate a robot and its measurement in a world: a list of effects (see `effects.py`)."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import hadamard

from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.constants import TwinConstants, specimen_law
from stiff_datasets.twin.effects import WORLDS, Effect, Friction, World
from stiff_datasets.twin.elastic_chain import ElasticChain
from stiff_datasets.twin.gear_law import GearLaw
from stiff_datasets.twin.twin import (
    TOLERANCE_NM,
    TwinExperiment,
    no_equilibrium,
    recorded_deflection,
    recorded_wrench,
)
from stiff_protocols.contract.types import TRUTH, BenchmarkData, FloatArray, Robot, Samples

Approach = Literal["random", "one-sided", "cycled"]
"""How a pose is reached: from a side drawn for each joint and pose; always from the same side; or
as random, with the first load put on and off once before its reading."""
MAX_ITERATIONS = 200


class RestState(NamedTuple):
    """An equilibrium of springs, load and weight.

    Attributes:
        plays: (n_plays, 3 n_joints, n) plays of the gears, N m.
        tcp, point: (3, n) TCP and measured point of the deformed robot, m.
    """

    plays: FloatArray
    tcp: FloatArray
    point: FloatArray


class Readings(NamedTuple):
    """Displacements under the loads of each pose, one after the other; (n, n_loads, 3) m.

    Attributes:
        tcp, point: loaded minus unloaded before it, of the TCP and of the measured point.
        remaining: unloaded after the load minus unloaded before it, of the measured point.
    """

    tcp: FloatArray
    point: FloatArray
    remaining: FloatArray


@dataclass(frozen=True, eq=False)
class WorldTwin:
    """A robot of a type in a world, which can be loaded and read.

    Attributes:
        constants: constants of the type.
        specimen: number of the robot.
        effects: effects of the world, drawn for this robot.
    """

    constants: TwinConstants
    specimen: int
    effects: tuple[Effect, ...]

    @cached_property
    def description(self) -> Robot:
        """The robot as models get it."""
        return self.constants.robot()

    @cached_property
    def robot(self) -> Robot:
        """The real robot."""
        robot = self.description
        for effect in self.effects:
            robot = effect.real_robot(robot)
        return robot

    @cached_property
    def _law(self) -> GearLaw:
        law = specimen_law(self.constants, self.specimen)
        for effect in self.effects:
            law = effect.law(law)
        return law

    @cached_property
    def _chains(self) -> tuple[ElasticChain, ElasticChain]:
        offset = sum((effect.tracked_point() for effect in self.effects), np.zeros(3))
        robot = self.robot
        return ElasticChain(robot), ElasticChain(replace(robot, tcp=robot.tcp + offset))

    def _settled(
        self,
        q: FloatArray,
        wrench: FloatArray,
        plays: FloatArray | None = None,
        direction: FloatArray | None = None,
    ) -> RestState:
        """Return the equilibrium at (n_joints, n) q under (6, n) wrench.

        It follows from the plays before the load, or from a motion that ended in `direction`
        (3 n_joints, n).
        """
        chain, law = self._chains[0], self._law
        theta = np.zeros((3 * len(q), q.shape[1]))
        weight, _ = chain.statics(q, theta, np.zeros_like(wrench))
        torque, _ = chain.statics(q, theta, wrench)
        for _ in range(MAX_ITERATIONS):
            on_springs = torque
            for effect in self.effects:
                on_springs = effect.loaded(on_springs, weight)
            if plays is None:
                assert direction is not None
                state = law.plays_after_motion(on_springs, direction)
            else:
                state = law.slipped(plays, on_springs)
            theta = law.angle(on_springs, state)
            for effect in reversed(self.effects):
                theta = effect.turned(theta, q)
            previous = torque
            torque, tcp = chain.statics(q, theta, wrench)
            change = np.abs(torque - previous).max(axis=0)
            if (change < TOLERANCE_NM).all():
                return RestState(state, tcp, self._chains[1].statics(q, theta, wrench)[1])
        raise no_equilibrium(change, q.T, wrench.T)

    def _structure(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return (n, 6) displacement and rotation of the TCP by links and floor."""
        parts = [effect.displacement(self.robot, q, wrench) for effect in self.effects]
        return np.asarray(sum(parts, np.zeros_like(wrench)))

    def readings(
        self, q: FloatArray, wrench: FloatArray, direction: FloatArray, *, cycled: bool = False
    ) -> Readings:
        """Return the displacements under several loads of each pose, in their order.

        Args:
            q: (n, n_joints) commanded joint positions, rad or m.
            wrench: (n, n_loads, 6) loads at the TCP [N, N m], base frame.
            direction: (n, n_joints) signs of the motion that ended at each pose.
            cycled: put the first load on and off once before its reading.

        Raises:
            DataError: no equilibrium was found (the load is too large).
        """
        columns, none = q.T.copy(), np.zeros((6, len(q)))
        signs = np.repeat(direction.T, 3, axis=0)
        before = self._settled(columns, none, direction=signs)
        rows: list[tuple[FloatArray, ...]] = []
        loads = [wrench[:, k] for k in range(wrench.shape[1])]
        for load in [*(loads[:1] if cycled else []), *loads]:
            loaded = self._settled(columns, load.T.copy(), before.plays)
            after = self._settled(columns, none, loaded.plays)
            structure = self._structure(q, load)
            lever = (before.point - before.tcp).T
            rows.append(
                (
                    (loaded.tcp - before.tcp).T + structure[:, :3],
                    (loaded.point - before.point).T
                    + structure[:, :3]
                    + np.cross(structure[:, 3:], lever),
                    (after.point - before.point).T,
                )
            )
            before = after
        rows = rows[1:] if cycled else rows
        return Readings(*(np.stack(part, axis=1) for part in zip(*rows, strict=True)))

    @cached_property
    def _states(self) -> FloatArray:
        """(n_states, n_joints) directions over which the truth is averaged.

        They are columns of a Hadamard matrix: the mean over them is that over all combinations if
        the joints' states do not act on each other.
        """
        n = self.robot.n_joints
        if not any(isinstance(effect, Friction) for effect in self.effects):
            return np.ones((1, n))
        size = 1 << n.bit_length()
        return np.asarray(hadamard(size)[:, 1 : n + 1], dtype=float)

    def truth(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of the TCP under (n, 6) wrenches at it, without the rig.

        With friction it is the mean over the directions from which a pose can be approached.
        """
        return self._mean_readings(q, wrench).tcp[:, 0]

    def _mean_readings(self, q: FloatArray, wrench: FloatArray) -> Readings:
        states, n = self._states, len(q)
        every = np.tile(q, (len(states), 1))
        loads = np.tile(wrench, (len(states), 1))[:, None]
        of_states = self.readings(every, loads, np.repeat(states, n, axis=0))
        return Readings(*(part.reshape(len(states), n, 1, 3).mean(axis=0) for part in of_states))

    def oracle(self, q: FloatArray, sensed_wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) mean reading [m] of the tracker, from the sensor's (n, 6) reading.

        It knows robot and rig, but neither noise nor the direction of the approach.
        """
        wrench = sensed_wrench
        for effect in reversed(self.effects):
            wrench = effect.sensed(wrench, inverse=True)
        return self.tracked(self._mean_readings(q, self.real_wrench(q, wrench)).point[:, 0])

    def real_wrench(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 6) wrench at the TCP that a file describes as `wrench`."""
        rotation = self.description.forward(q).rotation
        for effect in self.effects:
            wrench = effect.real_wrench(wrench, rotation)
        return wrench

    def tracked(self, deflection: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection in the tracker's frame."""
        for effect in self.effects:
            deflection = effect.tracked(deflection)
        return deflection

    def joint_turn(self, torque: FloatArray) -> FloatArray:
        """Return the (n, n_joints) turn [rad] (slide [m]) of unloaded joints under `torque`.

        `torque` (n, n_joints) [N m or N] loads each joint about, or along, its axis; the mean over
        both directions of a motion before it.
        """
        on_springs = np.zeros((3 * torque.shape[1], len(torque)))
        on_springs[::3] = torque.T
        law, none, turns = self._law, np.zeros_like(on_springs), []
        for sign in (1.0, -1.0):
            rest_plays = law.plays_after_motion(none, np.full_like(none, sign))
            loaded = law.angle(on_springs, law.slipped(rest_plays, on_springs))
            turns.append(loaded - law.angle(none, rest_plays))
        return np.asarray(((turns[0] + turns[1]) / 2.0)[::3].T)


class Measurement(NamedTuple):
    """Samples, and what a file of samples does not have; rows as the samples.

    Attributes:
        samples: samples.
        noiseless: (n, 3) readings without noise and errors, m.
        after: (n, 3) readings of the unloaded robot after the load, minus those before it, m.
        direction: (n, n_joints) signs of the motion that ended at the pose.
    """

    samples: Samples
    noiseless: FloatArray
    after: FloatArray
    direction: FloatArray


@dataclass(eq=False)
class WorldExperiment(TwinExperiment):
    """The measurement of a robot in a world; other attributes as `TwinExperiment`.

    Attributes:
        world: name of the world.
        approach: how each pose is reached.
    """

    _: KW_ONLY
    world: World = "clean"
    approach: Approach = "random"

    def __post_init__(self) -> None:
        """Draw the robot."""
        effects = (of.drawn(self.constants, self.specimen) for of in WORLDS[self.world])
        self.robot_in_world = WorldTwin(self.constants, self.specimen, tuple(effects))
        self.robot = self.robot_in_world.robot
        loads = self.loads.split("-")[0]
        self._key = (self.constants.name, loads, self.loads_per_pose, self.specimen, self.seed)

    def samples(self, poses: Poses, *, block: int = 0) -> Samples:
        """Measure every load at each of the poses, as `TwinExperiment.samples`."""
        return self.measurement(poses, block).samples

    def measured(self, poses: Poses) -> BenchmarkData:
        """Return `samples` with the robot and what only the simulation knows: see `BOUND_NAMES`.

        The truth is for the wrench as each row writes it, at the TCP of the description.
        """
        twin = self.robot_in_world
        samples, noiseless, *_ = self.measurement(poses)
        bounds = {
            TRUTH: twin.truth(samples.q, samples.wrench),
            "oracle": twin.oracle(samples.q, samples.wrench),
            "noise": noiseless,
        }
        return BenchmarkData(samples, twin.description, bounds, twin.truth, twin.joint_turn)

    def measurement(self, poses: Poses, block: int = 0) -> Measurement:
        """Measure every load at each of the poses, pose by pose."""
        twin, n = self.robot_in_world, self.loads_per_pose
        q = self.logged_q(poses)
        wrench = self.wrenches(q, block=block)
        rng = stream("approach", *self._key, block)
        direction = rng.choice([-1.0, 1.0], (len(poses.q), q.shape[1]))
        if self.approach == "one-sided":
            direction[:] = direction[0]
        readings = twin.readings(
            q[::n],
            twin.real_wrench(q, wrench).reshape(-1, n, 6),
            direction,
            cycled=self.approach == "cycled",
        )
        noiseless = twin.tracked(readings.point.reshape(-1, 3))
        rng, noise = stream("noise", *self._key, block), self.constants.noise
        for effect in twin.effects:
            noise = effect.noise(noise)
        sensed = wrench
        for effect in twin.effects:
            sensed = effect.sensed(sensed)
        recorded = recorded_wrench(sensed, noise, rng)
        pose = np.repeat(np.arange(len(poses.q)), n)
        errors = sum(
            (effect.reading_errors(pose, len(q), rng) for effect in twin.effects), 0.0 * noiseless
        )
        deflection = recorded_deflection(noiseless + errors, noise, rng)
        samples = self.rows(poses, recorded, deflection)
        remaining = twin.tracked(readings.remaining.reshape(-1, 3))
        after = recorded_deflection(remaining, noise, rng)
        return Measurement(samples, noiseless, after, np.repeat(direction, n, axis=0))
