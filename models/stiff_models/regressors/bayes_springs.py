"""`bayes-springs`: groups of springs, links and errors of the rig, with scales from the samples.

A reading is y = d(q, w') + errors: the wrench w' that acts differs from the written one by force
point and cross-talk of the rig. The deflection d is a sum over the groups of `spring_groups`. It is
linear in their coefficients. `group_scales` finds the scale of each group and the coefficients.
Weights, force point and cross-talk change the columns, so they are found in rounds (Gauss-Newton).
Samples with large errors count less, as in Student's t distribution with four degrees of freedom. A
prediction is the robot's: groups of the rig explain the file and are left out. SI: rad, N, N m, m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import ndtri

from stiff_models.fitted_model import NormalModel
from stiff_models.physics.fitted_geometry import GeometryModel
from stiff_models.physics.full_vjm import spring_twists
from stiff_models.physics.vjm import warn_no_masses, warn_unexplained
from stiff_models.pose_folds import FOLDS, folds_of_poses
from stiff_models.regressors.arm_loads import ArmLoads, Rig, Sizes, friction_blocks, wrench_blocks
from stiff_models.regressors.calibrated_process import FEWEST_POSES, TRACKER_NOISE
from stiff_models.regressors.group_scales import (
    LEAST,
    MOST,
    GroupedModel,
    Posterior,
    diagonals,
    joined,
)
from stiff_models.regressors.joint_curves import joint_curves
from stiff_models.regressors.spring_groups import (
    GROUP_NAMES,
    GROUPS,
    Group,
    LostMotion,
    groups_named,
)
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples, smallest_vectors
from stiff_protocols.kinematics.serial_chain import AT_TCP, unit_deflections
from stiff_protocols.springs.identification import CONTRIBUTION, number_with_interval
from stiff_protocols.springs.unseen_joints import unseen_columns

ROUNDS, REWEIGHTINGS = 3, 2
"""Rounds of Gauss-Newton, the first without the searched groups; reweightings in the others."""
STEPS, FOLD_STEPS = 60, 20
"""Most steps of a search for scales, and of the search of a fold, which continues from it."""
FRICTION_WIDTHS, FRICTION_SCALE, WRENCH_SCALE = (0.05, 0.2, 0.8), 0.1, 0.5
"""Of the errors by friction (shares of the largest torque, typical scale) and by the wrench."""
ERRORS = (*(f"friction {width}" for width in FRICTION_WIDTHS), "wrench", "noise")
"""Kinds of errors, in the order of their scales."""
FIRST_SHARE = 0.5
"""First value of a scale, of its typical one."""
FIRST_NOISE, MOST_NOISE, MOST_SHARE = 3.0, 10.0, 0.3
"""Noise: first value and bound over the instrument's; or bound over the deflections'."""
WEIGHT_STEP = 0.05
ROWS = 2048
"""Predictions computed together."""
LEAST_CONTRIBUTION, DRAWS = 1e-3, 200
"""mm: a group that moves the TCP less is not found; draws for a contribution's interval."""
TAIL = 0.9
"""Coverage of printed intervals."""
NORMAL_TAIL = float(ndtri(0.5 + TAIL / 2.0))
"""Half width of that interval of a normal distribution, in standard deviations."""


@dataclass(kw_only=True, eq=False, repr=False)
class BayesSprings(NormalModel, GeometryModel):
    """A linear model of springs and links whose groups have scales by marginal likelihood.

    Attributes:
        groups: names of the groups, separated by "+", or "all"; after "-" the names of groups that
            are left out of all. The name before a comma stands for all that begin with it.
        sizes_: units of the coefficients.
        rig_: errors of the file's loads, and the factors of the weights.
        coefficients_: (p,) coefficients of the robot's groups, in the order of `GROUPS`.
        root_: (p, k) matrix whose product with its transpose is their covariance.
        errors_: scales of the errors: three of friction, wrench, and independent ones [m].
        error_variance_: (3,) mean variance of the training readings' errors, m^2.
        fold_errors_: (n, 3) errors [m] of the training readings by fits without their poses;
            NaN with few poses. Of fewer than three numbers, the smallest vectors with these errors.
        curves_, springs_: turns and stiffnesses of the joints; see `joint_curves`.
        diagnostics_: report of `springs_`, contribution of each group, weights, force point, noise,
            and geometry.
    """

    groups: str = "all"

    def check_params(self) -> None:
        """Raise ConfigError if a group is unknown, or none bends the robot."""
        super().check_params()
        for name in self.groups.removeprefix("-").split("+"):
            if self.groups != "all" and not groups_named(name):
                valid = "; ".join(GROUP_NAMES)
                raise ConfigError(f"groups: {name!r} is not a group (valid: all; {valid})")
        if not self._linear:
            raise ConfigError(f"groups = {self.groups!r}: none of them bends the robot")

    @classmethod
    def describe_parts(cls) -> dict[str, str]:
        """Return each group's name, with equation, unit of a coefficient, and role."""
        return {group.name: group.description for group in GROUPS}

    @property
    def _chosen(self) -> list[Group]:
        if self.groups == "all":
            return list(GROUPS)
        names = self.groups.removeprefix("-").split("+")
        named = [group for name in names for group in groups_named(name)]
        return [group for group in GROUPS if (group in named) != self.groups.startswith("-")]

    @property
    def _linear(self) -> list[Group]:
        """The chosen groups that predictions have."""
        return [group for group in self._chosen if group.is_predicted]

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        twists_of = partial(spring_twists, springs=3)
        regressor = partial(unit_deflections, levers=train.levers)
        train, robot = self._placed(train, robot, twists_of, regressor)
        warn_no_masses(robot)
        self.sizes_ = Sizes.of(robot, train)
        self.rig_ = Rig.perfect(robot.n_joints)
        weights, scales = np.ones(len(train)), dict[object, float]()
        means = dict[Group, FloatArray]()
        stated = ("", *train.columns)
        chosen = [group for group in self._chosen if group.needs in stated]
        for number in range(ROUNDS):
            groups = chosen if number else [group for group in chosen if not group.is_searched]
            model = self._grouped(groups, self._loads(robot, train, means), train)
            readings = train.values + self._rig_deflections(groups, model)
            keys = [*groups, *ERRORS]
            firsts = [*FIRST_SHARE * model.typical[:-1], FIRST_NOISE * model.bounds[-1, 0]]
            for _ in range(REWEIGHTINGS if number else 1):
                model = model.weighted(weights)
                start = [scales.get(key, first) for key, first in zip(keys, firsts, strict=True)]
                best_scales = model.searched(readings, np.array(start), STEPS)
                scales = dict(zip(keys, best_scales.tolist(), strict=True))
                posterior = model.posterior(readings, best_scales)
                if number:
                    weights = posterior.student_weights(float(best_scales[-1]), weights)
            for place, group in enumerate(groups):
                means[group] = posterior.mean[model.group_of == place]
                if group.is_searched:
                    self.rig_ = group.changed(self.rig_, means[group], self.sizes_)
        self.coefficients_ = np.concatenate([means[group] for group in self._linear])
        self.errors_ = best_scales[model.n_groups :]
        self.file_variance_ = self._file_variance(groups, model, posterior)
        self._calibrate(model, readings, best_scales, posterior, train, seed)
        self._guess_unseen(groups, model)
        self.error_variance_ = self._error_variance(model, best_scales)
        loads = ArmLoads.of(robot, train.q, train.wrench, self.rig_)
        fitted = (self._linear, self.coefficients_, self.root_)
        self.curves_, self.springs_ = joint_curves(robot, loads, self.sizes_, *fitted)
        self.diagnostics_ = {
            **self.springs_.report(),
            **self._report(robot, groups, model, posterior),
            **self._geometry_report(),
        }
        warn_unexplained(self.coefficients_, train)

    def _loads(self, robot: Robot, train: Samples, means: Mapping[Group, FloatArray]) -> ArmLoads:
        """Return the training loads, with the derivative of the deflection by the weights.

        `means` are the groups' coefficients; none before the first round.
        """
        loads = ArmLoads.of(robot, train.q, train.wrench, self.rig_)
        seen = partial(replace, directions=train.directions, levers=train.levers)
        loads = seen(loads, order=train.order, approach=train.approach)
        slopes = np.zeros((*train.is_read.shape, robot.n_joints))
        if means:
            heavier = replace(self.rig_, weight_factor=self.rig_.weight_factor + WEIGHT_STEP)
            moved = ArmLoads.of(robot, train.q, train.wrench, heavier)
            moved = seen(moved)
            for group, coefficients in means.items():
                if isinstance(group, LostMotion):
                    first, second = (group.columns(of, self.sizes_) for of in (loads, moved))
                    change = (second - first) * coefficients / WEIGHT_STEP
                    slopes += change.reshape(*slopes.shape, -1).sum(axis=3)
        return replace(loads, by_weight=slopes)

    def _rig_deflections(self, groups: Sequence[Group], model: GroupedModel) -> FloatArray:
        """Return the (n, m) readings [m] by the current values of the searched groups."""
        deflections = np.zeros(model.columns.shape[:2])
        for place, group in enumerate(groups):
            if group.is_searched:
                columns = model.columns[:, :, model.group_of == place]
                deflections += columns @ group.coefficients(self.rig_, self.sizes_)
        return deflections

    @staticmethod
    def _error_variance(model: GroupedModel, scales: FloatArray) -> FloatArray:
        """Return the (3,) mean variances [m^2] of the readings' errors; of directions, one mean."""
        variance = model.error_variance(scales)
        if model.is_read.shape[1] == len(AXES) and model.is_read.all():
            return np.asarray(variance.mean(axis=0))
        return np.full(len(AXES), variance[model.is_read].mean())

    @staticmethod
    def _file_variance(groups: Sequence[Group], model: GroupedModel, posterior: Posterior) -> float:
        """Return the variance [m^2] of a reading by drift and approach, unknown at other rows."""
        needed = np.array([bool(group.needs) for group in groups])[model.group_of]
        moved = (model.columns[:, :, needed] @ posterior.mean[needed])[model.is_read]
        return float((moved**2).mean())

    def _grouped(self, groups: Sequence[Group], loads: ArmLoads, train: Samples) -> GroupedModel:
        """Return the model of the groups and errors, with equal weights of the samples."""
        columns, group_of = joined([group.columns(loads, self.sizes_) for group in groups])
        blocks = [*self._error_blocks(loads), diagonals(train.is_read)]
        typical = [group.scale for group in groups]
        typical += [FRICTION_SCALE] * len(FRICTION_WIDTHS) + [WRENCH_SCALE]
        noise = train.instrument_noise or TRACKER_NOISE
        size = float(np.sqrt((train.values[train.is_read] ** 2).mean()))
        bounds = [(LEAST * scale, MOST * scale) for scale in typical]
        bounds.append((noise, max(MOST_NOISE * noise, MOST_SHARE * size)))
        return GroupedModel(
            columns,
            group_of,
            np.stack(blocks),
            np.array([*typical, math.inf]),
            np.array(bounds),
            train.is_read,
        )

    def _error_blocks(self, loads: ArmLoads) -> list[FloatArray]:
        """Return the (n, m, m) covariances of friction and wrench at a scale of 1, m^2."""
        friction = [friction_blocks(loads, self.sizes_, width) for width in FRICTION_WIDTHS]
        return [*friction, wrench_blocks(loads, self.sizes_)]

    def _calibrate(
        self,
        model: GroupedModel,
        readings: FloatArray,
        scales: FloatArray,
        posterior: Posterior,
        train: Samples,
        seed: int,
    ) -> None:
        """Set the covariance of the coefficients by fits without each fifth of the poses.

        Its factor makes 90 % intervals of left-out readings hold; the coefficients' scatter over
        the fits is added (jackknife), because the scales are uncertain.
        """
        count, self.calibration_ = len(self.coefficients_), 1.0
        roots, means, shares = [posterior.root[:count]], [], []
        fold_errors = np.full(readings.shape, np.nan)
        if len(np.unique(train.pose_id)) >= FEWEST_POSES:
            for rows, left_out in folds_of_poses(train, seed):
                part, tested = model.take(rows), model.take(left_out)
                best_scales = part.searched(readings[rows], scales, FOLD_STEPS)
                of_part = part.posterior(readings[rows], best_scales)
                error = tested.columns @ of_part.mean - readings[left_out]
                fold_errors[left_out] = error
                variance = ((tested.columns @ of_part.root) ** 2).sum(axis=2)
                variance += tested.error_variance(best_scales)
                shares.append(error[tested.is_read] / np.sqrt(variance[tested.is_read]))
                means.append(of_part.mean[:count])
            sizes = np.abs(np.concatenate(shares))
            self.calibration_ = float(np.quantile(sizes, TAIL)) / NORMAL_TAIL
            scatter = np.array(means) - np.mean(means, axis=0)
            roots = [self.calibration_ * roots[0], math.sqrt((FOLDS - 1.0) / FOLDS) * scatter.T]
        self.root_ = np.hstack(roots)
        is_whole = not train.directions.size
        self.fold_errors_ = (
            fold_errors if is_whole else smallest_vectors(train.directions, fold_errors)
        )

    def _guess_unseen(self, groups: Sequence[Group], model: GroupedModel) -> None:
        """Give springs that no reading shows their usual coefficient, as uncertain as large."""
        count = len(self.coefficients_)
        usual = np.array([group.usual for group in groups])[model.group_of[:count]]
        unseen = (usual > 0.0) & unseen_columns(usual * model.columns[:, :, :count])
        if unseen.any():
            self.coefficients_[unseen], self.root_[unseen] = usual[unseen], 0.0
            self.root_ = np.hstack([self.root_, np.diag(usual)[:, unseen]])

    def predict_reading(
        self, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        """Return the (n, 3) deflection [m] that the training samples' rig would read.

        Arguments and errors are the same as for `predict`; `levers` as in `StiffnessModel`.
        """
        self._check_point_is_given(levers)
        q, wrench = self._checked(q, wrench)
        robot, wrench = self._at_measured_point(q, wrench)
        return self._mean(robot, q, wrench, self.rig_, levers)

    def _deflection(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        return self._mean(robot, q, wrench, self.rig_.without_errors, levers)

    def _mean(
        self,
        robot: Robot,
        q: FloatArray,
        wrench: FloatArray,
        rig: Rig,
        levers: FloatArray = AT_TCP,
    ) -> FloatArray:
        mean = np.empty((len(q), 3))
        for first in range(0, len(q), ROWS):
            rows = slice(first, first + ROWS)
            loads = replace(ArmLoads.of(robot, q[rows], wrench[rows], rig), levers=levers[rows])
            mean[rows] = self._columns(loads) @ self.coefficients_
        return mean

    def _columns(self, loads: ArmLoads) -> FloatArray:
        columns, _ = joined([group.columns(loads, self.sizes_) for group in self._linear])
        return columns

    def deviation(self, q: FloatArray, wrench: FloatArray, *, reading: bool) -> FloatArray:
        """Return the (n, 3) standard deviation [m] of the robot's deflection, or of a reading.

        For a reading it includes the error that the rig would add.
        """
        q, wrench = self._checked(q, wrench)
        robot, wrench = self._at_measured_point(q, wrench)
        deviation = np.empty((len(q), 3))
        for first in range(0, len(q), ROWS):
            rows = slice(first, first + ROWS)
            loads = ArmLoads.of(robot, q[rows], wrench[rows], self.rig_.without_errors)
            columns = self._columns(loads)
            variance = ((columns @ self.root_) ** 2).sum(axis=2)
            if reading:
                blocks = np.stack(self._error_blocks(loads))
                errors = np.tensordot(self.errors_[:-1] ** 2, blocks, axes=1)
                errors = np.diagonal(errors, axis1=1, axis2=2) + self.errors_[-1] ** 2
                rig = self._mean(robot, q[rows], wrench[rows], self.rig_)
                rig = rig - columns @ self.coefficients_
                variance = variance + self.calibration_**2 * errors + rig**2 + self.file_variance_
            deviation[rows] = np.sqrt(variance)
        return deviation

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return the covariance of the robot's deflections as `StiffnessModel`."""
        first, second = (
            self._columns_at(*self._checked(*loads)).transpose(1, 0, 2) @ self.root_
            for loads in ((q, wrench), (other_q, other_wrench))
        )
        return np.asarray(first @ second.swapaxes(1, 2))

    def noise_variance(self) -> FloatArray:
        """Return the (3,) variances of a reading's error, m^2."""
        return np.asarray(self.calibration_**2 * self.error_variance_)

    def _columns_at(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        robot, wrench = self._at_measured_point(q, wrench)
        return self._columns(ArmLoads.of(robot, q, wrench, self.rig_.without_errors))

    def _mean_and_deviation(
        self, q: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        return self._predict(q, wrench), self.deviation(q, wrench, reading=True)

    def _report(
        self,
        robot: Robot,
        groups: Sequence[Group],
        model: GroupedModel,
        posterior: Posterior,
    ) -> dict[str, float]:
        """Return each group's mean deflection [mm] over the training samples, 0 if none is found.

        The ends of a 90 % interval follow, and numbers of weights, force point and noise.
        """
        draws = posterior.mean[:, None] + posterior.root @ np.random.default_rng(0).normal(
            size=(len(posterior.mean), DRAWS)
        )
        numbers: dict[str, float] = {}
        names = np.array([groups[place].name for place in model.group_of])
        for name in dict.fromkeys(group.name for group in groups):
            of_name = names == name
            coefficients = np.column_stack([posterior.mean[of_name], draws[of_name]])
            moved = model.columns[:, :, of_name] @ coefficients
            sizes = 1e3 * np.linalg.norm(moved, axis=1).mean(axis=0)
            if sizes[0] < LEAST_CONTRIBUTION:
                numbers[f"{CONTRIBUTION} {name} [mm]"] = 0.0
                continue
            ends = np.quantile(sizes[1:], [0.5 - TAIL / 2.0, 0.5 + TAIL / 2.0])
            ends[0] = min(ends[0], sizes[0])  # scatter makes a length longer
            numbers |= number_with_interval(f"{CONTRIBUTION} {name}", "mm", sizes[0], ends)
        rig = self.rig_
        for joint, factor in zip(robot.joint_names, rig.weight_factor, strict=True):
            numbers[f"weights on {joint} [%]"] = 100.0 * float(factor)
        for axis, value in zip("xyz", rig.force_point, strict=True):
            numbers[f"force point from the TCP, {axis} [mm]"] = 1e3 * float(value)
        return numbers | {"noise [mm]": 1e3 * float(self.errors_[-1])}
