"""Simulate a robot in a world: gears, links and instruments with its effects (`effects.py`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import NamedTuple, Self

import numpy as np

from stiff_datasets.twin.effects import MIDDLE, WORLDS, Effect, Friction, World
from stiff_datasets.twin.elastic_chain import ElasticChain
from stiff_datasets.twin.gear_law import GearLaw
from stiff_datasets.twin.twin_file import TwinConstants, specimen_law
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot

TOLERANCE_NM = 1e-10
"""Largest change of a torque in the last step; rounding errors are about 1e-13 N m."""
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
class DigitalTwin:
    """A robot of a type in a world, which can be loaded and read.

    Attributes:
        constants: constants of the type.
        specimen: number of the robot.
        effects: effects of the world, drawn for this robot.
    """

    constants: TwinConstants
    specimen: int
    effects: tuple[Effect, ...]

    @classmethod
    def in_world(cls, constants: TwinConstants, specimen: int, world: World) -> Self:
        """Draw the robot of that number in a world."""
        drawn = (effect.drawn(constants, specimen) for effect in WORLDS[world])
        return cls(constants, specimen, tuple(drawn))

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
        time: FloatArray | float = MIDDLE,
    ) -> RestState:
        """Return the equilibrium at (n_joints, n) q under (6, n) wrench.

        It follows from the plays before the load, or from a motion that ended in `direction`
        (3 n_joints, n). `time` (n,) runs from 0 to 1 in a measurement.
        """
        chain, law = self._chains[0], self._law
        theta = np.zeros((3 * len(q), q.shape[1]))
        weight, _ = chain.statics(q, theta, np.zeros_like(wrench))
        torque, _ = chain.statics(q, theta, wrench)
        for _ in range(MAX_ITERATIONS):
            on_springs = torque
            for effect in self.effects:
                on_springs = effect.loaded(on_springs, weight, q)
            if plays is None:
                assert direction is not None
                state = law.plays_after_motion(on_springs, direction)
            else:
                state = law.slipped(plays, on_springs)
            theta = law.angle(on_springs, state)
            for effect in self.effects:
                theta = theta + effect.further_turn(on_springs, time)
            for effect in reversed(self.effects):
                theta = effect.turned(theta, q)
            previous = torque
            torque, tcp = chain.statics(q, theta, wrench)
            change = np.abs(torque - previous).max(axis=0)
            if (change < TOLERANCE_NM).all():
                return RestState(state, tcp, self._chains[1].statics(q, theta, wrench)[1])
        raise no_equilibrium(change, q.T, wrench.T)

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
        time = np.linspace(0.0, 1.0, len(q))
        signs = np.repeat(direction.T, 3, axis=0)
        before = self._settled(columns, none, direction=signs, time=time)
        rows: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        loads = [wrench[:, k] for k in range(wrench.shape[1])]
        for load in [*(loads[:1] if cycled else []), *loads]:
            loaded = self._settled(columns, load.T.copy(), before.plays, time=time)
            after = self._settled(columns, none, loaded.plays, time=time)
            moved = self._moved(q, load, before, loaded)
            rows.append((*moved, (after.point - before.point).T))
            before = after
        rows = rows[1:] if cycled else rows
        return Readings(*(np.stack(part, axis=1) for part in zip(*rows, strict=True)))

    def _moved(
        self, q: FloatArray, wrench: FloatArray, before: RestState, loaded: RestState
    ) -> tuple[FloatArray, FloatArray]:
        """Return the (n, 3) displacements [m] of TCP and measured point by (n, 6) wrench."""
        parts = [effect.displacement(self.robot, q, wrench) for effect in self.effects]
        structure = np.asarray(sum(parts, np.zeros_like(wrench)))
        shift, lever = structure[:, :3], (before.point - before.tcp).T
        tcp = (loaded.tcp - before.tcp).T + shift
        point = (loaded.point - before.point).T + shift + np.cross(structure[:, 3:], lever)
        return tcp, point

    @property
    def has_friction(self) -> bool:
        """Return True if a deflection depends on the direction from which the pose was reached."""
        return any(isinstance(effect, Friction) for effect in self.effects)

    @cached_property
    def _states(self) -> FloatArray:
        """(n_states, n_joints) directions over which the truth is averaged.

        They are columns of a Hadamard matrix: the mean over them is that over all combinations if
        the joints' states do not act on each other.
        """
        n = self.robot.n_joints
        if not self.has_friction:
            return np.ones((1, n))
        smallest = np.array([[1.0, 1.0], [1.0, -1.0]])
        return np.asarray(reduce(np.kron, [smallest] * n.bit_length())[:, 1 : n + 1])

    def truth(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of the TCP under (n, 6) wrenches at it, without the rig.

        With friction it is the mean over the directions from which a pose can be approached.

        Raises:
            DataError: no equilibrium was found (the load is too large).
        """
        return self._mean_moved(q, wrench)[0]

    def _mean_moved(self, q: FloatArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean over all directions of what `_moved` returns."""
        states, n = self._states, len(q)
        every, load = np.tile(q, (len(states), 1)), np.tile(wrench, (len(states), 1))
        columns = every.T.copy()
        signs = np.repeat(np.repeat(states, n, axis=0).T, 3, axis=0)
        before = self._settled(columns, np.zeros_like(load.T), direction=signs)
        loaded = self._settled(columns, load.T.copy(), before.plays)
        tcp, point = self._moved(every, load, before, loaded)
        shape = (len(states), n, 3)
        return tcp.reshape(shape).mean(axis=0), point.reshape(shape).mean(axis=0)

    def oracle(self, q: FloatArray, sensed_wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) mean reading [m] of the tracker, from the sensor's (n, 6) reading.

        It knows robot and rig, but neither noise nor the direction of the approach.
        """
        wrench = sensed_wrench
        for effect in reversed(self.effects):
            wrench = effect.sensed(wrench, inverse=True)
        return self.tracked(self._mean_moved(q, self.real_wrench(q, wrench))[1])

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


def no_equilibrium(change: FloatArray, q: FloatArray, wrench: FloatArray) -> DataError:
    """Return an error that names the worst of (n, n_joints) q and (n, 6) wrench.

    `change` (n,) is the last change of a torque, N m.
    """
    worst = int(np.argmax(~(change < TOLERANCE_NM)))  # NaN counts as no equilibrium
    return DataError(
        f"no elastic equilibrium at q = {np.rad2deg(q[worst]).round(3)} deg under the "
        f"wrench {wrench[worst].round(3)}: the load is too large for these springs"
    )
