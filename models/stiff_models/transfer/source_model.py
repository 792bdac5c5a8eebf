"""Base of the families with a source domain: its options and its simulation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, Self

import numpy as np

from stiff_models.model_catalog import SpringModel
from stiff_models.physics.vjm import (
    fitted_physics,
    identify_joints,
    warn_unidentifiable,
    why_rigid,
)
from stiff_models.transfer.source_domain import (
    PoseDesign,
    SourceDesign,
    SourceDomain,
    WrenchDesign,
    check_poses,
    source_design,
)
from stiff_protocols.contract.errors import ConfigError, ModelError, warn
from stiff_protocols.contract.types import BenchmarkData, Deflection, FloatArray, Robot, Samples

PAPER_STIFFNESS = (50_900.0, 63_360.0, 50_340.0, 2_270.0, 8_890.0, 1_390.0)
"""Source paper, Table 3: A1..A6, N m/rad."""

FAR_OFF = 100.0
"""A network is not reliable for forces this many times larger or smaller than in training."""

NO_TARGET_LABELS = "trained on simulated deflections only"
"""Regime of a model trained only on the source domain, whose VJM the labels identify."""

NO_TARGET_LABELS_AT_ALL = "no measured deflection used"
"""The same regime if another robot's labels identify the VJM."""


@dataclass(kw_only=True, eq=False, repr=False)
class SourceModel:
    """Options of the source domain; a mixin of model families, listed before their base class.

    The samples and the robot of the source are the training samples and their robot, or the data
    of `use_source`; "the samples" below are these.

    Attributes:
        source_poses: "sobol" (Sobol points in the samples' joint ranges), "paper" (grid of
            Table 4); "auto": the paper's with its preset, else "sobol". Ranges of samples are
            rounded outwards.
        source_wrenches: "uniform" or "sobol" (over the range of each component of the samples'
            wrenches), "paper" (Table 5); "auto": the paper's with its preset, else "uniform".
        source_teacher: model of the simulated robot's deflection, identified on the samples with
            its default options.
        source_stiffness: stiffness of the joints in the pre-training simulation: "identified" by
            the VJM on the samples, or "nominal".
        nominal_stiffness: values for "nominal", base to tip, N m/rad, as "5e4,6e4,..."; none:
            the paper's Table 3 with its preset.
    """

    source_poses: Literal["auto", "sobol", "paper"] = "auto"
    source_wrenches: Literal["auto", "uniform", "sobol", "paper"] = "auto"
    source_teacher: SpringModel = "vjm"
    source_stiffness: Literal["identified", "nominal"] = "identified"
    nominal_stiffness: str | None = None
    _source: BenchmarkData | None = field(default=None, init=False)

    def use_source(self, source: BenchmarkData | None) -> None:
        """Store the data whose VJM the next `fit` uses for the source domain.

        Args:
            source: another robot or specimen, with as many joints of the same types as the fitted
                robot; all of its samples are used. None: the training samples.
        """
        self._source = source

    def __sklearn_clone__(self) -> Self:
        """Return an unfitted copy with the same options and the same source."""
        copy = replace(self)
        copy.use_source(self._source)
        return copy

    @property
    def paper_source(self) -> bool:
        """True if the options request the source paper's Tables 4 and 5."""
        return False

    def check_robot(self, robot: Robot) -> None:
        """Check that the source can be simulated for the robot, or the robot of `use_source`.

        Raises:
            ConfigError: the paper's poses are used for a robot without six joints, or nominal
                stiffnesses are missing, not valid for the robot, or would be ignored.
        """
        robot = robot if self._source is None else self._source.robot
        check_poses(self._designs()[0], robot)
        if self.source_stiffness == "nominal":
            self._nominal(robot)
        elif self.nominal_stiffness is not None:
            raise ConfigError(
                f"nominal_stiffness={self.nominal_stiffness!r} would be ignored: source_stiffness "
                f"is {self.source_stiffness!r}; use source_stiffness=nominal"
            )
        if self.source_stiffness == "nominal" and self.source_teacher != "vjm":
            raise ConfigError(
                f"source_teacher={self.source_teacher!r} identifies its own springs, so "
                "source_stiffness=nominal would be ignored; use source_teacher=vjm"
            )

    @property
    def source_words(self) -> str:
        """Description of the source domain."""
        poses, wrenches = self._designs()
        springs = "" if self.source_stiffness == "identified" else " of nominal stiffnesses"
        samples = "training samples" if self._source is None else "source data set's samples"
        of_poses = f"Sobol poses in the {samples}' joint ranges"
        if poses == "paper":
            of_poses = "the paper's Table 4"
        kind = "Sobol" if wrenches == "sobol" else "uniform"
        of_wrenches = f"{kind} wrenches in the {samples}' range"
        if wrenches == "paper":
            of_wrenches = "the paper's Table 5"
        return f"{self.source_teacher}{springs} on {of_poses}, {of_wrenches}"

    def _unlabelled(self) -> str:
        return NO_TARGET_LABELS if self._source is None else NO_TARGET_LABELS_AT_ALL

    def _origin(self, train: Samples, robot: Robot) -> BenchmarkData:
        return BenchmarkData(train, robot) if self._source is None else self._source

    def _designs(self) -> tuple[PoseDesign, WrenchDesign]:
        """Return the designs of the options, with "auto" resolved."""
        poses: PoseDesign = "paper" if self.paper_source else "sobol"
        wrenches: WrenchDesign = "paper" if self.paper_source else "uniform"
        return (
            poses if self.source_poses == "auto" else self.source_poses,
            wrenches if self.source_wrenches == "auto" else self.source_wrenches,
        )

    def _simulated(self, samples: Samples, robot: Robot, seed: int) -> SourceDomain:
        """Return the source domain: the teacher's deflections over the design."""
        q, wrench = self._design(samples, robot, seed).rows()
        return SourceDomain(q, wrench, self._teacher(samples, robot)(q, wrench)[:, :, None])

    def _teacher(self, samples: Samples, robot: Robot) -> Deflection:
        if self.source_teacher == "vjm":
            return partial(robot.joint_deflection, self._source_compliance(samples, robot))
        return fitted_physics(self.source_teacher, samples, robot).predict

    def _design(self, samples: Samples, robot: Robot, seed: int) -> SourceDesign:
        design = source_design(*self._designs(), robot, samples, seed)
        simulated, measured = (
            float(np.sqrt(np.mean(wrench[..., :3] ** 2)))
            for wrench in (design.wrench, samples.wrench)
        )
        if measured > 0.0 and not 1.0 / FAR_OFF < simulated / measured < FAR_OFF:
            warn(
                f"pre-training forces are {simulated:.3g} N, measured forces {measured:.3g} N "
                "(root mean square): check that the file is in N, or use source_wrenches=uniform "
                "to draw loads in the measured range"
            )
        return design

    def _source_compliance(self, samples: Samples, robot: Robot) -> FloatArray:
        """Return the (n_joints,) compliances of the source's joints, rad/(N m)."""
        if self.source_stiffness == "nominal":
            return np.asarray(1.0 / self._nominal(robot))
        joints = identify_joints(robot, samples)
        of_source = "training samples" if self._source is None else "samples of the source data set"
        if not joints.compliance.any():
            raise ModelError(
                f"no pre-training data can be simulated from the {of_source}: {why_rigid(samples)}"
            )
        warn_unidentifiable(joints, of_source)
        return joints.compliance

    def _nominal(self, robot: Robot) -> FloatArray:
        if self.nominal_stiffness is None:
            if not self.paper_source:
                raise ConfigError(
                    f"source_stiffness=nominal requires stiffnesses for robot {robot.name!r}; set "
                    f"nominal_stiffness to {robot.n_joints} values in N m/rad, or use "
                    "source_stiffness=identified"
                )
            return np.array(PAPER_STIFFNESS)
        words = self.nominal_stiffness.split(",")
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.array([np.nan])
        if values.shape != (robot.n_joints,) or not (values > 0).all() or np.isinf(values).any():
            raise ConfigError(
                f"nominal_stiffness={self.nominal_stiffness!r}: give {robot.n_joints} positive "
                "numbers, base to tip, in N m/rad, separated by commas"
            )
        return values
