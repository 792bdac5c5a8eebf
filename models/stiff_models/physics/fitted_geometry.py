"""Estimate the measured point of the tool together with the springs.

A deflection belongs to the point of the tool that the instrument measured. The force acts at a
real point, too. A robot's card may name another TCP. With springs c, a point p of the last link
has, under a force F at the point f, the deflection

    d = J_v(p) diag(c) J(f)^T (F, T),    J_v(p) = J_v(t) + J_w x R (p - t)

with the given TCP t, the rotational rows J_w, the last link's orientation R and p, f, t in its
frame. `tcp=fit` moves both points together, p = f; `lever=fit` moves only f, p = t. For each point
the least-squares compliances follow (variable projection, Golub and Pereyra 1973). So the search
has three coordinates.

The fitted point compensates for errors of the springs. It improves predictions, but it is not the
true TCP.
SI: rad, N, N m, m.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar, Literal, cast

import numpy as np
from annotated_types import Gt

from stiff_models.fitted_model import FittedModel
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import AT_TCP, motion_at
from stiff_protocols.springs.identification import (
    LEAST_NOISE,
    least_compliance,
    number_with_interval,
)

Tcp = Literal["given", "fit", "prior"]
Lever = Literal["given", "fit"]
Moves = Literal["tcp", "force"]

Regressor = Callable[[FloatArray, FloatArray], FloatArray]
"""Turns (n, 6, n_springs) twists of the TCP by a unit motion of each spring and (n, 6) wrenches at
the TCP into (n, 3, n_columns) deflections at unit compliance."""

FIT_SIGMA = 0.5
"""m, standard deviation of each coordinate about the given point under "fit": no tool is larger.
If the samples determine the point, it changes nothing; else the point stays near the given one."""

ROUNDS = 3
"""Number of searches, each with the residual noise of the previous search."""
STEP = 1e-5  # m, of the differences
CONVERGED = 1e-7  # relative
INTERVAL = 0.9


@dataclass(frozen=True, eq=False)
class Geometry:
    """The measured point of the tool, and the point where the force acts.

    Attributes:
        robot: robot with the measured point as its TCP.
        lever: (3,) from the measured point to the force's point, last joint's frame, m.
        covariance: (3, 3) of the fitted coordinates, last joint's frame, m².
        given: (3,) TCP of the robot's card, last joint's frame, m.
    """

    robot: Robot
    lever: FloatArray
    covariance: FloatArray
    given: FloatArray

    @property
    def point(self) -> FloatArray:
        """(3,) fitted point in the last joint's frame, m."""
        return np.asarray(self.robot.tcp + self.lever)

    def wrench_at_tcp(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return (n, 6) wrenches at the TCP equivalent to wrenches at the force's point."""
        return moved_wrench(wrench, _turned(self.robot, q, self.lever))

    def samples_at_tcp(self, samples: Samples) -> Samples:
        """Return the samples with their wrenches at the robot's TCP."""
        return replace(samples, wrench=self.wrench_at_tcp(samples.q, samples.wrench))

    def interval(self, coverage: float = INTERVAL) -> FloatArray:
        """Return (3, 2) ends of each coordinate's interval, frame of the robot's flange, m."""
        from scipy.special import ndtri

        turn = self.robot.flange[:3, :3]
        spread = np.sqrt(np.diag(turn.T @ self.covariance @ turn))
        reach = float(ndtri(0.5 + coverage / 2.0)) * spread
        middle = self.point_on_flange
        return np.stack([middle - reach, middle + reach], axis=1)

    @property
    def point_on_flange(self) -> FloatArray:
        """(3,) fitted point in the frame of the robot's flange, as for `--tcp`, m."""
        return replace(self.robot, tcp=self.point).tcp_on_flange

    def report(self) -> dict[str, float]:
        """Return the fitted point with 90 % intervals and its distance from the given one, mm."""
        word = "force" if self.lever.any() else "TCP"
        numbers: dict[str, float] = {}
        for axis, value, ends in zip("xyz", self.point_on_flange, self.interval(), strict=True):
            name = f"fitted geometry, {word} {axis}"
            numbers |= number_with_interval(name, "mm", 1e3 * value, 1e3 * ends)
        distance = float(np.linalg.norm(self.point - self.given))
        return numbers | {f"fitted geometry, {word} from the given [mm]": 1e3 * distance}


def moved_wrench(wrench: FloatArray, lever: FloatArray) -> FloatArray:
    """Return (n, 6) wrenches at a new reference point.

    `lever` (n, 3) leads from the new point to the old point, base frame, m.
    """
    force, torque = wrench[:, :3], wrench[:, 3:]
    return np.hstack([force, torque + np.cross(lever, force)])


def moved_twists(twists: FloatArray, lever: FloatArray) -> FloatArray:
    """Return (n, 6, n_springs) twists of a new point of the tool.

    `lever` (n, 3) leads from the old point to the new point, base frame, m.
    """
    return np.concatenate([motion_at(twists, lever), twists[:, 3:]], axis=1)


def fitted_geometry(
    samples: Samples,
    robot: Robot,
    twists: FloatArray,
    regressor: Regressor,
    *,
    moves: Moves = "tcp",
    sigma: float = FIT_SIGMA,
) -> Geometry:
    """Estimate the measured point, or the force's point, together with a model's compliances.

    Gauss-Newton steps from the given point minimise a sum of two squared terms. The first is the
    residuals of non-negative least squares, in units of their noise. The second is the distance
    from the given point, in units of `sigma`.

    Args:
        samples: training samples.
        robot: robot with the given TCP.
        twists: (n, 6, n_springs) of the given TCP by a unit motion of each spring, base frame.
        regressor: regressor of the model, linear in its compliances.
        moves: "tcp" moves the measured point and the force's point together; "force" moves only
            the force's point.
        sigma: standard deviation of each coordinate about the given point, m.

    Raises:
        ModelError: compliances cannot be found.
    """
    problem = _Problem(samples, robot.forward(samples.q).rotation, twists, regressor, moves)
    offset = np.zeros(3)
    for _ in range(ROUNDS):
        noise = problem.noise(offset)
        offset = problem.searched(offset, noise, sigma)
    covariance = problem.covariance(offset, problem.noise(offset), sigma)
    if moves == "force":
        return Geometry(robot, offset, covariance, robot.tcp)
    return Geometry(replace(robot, tcp=robot.tcp + offset), np.zeros(3), covariance, robot.tcp)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The residuals as a function of the point's offset (3,) from the given one [m]."""

    samples: Samples
    rotation: FloatArray
    twists: FloatArray
    regressor: Regressor
    moves: Moves

    def matrix(self, offset: FloatArray) -> FloatArray:
        """Return the model's (k, n_columns) regressor of the k numbers that were read."""
        lever, twists, wrench = self.rotation @ offset, self.twists, self.samples.wrench
        if self.moves == "force":
            wrench = moved_wrench(wrench, lever)
        else:
            twists = moved_twists(twists, lever)
        return self.samples.read(self.regressor(twists, wrench))[self.samples.is_read]

    @cached_property
    def measured(self) -> FloatArray:
        """(k,) numbers that were read, m."""
        return np.asarray(self.samples.values[self.samples.is_read])

    def fitted(self, offset: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the regressor, its compliances, and their (k,) residuals."""
        matrix, measured = self.matrix(offset), self.measured
        compliance = least_compliance(matrix, measured)
        return matrix, compliance, measured - matrix @ compliance

    def slopes(self, offset: FloatArray) -> FloatArray:
        """Return the (k, 3) derivatives of the residuals by the offset, compliances refitted.

        From the change at constant compliances, the part that non-rigid springs can follow is
        subtracted (Kaufman 1975).
        """
        matrix, compliance, _ = self.fitted(offset)
        shifted = [self.matrix(offset + STEP * axis) for axis in np.eye(3)]
        changes = [(matrix - moved) @ compliance / STEP for moved in shifted]
        change = np.stack(changes, axis=1)
        active = matrix[:, compliance > 0.0]
        basis = np.linalg.qr(active / np.linalg.norm(active, axis=0))[0]
        return np.asarray(change - basis @ (basis.T @ change))

    def noise(self, offset: FloatArray) -> float:
        """Return the standard deviation of the residuals [m], as in identification."""
        _, compliance, residual = self.fitted(offset)
        measured = self.measured
        free = max(len(measured) - int((compliance > 0.0).sum()) - len(offset), 0)
        least = LEAST_NOISE**2 * float(measured @ measured) / len(measured)
        return float(np.sqrt((residual @ residual + least) / (free + 1)))

    def searched(self, start: FloatArray, noise: float, sigma: float) -> FloatArray:
        """Return the most probable offset for a noise and a prior's standard deviation, m."""
        from scipy.optimize import least_squares

        if not noise:  # every deflection is zero
            return start

        def residuals(offset: FloatArray) -> FloatArray:
            return np.concatenate([self.fitted(offset)[2] / noise, offset / sigma])

        def derivative(offset: FloatArray) -> FloatArray:
            return np.concatenate([self.slopes(offset) / noise, np.eye(3) / sigma])

        optimum = least_squares(
            residuals, start, jac=derivative, x_scale=0.1, ftol=CONVERGED, xtol=CONVERGED
        )
        return np.asarray(optimum.x)

    def covariance(self, offset: FloatArray, noise: float, sigma: float) -> FloatArray:
        """Return the (3, 3) covariance [m²] of the offset.

        It is the larger of two: with independent errors, and with a common error per pose.
        """
        prior = np.eye(3) / sigma**2
        if not noise:
            return np.asarray(sigma**2 * np.eye(3))
        slopes = self.slopes(offset) / noise
        residual = self.fitted(offset)[2] / noise
        independent = np.linalg.inv(slopes.T @ slopes + prior)
        pose = self.samples.pose_of_number
        scores = np.zeros((int(pose.max()) + 1, 3))
        np.add.at(scores, pose, slopes * residual[:, None])
        by_pose = independent @ (scores.T @ scores + prior) @ independent
        return max(independent, by_pose, key=np.trace)


@dataclass(kw_only=True, eq=False, repr=False)
class GeometryModel(FittedModel):
    """Base of the models whose measured point can be fitted.

    Attributes:
        tcp: measured point, where the force acts too: "given" by the robot's card, "fit" together
            with the springs, or "prior": fitted with a normal prior about the given point.
        tcp_sigma_mm: standard deviation of that prior, per coordinate, mm.
        lever: point where the force acts, with tcp="given": the measured point ("given"), or a
            fitted point ("fit").
        geometry_: fitted geometry; None if no point was fitted.
    """

    tcp: Tcp = "given"
    tcp_sigma_mm: Annotated[float, Gt(0)] = 50.0
    lever: Lever = "given"

    takes_directions: ClassVar[bool] = True
    takes_levers: ClassVar[bool] = True
    added_later: ClassVar[tuple[str, ...]] = ("tcp", "tcp_sigma_mm", "lever")
    geometry_ = cast("Geometry | None", None)

    def check_params(self) -> None:
        """Raise ConfigError if both the force's point and the measured point are to be fitted."""
        if self.lever == "fit" and self.tcp != "given":
            raise ConfigError(
                f"lever='fit' fits only the force's point, but tcp={self.tcp!r} moves it with the "
                "measured point; use tcp='given' with lever='fit'"
            )

    @property
    def fits_point(self) -> bool:
        """Return whether a point is estimated."""
        return not self.tcp == self.lever == "given"

    @property
    def moves(self) -> Moves:
        """Return "force" if only the force's point is estimated, else "tcp"."""
        return "force" if self.lever == "fit" else "tcp"

    @property
    def sigma(self) -> float:
        """Return the prior's standard deviation of each coordinate, m."""
        return 1e-3 * self.tcp_sigma_mm if self.tcp == "prior" else FIT_SIGMA

    def predict_at_tcp(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of the robot's TCP under wrenches that act there.

        `predict` returns the deflection of the measured point. For a rigid tool, the model's
        equation at the TCP also holds. Arguments and errors are the same as for `predict`.
        """
        return self.predict_at_point(q, wrench, self.robot_.tcp)

    def predict_at_point(self, q: FloatArray, wrench: FloatArray, point: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of a point of the tool; see `StiffnessModel`."""
        q, wrench = self._checked(q, wrench)
        robot = replace(self.robot_, tcp=point)
        return self._deflection(robot, q, wrench) if len(q) else np.empty((0, 3))

    def predict_reading(
        self, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        """Return the (n, 3) deflection [m] of the points of levers; see `StiffnessModel`."""
        if not levers.size:
            return self.predict(q, wrench)
        self._check_point_is_given(levers)
        q, wrench = self._checked(q, wrench)
        robot, wrench = self._at_measured_point(q, wrench)
        return self._deflection(robot, q, wrench, levers)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        robot, wrench = self._at_measured_point(q, wrench)
        return self._deflection(robot, q, wrench)

    def _at_measured_point(self, q: FloatArray, wrench: FloatArray) -> tuple[Robot, FloatArray]:
        """Return the robot with the measured point as its TCP, and the (n, 6) wrenches there."""
        if self.geometry_ is None:
            return self.robot_, wrench
        return self.geometry_.robot, self.geometry_.wrench_at_tcp(q, wrench)

    def _deflection(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        """Return the (n, 3) deflection [m] of points under wrenches at a robot's TCP.

        `levers` (n, 3) lead from that TCP to the points, base frame, m; empty: the TCP.
        """
        raise NotImplementedError

    def _placed(
        self,
        train: Samples,
        robot: Robot,
        twists_of: Callable[[Robot, FloatArray], FloatArray],
        regressor: Regressor,
    ) -> tuple[Samples, Robot]:
        """Fit the geometry; return the samples with wrenches at the TCP of the returned robot.

        Arguments are the same as for `fitted_geometry`; `twists_of` returns the twists at joint
        positions. ConfigError: the measured point is to be fitted, but the samples state it.
        """
        self.check_params()
        self.geometry_ = None
        if not self.fits_point:
            return train, robot
        self._check_point_is_given(train.levers)
        twists = twists_of(robot, train.q)
        self.geometry_ = fitted_geometry(
            train, robot, twists, regressor, moves=self.moves, sigma=self.sigma
        )
        return self.geometry_.samples_at_tcp(train), self.geometry_.robot

    def _check_point_is_given(self, levers: FloatArray) -> None:
        if levers.size and self.tcp != "given":
            raise ConfigError(
                f"tcp={self.tcp!r} fits the measured point, but the samples state the points that "
                "were read; use tcp='given'"
            )

    def _geometry_report(self) -> dict[str, float]:
        return self.geometry_.report() if self.geometry_ else {}


def _turned(robot: Robot, q: FloatArray, offset: FloatArray) -> FloatArray:
    """Return an offset (3,) of the last joint's frame in the base frame, (n, 3)."""
    if not offset.any():
        return np.zeros((len(q), 3))
    return np.asarray(robot.forward(q).rotation @ offset)
