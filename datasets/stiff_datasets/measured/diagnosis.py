"""Which mistake would explain measured samples: the hypotheses, compared by cross-validation.

A wrench in the wrong frame or a joint of the wrong sign fits no model, and nothing in the file
says why. The linear virtual joint model (one spring a joint, no negative compliance, no prior) is
cross-validated by pose on what each hypothesis makes of the samples.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_datasets.measured.mistakes import (
    ELSEWHERE,
    FARTHEST_SOUND,
    FITTED,
    Fitted,
    Reading,
    compliances,
    normal_equations,
    reading,
    readings,
    solve_nonnegative,
    with_tilting_joints,
)
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot, Samples
from stiff_protocols.springs.identification import RANK_TOLERANCE

CLEARLY = 2.0
"""Standard errors over poses by which a hypothesis must lower the squared residual."""
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
        elsewhere: where no mistake is found: with springs across the joints' axes, too, the fits at
            the given points and at others, the best first, if one of these is clearly better.
    """

    given: Fit
    best: Fit | None = None
    ties: tuple[str, ...] = ()
    elsewhere: tuple[Fit, ...] = ()


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
    elsewhere: tuple[Fit, ...] = ()
    if best is None and may_fit and not joints_only and given.explained < SOUND:
        elsewhere = _elsewhere(with_tilting_joints(data), pose, fold)
    return Diagnosis(given, best, tuple(fit.text for fit in close), elsewhere)


def _elsewhere(data: Reading, pose: IntArray, fold: IntArray) -> tuple[Fit, ...]:
    """Return the fits at the given points and at others, () unless a far one is clearly better."""
    given, fits, is_clear = _fit("", data, fold), [], False
    for free in ELSEWHERE:
        point = _fitted(free, data, np.zeros(free.n_free))
        fit = _fit_free(free, point, data, fold)
        is_far = float(np.linalg.norm(point)) > FARTHEST_SOUND
        is_clear |= is_far and _clearly_better(fit, given, pose)
        fits.append(fit)
    return (given, *sorted(fits, key=lambda fit: fit.rms)) if is_clear else ()


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


def _fit(text: str, data: Reading, fold: IntArray, must_gain: float = 0.0) -> Fit:
    """Cross-validate the samples as a hypothesis reads them; `fold` (n,) numbers the folds."""
    matrix = data.regressor()
    parts = [normal_equations(matrix[fold == i], data.deflection[fold == i]) for i in range(FOLDS)]
    grams, rights = (np.array(each) for each in zip(*parts, strict=True))
    found = [
        solve_nonnegative(grams.sum(0) - grams[i], rights.sum(0) - rights[i]) for i in range(FOLDS)
    ]
    predicted = (matrix @ np.array(found)[fold][:, :, None])[:, :, 0]
    return Fit(text, ((data.deflection - predicted) ** 2).sum(axis=1), data, must_gain)


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
