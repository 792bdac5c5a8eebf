"""Which mistake would explain measured samples: a table of hypotheses.

A wrench in the wrong frame or a joint of the wrong sign fits no model, and nothing in the file
says why. Each hypothesis undoes one mistake; the linear virtual joint model (one spring a joint, no
negative compliance, no prior) is cross-validated by pose on what it makes of the samples.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import nnls

from stiff_datasets.measured.identifiability import unit_deflections
from stiff_datasets.measured.sample_files import DEG_PER_RAD
from stiff_protocols.contract.identification import RANK_TOLERANCE
from stiff_protocols.contract.types import AXES, BoolArray, FloatArray, IntArray, Robot, Samples

POINT_GAIN, GAIN, RARE_GAIN = 0.05, 0.1, 0.15
"""Shares by which a hypothesis must lower the RMS residual: another point of the torques, any
other, units and odd orders of axes. The most in clean data of 30 poses was 0.10, by less weight on
the torques."""
CLEARLY = 2.0
"""Standard errors over poses by which it must lower the squared residual."""
AS_GOOD, NEARLY_AS_GOOD = 1.02, 1.13
"""Of hypotheses that leave so many times the lowest RMS residual, the likeliest is named; and those
that cannot be told apart from it with certainty are named beside it."""
ROUNDING = 1e-12
"""m: of noise-free data the residuals are rounding, which ranks no hypothesis."""
EXPLAINS = 0.9
"""Share of the squared deflection that must be explained once the named mistake is undone, or it
is another: joint springs explain 0.94 of the FANUC measurement and at least 0.93 of ten specimens
each of the shipped twins."""
SOUND = 0.995
"""Where joint springs explain this share, free numbers would be fitted to what links give."""
USUAL_SAG = 2e-3
"""rad; how far the joint that gives way most turns under the arm's own weight. 2 to 2.8e-3 in all
specimens of the shipped twins."""
UNUSUAL = 5.0
"""A robot that is so many times as compliant or stiff as usual is in another unit."""
FOLDS, FEWEST_POSES = 10, 10
BLOCKS, BLOCK_ROWS = 10, 100
"""Of a longer file so many blocks of rows are compared, spread evenly: a mistake shows in them."""
STEPS, MORE_STEPS = 10, 3
"""Of Gauss-Newton, for all samples, and from there for a part of them."""
GRAVITY = 9.81  # m/s2
UP = np.array([0.0, 0.0, 1.0])
LOAD = ("force", "torque")
UNITS = {
    ("", "N mm"): (1.0, 1e-3),
    ("kg", ""): (GRAVITY, 1.0),
    ("kg", "N mm"): (GRAVITY, 1e-3),
    ("kN", ""): (1000.0, 1.0),
}
"""Of forces and torques in the file, where they are not N and N m -> factors to N and N m."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Samples as a hypothesis reads them; SI, base frame.

    Attributes:
        robot: that was measured.
        q: (n, n_joints) rad or m.
        force, torque: (n, 3) N and N m at the TCP.
        deflection: (n, 3) m.
        jacobian: (n, 6, n_joints) at the TCP, linear part first.
        flange: (n, 3, 3) orientation of the last link.
        lever: (n, 3) from the last link's origin to the TCP, m.
        tcp: (n, 3) position of the TCP, m.
    """

    robot: Robot
    q: FloatArray
    force: FloatArray
    torque: FloatArray
    deflection: FloatArray
    jacobian: FloatArray
    flange: FloatArray
    lever: FloatArray
    tcp: FloatArray

    def at(self, q: FloatArray) -> Reading:
        """Return the same samples at other joint positions."""
        return reading(self.robot, q, np.hstack([self.force, self.torque]), self.deflection)

    def take(self, rows: BoolArray) -> Reading:
        """Return some of the samples."""
        arrays = {name: value for name, value in vars(self).items() if name != "robot"}
        return Reading(self.robot, **{name: value[rows] for name, value in arrays.items()})

    def regressor(self) -> FloatArray:
        """Return (n, 3, n_joints) the deflection by each joint at unit compliance."""
        return unit_deflections(self.jacobian, np.hstack([self.force, self.torque]))


def reading(robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray) -> Reading:
    """Return samples, as their file has them, with the kinematics of their joint positions."""
    poses = robot.forward(q)
    return Reading(
        robot=robot,
        q=q,
        force=wrench[:, :3],
        torque=wrench[:, 3:],
        deflection=deflection,
        jacobian=robot.jacobian_at(poses),
        flange=poses.rotation @ robot.flange[:3, :3],
        lever=poses.rotation @ (robot.tcp - robot.flange[:3, 3]),
        tcp=poses.points[:, -1],
    )


@dataclass(frozen=True)
class Fitted:
    """A hypothesis with free numbers.

    Attributes:
        text: with places for them in a unit that a user knows.
        change: what (n_free,) of them, SI, make of the samples.
        n_free: how many.
        must_gain: share by which it must lower the RMS residual; more than without free numbers,
            which also take up what joint springs leave of data without a mistake.
        unit: factor from SI to the unit of the text.
        positive: the first of them is.
    """

    text: str
    change: Callable[[Reading, FloatArray], Reading]
    n_free: int
    must_gain: float
    unit: float = 1.0
    positive: bool = False


@dataclass(frozen=True, eq=False)
class Fit:
    """The virtual joint model cross-validated under a hypothesis.

    Attributes:
        text: the hypothesis.
        squares: (n,) squared length of each residual, m2.
        reading: the samples as it reads them.
        must_gain: share by which it must lower the RMS residual.
    """

    text: str
    squares: FloatArray
    reading: Reading
    must_gain: float = 0.0

    @property
    def rms(self) -> float:
        """Root mean square length of the residual, m; see `_rms`."""
        return _rms(self.squares)

    @property
    def score(self) -> float:
        """The RMS residual, m, made larger by what it must gain: of two the lower is better."""
        return self.rms / (1.0 - self.must_gain)

    @property
    def explained(self) -> float:
        """Share of the squared deflection that is explained; 0 where that is worse than none."""
        size = (self.reading.deflection**2).sum()
        return max(float(1.0 - self.squares.sum() / size), 0.0) if size else 0.0


@dataclass(frozen=True)
class Diagnosis:
    """What cross-validation says of samples.

    Attributes:
        given: under no hypothesis.
        best: under one that explains them clearly better; None: there is none.
        ties: texts of others that explain them as well.
    """

    given: Fit
    best: Fit | None = None
    ties: tuple[str, ...] = ()


def diagnose(
    samples: Samples, robot: Robot, *, joints_only: bool = False, may_fit: bool = True
) -> Diagnosis:
    """Compare the samples as they are with every hypothesis.

    The best must lower the RMS residual by more than 5 to 30 % (`must_gain`), the squared
    residual by more than two standard errors of the difference, summed by pose, because the
    loads of a pose share their errors (the test of Q. Vuong, Econometrica 57, 1989, between models
    that do not contain each other), and explain nearly as much as joint springs do of sound data.
    Of those that are as good, the likeliest is named that leaves stiffnesses of a usual size.

    Args:
        samples: the data; fewer than ten poses are compared with nothing.
        robot: that was measured.
        joints_only: try only what may be wrong with the joint positions.
        may_fit: try hypotheses with free numbers, too.
    """
    some = samples
    if len(samples) > BLOCKS * BLOCK_ROWS:
        starts = np.linspace(0, len(samples) - BLOCK_ROWS, BLOCKS).astype(np.int64)
        some = samples.take((starts[:, None] + np.arange(BLOCK_ROWS)).reshape(-1))
    pose = np.asarray(np.unique(some.pose_id, return_inverse=True)[1])
    data = reading(robot, some.q, some.wrench, some.deflection)
    n_poses = int(pose.max()) + 1
    fold = np.random.default_rng(0).permutation(n_poses)[pose] % FOLDS
    given = _fit("", data, fold)
    if n_poses < FEWEST_POSES:
        return Diagnosis(given)
    better = _better(data, given, pose, fold, joints_only, may_fit)
    if _size(data) == "usual":  # what makes it unusual is no mistake undone
        better = [fit for fit in better if _size(fit.reading) != "unusual"]
    lowest = min((fit.score for fit in better), default=0.0)
    close = [fit for fit in better if fit.score <= NEARLY_AS_GOOD * lowest]
    best = min(close, key=functools.partial(_unlikely, AS_GOOD * lowest), default=None)
    close = sorted((fit for fit in close if fit is not best), key=lambda fit: fit.score)
    return Diagnosis(given, best, tuple(fit.text for fit in close))


def _better(
    data: Reading,
    given: Fit,
    pose: IntArray,
    fold: IntArray,
    joints_only: bool,
    may_fit: bool,
) -> list[Fit]:
    """Return the hypotheses that are better, the likeliest first; not those far from the best.

    Least squares leave no less of rows that were left out than of rows that were fitted: the
    residual without cross-validation is a bound, and settles most hypotheses.
    """
    tried: list[tuple[float, int, Callable[[], Fit]]] = []
    for text, each, gain in readings(data, joints_only):
        plain = functools.partial(_fit, text, each, fold, gain)
        tried.append((_rms_of_all(each) / (1.0 - gain), len(tried), plain))
    may_fit = may_fit and not joints_only and given.explained < SOUND
    for free in FITTED if may_fit else ():
        numbers = _fitted(free, data, np.zeros(free.n_free))
        if numbers[0] > 0.0 or not free.positive:
            bound = _rms_of_all(free.change(data, numbers)) / (1.0 - free.must_gain)
            fitted = functools.partial(_fit_free, free, numbers, data, fold)
            tried.append((bound, len(tried), fitted))
    most = given.rms
    found: dict[int, Fit] = {}
    for bound, order, cross_validate in sorted(tried, key=lambda each: each[:2]):
        if bound > most:
            break
        fit = cross_validate()
        if fit.explained > EXPLAINS and _clearly_better(fit, given, pose):
            found[order] = fit
            most = min(most, NEARLY_AS_GOOD * fit.score)
    return [found[order] for order in sorted(found)]


def _rms_of_all(data: Reading) -> float:
    """Return the RMS residual of joint springs fitted to all samples, m."""
    residual = data.deflection - data.regressor() @ compliances(data)
    return _rms((residual**2).sum(axis=1))


def _rms(squares: FloatArray) -> float:
    """Return the root of the mean of (n,) squared lengths [m2], m; not less than `ROUNDING`."""
    return max(float(np.sqrt(squares.mean())), ROUNDING)


def softness(data: Reading, compliance: FloatArray) -> float:
    """Return how many times as compliant as usual the joints are; 0 where nothing says so.

    Args:
        data: the samples.
        compliance: (n_joints,) rad/(N m), m/N.
    """
    torque = np.abs(data.robot.gravity_torque(data.q[:1000]))
    sag = (torque.max(axis=0) * compliance)[data.robot.turns]
    return float(sag.max(initial=0.0) / USUAL_SAG)


def _unlikely(as_good: float, fit: Fit) -> tuple[bool, bool, bool]:
    """Return what speaks against a hypothesis, the strongest first.

    Stiffnesses of another order of magnitude, a score above `as_good`, a negative stiffness.
    """
    negative = bool(clearly_negative(fit.reading).any())
    return _size(fit.reading) == "unusual", fit.score > as_good, negative


def _size(data: Reading) -> Literal["usual", "unusual", "unknown"]:
    """Say whether the joints' stiffnesses are of a robot's usual size."""
    factor = softness(data, compliances(data))
    if factor == 0.0:
        return "unknown"
    return "usual" if 1.0 / UNUSUAL < factor < UNUSUAL else "unusual"


def compliances(data: Reading) -> FloatArray:
    """Return (n_joints,) compliances by least squares, none negative; rad/(N m), m/N."""
    return _solved(*_normal_equations(data.regressor(), data.deflection))


def clearly_negative(data: Reading) -> BoolArray:
    """Return (n_joints,) which compliances least squares put below zero, and not by chance."""
    matrix = data.regressor().reshape(-1, data.q.shape[1])
    size = np.linalg.norm(matrix, axis=0)
    size[size <= RANK_TOLERANCE * size.max()] = np.inf  # no load turns it
    inverse = np.linalg.pinv(matrix / size)
    compliance = inverse @ data.deflection.reshape(-1)
    residual = data.deflection.reshape(-1) - matrix / size @ compliance
    error = np.linalg.norm(inverse, axis=1) * residual.std()
    return np.asarray(compliance < -CLEARLY * error)


def _clearly_better(fit: Fit, given: Fit, pose: IntArray) -> bool:
    gain = np.bincount(pose, given.squares - fit.squares)  # (n_poses,)
    clear = gain.sum() > CLEARLY * np.sqrt(len(gain)) * gain.std(ddof=1)
    return bool(clear and fit.score < given.rms)


def _squares(data: Reading, fold: IntArray) -> FloatArray:
    """Return (n,) the squared length of each residual when its fold (n,) is left out."""
    matrix = data.regressor()
    parts = [_normal_equations(matrix[fold == i], data.deflection[fold == i]) for i in range(FOLDS)]
    grams, rights = (np.array(each) for each in zip(*parts, strict=True))
    found = [_solved(grams.sum(0) - grams[i], rights.sum(0) - rights[i]) for i in range(FOLDS)]
    predicted = (matrix @ np.array(found)[fold][:, :, None])[:, :, 0]
    return np.asarray(((data.deflection - predicted) ** 2).sum(axis=1))


def _fit(text: str, data: Reading, fold: IntArray, must_gain: float = 0.0) -> Fit:
    return Fit(text, _squares(data, fold), data, must_gain)


def _fit_free(hypothesis: Fitted, numbers: FloatArray, data: Reading, fold: IntArray) -> Fit:
    """Cross-validate a hypothesis whose numbers are fitted on the training folds, too."""
    squares = np.empty(len(fold))
    for i in np.unique(fold):
        training = data.take(fold != i)
        of_fold = _fitted(hypothesis, training, numbers, MORE_STEPS)
        found = compliances(hypothesis.change(training, of_fold))
        tested = hypothesis.change(data.take(fold == i), of_fold)
        squares[fold == i] = ((tested.deflection - tested.regressor() @ found) ** 2).sum(axis=1)
    text = hypothesis.text.format(*(numbers * hypothesis.unit))
    return Fit(text, squares, hypothesis.change(data, numbers), hypothesis.must_gain)


def _fitted(
    hypothesis: Fitted, data: Reading, numbers: FloatArray, steps: int = STEPS
) -> FloatArray:
    """Return (n_free,) the numbers that fit best, by Gauss-Newton from `numbers`."""
    step = 1e-3
    for _ in range(steps):
        changed = hypothesis.change(data, numbers)
        matrix, found = changed.regressor(), compliances(changed)
        residual = changed.deflection - matrix @ found
        slopes = []
        for unit in np.eye(hypothesis.n_free):
            moved = hypothesis.change(data, numbers + step * unit)
            slopes.append((residual - moved.deflection + moved.regressor() @ found) / step)
        design = np.concatenate([np.stack(slopes, axis=-1), matrix], axis=-1)
        design = design.reshape(-1, design.shape[-1])
        size = np.linalg.norm(design, axis=0)
        size[size == 0.0] = 1.0
        change = np.linalg.lstsq(design / size, residual.reshape(-1))[0] / size
        change = change[: hypothesis.n_free]
        trials = (numbers + share * change for share in (1.0, 0.5, 0.25))
        numbers = min(trials, key=lambda each: _rms_of_all(hypothesis.change(data, each)))
        if np.linalg.norm(change) < 1e-3 * np.linalg.norm(numbers):
            break
    return numbers


def _normal_equations(matrix: FloatArray, deflection: FloatArray) -> tuple[FloatArray, FloatArray]:
    flat = matrix.reshape(-1, matrix.shape[-1])
    return flat.T @ flat, flat.T @ deflection.reshape(-1)


def _solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Return what solves normal equations without a negative number."""
    size = np.sqrt(np.diagonal(gram))
    if not size.any():  # no load
        return np.zeros_like(right)
    size = np.where(size > 0.0, size, 1.0)
    values, axes = np.linalg.eigh(gram / np.outer(size, size))
    kept = values > 1e-12 * values[-1]
    root, axes = np.sqrt(values[kept]), axes[:, kept]
    return np.asarray(nnls((axes * root).T, (axes / root).T @ (right / size))[0] / size)


def readings(data: Reading, joints_only: bool = False) -> list[tuple[str, Reading, float]]:
    """Return every hypothesis without free numbers, what it makes of the samples, and `must_gain`.

    The likeliest come first.
    """
    kinds = [(_joints, GAIN)]
    if not joints_only:
        kinds = [(_points, POINT_GAIN), (_wrenches, GAIN), (_units, RARE_GAIN), *kinds]
        kinds += [(_axes, GAIN), (_rows, GAIN)]
    return [
        (text, each, RARE_GAIN if "taken from" in text else gain)  # an odd order of axes
        for made, gain in kinds
        for text, each in made(data).items()
    ]


def _points(data: Reading) -> dict[str, Reading]:
    points = {"flange": data.lever, "base": data.tcp} if data.torque.any() else {}
    return {
        f"the torques look as if they were taken about the {name}, not the TCP": replace(
            data, torque=data.torque - np.cross(point, data.force)
        )
        for name, point in points.items()
    }


def _wrenches(data: Reading) -> dict[str, Reading]:
    to_base = functools.partial(_turned, data.flange)
    found = {
        "the wrench looks as if it had the opposite sign (the reaction? or is the deflection "
        "unloaded minus loaded?)": _changed(data, np.negative, *LOAD),
        "the wrench looks as if it were expressed in the flange frame": _changed(
            data, to_base, *LOAD
        ),
    }
    if (data.deflection >= 0.0).all():
        found["the deflections look as if they had lost their signs"] = _signed(data)
    if data.torque.any():
        opposite = _changed(data, np.negative, "torque")
        found["the torques look as if they had the opposite sign"] = opposite
        for name in ("torque", "force"):
            text = f"the {name}s look as if they were expressed in the flange frame"
            found[text] = _changed(data, to_base, name)
        swapped = replace(data, force=data.torque, torque=data.force)
        found["forces and torques look as if they were swapped"] = swapped
    return found


def _units(data: Reading) -> dict[str, Reading]:
    found: dict[str, Reading] = {}
    if not data.torque.any():  # the size of the stiffnesses is all that tells
        return found
    for (of_force, of_torque), (in_newton, in_newton_metres) in UNITS.items():
        words = [f"the forces look as if they were in {of_force}"] if of_force else []
        words += [f"the torques look as if they were in {of_torque}"] if of_torque else []
        force, torque = data.force * in_newton, data.torque * in_newton_metres
        found[" and ".join(words)] = replace(data, force=force, torque=torque)
    without = replace(data, torque=np.zeros_like(data.torque))
    return found | {"the torques look as if they did not belong to the forces": without}


def _signed(data: Reading) -> Reading:
    """Return the samples with the signs of deflections that joint springs would have."""
    matrix, changed, found = data.regressor(), data, np.ones(data.q.shape[1])
    for _ in range(10):
        changed = replace(data, deflection=np.copysign(data.deflection, matrix @ found))
        found = compliances(changed)
    return changed


def _axes(data: Reading) -> dict[str, Reading]:
    found: dict[str, Reading] = {}
    for matrix in _signed_permutations():
        proper = np.linalg.det(matrix) > 0.0
        same = bool((matrix == np.eye(3)).all())
        read = f"had to be read {_words(matrix)}"
        frame = "expressed in the flange frame" + ("" if same else f" and {read}")
        again = functools.partial(_turned, matrix)
        to_base = functools.partial(_turned, data.flange @ matrix)
        turned = _changed(data, to_base, *LOAD)
        if not same:
            found[f"the wrench looks as if it {read}"] = _changed(data, again, *LOAD)
            for name in ("force", "torque", "deflection"):
                found[f"the {name}s look as if they {read}"] = _changed(data, again, name)
            if proper:  # else one of opposite signs, which is the same
                text = f"wrench and deflections look as if they {read}"
                found[text] = _changed(data, again, *LOAD, "deflection")
            found[f"the wrench looks as if it were {frame}"] = turned
        if data.torque.any():
            about = turned.torque - np.cross(data.lever, turned.force)
            text = f"the wrench looks as if it were {frame}, its torque about the flange"
            found[text] = replace(turned, torque=about)
        text = f"the deflections look as if they were {frame}"
        found[text] = _changed(data, to_base, "deflection")
        if proper:
            text = f"wrench and deflections look as if they were {frame}"
            found[text] = _changed(turned, to_base, "deflection")
    return found


def _joints(data: Reading) -> dict[str, Reading]:
    names, q = data.robot.joint_names, data.q
    numbers = np.arange(len(names))
    revolute = data.robot.turns
    read = {  # text -> (n, n_joints) joint positions, rad or m
        f"joint {name} looks as if it had the opposite sign": np.where(numbers == i, -q, q)
        for i, name in enumerate(names)
    }
    for i in np.flatnonzero(revolute):
        for degrees in (90, -90, 180):
            text = f"joint {names[i]} looks as if it were {degrees:+d} deg off"
            if i == numbers[-1]:  # which turns the tool alone
                text = (
                    f"the TCP looks as if it were {degrees:+d} deg off about the axis of joint "
                    f"{names[i]}, or joint {names[i]} as if it were"
                )
            read[text] = q - (numbers == i) * np.deg2rad(degrees)
    for i, j in itertools.combinations(numbers, 2):
        order = numbers.copy()
        order[[i, j]] = j, i
        read[f"joints {names[i]} and {names[j]} look as if they were swapped"] = q[:, order]
    read["the joints look as if they stood in reverse order"] = q[:, ::-1]
    read["all joints look as if they had the opposite sign"] = -q
    in_rad = np.where(revolute, np.rad2deg(q), q)
    if revolute.any():
        read["the joint angles look as if they were in rad"] = in_rad
    small = np.abs(np.rad2deg(q)).max(axis=0) <= 2.0 * np.pi
    for i in np.flatnonzero(revolute & small):
        read[f"joint {names[i]} looks as if it were in rad"] = np.where(numbers == i, in_rad, q)
    return {text: data.at(positions) for text, positions in read.items()}


def _rows(data: Reading) -> dict[str, Reading]:
    found: dict[str, Reading] = {}
    for step, where in ((-1, "down"), (1, "up")):
        words = f"look as if they were shifted {where} by one row"
        kept = np.ones((len(data.q), 1))
        kept[-1 if step < 0 else 0] = 0.0  # nothing belongs to this row
        q, force, torque, deflection = (
            np.roll(each, step, 0) for each in (data.q, data.force, data.torque, data.deflection)
        )
        loads = replace(data, force=data.force * kept, torque=data.torque * kept)
        given = replace(loads, deflection=data.deflection * kept)
        found |= {
            f"the deflections {words}": replace(loads, deflection=deflection * kept),
            f"the wrenches {words}": replace(given, force=force * kept, torque=torque * kept),
            f"the joint angles {words}": given.at(q),
        }
    backwards = replace(data, deflection=data.deflection[::-1])
    return found | {"the deflections look as if their rows stood in reverse order": backwards}


def _moved_tcp(data: Reading, shift: FloatArray) -> Reading:
    """Return the samples of a TCP that lies elsewhere by (3,) m, flange frame."""
    linear, angular = data.jacobian[:, :3], data.jacobian[:, 3:]
    lever = data.flange @ shift  # (n, 3)
    linear = linear + np.cross(angular, lever[:, :, None], axis=1)
    return replace(data, jacobian=np.concatenate([linear, angular], axis=1))


def _weight_removed(data: Reading, numbers: FloatArray) -> Reading:
    """Return the samples without a weight [N], and its first moment (3,) [N m], flange frame."""
    torque = data.torque + np.cross(data.flange @ numbers[1:], UP)
    return replace(data, force=data.force + numbers[0] * UP, torque=torque)


def _about_z(data: Reading, angle: FloatArray, *, names: Sequence[str]) -> Reading:
    """Return the samples with vectors turned by an angle [rad] about z."""
    cosine, sine = np.cos(angle[0]), np.sin(angle[0])
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return _changed(data, functools.partial(_turned, turn), *names)


WEIGHT_GAIN, OFFSET_GAIN, TCP_GAIN, TURN_GAIN = 0.15, 0.18, 0.2, 0.3
"""Free numbers also take up what joint springs leave of clean data: the most that was seen is 0.10
of the KR10's twins, 0.14 of the FANUC measurement, and 0.01."""
FITTED = (
    Fitted(
        "the forces look as if the weight of a tool of {:.2g} kg were in them (not tared)",
        lambda data, weight: replace(data, force=data.force + weight * UP),
        n_free=1,
        must_gain=WEIGHT_GAIN,
        unit=1.0 / GRAVITY,
        positive=True,
    ),
    Fitted(
        "the wrench looks as if the weight of a tool of {:.2g} kg were in it (not tared)",
        _weight_removed,
        n_free=4,
        must_gain=OFFSET_GAIN,
        unit=1.0 / GRAVITY,
        positive=True,
    ),
    Fitted(
        "the forces look as if they had a constant offset of ({:.2g}, {:.2g}, {:.2g}) N",
        lambda data, offset: replace(data, force=data.force - offset),
        n_free=3,
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the force sensor looks as if it had an offset of ({:.2g}, {:.2g}, {:.2g}) N in the flange "
        "frame",
        lambda data, offset: replace(data, force=data.force - data.flange @ offset),
        n_free=3,
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the torques look as if they had a constant offset of ({:.2g}, {:.2g}, {:.2g}) N m",
        lambda data, offset: replace(data, torque=data.torque - offset),
        n_free=3,
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the TCP looks as if it lay ({:.0f}, {:.0f}, {:.0f}) mm from the given one, in the flange "
        "frame",
        _moved_tcp,
        n_free=3,
        must_gain=TCP_GAIN,
        unit=1000.0,
    ),
    *(
        Fitted(
            f"{what} had to be read turned by {{:+.0f}} deg about z",
            functools.partial(_about_z, names=names),
            n_free=1,
            must_gain=TURN_GAIN,
            unit=DEG_PER_RAD,
        )
        for what, names in (
            ("the wrench looks as if it", LOAD),
            ("the deflections look as if they", ("deflection",)),
            ("wrench and deflections look as if they", (*LOAD, "deflection")),
        )
    ),
)


def _signed_permutations() -> list[FloatArray]:
    """Return the 48 (3, 3) signed permutations, the least change first."""
    found = [
        np.diag(signs)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return sorted(found, key=lambda matrix: -float(np.trace(matrix)))


def _words(matrix: FloatArray) -> str:
    """Say in words what a signed permutation makes of the axes of a file."""
    diagonal, proper = np.diag(matrix), np.linalg.det(matrix) > 0.0
    if (diagonal == -1.0).all():
        return "with the opposite sign"
    if diagonal.all() and proper:
        axis = int(np.argmax(diagonal))
        return f"turned by 180 deg about {AXES[axis]}" + ("" if axis == 2 else " (z down?)")
    if diagonal.all():
        axis = int(np.argmin(diagonal))
        return f"with the sign of {AXES[axis]} flipped" + (" (z down?)" if axis == 2 else "")
    if proper and diagonal.sum() == 1.0:
        axis = int(np.argmax(diagonal))
        sine = matrix[(axis + 2) % 3, (axis + 1) % 3]
        return f"turned by {90 * sine:+.0f} deg about {AXES[axis]}"
    if not proper and (matrix >= 0.0).all():
        first, second = (name for name, kept in zip(AXES, diagonal, strict=True) if not kept)
        return f"with {first} and {second} swapped"
    sources = np.abs(matrix).argmax(axis=1)
    signs = ("-" if row.sum() < 0.0 else "" for row in matrix)
    read = ", ".join(sign + AXES[source] for sign, source in zip(signs, sources, strict=True))
    return f"with x, y, z taken from its columns {read}"


def _changed(data: Reading, change: Callable[[FloatArray], FloatArray], *names: str) -> Reading:
    """Return the samples with these of their vectors changed."""
    vectors: dict[str, Any] = {name: change(getattr(data, name)) for name in names}
    return replace(data, **vectors)


def _turned(rotation: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return (n, 3) vectors turned by one rotation (3, 3), or each by its own (n, 3, 3)."""
    return np.asarray((rotation @ vectors[:, :, None])[:, :, 0])
