"""Identify springs from measured deflections, with a prior for springs that data do not determine.

A deflection that is linear in the compliances is ``target = matrix @ compliance``. Least squares
assign deflections of well-determined springs to springs that the samples can hardly distinguish. A
stiffness may then be 10,000 times too small, and another infinite. Here the logarithms x of the
compliances have the posterior

    |matrix @ exp(x) - target|^2 / sigma^2 + |(x - x_0) - mean(x - x_0)|^2 / s^2 -> min.

sigma is the noise that the residuals of non-negative least squares show, and x_0 - mean(x_0) a
law of size: `typical_compliance`. The data determine the law's overall factor, so robots of any
size have the same prior. A spring is identifiable if the data contribute nine tenths of its
information. It gets its least-squares value without the prior; other springs keep the posterior's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import compress

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.robot import Robot

RANK_TOLERANCE = 1e-8
"""Columns shorter than this share of the longest count as zero, and so do singular values of the
column-scaled regressor: far above rounding, far below what instruments resolve."""

PRIOR_SPREAD = float(np.log(5.0))
"""s, of ln compliance about the law: three times the scatter of the KR10 (source paper), the
FANUC and the simulated arms about it, 0.25 to 0.5. With ln 30, mere noise gave a spring 1/500 of
its stiffness if two of seven joints moved."""

PRIOR_SHARE = 0.1
"""Largest share of the prior's variance that an identifiable spring keeps: the data contribute nine
tenths of its information. Its stiffness is known to a factor of 1.7 (standard deviation)."""

LARGEST_ERROR = float(np.sqrt(PRIOR_SHARE)) * PRIOR_SPREAD
"""Largest standard deviation of ln compliance of an identifiable spring."""

LEVER_EXPONENT = 1.0
"""Stiffness grows with the largest lever to this power: 1.28 fits the six joints of the KR10, 0.90
the FANUC's; 0.8 to 1.2 the simulated arms, whose gears are sized by torque."""

LEAST_LEVER = 0.05
"""Of a robot's largest: a joint is built for a tool, even if the TCP lies on its axis."""

LEAST_NOISE = 0.1
"""One residual of this share of the RMS deflection is added to those that were seen: as many
samples as springs leave none."""

LEVER_POSES = 256
CONVERGED = 1e-12  # relative: rounding, which machines differ in, decides no digit that counts
FARTHEST = 50.0  # of ln compliance from the start: exp() stays finite


@dataclass(frozen=True, eq=False, repr=False)
class Identified(BriefFields):
    """Compliances identified from samples, and what the samples can say of them.

    Attributes:
        compliance: (n_columns,) rad/(N m) or m/N; above 0, unless no spring explains anything.
        is_identified: (n_columns,) true if the data identify the spring; else its compliance is the
            prior's, corrected by the data.
        log_error: (n_columns,) standard deviation of ln compliance, the larger of two: of
            the posterior, and of the same where the samples of one pose err together.
        rank: how many combinations of springs the data identify.
        condition: condition number of the column-scaled regressor of the identifiable springs.
    """

    compliance: FloatArray
    is_identified: BoolArray
    log_error: FloatArray
    rank: int
    condition: float

    @property
    def stiffness(self) -> FloatArray:
        """1 / compliance; infinite for a spring found rigid, NaN where the data cannot tell."""
        with np.errstate(divide="ignore"):
            return np.where(self.is_identified, 1.0 / self.compliance, np.nan)

    @property
    def standard_error(self) -> FloatArray:
        """(n_columns,) of `stiffness`, to first order; NaN where that is not known or infinite."""
        finite = self.is_identified & (self.compliance > 0.0)
        stiffness = np.divide(1.0, self.compliance, where=finite, out=np.full(len(finite), np.nan))
        return np.asarray(stiffness * self.log_error)

    def interval(self, coverage: float = 0.9) -> FloatArray:
        """Return the (n_columns, 2) intervals of the true stiffnesses with this probability.

        Intervals of springs that are not identifiable are the prior's, narrowed by the data.
        """
        from scipy.special import ndtri  # takes a tenth of a second to import

        reach = float(ndtri(0.5 + coverage / 2.0)) * self.log_error
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ends = np.exp(np.stack([-reach, reach], axis=1)) / self.compliance[:, None]
        return np.asarray(ends)


SPRING_CURVE = "spring "
"""Begins the name of a curve of a fitted model that is a joint's spring."""


CONTRIBUTION = "contribution of"
"""Begins the name of the mean deflection by a group of springs; it is 0 if none is found."""


def spring_key(word: str, name: str, unit: str) -> str:
    """Return the name of a spring's number in a fit's report.

    >>> spring_key("stiffness", "A2", "Nm/rad")
    'stiffness A2 [Nm/rad]'
    """
    return f"{word} {name} [{unit}]"


LOW_END, HIGH_END = "90 % interval from", "90 % interval to"
"""In the names of the ends of a number's interval in a fit's report."""


def number_with_interval(name: str, unit: str, value: float, ends: FloatArray) -> dict[str, float]:
    """Return a number of a fit's report and the (2,) ends of its 90 % interval, by name."""
    low, high = ends.tolist()
    return {
        f"{name} [{unit}]": float(value),
        f"{name} {LOW_END} [{unit}]": low,
        f"{name} {HIGH_END} [{unit}]": high,
    }


def contributions(report: Mapping[str, float]) -> dict[str, tuple[float, float, float]]:
    """Return group -> its mean deflection and the ends of its interval [mm], from a fit's report.

    The ends are NaN where it has none. A group that is not found has the mean 0.
    """
    groups = {}
    for name, value in report.items():
        if name.startswith(CONTRIBUTION) and LOW_END not in name and HIGH_END not in name:
            group = name.removeprefix(f"{CONTRIBUTION} ").removesuffix(" [mm]")
            low, high = (
                report.get(spring_key(f"{CONTRIBUTION} {group}", end, "mm"), math.nan)
                for end in (LOW_END, HIGH_END)
            )
            groups[group] = (value, low, high)
    return groups


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedSprings(Identified):
    """Springs with names, in the order of the compliances.

    Attributes:
        names: such as "A2" or "A2 segment 1".
        units: of the stiffnesses, "Nm/rad" or "N/m".
    """

    names: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """Names of the springs that the data cannot identify."""
        return tuple(
            name
            for name, is_known in zip(self.names, self.is_identified, strict=True)
            if not is_known
        )

    def take(self, springs: BoolArray) -> IdentifiedSprings:
        """Return the chosen springs, (n_springs,), with the rank and condition of all springs."""
        return replace(
            self,
            compliance=self.compliance[springs],
            is_identified=self.is_identified[springs],
            log_error=self.log_error[springs],
            names=tuple(compress(self.names, springs)),
            units=tuple(compress(self.units, springs)),
        )

    def report(self) -> dict[str, float]:
        """Return stiffnesses, standard errors, 90 % intervals or the prior's, rank, condition."""
        numbers: dict[str, float] = {}
        interval = self.interval(0.9)
        for i, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            spring_numbers = {
                "stiffness": self.stiffness[i],
                "standard error": self.standard_error[i],
            }
            if self.is_identified[i]:
                spring_numbers[LOW_END], spring_numbers[HIGH_END] = interval[i]
            else:
                spring_numbers["prior stiffness"] = 1.0 / self.compliance[i]
            numbers |= {
                spring_key(word, name, unit): float(number)
                for word, number in spring_numbers.items()
            }
        return numbers | {"rank": float(self.rank), "condition number": self.condition}


@lru_cache(32)
def typical_joints(robot: Robot) -> FloatArray:
    """Return the (n_joints,) typical compliances of a robot's joints, up to one factor."""
    typical = typical_compliance(robot.jacobian(spread_positions(robot))[:, :3], robot.turns)
    typical.flags.writeable = False
    return typical


def spread_positions(robot: Robot) -> FloatArray:
    """Return (n, n_joints) positions all over the joint limits; half a turn where there are none.

    A slide without limits stands still.
    """
    far = np.where(robot.turns, np.pi, 0.0)
    lower = np.where(np.isfinite(robot.lower), robot.lower, -far)
    upper = np.where(np.isfinite(robot.upper), robot.upper, far)
    return np.random.default_rng(0).uniform(lower, upper, (LEVER_POSES, robot.n_joints))


def typical_compliance(move: FloatArray, turns: BoolArray) -> FloatArray:
    """Return typical compliances of robots, up to one factor, (n_springs,).

    The stiffness of joints grows with their largest lever. A slide deflects the TCP as much as the
    turn with the largest lever.

    Args:
        move: (n, 3, n_springs) how springs move the TCP at poses all over the joint limits, m/rad
            or m/m.
        turns: (n_springs,) whether they are turned (rad/(N m)); else they are moved along (m/N).
    """
    lever = np.linalg.norm(move, axis=1).max(axis=0)
    largest = float(lever[turns].max(initial=0.0)) or 1.0
    relative = np.maximum(lever / largest, LEAST_LEVER) ** -LEVER_EXPONENT
    return np.where(turns, relative, largest**2)


def identify(
    matrix: FloatArray, target: FloatArray, typical: FloatArray, pose: IntArray
) -> Identified:
    """Identify compliances.

    Args:
        matrix: (rows, n_columns) deflection by each spring at unit compliance.
        target: (rows,) measured deflection.
        typical: (n_columns,) typical compliances, up to one factor for all.
        pose: (rows,) number of the pose of each row, from 0: what no spring explains there is one
            error for all of its samples.

    Raises:
        ModelError: no spring can be identified (for example, every wrench is zero).
    """
    size = np.linalg.norm(matrix, axis=0)
    if not size.any():
        raise ModelError("no joint spring can be identified: no wrench turns any joint")
    fitted = least_compliance(matrix, target)
    if not fitted.any():  # a prior does not help against a wrench of the wrong sign
        no_errors = np.full(len(fitted), np.nan)
        is_known = size > RANK_TOLERANCE * size.max()
        return Identified(fitted, is_known, no_errors, int(is_known.sum()), np.nan)
    residual = target - matrix @ fitted
    free = max(len(target) - int((fitted > 0.0).sum()), 0)
    least = LEAST_NOISE**2 * float(target @ target) / len(target)
    noise = np.sqrt((float(residual @ residual) + least) / (free + 1))
    # the same sum of squares in as many rows as there are springs, and one
    rows = np.asarray(np.linalg.qr(np.column_stack([matrix, target]), mode="r")) / noise
    compliance, spread = _most_probable(rows[:, :-1], rows[:, -1], fitted, typical)
    inward = np.asarray(rows[:, :-1] * compliance)  # by ln compliance
    information = inward.T @ inward
    covariance = np.linalg.inv(information + spread.T @ spread)
    error = np.sqrt(np.diag(covariance))
    # To first order a soft spring hides what a stiff one in line with it may take of its share, so
    # those that are not identifiable are looked at when they are softer by the prior's spread.
    softer = np.where(error <= LARGEST_ERROR, 1.0, np.exp(PRIOR_SPREAD))
    scaled = information * softer * softer[:, None]
    shared = np.linalg.inv(scaled + spread.T @ spread)
    error = np.maximum(error, np.sqrt(np.diag(shared)))
    is_known = error <= LARGEST_ERROR
    if is_known.all():
        compliance = fitted if fitted.all() else compliance
    elif is_known.any():
        remaining_target = target - matrix[:, ~is_known] @ compliance[~is_known]
        refitted = least_compliance(matrix[:, is_known], remaining_target)
        compliance[is_known] = refitted if refitted.all() else compliance[is_known]
    residual = (target - matrix @ compliance) / noise
    scores = np.zeros((int(pose.max()) + 1, len(compliance)))
    np.add.at(scores, pose, matrix * compliance / noise * residual[:, None])
    together = covariance @ (scores.T @ scores + spread.T @ spread) @ covariance
    # rounding may leave a variance below 0
    error = np.maximum(error, np.sqrt(np.maximum(np.diag(together), 0.0)))
    needed = (1.0 / PRIOR_SHARE - 1.0) / PRIOR_SPREAD**2
    return Identified(
        compliance=compliance,
        is_identified=is_known,
        log_error=error,
        rank=int((np.linalg.eigvalsh(information) >= needed).sum()),
        condition=float(np.linalg.cond(matrix[:, is_known] / size[is_known]))
        if is_known.any()
        else np.nan,
    )


def _most_probable(
    matrix: FloatArray, target: FloatArray, fitted: FloatArray, typical: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the compliances that are the most probable, and the prior's part of the Jacobian.

    `matrix` and `target` are in units of the noise; `fitted` is the least-squares solution.
    """
    from scipy.optimize import least_squares  # takes half a second to import

    n = len(typical)
    spread = (np.eye(n) - 1.0 / n) / PRIOR_SPREAD  # of ln compliance, its mean left out
    explained = matrix @ typical
    factor = float(explained @ target / (explained @ explained))
    if factor <= 0.0:
        factor = float(np.median((fitted / typical)[fitted > 0.0]))
    usual = factor * typical
    near = np.clip(fitted, usual * np.exp(-2.0 * PRIOR_SPREAD), usual * np.exp(2.0 * PRIOR_SPREAD))
    start = np.where(fitted > 0.0, near, usual)
    away = np.log(start / usual)

    def compliance(x: FloatArray) -> FloatArray:
        return np.asarray(start * np.exp(np.clip(x, -FARTHEST, FARTHEST)))

    def residuals(x: FloatArray) -> FloatArray:
        return np.concatenate([matrix @ compliance(x) - target, spread @ (x + away)])

    def derivative(x: FloatArray) -> FloatArray:
        return np.concatenate([matrix * compliance(x), spread])

    optimum = least_squares(
        residuals,
        np.zeros(n),
        jac=derivative,
        method="lm",
        ftol=CONVERGED,
        xtol=CONVERGED,
        gtol=CONVERGED,
    )
    return compliance(optimum.x), np.asarray(spread)


Solver = Callable[[FloatArray, FloatArray], FloatArray]
"""Turns a column-scaled regressor (rows, columns) and a target (rows,) into a solution."""


def nonnegative(scaled: FloatArray, target: FloatArray) -> FloatArray:
    """Return the least-squares solution without negative entries; ModelError for none found."""
    from scipy.optimize import nnls

    try:
        return np.asarray(nnls(scaled, target)[0])
    except RuntimeError as error:
        raise ModelError(
            f"no compliances >= 0 were found for {scaled.shape[1]} springs: {error}"
        ) from error


def least_compliance(
    matrix: FloatArray, target: FloatArray, solver: Solver = nonnegative
) -> FloatArray:
    """Return the (n_columns,) least-squares compliances; 0 of columns next to zero.

    The columns of the matrix differ by orders of magnitude from base to tip, so they are scaled
    to unit length. Arguments as `identify`.
    """
    size = np.linalg.norm(matrix, axis=0)
    turned = size > RANK_TOLERANCE * size.max()  # False: no sample bends this spring
    compliance = np.zeros(matrix.shape[1])
    if turned.any():
        scaled = matrix[:, turned] / size[turned]
        compliance[turned] = solver(scaled, target) / size[turned]
    return compliance
