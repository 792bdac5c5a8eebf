"""The multi-segment virtual joint model: springs whose slope changes with the torque.

A joint under the torque tau turns by the odd, piecewise linear

    phi(tau) = sgn(tau) [c1 min(|tau|, T1) + c2 (min(|tau|, T2) - T1)+ + c3 (|tau| - T2)+],

as in catalogues of strain-wave gears. The measured deflection is the TCP's position with the load
minus its position without the load. Gravity preloads the gear in both:

    d = J_v [phi(tau_g + J^T w) - phi(tau_g)].

Given the breakpoints T it is linear in the slopes c >= 0. SI: rad, N, N m, m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from scipy.optimize import nnls

from stiff_models.physics.fitted_geometry import GeometryModel, Regressor
from stiff_models.physics.vjm import (
    identify_springs,
    stiffness_unit,
    warn_no_masses,
    warn_unexplained,
    warn_unidentifiable,
)
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import AT_TCP, joint_torque, motion_at
from stiff_protocols.springs.identification import spring_key, typical_joints

MAX_SWEEPS = 20
WORTH = 1e-9  # least relative fall of the residual to move a breakpoint: more than rounding


def search_breakpoints(finest: FloatArray, target: FloatArray, start: IntArray) -> IntArray:
    """Return the candidates with the least residual, moving one breakpoint at a time.

    A segment is a sum of the finest segments, so the samples are compressed once (QR). The cost of
    a trial does not depend on the number of samples.

    Args:
        finest: (n, m, n_joints, n_candidates + 1) reading [m] by each of the segments between
            neighbouring candidates at unit slope.
        target: (n, m) readings, m.
        start: (n_joints, n_breakpoints) candidates' numbers to start from, increasing; the
            returned numbers are also increasing.
    """
    _, _, n_joints, n_finest = finest.shape
    rows = finest.reshape(-1, n_joints * n_finest)
    # the target is the last column: its explained part, then its unexplained part
    augmented = np.column_stack([rows, target.reshape(-1)])
    compressed = np.asarray(np.linalg.qr(augmented, mode="r"))  # numpy's types omit this mode
    triangle, projected = compressed[:, :-1], compressed[:, -1]
    # columns where each joint's segments begin; the first segment begins at the joint's first
    first_columns = n_finest * np.arange(n_joints)[:, None]
    zeros = np.zeros(n_joints, dtype=np.int64)

    def residual(chosen: IntArray) -> float:
        first = first_columns + np.column_stack([zeros, chosen + 1])
        coarse = np.add.reduceat(triangle, first.ravel(), axis=1)
        size = np.linalg.norm(coarse, axis=0)
        size[size == 0.0] = 1.0  # no sample's torque lies in the segment
        return float(nnls(coarse / size, projected)[1])

    chosen, best = start, residual(start)
    for _ in range(MAX_SWEEPS):
        before = best
        for joint, number in np.ndindex(start.shape):
            around = [-1, *chosen[joint], n_finest - 1]
            for candidate in range(around[number] + 1, around[number + 2]):
                trial = chosen.copy()
                trial[joint, number] = candidate
                error = residual(trial)
                if error < best * (1.0 - WORTH):
                    best, chosen = error, trial
        if best == before:
            break
    return chosen


FIRST_SHARE = 0.25  # share of the training torques below the first breakpoint
CANDIDATE_SHARES = np.linspace(0.1, 0.9, 17)  # of the search: each end keeps a tenth of the samples


@dataclass(kw_only=True, eq=False, repr=False)
class MultiSegmentVjm(GeometryModel):
    """The multi-segment VJM as a model.

    The prior assumes similar segments of a joint. Geometry is fitted with breakpoints by quantile,
    unless they are given.

    Attributes:
        segments: stiffness segments per joint.
        breakpoints: end of each segment. "quantile" of the training samples' torques: a quarter
            lies in the first segment, and the other segments share the remainder evenly. "search"
            takes the quantiles with the least training residual (with few samples it follows
            their noise). "given" takes `given_breakpoints`.
        given_breakpoints: torques [N m] (forces [N] at a prismatic joint) for
            breakpoints="given", increasing: "10,30" for all joints, or a list per joint, base to
            tip: "10,30;12,35;...".
        gravity: preload of the gears by the weights; false for a balanced robot.
        breakpoints_: (n_joints, segments - 1) N m.
        springs_: identified springs, by names such as "A2 segment 1". Segments that no sample's
            torque reaches are left out.
        slopes_: (n_joints, segments) compliance of each segment, rad/(N m); the prior's if no
            sample's torque reaches the segment.
        diagnostics_: breakpoints, the report of `IdentifiedSprings`, and the fitted geometry, by
            name and unit.
    """

    segments: Annotated[int, Ge(2), Le(4)] = 2
    breakpoints: Literal["quantile", "search", "given"] = "quantile"
    given_breakpoints: str = ""
    gravity: bool = True

    def check_params(self) -> None:
        """Raise ConfigError if options contradict each other."""
        super().check_params()
        if self.breakpoints == "given":
            _parsed(self.given_breakpoints, self.segments)
        elif self.given_breakpoints:
            raise ConfigError(
                f"given_breakpoints {self.given_breakpoints!r} would be ignored: breakpoints is "
                f"{self.breakpoints!r}; use breakpoints='given'"
            )

    def check_robot(self, robot: Robot) -> None:
        """Raise ConfigError unless the given breakpoints are one list, or one per joint."""
        self.check_params()
        if self.breakpoints == "given":
            lists = len(_parsed(self.given_breakpoints, self.segments))
            if lists not in (1, robot.n_joints):
                raise ConfigError(
                    f"given_breakpoints {self.given_breakpoints!r} holds {lists} lists, expected "
                    f"1 for all joints or {robot.n_joints}, one per joint of {robot.name!r}"
                )

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self.check_robot(robot)
        regressor = self._regressor(robot, train.q, train.levers)
        train, robot = self._placed(train, robot, Robot.jacobian, regressor)
        at = robot, train.q, train.wrench, train.levers
        loaded = _loaded_joints(*at, gravity=self.gravity)
        self.breakpoints_ = self._breakpoints(loaded, train)
        if self.gravity:
            warn_no_masses(robot)
        springs = {
            f"{name} segment {k + 1}": stiffness_unit(kind)
            for name, kind in zip(robot.joint_names, robot.joint_types, strict=True)
            for k in range(self.segments)
        }
        matrix = loaded.effects(self.breakpoints_)
        typical = np.repeat(typical_joints(robot), self.segments)
        identified = identify_springs(springs, matrix.reshape(len(train), 3, -1), train, typical)
        self.springs_ = identified.take(loaded.parts(self.breakpoints_).any(axis=0).ravel())
        self.slopes_ = identified.compliance.reshape(robot.n_joints, self.segments)
        springs_report = _named(robot, self.breakpoints_) | self.springs_.report()
        self.diagnostics_ = springs_report | self._geometry_report()
        warn_unidentifiable(identified)
        warn_unexplained(identified.compliance, train)

    def _deflection(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        loaded = _loaded_joints(robot, q, wrench, levers, gravity=self.gravity)
        return np.asarray(np.einsum("nkis,is->nk", loaded.effects(self.breakpoints_), self.slopes_))

    def _regressor(self, robot: Robot, q: FloatArray, levers: FloatArray) -> Regressor:
        preload = robot.gravity_torque(q) if self.gravity else np.zeros((len(q), robot.n_joints))

        def regressor(twists: FloatArray, wrench: FloatArray) -> FloatArray:
            torque = preload + joint_torque(twists, wrench)
            loaded = _LoadedJoints(motion_at(twists, levers), preload, torque)
            return loaded.effects(self._usual_breakpoints(loaded)).reshape(len(q), 3, -1)

        return regressor

    def _usual_breakpoints(self, loaded: _LoadedJoints) -> FloatArray:
        """Return the (n_joints, segments - 1) breakpoints without a search, N m."""
        if self.breakpoints == "given":
            given = np.array(_parsed(self.given_breakpoints, self.segments))
            n_joints = loaded.torque.shape[1]
            return np.array(np.broadcast_to(given, (n_joints, self.segments - 1)))
        return loaded.quantiles(self._shares())

    def _shares(self) -> FloatArray:
        """Return the (segments - 1,) shares of the torques below each breakpoint."""
        return np.linspace(FIRST_SHARE, 1.0, self.segments)[:-1]

    def _breakpoints(self, loaded: _LoadedJoints, train: Samples) -> FloatArray:
        if self.breakpoints != "search":
            return self._usual_breakpoints(loaded)
        shares = self._shares()
        candidates = loaded.quantiles(CANDIDATE_SHARES)
        nearest = np.abs(CANDIDATE_SHARES - shares[:, None]).argmin(axis=1)
        start = np.tile(nearest, (len(candidates), 1))
        finest = train.read(loaded.effects(candidates))
        chosen = search_breakpoints(finest, train.values, start)
        return np.take_along_axis(candidates, chosen, axis=1)


def segment_torques(torque: FloatArray, breakpoints: FloatArray) -> FloatArray:
    """Return the (n, n_joints, segments) parts of (n, n_joints) torques [N m] in each segment.

    Phi is their sum times the slopes. `breakpoints` (n_joints, segments - 1) are positive and
    increasing; the parts have the sign of the torque.
    """
    edges = np.pad(breakpoints, ((0, 0), (1, 0)))
    width = np.diff(edges, axis=1, append=np.inf)
    size = np.clip(np.abs(torque)[..., None] - edges, 0.0, width)
    return np.asarray(np.sign(torque)[..., None] * size)


@dataclass(frozen=True, eq=False)
class _LoadedJoints:
    """J_v (n, 3, n_joints) of the points that were read, m/rad, and the joints' torques.

    Torques [N m] are without the load and with it.
    """

    move: FloatArray
    preload: FloatArray
    torque: FloatArray

    def effects(self, breakpoints: FloatArray) -> FloatArray:
        """Return the (n, 3, n_joints, segments) deflection [m] by each segment at unit slope."""
        return np.asarray(self.move[..., None] * self.parts(breakpoints)[:, None])

    def parts(self, breakpoints: FloatArray) -> FloatArray:
        """Return the (n, n_joints, segments) change of torque by the load in each segment, N m."""
        unloaded = segment_torques(self.preload, breakpoints)
        return np.asarray(segment_torques(self.torque, breakpoints) - unloaded)

    def quantiles(self, shares: FloatArray) -> FloatArray:
        """Return the (n_joints, n_shares) torques [N m] below which shares of |torque| lie."""
        return np.asarray(np.quantile(np.abs(self.torque), shares, axis=0).T)


def _loaded_joints(
    robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray, *, gravity: bool
) -> _LoadedJoints:
    rows = robot.jacobian(q)
    load = joint_torque(rows, wrench)
    preload = robot.gravity_torque(q) if gravity else np.zeros_like(load)
    return _LoadedJoints(motion_at(rows, levers), preload, preload + load)


def _parsed(text: str, segments: int) -> list[list[float]]:
    """Return the lists of `given_breakpoints`; ConfigError if a list is not valid."""
    if not text:
        raise ConfigError("breakpoints=given requires given_breakpoints, in N m")
    example = ",".join(str(20 * number) for number in range(1, segments))
    expectation = (
        f"expected {segments - 1} positive, increasing torques for {segments} segments, "
        f"e.g. '{example}' for all joints or '{example};{example};...' joint by joint"
    )
    lists = []
    for part in text.split(";"):
        try:
            torques = [float(word) for word in part.split(",")]
        except ValueError:
            raise ConfigError(f"given_breakpoints: {part!r}, {expectation}") from None
        increasing = all(a < b for a, b in zip([0.0, *torques], torques, strict=False))
        if len(torques) != segments - 1 or not increasing or not all(map(math.isfinite, torques)):
            raise ConfigError(f"given_breakpoints: {part!r}, {expectation}")
        lists.append(torques)
    return lists


def _named(robot: Robot, breakpoints: FloatArray) -> dict[str, float]:
    units = ("Nm" if kind == "revolute" else "N" for kind in robot.joint_types)
    return {
        spring_key("breakpoint", f"{name} {k}", unit): float(value)
        for name, unit, torques in zip(robot.joint_names, units, breakpoints, strict=True)
        for k, value in enumerate(torques, start=1)
    }
