"""Define what a simulated robot and its measurement have beyond springs: effects, and worlds.

An effect is an object with its equation, its size and its draw. A world is a list of effects. Sizes
are drawn once from robot and specimen. Every hook of `Effect` returns its argument unless an effect
changes it, so that a world is the hooks of its effects one after the other.

rad, N, N m, m; base frame. Elastic coordinates are three per joint: the torsion (the motion of a
prismatic joint), then two tilts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, Self

import numpy as np

from stiff_datasets.planning.loads import omni_forces, stream
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.robots.urdf_reader import rotation_of
from stiff_datasets.twin.elastic_chain import ElasticChain
from stiff_datasets.twin.gear_law import GearLaw
from stiff_datasets.twin.gears import CYCLOIDAL, STRAIN_WAVE
from stiff_datasets.twin.twin_file import ARCMIN, SLIDE, Noise, TwinConstants, specimen_law
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, IntArray, Robot

# Ranges of the sizes. A: measured; B: read in a public repository; C: assumption.
FRICTION_ARCMIN = {STRAIN_WAVE: (0.2, 0.6), CYCLOIDAL: (0.03, 0.3), SLIDE: (0.0, 0.0)}
"""Width of a gear's loop: C, catalogues say at most 1; RV: KUKA KR300 0.03 to 0.08 (A), C above."""
ASPECTS = (0.6, 1.0)  # width over height of a tube; C
FLOOR_SHARES = (0.01, 0.05)  # of the deflection; C
BALANCED_SHARES = (0.6, 0.8)  # of the weight's torque; C
LIGHTEST_WITH_BALANCER_KG = 100.0  # payload
COUPLINGS = (0.1, 0.3)  # C
WRIST_JOINTS = 3
ANGLE_SIZES = (0.05, 0.2)  # C
TEETH = (2, 6)  # felt per turn; C
BEARING_PLAY_ARCMIN = (0.2, 0.6)  # C
BEARING_PLAY_SHARE = 0.03  # of the rated torque, within which it is taken up; C
MASS_ERROR = 0.3  # C
FORCE_POINT_M = (5e-3, 25e-3)  # C
SENSOR_ERRORS = (0.01, 0.03)  # cross-talk and gain; C
SENSOR_SIZE_M = 0.1  # lever between cross-talk of forces and of moments; C
FRAME_ERROR_DEG = (0.1, 0.3)  # C
TRACKED_POINT_M = (0.5e-3, 2e-3)  # C
TAIL = 2.5  # degrees of freedom; C
OUTLIER_SHARE, OUTLIER_M = 0.02, 2e-4  # C
SEATING_M, SEATING_PAYLOAD_KG = 2e-5, 10.0  # C
DRIFT_M, DRIFT_STEPS = 4e-5, 3  # C
ONE_SIDED_PLAY_ARCMIN = (0.2, 0.6)  # C
BALL_SHARES = (0.15, 0.4)  # of a bearing's spring, at the rated torque; C
BALL_EXPONENT, LEAST_BALL_LOAD = 2.0 / 3.0, 0.02
"""A ball's approach grows with the force to this power (H. Hertz 1882); its preload over rated."""
OPENING_SHARES, OPENED_SHARES = (0.1, 0.3), (0.15, 0.5)
"""Torque that opens a bolted flange over the rated one; compliance beyond over the bearing's; C."""
RELAXED_SHARES = (0.1, 0.4)  # of the bolts' preload, over the measurement; C
WARMED_SHARES = (0.03, 0.1)  # of a gear's compliance, cold to warm; C
WARMING_TIMES = 3.0  # time constants in a measurement; C
HOSE_SHARES = (0.02, 0.08)  # of the rated torque, at a turn of 90 deg; C
MIDDLE = 0.5
"""Time of the truth: the robot in the middle of the measurement."""
SHEAR_COEFFICIENT = 0.44
"""Of a thin-walled square tube (G. R. Cowper, J. Appl. Mech. 33, 1966)."""
NEARLY_PARALLEL = 0.9
TYPICAL_POSES = 30
SECOND_TORSION = 3
"""Row of the second joint's torsion."""


@dataclass(frozen=True, eq=False)
class Effect:
    """A deviation of a robot or of its measurement; this one has none."""

    @classmethod
    def drawn(cls, constants: TwinConstants, specimen: int) -> Self:
        """Return the effect of one robot of a type."""
        return cls._of(constants, stream("effect", cls.__name__, constants.name, specimen))

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        return cls()

    # the robot

    def real_robot(self, robot: Robot) -> Robot:
        """Return the robot whose description is `robot`."""
        return robot

    def law(self, law: GearLaw) -> GearLaw:
        """Return the law of the elastic coordinates, with arrays (..., 3 n_joints, 1)."""
        return law

    def loaded(self, torque: FloatArray, weight_torque: FloatArray, q: FloatArray) -> FloatArray:
        """Return the (3 n_joints, n) torques on the springs of `torque` on the joints.

        `weight_torque` (3 n_joints, n) is the part of the weight at the commanded angles `q`
        (n_joints, n).
        """
        return torque

    def further_turn(self, torque: FloatArray, time: FloatArray | float) -> FloatArray | float:
        """Return the (3 n_joints, n) turns of the springs in addition to the law's.

        `torque` (3 n_joints, n) is on the springs; `time` (n,) runs from 0 to 1 in a measurement.
        """
        return 0.0

    def turned(self, theta: FloatArray, q: FloatArray) -> FloatArray:
        """Return the (3 n_joints, n) turns of the joints of `theta` of the springs.

        `q` (n_joints, n) are the commanded joint positions.
        """
        return theta

    def displacement(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 6) displacement [m] and rotation [rad] of the TCP by the structure.

        `q` is (n, n_joints), `wrench` (n, 6) at the TCP.
        """
        return np.zeros_like(wrench)

    # the measurement

    def real_wrench(self, wrench: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return the (n, 6) real wrench at the TCP of a `wrench` in the file.

        `rotation` (n, 3, 3) turns from the last joint's frame.
        """
        return wrench

    def sensed(self, wrench: FloatArray, *, inverse: bool = False) -> FloatArray:
        """Return the sensor's reading of a (n, 6) wrench; `inverse`: the wrench of a reading."""
        return wrench

    def tracked_point(self) -> FloatArray:
        """Return the (3,) measured point from the TCP, in the last joint's frame."""
        return np.zeros(3)

    def tracked(self, deflection: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection in the tracker's frame."""
        return deflection

    def noise(self, noise: Noise) -> Noise:
        """Return the noise of the instruments."""
        return noise

    def reading_errors(self, pose: IntArray, n_rows: int, rng: np.random.Generator) -> FloatArray:
        """Return (n_rows, 3) errors of the readings [m]; `pose` (n_rows,) numbers the poses."""
        return np.zeros((n_rows, 3))


def direction(rng: np.random.Generator) -> FloatArray:
    """Return a (3,) unit vector of random direction."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


# friction


@dataclass(frozen=True, eq=False)
class Friction(Effect):
    """Gears stick after a reversal: theta = e(tau) + sum_i w_i p_i (see `gear_law.py`).

    Attributes:
        width: (n_joints,) full width of the loop after the rated torque, rad; 0 for a slide.
        rated: (n_joints,) N m.
    """

    width: FloatArray
    rated: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        ranges = np.array([FRICTION_ARCMIN[kind] for kind in constants.gear_kinds]) * ARCMIN
        return cls(np.asarray(rng.uniform(*ranges.T)), constants.rated_torques)

    def law(self, law: GearLaw) -> GearLaw:
        """Add plays to the torsion of the gears."""
        width = np.zeros((3 * len(self.width), 1))
        rated = np.ones_like(width)
        width[::3, 0], rated[::3, 0] = self.width, self.rated
        plays = GearLaw.of_width(width, rated, law.compliance, law.breakpoints)
        return replace(law, thresholds=plays.thresholds, weights=plays.weights)


# structure


@dataclass(frozen=True, eq=False)
class BendingLinks(Effect):
    """Links are clamped rectangular tubes that bend, shear, twist and stretch.

    A segment of length l moves its end by force F and moment M like a Timoshenko beam:
    F l^3 / (3 E I) + F l / (k G A) + M l^2 / (2 E I). It turns it by F l^2 / (2 E I) + M l / (E I),
    about its axis by M l / (G J), J = 4 A_m^2 t / s of a thin tube (R. Bredt, VDI-Z 40, 1896). The
    chain is statically determinate, so that the TCP's displacement is the sum over the segments
    (J. S. Przemieniecki, Theory of Matrix Structural Analysis, 1968, chapter 5).

    Attributes:
        height, width, wall: (n_segments,) outer sizes and thickness of the tubes, m.
        modulus: (n_segments,) Young's modulus, Pa.
        poisson: Poisson's ratio.
    """

    height: FloatArray
    width: FloatArray
    wall: FloatArray
    modulus: FloatArray
    poisson: float

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        if (beams := constants.beams) is None:
            raise DataError(
                f"{constants.name}: no table [beams], which the worlds structure and all need "
                "(valid: sections as in stiff_datasets/twin/twin_file.py, or another world)"
            )
        height = np.array([tube.outer_m for tube in beams.segment])
        aspect = rng.uniform(*ASPECTS, size=len(height))
        modulus = beams.modulus_Pa * np.exp(constants.scatter.beams * rng.normal(size=len(height)))
        wall = np.array([tube.wall_m for tube in beams.segment])
        return cls(height, height * aspect, wall, modulus, beams.poisson)

    def displacement(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Add up what the segments move the TCP."""
        chain, n = robot.forward(q), robot.n_joints
        tcp, force = chain.points[:, -1], wrench[:, :3]
        turns = np.concatenate([np.broadcast_to(np.eye(3), (len(q), 1, 3, 3)), chain.rotations], 1)
        offsets = np.vstack([robot.placements[:, :3, 3], robot.tcp])
        across = np.vstack([np.eye(3)[2], robot.axes])
        moved = np.zeros_like(wrench)
        for i in range(n + 1):
            if (length := float(np.linalg.norm(offsets[i]))) == 0.0:
                continue
            lever = tcp - chain.points[:, i]
            load = np.hstack([force, wrench[:, 3:] + np.cross(lever, force)])
            basis = turns[:, i] @ _section_basis(offsets[i] / length, across[i])
            of_end = self._end(i, length, basis, load)
            moved += of_end
            moved[:, :3] += np.cross(of_end[:, 3:], lever)
        return moved

    def _end(self, i: int, length: float, basis: FloatArray, load: FloatArray) -> FloatArray:
        """Return (n, 6) displacement and rotation of a cantilever's end under (n, 6) load.

        The columns of `basis` (n, 3, 3) are the tube's axis, its height and its width.
        """
        height, width, wall = self.height[i], self.width[i], self.wall[i]
        modulus, inner = self.modulus[i], (height - 2.0 * wall, width - 2.0 * wall)
        shear_modulus = modulus / (2.0 * (1.0 + self.poisson))
        area = height * width - inner[0] * inner[1]
        moments = (  # about the second and the third axis
            (height * width**3 - inner[0] * inner[1] ** 3) / 12.0,
            (width * height**3 - inner[1] * inner[0] ** 3) / 12.0,
        )
        middle = (height - wall, width - wall)
        twist = 2.0 * wall * (middle[0] * middle[1]) ** 2 / (middle[0] + middle[1])
        force, moment = (np.einsum("nij,ni->nj", basis, load[:, k : k + 3]) for k in (0, 3))
        shift, turn = np.zeros_like(force), np.zeros_like(force)
        shift[:, :1] = length * force[:, :1] / (modulus * area)
        turn[:, :1] = length * moment[:, :1] / (shear_modulus * twist)
        for along, about, sign in ((1, 2, 1.0), (2, 1, -1.0)):
            bending = modulus * moments[about - 1]
            shear = SHEAR_COEFFICIENT * shear_modulus * area
            f, m = force[:, [along]], sign * moment[:, [about]]
            shift[:, [along]] = f * (length**3 / (3.0 * bending) + length / shear) + m * (
                length**2 / (2.0 * bending)
            )
            turn[:, [about]] = sign * (f * length**2 / (2.0 * bending) + m * length / bending)
        return np.hstack([np.einsum("nij,nj->ni", basis, part) for part in (shift, turn)])


def _section_basis(axis: FloatArray, width: FloatArray) -> FloatArray:
    """Return a (3, 3) rotation: the tube's axis, its height, its width near the joint's axis."""
    if abs(axis @ width) > NEARLY_PARALLEL:
        width = np.roll(width, 1)
    width = width - (axis @ width) * axis
    width = width / np.linalg.norm(width)
    return np.column_stack([axis, np.cross(width, axis), width])


@dataclass(frozen=True, eq=False)
class SoftFloor(Effect):
    """The base stands on a soft floor: u = M x r / k, with the moment M about the base's origin.

    Attributes:
        compliance: turn of the base about a horizontal axis, rad/(N m).
    """

    compliance: float

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        robot, share = constants.robot(), rng.uniform(*FLOOR_SHARES)
        q = reachable_poses(robot, TYPICAL_POSES, rng, constants.clearance_m)
        force = omni_forces(len(q), constants.payload_kg, rng)
        wrench = np.hstack([force, np.zeros_like(force)])
        chain, law = ElasticChain(robot), specimen_law(constants, 0)
        still = np.zeros((3 * robot.n_joints, len(q)))
        torque, tcp = chain.statics(q.T, still, wrench.T)
        weight, _ = chain.statics(q.T, still, 0.0 * wrench.T)
        turned = law.angle(torque) - law.angle(weight)
        moved = chain.statics(q.T, turned, wrench.T)[1] - tcp
        by_floor = _floor_motion(1.0, robot, q, wrench)[:, :3]
        sizes = [np.median(np.linalg.norm(part, axis=1)) for part in (moved.T, by_floor)]
        return cls(float(share * sizes[0] / sizes[1]))

    def displacement(self, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Turn the whole robot about the horizontal axes of its base."""
        return _floor_motion(self.compliance, robot, q, wrench)


def _floor_motion(compliance: float, robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
    tcp = robot.tcp_position(q)
    turn = compliance * (wrench[:, 3:] + np.cross(tcp, wrench[:, :3])) * [1.0, 1.0, 0.0]
    return np.hstack([np.cross(turn, tcp), turn])


@dataclass(frozen=True, eq=False)
class Balancer(Effect):
    """A balancer at joint 2 carries a share of the weight's torque, at the commanded angles.

    Attributes:
        share: of the weight's torque about the axis of joint 2; 0 for a small robot.
    """

    share: float

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        share = rng.uniform(*BALANCED_SHARES)
        return cls(share if constants.payload_kg >= LIGHTEST_WITH_BALANCER_KG else 0.0)

    def loaded(self, torque: FloatArray, weight_torque: FloatArray, q: FloatArray) -> FloatArray:
        """Take the share of the weight off the second joint."""
        torque = torque.copy()
        torque[SECOND_TORSION] -= self.share * weight_torque[SECOND_TORSION]
        return torque


@dataclass(frozen=True, eq=False)
class CoupledWrist(Effect):
    """Wrist joints share compliance: theta = G' phi(G tau), G = 1 + coupling of neighbours.

    Attributes:
        coupling: (3 n_joints, 3 n_joints) G.
    """

    coupling: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        n = len(constants.joint)
        coupling = np.eye(3 * n)
        wrist = [3 * joint for joint in range(max(n - WRIST_JOINTS, 0), n)]
        for first, second in pairwise(wrist):
            coupling[second, first] = rng.uniform(*COUPLINGS) * rng.choice([-1.0, 1.0])
        return cls(coupling)

    def loaded(self, torque: FloatArray, weight_torque: FloatArray, q: FloatArray) -> FloatArray:
        """Return G tau."""
        return np.asarray(self.coupling @ torque)

    def turned(self, theta: FloatArray, q: FloatArray) -> FloatArray:
        """Return G' theta."""
        return np.asarray(self.coupling.T @ theta)


@dataclass(frozen=True, eq=False)
class AngleStiffness(Effect):
    """The compliance of a torsion varies with the commanded angle: 1 + a (t(k q + p) + c(q)) / 2.

    t is a triangle wave between -1 and 1 (teeth), c a clipped line (the cable's pull).

    Attributes:
        size: (n_joints,) a.
        periods: (n_joints,) k, teeth per turn that are felt.
        phase, middle: (n_joints,) p, and the middle of the clipped line, rad.
    """

    size: FloatArray
    periods: FloatArray
    phase: FloatArray
    middle: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        n = len(constants.joint)
        size = rng.uniform(*ANGLE_SIZES, size=n) * (constants.rated_torques > 0.0)
        phase, middle = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(-1.0, 1.0, n)
        return cls(size, rng.integers(*TEETH, n).astype(float), phase, middle)

    def turned(self, theta: FloatArray, q: FloatArray) -> FloatArray:
        """Scale the torsions."""
        size, periods, phase, middle = (
            part[:, None] for part in (self.size, self.periods, self.phase, self.middle)
        )
        wave = 2.0 / np.pi * np.arcsin(np.sin(periods * q + phase))
        theta = theta.copy()
        theta[::3] *= 1.0 + size * (wave + np.clip(q - middle, -1.0, 1.0)) / 2.0
        return theta


@dataclass(frozen=True, eq=False)
class BearingPlay(Effect):
    """Bearings have play: a tilt has width / 2 tanh(tau / tau_0) in addition to its spring.

    Attributes:
        width: (n_joints, 2) full width about both cross axes, rad.
        torque: (n_joints,) tau_0, N m.
    """

    width: FloatArray
    torque: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        width = rng.uniform(*BEARING_PLAY_ARCMIN, size=(len(constants.joint), 2)) * ARCMIN
        rated = constants.rated_torques
        return cls(width * (rated > 0.0)[:, None], BEARING_PLAY_SHARE * np.maximum(rated, 1.0))

    def law(self, law: GearLaw) -> GearLaw:
        """Add lost motion to both tilts."""
        lost_motion = np.array(np.broadcast_to(law.lost_motion, law.compliance.shape[1:]))
        torque = np.array(np.broadcast_to(law.lost_motion_torque, law.compliance.shape[1:]))
        for tilt in (0, 1):
            lost_motion[tilt + 1 :: 3, 0] = self.width[:, tilt]
            torque[tilt + 1 :: 3, 0] = self.torque
        return replace(law, lost_motion=lost_motion, lost_motion_torque=torque)


# the measurement


@dataclass(frozen=True, eq=False)
class LinkMasses(Effect):
    """Links are heavier or lighter than the description says.

    Attributes:
        factors: (n_joints,) true mass over the description's.
    """

    factors: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        return cls(1.0 + rng.uniform(-MASS_ERROR, MASS_ERROR, len(constants.joint)))

    def real_robot(self, robot: Robot) -> Robot:
        """Scale the masses."""
        return replace(robot, masses=robot.masses * self.factors)


@dataclass(frozen=True, eq=False)
class ForcePoint(Effect):
    """The force acts at another point than the TCP: the moment at the TCP has d x F more.

    Attributes:
        offset: (3,) d, frame of the last joint, m.
    """

    offset: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        return cls(rng.uniform(*FORCE_POINT_M) * direction(rng))

    def real_wrench(self, wrench: FloatArray, rotation: FloatArray) -> FloatArray:
        """Add the moment of the force on the offset."""
        moment = np.cross(rotation @ self.offset, wrench[:, :3])
        return np.hstack([wrench[:, :3], wrench[:, 3:] + moment])


@dataclass(frozen=True, eq=False)
class ForceSensor(Effect):
    """The force sensor has a gain and cross-talk: reading = C w.

    Cross-talk of a force on a moment is a length, and is scaled by the size of the sensor.

    Attributes:
        matrix: (6, 6) C.
    """

    matrix: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        cross_talk = rng.uniform(*SENSOR_ERRORS, (6, 6)) * rng.choice([-1.0, 1.0], (6, 6))
        gain = 1.0 + rng.uniform(*SENSOR_ERRORS, 2) * rng.choice([-1.0, 1.0], 2)
        scale = np.repeat([1.0, SENSOR_SIZE_M], 3)
        matrix = scale[:, None] * cross_talk / scale
        np.fill_diagonal(matrix, np.repeat(gain, 3))
        return cls(matrix)

    def sensed(self, wrench: FloatArray, *, inverse: bool = False) -> FloatArray:
        """Return C w, or its inverse."""
        matrix = np.linalg.inv(self.matrix) if inverse else self.matrix
        return np.asarray(wrench @ matrix.T)


@dataclass(frozen=True, eq=False)
class TrackerFrame(Effect):
    """The tracker's frame is turned against the robot's base.

    Attributes:
        turn: (3, 3) turns a true displacement into the tracker's frame.
    """

    turn: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        return cls(rotation_of(np.deg2rad(rng.uniform(*FRAME_ERROR_DEG)) * direction(rng)))

    def tracked(self, deflection: FloatArray) -> FloatArray:
        """Turn the deflection."""
        return np.asarray(deflection @ self.turn.T)


@dataclass(frozen=True, eq=False)
class TrackedPoint(Effect):
    """The tracker measures another point than the TCP, which moves as the tool turns.

    Attributes:
        offset: (3,) frame of the last joint, m.
    """

    offset: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        return cls(rng.uniform(*TRACKED_POINT_M) * direction(rng))

    def tracked_point(self) -> FloatArray:
        """Return the offset."""
        return self.offset


@dataclass(frozen=True, eq=False)
class HeavyTails(Effect):
    """Readings scatter as Student's t, with few degrees of freedom and the tracker's size."""

    def noise(self, noise: Noise) -> Noise:
        """Return noise with heavy tails."""
        return noise.model_copy(update={"tail": TAIL})


@dataclass(frozen=True, eq=False)
class Outliers(Effect):
    """A few readings are wrong by a fixed length in a random direction."""

    def reading_errors(self, pose: IntArray, n_rows: int, rng: np.random.Generator) -> FloatArray:
        """Draw the wrong readings."""
        is_wrong = rng.random((n_rows, 1)) < OUTLIER_SHARE
        vectors = rng.normal(size=(n_rows, 3))
        lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
        return np.asarray(is_wrong * OUTLIER_M * vectors / lengths)


@dataclass(frozen=True, eq=False)
class Seating(Effect):
    """The reflector is placed again at every pose, with an error that grows with the robot.

    Attributes:
        size: standard deviation of one axis, m.
    """

    size: float

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        return cls(SEATING_M * np.cbrt(constants.payload_kg / SEATING_PAYLOAD_KG))

    def reading_errors(self, pose: IntArray, n_rows: int, rng: np.random.Generator) -> FloatArray:
        """Draw one error per pose."""
        names, place = np.unique(pose, return_inverse=True)
        return np.asarray(self.size * rng.normal(size=(len(names), 3))[place])


@dataclass(frozen=True, eq=False)
class Drift(Effect):
    """Readings drift over the measurement: half as a line, half in steps, in one direction."""

    def reading_errors(self, pose: IntArray, n_rows: int, rng: np.random.Generator) -> FloatArray:
        """Draw direction and times of the steps."""
        time = np.arange(n_rows) / max(n_rows - 1, 1)
        steps = (time[:, None] >= rng.random(DRIFT_STEPS)).mean(axis=1)
        return np.asarray(DRIFT_M * (time + steps)[:, None] / 2.0 * direction(rng))


# not in any model: written after the models, which have no group for these


@dataclass(frozen=True, eq=False)
class OneSidedPlay(Effect):
    """A gear turns further in one direction: theta = s w (1 - exp(-max(s tau, 0) / tau_0)).

    Attributes:
        width: (n_joints, 1) s w, signed, rad.
        torque: (n_joints, 1) tau_0, N m.
    """

    width: FloatArray
    torque: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        rated = constants.rated_torques[:, None]
        width = rng.uniform(*ONE_SIDED_PLAY_ARCMIN, size=rated.shape) * ARCMIN
        sign = rng.choice([-1.0, 1.0], rated.shape)
        return cls(sign * width * (rated > 0.0), BEARING_PLAY_SHARE * np.maximum(rated, 1.0))

    def further_turn(self, torque: FloatArray, time: FloatArray | float) -> FloatArray:
        """Turn the torsions."""
        turn = np.zeros_like(torque)
        load = np.maximum(np.sign(self.width) * torque[::3], 0.0)
        turn[::3] = self.width * -np.expm1(-load / self.torque)
        return turn


@dataclass(frozen=True, eq=False)
class BallBearings(Effect):
    """Balls in the bearings stiffen with the force: Hertz's contact.

    theta = a T ((|tau| / T + l)^(2/3) - l^(2/3)) sign(tau), with the rated torque T.

    Attributes:
        compliance: (n_joints, 2, 1) a, rad/(N m).
        torque: (n_joints, 1, 1) T, N m.
    """

    compliance: FloatArray
    torque: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        share = rng.uniform(*BALL_SHARES, size=(len(constants.joint), 2, 1))
        return cls(share * _tilting(constants), _rated(constants))

    def further_turn(self, torque: FloatArray, time: FloatArray | float) -> FloatArray:
        """Turn the tilts."""
        load = np.abs(_tilts_of(torque)) / self.torque
        grown = (load + LEAST_BALL_LOAD) ** BALL_EXPONENT - LEAST_BALL_LOAD**BALL_EXPONENT
        return _with_tilts(self.compliance * self.torque * grown, torque)


@dataclass(frozen=True, eq=False)
class OpeningFlange(Effect):
    """A bolted flange opens beyond a torque that falls as its bolts' preload relaxes.

    theta = a max(|tau| - tau_0 (1 - r t), 0) sign(tau) at the time t.

    Attributes:
        compliance: (n_joints, 2, 1) a, rad/(N m).
        torque: (n_joints, 1, 1) tau_0, N m.
        relaxed: r.
    """

    compliance: FloatArray
    torque: FloatArray
    relaxed: float

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        n = len(constants.joint)
        compliance = rng.uniform(*OPENED_SHARES, size=(n, 2, 1)) * _tilting(constants)
        torque = rng.uniform(*OPENING_SHARES, size=(n, 1, 1)) * _rated(constants)
        return cls(compliance, torque, rng.uniform(*RELAXED_SHARES))

    def further_turn(self, torque: FloatArray, time: FloatArray | float) -> FloatArray:
        """Turn the tilts."""
        beyond = np.abs(_tilts_of(torque)) - self.torque * (1.0 - self.relaxed * time)
        return _with_tilts(self.compliance * np.maximum(beyond, 0.0), torque)


@dataclass(frozen=True, eq=False)
class WarmingGears(Effect):
    """Gears soften as they warm up: theta = a (1 - exp(-3 t)) tau at the time t.

    Attributes:
        compliance: (n_joints, 1) a, rad/(N m).
    """

    compliance: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        share = rng.uniform(*WARMED_SHARES, size=(len(constants.joint), 1))
        of_gear = specimen_law(constants, 0).compliance[1, ::3]
        return cls(share * of_gear * (constants.rated_torques > 0.0)[:, None])

    def further_turn(self, torque: FloatArray, time: FloatArray | float) -> FloatArray:
        """Turn the torsions."""
        turn = np.zeros_like(torque)
        turn[::3] = -np.expm1(-WARMING_TIMES * np.asarray(time)) * self.compliance * torque[::3]
        return turn


@dataclass(frozen=True, eq=False)
class HosePull(Effect):
    """The hose package pulls the wrist's joints back, with a torque -a sin(q) |sin(q)|.

    Attributes:
        torque: (n_joints, 1) a, N m; 0 before the wrist.
    """

    torque: FloatArray

    @classmethod
    def _of(cls, constants: TwinConstants, rng: np.random.Generator) -> Self:
        torque = rng.uniform(*HOSE_SHARES, len(constants.joint)) * constants.rated_torques
        torque[:-WRIST_JOINTS] = 0.0
        return cls(torque[:, None])

    def loaded(self, torque: FloatArray, weight_torque: FloatArray, q: FloatArray) -> FloatArray:
        """Add the pull at the commanded angles."""
        torque = torque.copy()
        torque[::3] -= self.torque * np.sin(q) * np.abs(np.sin(q))
        return torque


def _rated(constants: TwinConstants) -> FloatArray:
    return np.asarray(np.maximum(constants.rated_torques, 1.0)[:, None, None])


def _tilting(constants: TwinConstants) -> FloatArray:
    """Return the (n_joints, 2, 1) compliances of the tilts, rad/(N m)."""
    return _tilts_of(specimen_law(constants, 0).compliance[1])


def _tilts_of(values: FloatArray) -> FloatArray:
    """Return (n_joints, 2, n) of the (3 n_joints, n) values."""
    return np.asarray(values.reshape(-1, 3, values.shape[1])[:, 1:])


def _with_tilts(size: FloatArray, torque: FloatArray) -> FloatArray:
    """Return (3 n_joints, n) turns of which the tilts have (n_joints, 2, n) sizes."""
    turn = np.zeros((len(size), 3, torque.shape[1]))
    turn[:, 1:] = size * np.sign(_tilts_of(torque))
    return turn.reshape(torque.shape)


FRICTION: tuple[type[Effect], ...] = (Friction,)
STRUCTURE: tuple[type[Effect], ...] = (
    *(BendingLinks, SoftFloor, Balancer, CoupledWrist, AngleStiffness, BearingPlay),
)
WORKSHOP: tuple[type[Effect], ...] = (
    *(LinkMasses, ForcePoint, ForceSensor, TrackerFrame, TrackedPoint),
    *(HeavyTails, Outliers, Seating, Drift),
)
UNSEEN: tuple[type[Effect], ...] = (
    *(OneSidedPlay, BallBearings, OpeningFlange, WarmingGears, HosePull),
)
World = Literal["clean", "friction", "structure", "workshop", "all", "unseen"]
WORLDS: dict[World, tuple[type[Effect], ...]] = {
    "clean": (),
    "friction": FRICTION,
    "structure": STRUCTURE,
    "workshop": WORKSHOP,
    "all": (*FRICTION, *STRUCTURE, *WORKSHOP),
    "unseen": UNSEEN,
}
"""Effects of each world, in addition to the gears' curves, tilting bearings and noise."""
