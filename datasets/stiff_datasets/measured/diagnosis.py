"""Compare the mistakes that may explain measured samples, by cross-validation.

With a wrench in the wrong frame or a joint of the wrong sign, no model fits, and the file does not
show why. Each hypothesis changes the samples. The linear virtual joint model (one spring per joint,
no negative compliance, no prior) is cross-validated by pose on the changed samples.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from stiff_datasets.measured.fault_hypotheses import (
    FITTED_HYPOTHESES,
    GAIN,
    OFFSET_HYPOTHESES,
    POINT_HYPOTHESES,
    TCP_HYPOTHESIS,
    ZERO_WORDS,
    FittedHypothesis,
    Reading,
    compliances,
    effect_hypotheses,
    fitted_effects,
    fixed_hypotheses,
    normal_equations,
    reading,
    solve_nonnegative,
    with_tilting_joints,
    zero_hypotheses,
)
from stiff_datasets.measured.outliers_and_drift import LeftOut, left_out
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot, Samples
from stiff_protocols.springs.identification import RANK_TOLERANCE

MIN_GAIN_SE = 2.0
"""Standard errors over poses by which a hypothesis must lower the squared residual."""
TIE_RATIO, NEAR_TIE_RATIO = 1.02, 1.13
"""Ratios to the lowest RMS residual. Of the hypotheses within the first, the likeliest is named.
Those within the second cannot be excluded with certainty and are named after it."""
MIN_RMS = 1e-12
"""m: residuals of noise-free data are rounding errors and must not rank hypotheses."""
MIN_EXPLAINED = 0.9
"""Least explained share of the squared deflection after a mistake is undone; below it, the mistake
is another. Joint springs explain 0.94 of the FANUC measurement and at least 0.93 of ten specimens
of each shipped twin."""
CLEAN_EXPLAINED = 0.995
"""If joint springs explain this share, free numbers would only fit the deflection of links."""
USUAL_SAG = 2e-3
"""rad; turn of the most compliant joint under the arm's own weight. 2 to 2.8e-3 in all specimens
of the shipped twins."""
UNUSUAL_RATIO = 5.0
"""A robot this many times more compliant or stiffer than usual is in another unit."""
FOLDS, MIN_POSES = 10, 10
BLOCKS, BLOCK_ROWS = 10, 100
"""A longer file is sampled: this number of blocks of rows, spread evenly, shows a mistake."""
FIT_STEPS, FOLD_FIT_STEPS = 10, 3
"""Steps of Gauss-Newton: for all samples, and from that result for each fold."""
STEP = 1e-3
"""Step of numerical slopes, SI."""
EFFECT_STEPS, SMALL_CHANGE = 6, 1e-2
"""Steps of Gauss-Newton with all effects, and the relative change after which they end."""
MIN_EFFECT_F = 12.0
"""Least F statistic of the numbers of a hypothesis that is fitted with all effects."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The virtual joint model cross-validated under a hypothesis.

    Attributes:
        text: the hypothesis.
        squares: (n,) squared length of each residual, m2.
        reading: the samples as changed by the hypothesis.
        min_gain: least share by which the hypothesis has to lower the RMS residual.
        hypothesis: the hypothesis with free numbers; None: it has none.
        numbers: (n_free,) fitted numbers, SI.
    """

    text: str
    squares: FloatArray
    reading: Reading
    min_gain: float = 0.0
    hypothesis: FittedHypothesis | None = None
    numbers: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def rms(self) -> float:
        """Root mean square length of the residual, m; see `_rms`."""
        return _rms(self.squares)

    @property
    def is_offset(self) -> bool:
        """True for one of `OFFSET_HYPOTHESES`."""
        return self.hypothesis in OFFSET_HYPOTHESES

    @property
    def score(self) -> float:
        """RMS residual, m, divided by one minus the minimum gain; lower is better."""
        return self.rms / (1.0 - self.min_gain)

    @property
    def explained(self) -> float:
        """Explained share of the squared deflection; 0 if the fit is worse than no model."""
        size = (self.reading.deflection**2).sum()
        return max(float(1.0 - self.squares.sum() / size), 0.0) if size else 0.0


@dataclass(frozen=True)
class Diagnosis:
    """Result of the comparison of hypotheses by cross-validation.

    Attributes:
        given: fit to the samples without a hypothesis.
        best: fit of the hypothesis that is clearly better; None: no hypothesis is.
        compared: fit to the samples without a hypothesis, by the springs of `best`.
        ties: texts of the hypotheses that explain the samples as well.
        elsewhere: fits with springs across the joints' axes, too: at the given points, then at
            other points, the best first. Empty if a mistake was found or no other point is
            clearly better.
    """

    given: Fit
    best: Fit | None = None
    compared: Fit | None = None
    ties: tuple[str, ...] = ()
    elsewhere: tuple[Fit, ...] = ()


def diagnose(
    samples: Samples, robot: Robot, *, joints_only: bool = False, may_fit: bool = True
) -> Diagnosis:
    """Compare the samples as they are with every hypothesis.

    The best hypothesis meets four conditions. It lowers the RMS residual by more than 5 to 30 %
    (`min_gain`). It lowers the squared residual by more than two standard errors of the difference.
    It explains nearly as much as joint springs explain of clean data. It does so with springs
    across the joints' axes, too. Differences are summed by
    pose, because the loads of a pose share their errors. The test is the one of Q. Vuong
    (Econometrica 57, 1989) for models that do not contain each other. Of hypotheses that tie, the
    likeliest with stiffnesses of a usual size is named.

    Offsets and the TCP are named only if springs with all effects confirm them. These springs also
    seek what joint springs do not show, and tell offsets from each other.

    Args:
        samples: the data; with fewer than ten poses no hypothesis is tried.
        robot: the measured robot.
        joints_only: try only mistakes in the joint positions.
        may_fit: try hypotheses with free numbers, too.
    """
    compared_samples = samples
    if len(samples) > BLOCKS * BLOCK_ROWS:
        starts = np.linspace(0, len(samples) - BLOCK_ROWS, BLOCKS).astype(np.int64)
        compared_samples = samples.take((starts[:, None] + np.arange(BLOCK_ROWS)).reshape(-1))
    pose = np.asarray(np.unique(compared_samples.pose_id, return_inverse=True)[1])
    data = reading(robot, compared_samples.q, compared_samples.wrench, compared_samples.deflection)
    n_poses = int(pose.max()) + 1
    fold = np.random.default_rng(0).permutation(n_poses)[pose] % FOLDS
    given = _cross_validate("", data, fold)
    if n_poses < MIN_POSES:
        return Diagnosis(given)
    with_effects = _fit_with_effects("", data)
    better_fits = _better_hypotheses(data, given, pose, fold, joints_only, may_fit)
    if better_fits:  # not what bearings that tilt explain as well
        tilting = _cross_validate("", with_tilting_joints(data), fold)
        tilting_fits = {
            fit.text: _cross_validate("", with_tilting_joints(fit.reading), fold, fit.min_gain)
            for fit in better_fits
        }
        better_fits = [  # nor what springs with all effects explain as well
            fit
            for fit in better_fits
            if _clearly_better(tilting_fits[fit.text], tilting, pose)
            and _is_clear_with_effects(fit, with_effects, pose)
        ]
    if _stiffness_size(data) == "usual":  # an undone mistake leaves a usual size
        better_fits = [fit for fit in better_fits if _stiffness_size(fit.reading) != "unusual"]
    lowest = min((fit.score for fit in better_fits), default=0.0)
    near_best = [fit for fit in better_fits if fit.score <= NEAR_TIE_RATIO * lowest]
    best = min(near_best, key=functools.partial(_doubts, TIE_RATIO * lowest), default=None)
    has_offset = any(fit.is_offset for fit in near_best)
    if best is not None and ZERO_WORDS in best.text:  # bearings that tilt tell it from a TCP
        best = min(near_best, key=lambda fit: tilting_fits[fit.text].rms)
        is_decided = not has_offset
    else:
        is_decided = best is not None and not best.is_offset
    near_best = sorted((fit for fit in near_best if fit is not best), key=lambda fit: fit.score)
    ties = tuple(fit.text for fit in near_best)
    if is_decided or not may_fit:
        return Diagnosis(given, best, given, ties)
    if near_best := _best_with_effects(with_effects, pose, joints_only):
        ties = tuple(fit.text for fit in near_best[1:] if fit.text)
        return Diagnosis(given, near_best[0], with_effects, ties)
    if best is not None:
        return Diagnosis(given, best, given, ties)
    elsewhere: tuple[Fit, ...] = ()
    if not joints_only and given.explained < CLEAN_EXPLAINED:
        tilting_data = with_tilting_joints(data)
        tilting = _cross_validate("", tilting_data, fold)
        elsewhere = _fits_of_points(tilting_data, tilting, pose, fold)
    return Diagnosis(given, elsewhere=elsewhere)


def _best_with_effects(given: Fit, pose: IntArray, joints_only: bool) -> list[Fit]:
    """Return the fits of the best mistakes by springs with all effects; see `left_out`.

    They leave less than joint springs, so that they show smaller mistakes. The first is the
    likeliest of those that tie. If the force's point explains most, none is returned:
    `_fits_of_points` asks about it.
    """
    fits, data = [], given.reading
    if not joints_only:
        moved_tcp = replace(TCP_HYPOTHESIS, min_gain=GAIN)
        may_move = _can_gain(moved_tcp, with_tilting_joints(data), np.zeros(moved_tcp.n_free))
        fits = [
            _fit_with_effects(text, changed_data, gain)
            for text, changed_data, gain in effect_hypotheses(data, may_move)
        ]
    for hypothesis in fitted_effects(data, joints_only):
        fits.extend(_fit_effects(hypothesis, given, pose, np.zeros(hypothesis.n_free)))
    clear_fits = [
        fit for fit in fits if fit.explained > MIN_EXPLAINED and _clearly_better(fit, given, pose)
    ]
    lowest = min((fit.score for fit in clear_fits), default=0.0)
    near_best = [fit for fit in clear_fits if fit.score <= NEAR_TIE_RATIO * lowest]
    near_best.sort(key=lambda fit: fit.score > TIE_RATIO * lowest)
    return near_best if near_best and near_best[0].text else []


def _fit_with_effects(text: str, data: Reading, min_gain: float = 0.0) -> Fit:
    """Fit springs with all effects; each square is the error of a row that is left out."""
    springs = left_out(data, np.ones(len(data.q), dtype=bool))
    return Fit(text, _squares(springs), data, min_gain)


def _is_clear_with_effects(fit: Fit, given: Fit, pose: IntArray) -> bool:
    """Test if springs with all effects confirm an offset, with numbers fitted again.

    Curved springs under loads of one size look like an offset of the forces.
    """
    if fit.hypothesis is None or not fit.is_offset:
        return True
    refits = _fit_effects(fit.hypothesis, given, pose, fit.numbers)
    return any(_clearly_better(refit, given, pose) for refit in refits)


def _fit_effects(
    hypothesis: FittedHypothesis, given: Fit, pose: IntArray, numbers: FloatArray
) -> Iterator[Fit]:
    """Fit numbers of a hypothesis, from the given ones, and springs that have all effects.

    Nothing is yielded if they are too small, or if their F statistic is below `MIN_EFFECT_F`.
    """
    data, n = given.reading, hypothesis.n_free
    every = np.ones(len(data.q), dtype=bool)
    for step in range(EFFECT_STEPS):
        changed = hypothesis.change(data, numbers)
        springs = left_out(changed, every)
        residual = springs.residual(changed)
        slopes = [
            (residual - springs.residual(hypothesis.change(data, numbers + unit))) / STEP
            for unit in STEP * np.eye(n)
        ]
        fit = left_out(changed, every, np.stack(slopes, axis=-1))
        if step == 0 and fit.rms > (1.0 - 0.5 * hypothesis.min_gain) * given.rms:
            return
        change = fit.coefficients[-n:] / fit.size[-n:]
        numbers = numbers + change
        if np.linalg.norm(change) < SMALL_CHANGE * np.linalg.norm(numbers):
            break
    rows_per_pose = len(data.q) / (pose.max() + 1)
    is_clear = fit.statistic(numbers) > MIN_EFFECT_F * rows_per_pose
    is_positive = numbers[0] > 0.0 or not hypothesis.positive
    if is_clear and is_positive and np.linalg.norm(numbers) > hypothesis.least:
        text = hypothesis.text.format(*(numbers * hypothesis.unit))
        yield Fit(text, _squares(fit), hypothesis.change(data, numbers), hypothesis.min_gain)


def _squares(springs: LeftOut) -> FloatArray:
    return np.asarray((springs.error**2).sum(axis=1))


def _fits_of_points(
    data: Reading, given_fit: Fit, pose: IntArray, fold: IntArray
) -> tuple[Fit, ...]:
    """Return the fits at given and other points; () if no far point is clearly better."""
    fits, is_clear = [], False
    for hypothesis in POINT_HYPOTHESES:
        point = _fit_numbers(hypothesis, data, np.zeros(hypothesis.n_free))
        fit = _cross_validate_fitted(hypothesis, point, data, fold)
        is_far = float(np.linalg.norm(point)) > hypothesis.least
        is_clear |= is_far and _clearly_better(fit, given_fit, pose)
        fits.append(fit)
    return (given_fit, *sorted(fits, key=lambda fit: fit.rms)) if is_clear else ()


def _better_hypotheses(
    data: Reading,
    given: Fit,
    pose: IntArray,
    fold: IntArray,
    joints_only: bool,
    may_fit: bool,
) -> list[Fit]:
    """Return the fits of better hypotheses near the best, the likeliest first.

    The residual of rows that were left out is never below the residual of fitted rows. So the
    residual without cross-validation is a bound, which excludes most hypotheses.
    """
    candidates: list[tuple[float, int, Callable[[], Fit]]] = []
    for text, changed_data, gain in fixed_hypotheses(data, joints_only):
        cross_validate_fixed = functools.partial(_cross_validate, text, changed_data, fold, gain)
        candidates.append(
            (rms_of_all(changed_data) / (1.0 - gain), len(candidates), cross_validate_fixed)
        )
    hypotheses = zero_hypotheses(data.robot) if may_fit else ()
    if may_fit and not joints_only and given.explained < CLEAN_EXPLAINED:
        hypotheses = (*FITTED_HYPOTHESES, *hypotheses)
    for hypothesis in hypotheses:
        start = np.zeros(hypothesis.n_free)
        if hypothesis.starts:
            trials = [start, *(np.array([number]) for number in hypothesis.starts)]
            start = min(trials, key=lambda trial: rms_of_all(hypothesis.change(data, trial)))
            if not start.any() and not _can_gain(hypothesis, data, start):
                continue
        numbers = _fit_numbers(hypothesis, data, start)
        is_positive = numbers[0] > 0.0 or not hypothesis.positive
        if is_positive and np.linalg.norm(numbers) > hypothesis.least:
            bound = rms_of_all(hypothesis.change(data, numbers)) / (1.0 - hypothesis.min_gain)
            cross_validate_fitted = functools.partial(
                _cross_validate_fitted, hypothesis, numbers, data, fold
            )
            candidates.append((bound, len(candidates), cross_validate_fitted))
    rms_limit = given.rms
    better_fits: dict[int, Fit] = {}
    for bound, position, cross_validate in sorted(candidates, key=lambda entry: entry[:2]):
        if bound > rms_limit:
            break
        fit = cross_validate()
        if fit.explained > MIN_EXPLAINED and _clearly_better(fit, given, pose):
            better_fits[position] = fit
            rms_limit = min(rms_limit, NEAR_TIE_RATIO * fit.score)
    return [better_fits[position] for position in sorted(better_fits)]


def rms_of_all(data: Reading) -> float:
    """Return the RMS residual of joint springs fitted to all samples, m."""
    residual = data.deflection - data.regressor() @ compliances(data)
    return _rms((residual**2).sum(axis=1))


def _rms(squares: FloatArray) -> float:
    """Return the root of the mean of (n,) squared lengths [m2], m; not less than `MIN_RMS`."""
    return max(float(np.sqrt(squares.mean())), MIN_RMS)


def relative_compliance(data: Reading, compliance: FloatArray) -> float:
    """Return the joints' compliance as a multiple of the usual one; 0 if unknown.

    It is unknown if the robot's masses are unknown or cannot be right (`Robot.mass_doubt`).

    Args:
        data: the samples.
        compliance: (n_joints,) rad/(N m), m/N.
    """
    if data.robot.mass_doubt:
        return 0.0
    torque = np.abs(data.robot.gravity_torque(data.q[:1000]))
    sag = (torque.max(axis=0) * compliance)[data.robot.turns]
    return float(sag.max(initial=0.0) / USUAL_SAG)


def _doubts(tie_score: float, fit: Fit) -> tuple[bool, bool, bool]:
    """Return the reasons against a hypothesis, the strongest first.

    They are stiffnesses of an unusual size, a score above `tie_score`, and a negative stiffness.
    """
    negative = bool(has_negative_compliance(fit.reading).any())
    return _stiffness_size(fit.reading) == "unusual", fit.score > tie_score, negative


def _stiffness_size(data: Reading) -> Literal["usual", "unusual", "unknown"]:
    """Compare the joints' stiffnesses with a robot's usual ones."""
    factor = relative_compliance(data, compliances(data))
    if factor == 0.0:
        return "unknown"
    return "usual" if 1.0 / UNUSUAL_RATIO < factor < UNUSUAL_RATIO else "unusual"


def has_negative_compliance(data: Reading) -> BoolArray:
    """Return (n_joints,) true for compliances that are significantly negative in least squares."""
    matrix = data.regressor().reshape(-1, data.q.shape[1])
    size = np.linalg.norm(matrix, axis=0)
    size[size <= RANK_TOLERANCE * size.max()] = np.inf  # no load turns these joints
    inverse = np.linalg.pinv(matrix / size)
    compliance = inverse @ data.deflection.reshape(-1)
    residual = data.deflection.reshape(-1) - matrix / size @ compliance
    error = np.linalg.norm(inverse, axis=1) * residual.std()
    return np.asarray(compliance < -MIN_GAIN_SE * error)


def _clearly_better(fit: Fit, given: Fit, pose: IntArray) -> bool:
    gain = np.bincount(pose, given.squares - fit.squares)  # (n_poses,)
    clear = gain.sum() > MIN_GAIN_SE * np.sqrt(len(gain)) * gain.std(ddof=1)
    return bool(clear and fit.score < given.rms)


def _cross_validate(text: str, data: Reading, fold: IntArray, min_gain: float = 0.0) -> Fit:
    """Cross-validate the samples as changed by a hypothesis; `fold` (n,) numbers the folds."""
    matrix = data.regressor()
    parts = [normal_equations(matrix[fold == i], data.deflection[fold == i]) for i in range(FOLDS)]
    grams, rights = (np.array(sums) for sums in zip(*parts, strict=True))
    fold_compliances = [
        solve_nonnegative(grams.sum(0) - grams[i], rights.sum(0) - rights[i]) for i in range(FOLDS)
    ]
    predicted = (matrix @ np.array(fold_compliances)[fold][:, :, None])[:, :, 0]
    return Fit(text, ((data.deflection - predicted) ** 2).sum(axis=1), data, min_gain)


def _cross_validate_fitted(
    hypothesis: FittedHypothesis, numbers: FloatArray, data: Reading, fold: IntArray
) -> Fit:
    """Cross-validate a hypothesis and fit its numbers on the training folds, too."""
    squares = np.empty(len(fold))
    for i in np.unique(fold):
        training = data.take(fold != i)
        fold_numbers = _fit_numbers(hypothesis, training, numbers, FOLD_FIT_STEPS)
        fold_compliance = compliances(hypothesis.change(training, fold_numbers))
        test_data = hypothesis.change(data.take(fold == i), fold_numbers)
        squares[fold == i] = (
            (test_data.deflection - test_data.regressor() @ fold_compliance) ** 2
        ).sum(axis=1)
    text = hypothesis.text.format(*(numbers * hypothesis.unit))
    changed = hypothesis.change(data, numbers)
    return Fit(text, squares, changed, hypothesis.min_gain, hypothesis, numbers)


def _fit_numbers(
    hypothesis: FittedHypothesis, data: Reading, numbers: FloatArray, steps: int = FIT_STEPS
) -> FloatArray:
    """Return the (n_free,) numbers that fit best, by Gauss-Newton from `numbers`."""
    rms = rms_of_all(hypothesis.change(data, numbers))
    for _ in range(steps):
        change, _ = _linear_step(hypothesis, data, numbers)
        trials = (numbers + share * change for share in (1.0, 0.5, 0.25))
        rms_before, (rms, numbers) = (
            rms,
            min(
                ((rms_of_all(hypothesis.change(data, trial)), trial) for trial in trials),
                key=lambda entry: entry[0],
            ),
        )
        is_small = np.linalg.norm(change) < 1e-3 * np.linalg.norm(numbers)
        if is_small or rms > (1.0 - 1e-4) * rms_before:
            break
    return numbers


def _can_gain(hypothesis: FittedHypothesis, data: Reading, numbers: FloatArray) -> bool:
    """Test if the first step of the search gains half of the least share."""
    rms = rms_of_all(hypothesis.change(data, numbers))
    return _linear_step(hypothesis, data, numbers)[1] < (1.0 - 0.5 * hypothesis.min_gain) * rms


def _linear_step(
    hypothesis: FittedHypothesis, data: Reading, numbers: FloatArray
) -> tuple[FloatArray, float]:
    """Return a step of Gauss-Newton (n_free,) and the RMS residual [m] that it would leave.

    In the step, compliances may become negative.
    """
    changed = hypothesis.change(data, numbers)
    matrix, compliance = changed.regressor(), compliances(changed)
    residual = changed.deflection - matrix @ compliance
    slopes = []
    for unit in np.eye(hypothesis.n_free):
        moved = hypothesis.change(data, numbers + STEP * unit)
        slopes.append((residual - moved.deflection + moved.regressor() @ compliance) / STEP)
    design = np.concatenate([np.stack(slopes, axis=-1), matrix], axis=-1)
    design = design.reshape(-1, design.shape[-1])
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    coefficients = np.linalg.lstsq(design / size, residual.reshape(-1))[0]
    residual_left = residual.reshape(-1) - design / size @ coefficients
    return (coefficients / size)[: hypothesis.n_free], _rms(
        (residual_left.reshape(-1, 3) ** 2).sum(axis=1)
    )
