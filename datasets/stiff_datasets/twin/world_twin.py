"""Simulate a robot and its measurement in a world: a list of effects (see `effects.py`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import hadamard

from stiff_datasets.twin.constants import TwinConstants, specimen_law
from stiff_datasets.twin.effects import Effect, Friction
from stiff_datasets.twin.elastic_chain import ElasticChain
from stiff_datasets.twin.gear_law import GearLaw
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot

Approach = Literal["random", "one-sided", "cycled"]
"""How a pose is reached: from a side drawn for each joint and pose; always from the same side; or
as random, with the first load put on and off once before its reading."""
TOLERANCE_NM = 1e-10
"""Largest change of a torque in the last step; rounding errors are about 1e-13 N m."""
MAX_ITERATIONS = 200


class Rest(NamedTuple):
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
    ) -> Rest:
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
                return Rest(state, tcp, self._chains[1].statics(q, theta, wrench)[1])
        worst = int(np.argmax(~(change < TOLERANCE_NM)))  # NaN counts as no equilibrium
        raise DataError(
            f"no elastic equilibrium at q = {np.rad2deg(q[:, worst]).round(3)} deg under the "
            f"wrench {wrench[:, worst].round(3)}: the load is too large for these springs"
        )

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
        states, n = self._states, len(q)
        every = np.tile(q, (len(states), 1))
        loads = np.tile(wrench, (len(states), 1))[:, None]
        moved = self.readings(every, loads, np.repeat(states, n, axis=0)).tcp[:, 0]
        return np.asarray(moved.reshape(len(states), n, 3).mean(axis=0))

    def joint_turn(self, torque: FloatArray) -> FloatArray:
        """Return the (n, n_joints) turn [rad] (slide [m]) of unloaded joints under `torque`.

        `torque` (n, n_joints) [N m or N] loads each joint about, or along, its axis; the mean over
        both directions of a motion before it.
        """
        on_springs = np.zeros((3 * torque.shape[1], len(torque)))
        on_springs[::3] = torque.T
        law, none, turns = self._law, np.zeros_like(on_springs), []
        for sign in (1.0, -1.0):
            rest = law.plays_after_motion(none, np.full_like(none, sign))
            loaded = law.angle(on_springs, law.slipped(rest, on_springs))
            turns.append(loaded - law.angle(none, rest))
        return np.asarray(((turns[0] + turns[1]) / 2.0)[::3].T)
