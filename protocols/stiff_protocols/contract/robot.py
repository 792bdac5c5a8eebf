"""A serial robot: its geometry, and where its links, its tool and its weights are.

The methods are the plain closed forms. Stiffness models compute the Jacobian of many thousand
samples faster (`stiff_models.physics.kinematics`), with the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, freeze, frozen_array
from stiff_protocols.contract.errors import DataError

JointType = Literal["revolute", "prismatic"]

STANDARD_GRAVITY = 9.81
"""m/s2, rounded as Pinocchio's default is."""

REACHED_M, REACHED_RAD = 1e-8, 1e-8
"""How near inverse kinematics comes to the pose that was asked for."""
LONGEST_M = 100.0
"""m between two joints of a robot at most; a larger number was written in mm."""
STEPS = 40
"""Newton's steps at most; in reach and away from singularities it takes three to five."""
PATIENCE = 8
"""A point whose error has not halved in so many steps is given up."""
LARGEST_TURN = 0.3
"""rad or m, of a joint in one Newton step."""
LENGTH = 0.5
"""m that count as 1 rad in the damping and the condition of a Jacobian."""


@dataclass(frozen=True, eq=False)
class ChainPoses:
    """Where a robot stands at n joint positions, base frame.

    Attributes:
        points: (n, n_joints + 1, 3) origins of the joints' frames after their motion and TCP, m.
        rotations: (n, n_joints, 3, 3) orientation of every joint's frame after its motion.
    """

    points: FloatArray
    rotations: FloatArray

    @property
    def rotation(self) -> FloatArray:
        """(n, 3, 3) orientation of the last joint's frame, which is the tool's."""
        return self.rotations[:, -1]

    @property
    def tcp(self) -> FloatArray:
        """(n, 4, 4) pose of the TCP, m."""
        return _poses(self.points[:, -1], self.rotation)

    @property
    def links(self) -> FloatArray:
        """(n, n_joints, 4, 4) pose of what every joint carries, m."""
        return _poses(self.points[:, :-1], self.rotations)


def _poses(points: FloatArray, rotations: FloatArray) -> FloatArray:
    poses = np.zeros((*points.shape[:-1], 4, 4))
    poses[..., :3, :3], poses[..., :3, 3], poses[..., 3, 3] = rotations, points, 1.0
    return poses


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial chain of revolute or prismatic joints with a tool centre point.

    Attributes:
        name: name of the robot.
        joint_names: names from the base to the tip.
        joint_types: "revolute" or "prismatic", one a joint.
        placements: (n_joints, 4, 4) pose of each joint frame in the previous joint's
            frame (the base for the first) at zero joint position; lengths in m.
        axes: (n_joints, 3) unit axis of each joint in its own frame.
        lower, upper: (n_joints,) joint limits, rad or m; infinite where there are none.
        masses: (n_joints,) mass of what each joint carries up to the next one, kg.
        centres_of_mass: (n_joints, 3) its centre of mass in the joint's frame, m.
        tcp: (3,) tool centre point in the last joint's frame, m.
        gravity: (3,) acceleration of gravity in the base frame, m/s2.
        flange: (4, 4) pose of the robot description's last link in the last joint's frame, m: the
            frame in which people give a TCP. No number depends on it.
    """

    name: str
    joint_names: tuple[str, ...]
    joint_types: tuple[JointType, ...]
    placements: FloatArray
    axes: FloatArray
    lower: FloatArray
    upper: FloatArray
    masses: FloatArray
    centres_of_mass: FloatArray
    tcp: FloatArray
    gravity: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    flange: FloatArray = field(
        default_factory=lambda: np.eye(4), metadata={"shapes_no_result": True}
    )

    def __post_init__(self) -> None:
        n = len(self.joint_names)
        if n == 0 or len(self.joint_types) != n:
            raise DataError(f"robot {self.name!r}: {n} joint names, {len(self.joint_types)} types")
        freeze(self, placements=(n, 4, 4), axes=(n, 3), masses=(n,), centres_of_mass=(n, 3))
        freeze(self, tcp=(3,), gravity=(3,), flange=(4, 4))
        for name in ("lower", "upper"):  # limits alone may be infinite
            limits = np.array(getattr(self, name), dtype=np.float64)
            if limits.shape != (n,) or np.isnan(limits).any():
                raise DataError(f"robot {self.name!r}: {name} limits are {limits}, expected {n}")
            limits.flags.writeable = False
            object.__setattr__(self, name, limits)
        if not np.allclose(np.linalg.norm(self.axes, axis=1), 1.0, atol=1e-9):
            lengths = ", ".join(f"{length:g}" for length in np.linalg.norm(self.axes, axis=1))
            raise DataError(
                f"robot {self.name!r}: joint axes must have unit length, here {lengths}"
            )
        self._check_sizes()

    def _check_sizes(self) -> None:
        """Check that no mass is negative and that placements are poses within `LONGEST_M`."""
        if (self.masses < 0.0).any():
            raise DataError(f"robot {self.name!r}: masses are {self.masses} kg, expected >= 0")
        for name, placement in zip(
            (*self.joint_names, "the flange"), (*self.placements, self.flange), strict=True
        ):
            turn, longest = placement[:3, :3], np.abs(placement[:3, 3]).max()
            if longest > LONGEST_M:
                raise DataError(
                    f"robot {self.name!r}: {name} is placed {longest:g} m from the joint before, "
                    f"expected at most {LONGEST_M:g}; lengths are in m, not mm"
                )
            if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0.0:
                raise DataError(f"robot {self.name!r}: the placement of {name} is no rotation")
        if max(np.abs(self.tcp).max(), np.abs(self.centres_of_mass).max()) > LONGEST_M:
            raise DataError(
                f"robot {self.name!r}: the TCP or a centre of mass is farther than {LONGEST_M:g} m "
                "from its joint; lengths are in m, not mm"
            )

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def turns(self) -> BoolArray:
        """(n_joints,) whether each joint is revolute."""
        return np.array([kind == "revolute" for kind in self.joint_types])

    @property
    def n_slides(self) -> int:
        """Number of prismatic joints at the base, such as a track or a lift: they carry the arm."""
        return int(np.argmax([*self.turns, True]))

    def arm_base(self, points: FloatArray) -> FloatArray:
        """Return the (n, 3) places to which the `n_slides` joints carry the arm, base frame, m.

        Without such joints they are the base frame's origin. Args: `points` as of `ChainPoses`.
        """
        return points[:, self.n_slides - 1] if self.n_slides else np.zeros((len(points), 3))

    @property
    def tcp_on_flange(self) -> FloatArray:
        """(3,) tool centre point in the frame of the robot description's last link, m.

        As `--tcp` has it: rounded to 1 nm, so that a rotation leaves no digits behind.
        """
        lever = self.tcp - self.flange[:3, 3]
        return np.asarray((lever @ self.flange[:3, :3]).round(9) + 0.0)

    def __repr__(self) -> str:
        units = {"revolute": ("deg", np.degrees(1.0)), "prismatic": ("mm", 1000.0)}
        limits = []
        joints = zip(self.joint_names, self.joint_types, self.lower, self.upper, strict=True)
        for name, kind, low, high in joints:
            unit, factor = units[kind]
            limits.append(f"{name} {low * factor:.0f}..{high * factor:.0f} {unit}")
        (place,) = 1000.0 * self.tcp_position(np.zeros((1, self.n_joints)))
        tcp = ", ".join(f"{length:.1f}" for length in place)
        return (
            f"Robot {self.name}, {self.n_joints} joints, {self.masses.sum():.1f} kg\n"
            f"  limits: {', '.join(limits)}\n  TCP at zero positions: ({tcp}) mm, base frame"
        )

    def checked_positions(self, q: FloatArray) -> FloatArray:
        """Return joint positions as (n, n_joints) float64; DataError for any other shape."""
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != self.n_joints:
            raise DataError(f"q has shape {q.shape}, expected (n, {self.n_joints})")
        return q

    def forward(self, q: FloatArray) -> ChainPoses:
        """Return where the joints, the links and the TCP are.

        Args:
            q: (n, n_joints) joint positions, rad or m.

        Raises:
            DataError: `q` has another number of joints than the robot.
        """
        q = self.checked_positions(q)
        # Samples last: NumPy is several times as fast with long inner loops
        rotation, origin = np.broadcast_to(np.eye(3)[..., None], (3, 3, len(q))), np.zeros((3, 1))
        points = np.empty((self.n_joints + 1, 3, len(q)))
        rotations = np.empty((self.n_joints, 3, 3, len(q)))
        for joint, kind in enumerate(self.joint_types):
            position, placed = q[:, joint], self._placed[joint]
            origin = origin + np.einsum("abn,b->an", rotation, self.placements[joint, :3, 3])
            if kind == "revolute":
                part = np.stack([np.ones(len(q)), np.sin(position), 1.0 - np.cos(position)])
                rotation = np.einsum("abn,bcn->acn", rotation, placed @ part)
            else:
                rotation = np.einsum("abn,bc->acn", rotation, placed[..., 0])
                origin = origin + position * np.einsum("abn,b->an", rotation, self.axes[joint])
            points[joint], rotations[joint] = origin, rotation
        points[-1] = origin + np.einsum("abn,b->an", rotation, self.tcp)
        return ChainPoses(points.transpose(2, 0, 1), rotations.transpose(3, 0, 1, 2))

    @cached_property
    def _placed(self) -> FloatArray:
        """(n_joints, 3, 3, 3): [..., 0] + sin(q) [..., 1] + (1 - cos(q)) [..., 2] turns a joint.

        Rodrigues' formula, behind the joint's placement.
        """
        turn, cross = self.placements[:, :3, :3], np.cross(np.eye(3), self.axes[:, None])
        return np.stack([turn, turn @ cross, turn @ cross @ cross], axis=-1)

    def tcp_position(self, q: FloatArray) -> FloatArray:
        """Return the (n, 3) position of the TCP [m]; argument and error as `forward`."""
        return self.forward(q).points[:, -1]

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Return the geometric Jacobian at the TCP, base frame; argument and error as `forward`.

        It is (n, 6, n_joints): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation.
        """
        return self.jacobian_at(self.forward(q))

    def jacobian_at(self, found: ChainPoses) -> FloatArray:
        """Return the `jacobian` where the robot stands as `forward` has returned."""
        axes = np.einsum("njab,jb->ajn", found.rotations, self.axes)  # (3, n_joints, n)
        turns = self.turns[:, None]
        lever = (found.points[:, -1:] - found.points[:, :-1]).transpose(2, 1, 0)
        translation = np.where(turns, np.cross(axes, lever, axis=0), axes)
        return np.concatenate([translation, np.where(turns, axes, 0.0)]).transpose(2, 0, 1)

    def inverse(
        self,
        position: FloatArray,
        rotation: FloatArray,
        seed: FloatArray,
        free: BoolArray | None = None,
    ) -> tuple[FloatArray, BoolArray]:
        """Return joint positions at which the TCP has each pose, and whether it reaches it.

        Newton's method for n poses at once, with the damping of Sugihara (IEEE Trans. Robotics 27,
        2011), which shrinks with the remaining error. Limits of the joints are not looked at. A
        pose that is not reached gets the positions where its search ended.

        Args:
            position: (n, 3) of the TCP, base frame, m.
            rotation: (n, 3, 3) of the last joint's frame.
            seed: (n, n_joints) where to begin, rad or m.
            free: (n_joints,) whether each joint may move; the others stay at the seed. None: all.

        Raises:
            DataError: the shapes do not fit, or a number is not finite.
        """
        from scipy.spatial.transform import Rotation

        position = frozen_array(position, "position", (len(seed), 3))
        rotation = frozen_array(rotation, "rotation", (len(seed), 3, 3))
        free = np.ones(self.n_joints, dtype=bool) if free is None else free
        q, reached = np.array(seed, dtype=np.float64), np.zeros(len(seed), dtype=bool)
        rows, left = np.arange(len(q)), np.full((STEPS, len(q)), np.inf)
        for step in range(STEPS):
            stands = self.forward(q[rows])
            turn = Rotation.from_matrix(rotation[rows] @ stands.rotation.transpose(0, 2, 1))
            error = np.hstack([position[rows] - stands.points[:, -1], turn.as_rotvec()])
            near = np.linalg.norm(error.reshape(-1, 2, 3), axis=2) <= (REACHED_M, REACHED_RAD)
            reached[rows[near.all(axis=1)]] = True
            error[:, :3] /= LENGTH
            left[step, rows] = np.linalg.norm(error, axis=1)
            on = ~near.all(axis=1)
            if step >= PATIENCE:
                on &= left[step, rows] < 0.5 * left[step - PATIENCE, rows]
            rows, error = rows[on], error[on]
            if not len(rows):
                break
            jacobian = self.jacobian_at(ChainPoses(stands.points[on], stands.rotations[on]))
            if not free.all():
                jacobian = jacobian[:, :, free]
            jacobian[:, :3] /= LENGTH
            transposed = jacobian.transpose(0, 2, 1)
            damping = 0.5 * np.einsum("ni,ni->n", error, error) + 1e-14
            normal = transposed @ jacobian + damping[:, None, None] * np.eye(free.sum())
            turned = np.linalg.solve(normal, transposed @ error[..., None])[..., 0]
            largest = np.abs(turned).max(axis=1, keepdims=True)
            turned *= np.minimum(1.0, LARGEST_TURN / np.maximum(largest, LARGEST_TURN))
            q[np.ix_(rows, free)] += turned
        return q, reached

    def gravity_torque(self, q: FloatArray) -> FloatArray:
        """Return the (n, n_joints) torque [N m] (force [N]) of the links' weights on the joints.

        It has the sign of a load's torque: drives balance it with the opposite one. Loads and tools
        that the robot carries are not part of it. Argument and error as `forward`.
        """
        found = self.forward(q)
        axes = np.einsum("njab,jb->nja", found.rotations, self.axes)
        carried = np.einsum("njab,jb->nja", found.rotations, self.centres_of_mass)
        centres = found.points[:, :-1] + carried
        weights = self.masses[:, None] * self.gravity  # (n_joints, 3) N
        torque = np.empty((len(axes), self.n_joints))
        for joint, turns in enumerate(self.turns):
            force = np.broadcast_to(weights[joint:], centres[:, joint:].shape)
            if turns:
                force = np.cross(centres[:, joint:] - found.points[:, joint, None], force)
            torque[:, joint] = np.einsum("na,nka->n", axes[:, joint], force)
        return torque
