"""`gp-springs`: Gaussian processes over the torque-deflection curves of virtual springs.

`spring_process.py` has the covariance and the posterior. This file has its hyperparameters,
with weak priors from the robot's size, and the model. SI: rad, N, N m, m.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from annotated_types import Ge
from scipy.optimize import minimize

from stiff_models.networks.encoded_model import encode
from stiff_models.physics.fitted_geometry import (
    STEP,
    Geometry,
    GeometryModel,
    geometry_at,
    inverse_curvature,
)
from stiff_models.physics.full_vjm import spring_columns, spring_twists
from stiff_models.physics.vjm import identify_joints, warn_no_masses, why_rigid
from stiff_models.regressors.calibrated_process import CalibratedProcess
from stiff_models.regressors.gaussian_process import Covariance, minimum
from stiff_models.regressors.joint_curves import joint_curves
from stiff_models.regressors.spring_process import (
    LikelihoodSlopes,
    SpringCovariance,
    SpringLoads,
    SpringProcess,
    likelihood_slopes,
)
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import joint_torque, unit_deflections
from stiff_protocols.springs.identification import typical_joints

SPREAD = 3.2
"""Standard deviation of a hyperparameter's logarithm: the prior allows a factor of 25 either way.
It matters only for hyperparameters that the samples do not determine."""
SIZE_SPREAD = 1.6
"""The same for the sizes of curves: ln 5, as for the springs that `identification` identifies."""
LIKELIHOOD_TOLERANCE = 1e-6
"""Least relative gain of a step of the search, a few thousandths of a log-likelihood."""
ROUNDS = 2
"""Searches of the point, each followed by a search of the hyperparameters."""
POINT_SCALE = 0.01  # m, of the search for the point
LOST = ("lost", "lost again")
AXES_OF_WRENCH = 6


@dataclass(frozen=True)
class Prior:
    """A prior of a hyperparameter's logarithm; its mean is the search's start.

    Attributes:
        start: the prior's mean, and the first value.
        low, high: bounds.
        spread: the prior's standard deviation; infinite: only the bounds count.
    """

    start: float
    low: float
    high: float
    spread: float = SPREAD

    @classmethod
    def near(cls, start: float) -> Prior:
        """Return the prior of a curve's size about a value, within a factor of 400."""
        return cls(start, start - 6.0, start + 6.0, SIZE_SPREAD)


@dataclass(frozen=True, eq=False)
class Hyperparameters:
    """Names, priors and meaning of the logarithms in the search.

    Attributes:
        priors: priors by name. "own 0" is ln c of the first joint's own spring; "across" is added
            to it for the springs across the joint; "bend own", "bend across" are ln n; "length" is
            ln l; "lost", "lost again" are ln m and ln m'; "width" is ln h. "noise" and "remainder"
            are logarithms of a standard deviation [m]; "pose", "load" of the remainder's lengths.
        joint: (n_springs,) number of each spring's joint.
        across: (n_springs,) true for springs across the joint's axis.
        scale: (n_springs,) T_s, N m or N.
        n_pose_features: number of the remainder's pose features.
    """

    priors: Mapping[str, Prior]
    joint: IntArray
    across: BoolArray
    scale: FloatArray
    n_pose_features: int

    @property
    def start(self) -> FloatArray:
        """Mean of each prior."""
        return np.array([prior.start for prior in self.priors.values()])

    @property
    def precision(self) -> FloatArray:
        """Inverse variance of each prior."""
        return np.array([prior.spread**-2 for prior in self.priors.values()])

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of each logarithm."""
        return [(prior.low, prior.high) for prior in self.priors.values()]

    def covariance(self, theta: FloatArray) -> SpringCovariance:
        """Return the covariance of these logarithms."""
        value = dict(zip(self.priors, theta.tolist(), strict=True))
        compliance = np.array([value[f"own {joint}"] for joint in self.joint])
        slope = np.exp(2.0 * (compliance + np.where(self.across, value["across"], 0.0)))
        bend = np.where(self.across, value["bend across"], value["bend own"])
        size, remainder = slope * self.scale**2, None
        if "remainder" in value:
            counts = [self.n_pose_features, AXES_OF_WRENCH]
            lengths = np.exp(np.repeat([value["pose"], value["load"]], counts))
            variance = math.exp(2.0 * value["remainder"])
            remainder = Covariance("matern", variance, lengths, noise=0.0, jitter=0.0)
        return SpringCovariance(
            slope=slope,
            bend=size * np.exp(2.0 * bend),
            lost=np.where(self.across, 0.0, size)
            * np.exp([[2.0 * value.get(name, -math.inf)] for name in LOST]),
            width=math.exp(value.get("width", 0.0)),
            length=math.exp(value["length"]),
            scale=self.scale,
            noise=math.exp(2.0 * value["noise"]),
            remainder=remainder,
        )

    def slopes(self, covariance: SpringCovariance, likelihood: LikelihoodSlopes) -> FloatArray:
        """Return the derivatives of a likelihood by the logarithms."""
        by_bend, by_lost = (
            covariance.bend * likelihood.by_bend,
            covariance.lost * likelihood.by_lost,
        )
        by_size = 2.0 * (covariance.slope * likelihood.by_slope + by_bend + by_lost.sum(axis=0))
        slopes = {
            f"own {joint}": slope for joint, slope in enumerate(np.bincount(self.joint, by_size))
        } | {
            "across": by_size[self.across].sum(),
            "bend own": 2.0 * by_bend[~self.across].sum(),
            "bend across": 2.0 * by_bend[self.across].sum(),
            "length": likelihood.by_length,
            **dict(zip(LOST, 2.0 * by_lost.sum(axis=1), strict=True)),
            "width": likelihood.by_width,
            "noise": 2.0 * covariance.noise * likelihood.by_noise,
            "remainder": likelihood.by_remainder,
            "pose": likelihood.by_features[: self.n_pose_features].sum(),
            "load": likelihood.by_features[self.n_pose_features :].sum(),
        }
        return np.array([slopes[name] for name in self.priors])


@dataclass(kw_only=True, eq=False, repr=False)
class GpSprings(CalibratedProcess, GeometryModel):
    """Gaussian processes over the curves of virtual springs, plus a small remainder.

    With tcp="fit", tcp="prior" or lever="fit" the point is also the most probable point.

    Attributes:
        springs: 18: three virtual springs per joint (18 for six joints), about its axis and about
            the two axes across it (along them at a prismatic joint); 6: one per joint.
        lost_motion: lost motion of the joints, near zero torque and under every load.
        remainder: an extra process of pose and load for deflections that no spring explains.
        search_rows: most training samples of the search for hyperparameters (drawn at random).
        most_samples: most training samples of the process (drawn at random); its memory grows with
            their square, its time with their cube.
        process_: the process given the training samples.
        theta_: its hyperparameters, logarithms in the order of `Hyperparameters.priors`.
        springs_: stiffness of each joint's own spring at no, half and full torque (the slope over
            a twentieth of the largest torque), with its standard error, where the training samples
            have this torque.
        curves_: "spring A2" -> (n, 3) torque on a previously unloaded joint [N m or N], turn of its
            spring [rad or m] and the turn's standard deviation, inside the training samples'
            torques.
        diagnostics_: report of `springs_`, lost motion of each joint (width inside the training
            samples' torques, 0 if none is found), noise and remainder.
    """

    springs: Literal[6, 18] = 18
    lost_motion: bool = True
    remainder: bool = True
    search_rows: Annotated[int, Ge(10)] = 300
    most_samples: Annotated[int, Ge(10)] = 2000

    added_later: ClassVar[tuple[str, ...]] = (*GeometryModel.added_later, "lost_motion")
    _begin: GpSprings | None = field(default=None, init=False)

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Fit as `CalibratedProcess.fit`, and store the curves of the joints' springs."""
        super().fit(train, robot=robot, validation=validation, seed=seed)
        self._report(robot)
        return self

    def _for_a_fold(self) -> Self:
        copy = super()._for_a_fold()
        copy._begin = self  # the searches continue from this fit
        return copy

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        self.check_params()
        train = self._affordable(train, seed)
        warn_no_masses(robot)
        self.load_scale_ = np.abs(train.wrench).max(axis=0)
        self.load_scale_[self.load_scale_ == 0.0] = 1.0
        hyper = self._hyperparameters(train, robot, self._loads(robot, train.q, train.wrench))
        rows = np.random.default_rng(seed).permutation(len(train))[: self.search_rows]
        search_samples = train.take(np.sort(rows))
        begin = self._begin
        self.theta_: FloatArray = hyper.start if begin is None else begin.theta_
        self.geometry_ = None if begin is None else begin.geometry_
        self.theta_ = self._likeliest(hyper, search_samples, robot)
        if self.fits_point:
            self._search_point(hyper, search_samples, robot, full_search=begin is None)
        self.process_ = self._process(hyper.covariance(self.theta_), train, robot, self.geometry_)

    def _likeliest(self, hyper: Hyperparameters, samples: Samples, robot: Robot) -> FloatArray:
        """Return the most probable hyperparameters for the current geometry."""
        loads = self._measured_loads(robot, self.geometry_, samples.q, samples.wrench)

        def loss(theta: FloatArray) -> tuple[float, FloatArray]:
            covariance, away = hyper.covariance(theta), theta - hyper.start
            slopes = likelihood_slopes(covariance, loads, samples.deflection.T)
            value = 0.5 * float(hyper.precision @ away**2) - slopes.value
            return value, hyper.precision * away - hyper.slopes(covariance, slopes)

        return minimum(loss, [self.theta_], hyper.bounds, LIKELIHOOD_TOLERANCE)

    def _search_point(
        self, hyper: Hyperparameters, samples: Samples, robot: Robot, *, full_search: bool
    ) -> None:
        """Set the most probable point and hyperparameters.

        The full search begins at the given point and at the point of linear springs. The search of
        a fold (`full_search` is false) continues from the current point.
        """
        if not full_search:
            self.geometry_ = self._likeliest_geometry(hyper, samples, robot)
            self.theta_ = self._likeliest(hyper, samples, robot)
            return
        begin, optima = self.theta_, []
        twists = spring_twists(robot, samples.q, self._of_joint)
        linear = self._linear_geometry(samples, robot, twists, unit_deflections)
        for start in (None, linear):
            self.theta_, self.geometry_ = begin, start
            for _ in range(ROUNDS):
                self.geometry_ = self._likeliest_geometry(hyper, samples, robot)
                self.theta_ = self._likeliest(hyper, samples, robot)
            offset, away = self._offset(robot), self.theta_ - hyper.start
            loss = self._loss_of_point(hyper, samples, robot)(offset)
            loss += 0.5 * float(hyper.precision @ away**2)
            optima.append((loss, self.theta_, offset))
        _, self.theta_, offset = min(optima, key=lambda optimum: optimum[0])
        loss_of = self._loss_of_point(hyper, samples, robot)
        covariance = inverse_curvature(loss_of, offset, self.sigma)
        self.geometry_ = geometry_at(robot, offset, covariance, self.moves)

    def _likeliest_geometry(
        self, hyper: Hyperparameters, samples: Samples, robot: Robot
    ) -> Geometry:
        """Return the most probable point for the current hyperparameters."""
        loss = self._loss_of_point(hyper, samples, robot)
        start = self._offset(robot)
        options: Any = {"eps": STEP / POINT_SCALE, "ftol": LIKELIHOOD_TOLERANCE}

        def scaled_loss(steps: FloatArray) -> float:
            return loss(steps * POINT_SCALE)

        optimum = minimize(scaled_loss, start / POINT_SCALE, method="L-BFGS-B", options=options)
        return geometry_at(robot, optimum.x * POINT_SCALE, np.zeros((3, 3)), self.moves)

    def _offset(self, robot: Robot) -> FloatArray:
        """Return the current point's (3,) offset from the given point, m."""
        return np.zeros(3) if self.geometry_ is None else self.geometry_.point - robot.tcp

    def _loss_of_point(
        self, hyper: Hyperparameters, samples: Samples, robot: Robot
    ) -> Callable[[FloatArray], float]:
        """Return the negative log-probability of the point's (3,) offset [m]."""
        covariance, unknown = hyper.covariance(self.theta_), np.zeros((3, 3))

        def loss(offset: FloatArray) -> float:
            geometry = geometry_at(robot, offset, unknown, self.moves)
            process = self._process(covariance, samples, robot, geometry)
            return 0.5 * float(offset @ offset) / self.sigma**2 - process.log_likelihood

        return loss

    def _process(
        self,
        covariance: SpringCovariance,
        samples: Samples,
        robot: Robot,
        geometry: Geometry | None,
    ) -> SpringProcess:
        loads = self._measured_loads(robot, geometry, samples.q, samples.wrench)
        return SpringProcess.of(covariance, loads, samples.deflection.T)

    def _affordable(self, train: Samples, seed: int) -> Samples:
        """Return the samples, or `most_samples` of them, drawn at random."""
        if len(train) <= self.most_samples:
            return train
        warn(
            f"the process uses {self.most_samples:,} of {len(train):,} training samples, drawn at "
            "random; raise the option most_samples to use more"
        )
        drawn = np.random.default_rng(seed).permutation(len(train))[: self.most_samples]
        return train.take(np.sort(drawn))

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return the covariance of deflections as `StiffnessModel`; errors as in `predict`."""
        first = self._fitted_loads(*self._checked(q, wrench))
        second = self._fitted_loads(*self._checked(other_q, other_wrench))
        scale = self.calibration_[:, None, None] ** 2
        return np.asarray(self.process_.between(first, second) * scale)

    def noise_variance(self) -> FloatArray:
        """Return the (3,) variances of a measured deflection's error, m²."""
        noise = self.process_.covariance.noise * self.calibration_**2
        return np.asarray(np.maximum(noise, self.instrument_noise_**2))

    def _deflection(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return self.process_.mean(self._loads(robot, q, wrench))

    def _uncalibrated(self, q: FloatArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.process_.mean_and_deviation(self._fitted_loads(q, wrench))

    def _fitted_loads(self, q: FloatArray, wrench: FloatArray) -> SpringLoads:
        """Return the loads for the fitted robot and geometry."""
        return self._measured_loads(self.robot_, self.geometry_, q, wrench)

    def _measured_loads(
        self, robot: Robot, geometry: Geometry | None, q: FloatArray, wrench: FloatArray
    ) -> SpringLoads:
        """Return the loads by wrenches at the robot's TCP; they move the measured point."""
        if geometry is None:
            return self._loads(robot, q, wrench)
        return self._loads(geometry.robot, q, geometry.wrench_at_tcp(q, wrench))

    def _loads(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> SpringLoads:
        twists = spring_twists(robot, q, self._of_joint)
        joint, kind = self._virtual_joints(robot)
        unloaded = robot.virtual_gravity_torque(q)[:, joint, kind]
        loaded = unloaded + joint_torque(twists, wrench)
        return SpringLoads(
            move=np.ascontiguousarray(twists[:, :3].transpose(2, 1, 0)),
            unloaded=np.ascontiguousarray(unloaded.T),
            loaded=np.ascontiguousarray(loaded.T),
            pose=encode(robot, q, wrench, "sincos")[:, :-AXES_OF_WRENCH],
            load=wrench / self.load_scale_,
        )

    @property
    def _of_joint(self) -> Literal[1, 3]:
        return 3 if self.springs == 18 else 1

    def _virtual_joints(self, robot: Robot) -> tuple[IntArray, IntArray]:
        """Return each spring's joint and kind (of `virtual_jacobian`'s six); 2, 5: the joint."""
        return np.divmod(np.array(spring_columns(robot, self._of_joint)), 6)

    def _hyperparameters(self, train: Samples, robot: Robot, loads: SpringLoads) -> Hyperparameters:
        joint, kind = self._virtual_joints(robot)
        scale = np.abs(loads.loaded - loads.unloaded).max(axis=1)
        scale[scale == 0.0] = 1.0  # no sample loads it
        size = max(float(np.sqrt(np.mean(train.deflection**2))), self.instrument_noise_)
        noise = math.log(self.instrument_noise_)
        priors = {
            f"own {k}": Prior.near(math.log(c))
            for k, c in enumerate(_first_compliance(train, robot, size))
        } | {
            "across": Prior.near(-1.5),  # a bearing tilts a fifth as far as its gear turns
            "bend own": Prior.near(-1.0),
            "bend across": Prior.near(-1.0),
            "length": Prior(math.log(0.5), -4.0, 3.0),
            "noise": Prior(
                noise + math.log(3.0), noise, max(noise + 2.3, math.log(0.3 * size)), math.inf
            ),
        }
        if self.lost_motion:
            priors |= dict.fromkeys(LOST, Prior(-1.5, -5.0, 3.0))
            priors["width"] = Prior(math.log(0.05), -5.0, 0.0)
        if self.remainder:
            small, least = math.log(0.05 * size), math.log(1e-3 * size)
            priors["remainder"] = Prior(small, least, math.log(size), math.inf)
            priors |= dict.fromkeys(("pose", "load"), Prior(0.7, -1.5, 3.0, math.inf))
        return Hyperparameters(priors, joint, kind % 3 != 2, scale, loads.pose.shape[1])

    def _report(self, robot: Robot) -> None:
        """Store curves, stiffnesses and lost motions of the joints' own springs."""
        _, kind = self._virtual_joints(robot)
        springs = np.flatnonzero(kind % 3 == 2)
        calibration = float(np.sqrt(np.mean(self.calibration_**2)))
        self.curves_, self.springs_, lost = joint_curves(self.process_, robot, springs, calibration)
        self.diagnostics_ = {
            **self.springs_.report(),
            **(lost if self.lost_motion else {}),
            "noise [mm]": 1e3 * math.sqrt(self.process_.covariance.noise),
            **self._geometry_report(),
        }


def _first_compliance(train: Samples, robot: Robot, size: float) -> FloatArray:
    """Return the search's start: each joint's compliance as identified by the VJM."""
    compliance = identify_joints(robot, train).compliance
    if compliance.all():
        return compliance
    warn(why_rigid(train))
    torque = joint_torque(robot.jacobian(train.q), train.wrench)
    typical = typical_joints(robot)
    moved = np.einsum("nki,ni,i->nk", robot.jacobian(train.q)[:, :3], torque, typical)
    return typical * size / float(np.sqrt(np.mean(moved**2)))
