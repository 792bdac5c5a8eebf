"""What the families with a source domain share: its options, and how it is made."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, Self

import numpy as np

from stiff_models.physics.vjm import (
    Physics,
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
"""A network says nothing of forces so many times larger or smaller than those it learned from."""

NO_TARGET_LABELS = "target labels not trained on"
"""Regime of a model whose weights see the source domain alone: the labels identify the VJM."""

NO_TARGET_LABELS_AT_ALL = "target labels not used"
"""The same where another robot's labels identify the VJM."""


@dataclass(kw_only=True, eq=False, repr=False)
class SourceModel:
    """Options of the source domain; a mixin of model families, before their base class.

    The samples and the robot of the source are the training samples and their robot, or those that
    `use_source` was given; "the samples" below are these.

    Attributes:
        source_poses: "sobol" (Sobol points in the samples' joint ranges), "paper" (grid of
            Table 4); "auto": the paper's where its source is asked for, else "sobol". Ranges of
            samples are rounded outwards.
        source_wrenches: "uniform" or "sobol" (over the range of each component of the samples'
            wrenches), "paper" (Table 5); "auto": the paper's where its source is asked for, else
            "uniform".
        source_teacher: model that is identified on the samples and says how the simulated robot
            gives way; with its default options.
        source_stiffness: of the joints in the pre-training simulation: "identified" by the
            VJM on the samples, or "nominal".
        nominal_stiffness: values for "nominal", base to tip, N m/rad, as "5e4,6e4,..."; none:
            the paper's Table 3, where its source is asked for.
    """

    source_poses: Literal["auto", "sobol", "paper"] = "auto"
    source_wrenches: Literal["auto", "uniform", "sobol", "paper"] = "auto"
    source_teacher: Physics = "vjm"
    source_stiffness: Literal["identified", "nominal"] = "identified"
    nominal_stiffness: str | None = None
    _source: BenchmarkData | None = field(default=None, init=False)

    def use_source(self, source: BenchmarkData | None) -> None:
        """Store whose VJM the next `fit` makes the source domain of.

        Args:
            source: another robot or specimen, with as many joints of the same types as the one
                that is fitted for; all of its samples are used. None: the training samples.
        """
        self._source = source

    def __sklearn_clone__(self) -> Self:
        """Return an unfitted copy with the same options and the same source."""
        base: Any = super()
        copy: Self = base.__sklearn_clone__()
        copy.use_source(self._source)
        return copy

    @property
    def paper_source(self) -> bool:
        """Whether the options ask for the source paper's Tables 4 and 5."""
        return False

    def check_robot(self, robot: Robot) -> None:
        """Check that the source can be made for the robot, or of the one that `use_source` gave.

        Raises:
            ConfigError: the paper's poses for a robot without six joints, or nominal stiffnesses
                that are missing, do not fit it, or would not be used.
        """
        robot = robot if self._source is None else self._source.robot
        check_poses(self._designs()[0], robot)
        if self.source_stiffness == "nominal":
            self._nominal(robot)
        elif self.nominal_stiffness is not None:
            raise ConfigError(
                f"nominal_stiffness={self.nominal_stiffness!r} would not be used: "
                f"source_stiffness is {self.source_stiffness!r} (valid with it: nominal)"
            )
        if self.source_stiffness == "nominal" and self.source_teacher != "vjm":
            raise ConfigError(
                f"source_teacher={self.source_teacher!r} identifies its own springs: "
                "source_stiffness=nominal would not be used (valid with it: vjm)"
            )

    @property
    def source_words(self) -> str:
        """What the source domain is, in words."""
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
        """Return what "auto" stands for, or what was asked for."""
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
                "(root mean square): is the file in N? source_wrenches=uniform draws loads in the "
                "measured ones' range"
            )
        return design

    def _source_compliance(self, samples: Samples, robot: Robot) -> FloatArray:
        """The (n_joints,) compliance, rad/(N m), of the joints that make the source."""
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
                    f"source_stiffness=nominal: no stiffnesses were given for robot "
                    f"{robot.name!r}; give nominal_stiffness={robot.n_joints} values in N m/rad, "
                    "or use identified"
                )
            return np.array(PAPER_STIFFNESS)
        words = self.nominal_stiffness.split(",")
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.array([np.nan])
        if values.shape != (robot.n_joints,) or not (values > 0).all() or np.isinf(values).any():
            raise ConfigError(
                f"nominal_stiffness={self.nominal_stiffness!r}: valid are {robot.n_joints} "
                f"positive numbers, base to tip, in N m/rad, separated by commas"
            )
        return values
