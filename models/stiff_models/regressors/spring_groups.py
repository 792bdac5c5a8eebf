"""The groups of `bayes-springs`: parts of a robot that bend, and errors of its rig.

A group is a list of columns: deflections [m], each multiplied by a coefficient. All coefficients of
a group have one scale, which the samples choose. Most columns are products a_r t_s: the motion a_r
by a virtual spring of `arm_loads` times the torque t_s on another. A coefficient of 1 is as soft as
the joint itself. SI: rad, N, N m, m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import ClassVar, Literal

import numpy as np

from stiff_models.physics.full_vjm import TURN_RATIO
from stiff_models.regressors.arm_loads import OWN_AXIS, ArmLoads, Rig, Sizes, friction_turns
from stiff_protocols.contract.types import FloatArray

CROSS_AXES, OTHER_AXES, BASE = (0, 1), (3, 4, 5), 0
"""Virtual springs of a joint, and the number of the base among the joints."""
POINT_UNIT, CROSS_UNIT, WEIGHT_UNIT = 0.02, 0.02, 0.3
"""Coefficients of 1: 20 mm, 2 % of cross-talk, 30 % of the weights."""
WEIGHT_RANGE = (-0.5, 2.5)
DRIFT_UNIT, DRIFT_PLACES, DRIFT_WIDTH = 1e-5, np.linspace(0.0, 1.0, 6), 0.2
"""m of a coefficient of 1; places of the bumps and their width, as shares of the measurement."""


@dataclass(frozen=True)
class Group:
    """A group of columns with one scale.

    Attributes:
        name: name for the option `groups`; groups of one name are chosen together.
        unit: of a coefficient.
        part: "robot", or "rig": explains the file and is left out of predictions.
        scale: typical standard deviation of a coefficient; its prior is exponential.
        needs: what samples must state for it, a field of `Samples`; "" for nothing more.
        usual: coefficient by the joints' sizes, of a column that no reading shows.
    """

    name: ClassVar[str]
    unit: ClassVar[str] = "the joint's compliance"
    part: ClassVar[Literal["robot", "rig"]] = "robot"
    scale: ClassVar[float] = 0.15
    needs: ClassVar[str] = ""
    usual: ClassVar[float] = 0.0
    is_searched: ClassVar[bool] = False
    """Whether the columns depend on the coefficients, which are found in rounds (Gauss-Newton)."""

    @property
    def description(self) -> str:
        """Equation, unit of a coefficient, and what the group is part of and needs."""
        meaning = str(type(self).__doc__).partition("\n")[0].rstrip(".")
        needs = f"; needs {self.needs} in the samples" if self.needs else ""
        return f"{meaning} ({self.part}; 1 is {self.unit}{needs})"

    @property
    def is_predicted(self) -> bool:
        """True if predictions are sums over its columns."""
        return self.part == "robot" and not self.is_searched

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return the (n, 3, p) deflections [m] by each coefficient."""
        raise NotImplementedError

    def coefficients(self, rig: Rig, sizes: Sizes) -> FloatArray:
        """Return the (p,) coefficients of a searched group in a rig."""
        raise NotImplementedError

    def changed(self, rig: Rig, coefficients: FloatArray, sizes: Sizes) -> Rig:
        """Return the rig with a searched group's (p,) coefficients."""
        raise NotImplementedError


class JointLines(Group):
    """Linear springs of the joints: d = sum_j a_j c_j t_j."""

    name, scale, usual = "joints", 2.0, 1.0

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return a column per joint."""
        return loads.products(sizes, [(j, OWN_AXIS, j, OWN_AXIS) for j in loads.joints])


class Tilts(Group):
    """Linear springs of the bearings across the joints' axes: d = sum_s a_s c_s t_s."""

    name, scale, usual = "bearings", 0.5, 1.0 / TURN_RATIO

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return two columns per joint."""
        return loads.products(sizes, [(j, a, j, a) for j in loads.joints for a in CROSS_AXES])


@dataclass(frozen=True)
class LostMotion(Group):
    """Lost motion about zero torque: phi = c T [atan((g + t) / (h T)) - atan(g / (h T))]."""

    name: ClassVar[str] = "lost motion"
    width: float = 0.1
    axes: tuple[int, ...] = (OWN_AXIS,)

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return a column per joint (and axis)."""
        axes = np.array(self.axes)
        width = self.width * sizes.torque[1:, axes]
        weight, load = loads.weight[:, 1:, axes], loads.load[:, 1:, axes]
        turned = np.arctan((weight + load) / width) - np.arctan(weight / width)
        return loads.curves(sizes, axes, turned)


@dataclass(frozen=True)
class BearingPlay(LostMotion):
    """Lost motion of the bearings across the joints' axes; the same equation."""

    name: ClassVar[str] = "bearing play"
    scale: ClassVar[float] = 0.1
    axes: tuple[int, ...] = CROSS_AXES


@dataclass(frozen=True)
class LoadCurves(Group):
    """Odd curves of the load only, friction's mean part: phi = 2 c T atan(t / (2 h T))."""

    name: ClassVar[str] = "load curves"
    width: float = 0.1

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return a column per joint."""
        axes = np.array([OWN_AXIS])
        width = 2.0 * self.width * sizes.torque[1:, axes]
        return loads.curves(sizes, axes, 2.0 * np.arctan(loads.load[:, 1:, axes] / width))


class JointAngles(Group):
    """Compliances that vary with the joint's own angle: d = a_j c_j t_j (cos, sin)(k q_j) / k."""

    name = "joint angles"

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return four columns per revolute joint: two harmonics."""
        turning = np.flatnonzero(loads.turns).tolist()
        turns = loads.products(sizes, [(j + 1, OWN_AXIS, j + 1, OWN_AXIS) for j in turning])
        waves = _waves(loads.q[:, turning])
        return np.concatenate([turns * wave[:, None] for wave in waves], axis=2)


class BearingAngles(Group):
    """Tilts that vary with the joint's own angle, and their products at its second harmonic."""

    name = "bearing angles"

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return ten columns per revolute joint."""
        turning = np.flatnonzero(loads.turns).tolist()
        waves = _waves(loads.q[:, turning])
        tilts = [loads.products(sizes, [(j + 1, a, j + 1, a) for j in turning]) for a in CROSS_AXES]
        mixed = loads.products(sizes, [(j + 1, 0, j + 1, 1) for j in turning])
        parts = [tilt * wave[:, None] for wave in waves for tilt in tilts]
        return np.concatenate([*parts, *(mixed * wave[:, None] for wave in waves[2:])], axis=2)


class Couplings(Group):
    """Compliance between the joints, such as a wrist's: d = sqrt(c_i c_j) (a_i t_j + a_j t_i)."""

    name = "couplings"

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return a column per pair of joints."""
        return loads.products(
            sizes, [(i, OWN_AXIS, j, OWN_AXIS) for i, j in combinations(loads.joints, 2)]
        )


class LinkTurns(Group):
    """Links that twist askew: the products a_r t_s + a_s t_r of the axes of a joint's frame."""

    name = "links, turns"

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return three columns per joint."""
        pairs = [(j, a, j, b) for j in loads.joints for a, b in combinations(range(3), 2)]
        return loads.products(sizes, pairs)


class LinkSlides(Group):
    """Links that shear and stretch: the symmetric 3 x 3 compliance of forces at a joint's frame."""

    name = "links, slides"

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return six columns per joint."""
        pairs = [
            (j, a, j, b) for j in loads.joints for a in OTHER_AXES for b in OTHER_AXES if a <= b
        ]
        return loads.products(sizes, pairs)


class LinkBending(Group):
    """Links that bend: motions along an axis by a torque about another, and the reverse."""

    name = "links, bending"

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return nine columns per joint."""
        pairs = [(j, a, j, b) for j in loads.joints for a, b in product(range(3), OTHER_AXES)]
        return loads.products(sizes, pairs)


class BaseSpring(Group):
    """The base on its floor: a symmetric 6 x 6 compliance at the base frame's origin."""

    name = "base"

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return 21 columns."""
        pairs = [(BASE, a, BASE, b) for a in range(6) for b in range(a, 6)]
        return loads.products(sizes, pairs)


@dataclass(frozen=True)
class KnownFriction(Group):
    """Friction whose state the approach tells: d = a_j s_j c T tanh(|t| / (h T)), s = 1 or -1."""

    name: ClassVar[str] = "approach"
    part: ClassVar[Literal["robot", "rig"]] = "rig"
    needs: ClassVar[str] = "approach"
    width: float = 0.2

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return a column per joint."""
        turned = friction_turns(loads, sizes, self.width) * loads.approach
        return np.asarray(loads.move[:, :, 1:, OWN_AXIS] * turned[:, None])


class Drift(Group):
    """Readings that drift over the measurement: a smooth curve of the order, axis by axis."""

    name, unit, part, needs = "drift", f"{1e3 * DRIFT_UNIT:.2g} mm", "rig", "order"
    scale = 1.0

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return a column per bump and axis."""
        since = loads.order - loads.order.min()
        share = since / (since.max() or 1.0)
        bumps = np.exp(-0.5 * ((share[:, None] - DRIFT_PLACES) / DRIFT_WIDTH) ** 2)
        axes = np.einsum("nb,kl->nkbl", bumps, np.eye(3)) * DRIFT_UNIT
        return loads.read(axes.reshape(len(since), 3, -1))


class WeightFactors(Group):
    """Weights on the joints that differ from the description's, by a factor per joint."""

    is_searched = True
    name, unit, scale = "weights", f"{100 * WEIGHT_UNIT:.0f} % of the weights", 1.0

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return a column per joint: the derivative about the current factors."""
        return loads.by_weight * WEIGHT_UNIT

    def coefficients(self, rig: Rig, sizes: Sizes) -> FloatArray:
        """Return the change of each factor, in its unit."""
        return (rig.weight_factor - 1.0) / WEIGHT_UNIT

    def changed(self, rig: Rig, coefficients: FloatArray, sizes: Sizes) -> Rig:
        """Return the rig with these changes of the factors."""
        factors = np.clip(1.0 + WEIGHT_UNIT * coefficients, *WEIGHT_RANGE)
        return replace(rig, weight_factor=factors)


class ForcePoint(Group):
    """A force that acts away from the TCP, at b in the last link: d = C (0, R b x f)."""

    is_searched = True
    name, unit, part, scale = "force point", f"{1e3 * POINT_UNIT:.0f} mm", "rig", 1.0

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return three columns, with the linear springs' compliance C."""
        moments = np.cross(loads.rotation.swapaxes(1, 2), loads.acting[:, None, :3])
        return np.asarray(loads.compliance(sizes)[:, :, 3:] @ moments.swapaxes(1, 2) * POINT_UNIT)

    def coefficients(self, rig: Rig, sizes: Sizes) -> FloatArray:
        """Return the point in its unit."""
        return rig.force_point / POINT_UNIT

    def changed(self, rig: Rig, coefficients: FloatArray, sizes: Sizes) -> Rig:
        """Return the rig with this point."""
        return replace(rig, force_point=POINT_UNIT * coefficients)


class CrossTalk(Group):
    """A force sensor that mixes and scales its components: d = C X w, X 6 x 6."""

    is_searched = True
    name, unit, part, scale = "force sensor", f"{100 * CROSS_UNIT:.0f} % of the load", "rig", 1.0

    def columns(self, loads: ArmLoads, sizes: Sizes) -> FloatArray:
        """Return 36 columns, with the linear springs' compliance C."""
        soft = loads.compliance(sizes) * sizes.wrench
        columns = soft[..., None] * (loads.written / sizes.wrench)[:, None, None]
        return np.asarray(columns.reshape(*soft.shape[:2], 36) * CROSS_UNIT)

    def coefficients(self, rig: Rig, sizes: Sizes) -> FloatArray:
        """Return the shares in units of the wrench's sizes."""
        return np.ravel(rig.cross_talk * sizes.wrench / sizes.wrench[:, None]) / CROSS_UNIT

    def changed(self, rig: Rig, coefficients: FloatArray, sizes: Sizes) -> Rig:
        """Return the rig with these shares."""
        shares = CROSS_UNIT * coefficients.reshape(6, 6)
        return replace(rig, cross_talk=shares * sizes.wrench[:, None] / sizes.wrench)


GROUPS: tuple[Group, ...] = (
    JointLines(),
    Tilts(),
    *(LostMotion(width) for width in (0.03, 0.1, 0.3)),
    BearingPlay(0.1),
    *(LoadCurves(width) for width in (0.03, 0.1, 0.3)),
    JointAngles(),
    BearingAngles(),
    Couplings(),
    LinkTurns(),
    LinkSlides(),
    LinkBending(),
    BaseSpring(),
    *(KnownFriction(width) for width in (0.05, 0.2, 0.8)),
    Drift(),
    WeightFactors(),
    ForcePoint(),
    CrossTalk(),
)
GROUP_NAMES = tuple(dict.fromkeys(group.name for group in GROUPS))


def groups_named(name: str) -> list[Group]:
    """Return the groups of a name, or of all names that begin with it and a comma."""
    name = name.strip()
    return [group for group in GROUPS if name in (group.name, group.name.partition(",")[0])]


def _waves(angle: FloatArray) -> list[FloatArray]:
    """Return cosine and sine of (n, k) angles, and half the waves of twice the angles."""
    return [
        *(np.cos(angle), np.sin(angle)),
        *(0.5 * np.cos(2.0 * angle), 0.5 * np.sin(2.0 * angle)),
    ]
