"""A serial robot: its geometry, and where its links, its tool and its weights are.

The methods are the plain closed forms. Stiffness models compute the Jacobian of many thousand
samples faster (`stiff_models.physics.kinematics`), with the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stiff_protocols.contract.arrays import FloatArray, frozen_array
from stiff_protocols.contract.errors import DataError

JointType = Literal["revolute", "prismatic"]

GRAVITY = (0.0, 0.0, -9.81)  # (3,) m/s2, base frame; Pinocchio's default

REACHED_M, REACHED_RAD = 1e-6, 1e-6
"""How near `Robot.inverse` comes to the pose that was asked for."""


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
    gravity: FloatArray = field(default_factory=lambda: np.array(GRAVITY))
    flange: FloatArray = field(
        default_factory=lambda: np.eye(4), metadata={"shapes_no_result": True}
    )

    def __post_init__(self) -> None:
        """Freeze and check every array."""
        n = len(self.joint_names)
        if n == 0 or len(self.joint_types) != n:
            raise DataError(f"robot {self.name!r}: {n} joint names, {len(self.joint_types)} types")
        shapes: dict[str, tuple[int | None, ...]] = {
            "placements": (n, 4, 4),
            "axes": (n, 3),
            "masses": (n,),
            "centres_of_mass": (n, 3),
            "tcp": (3,),
            "gravity": (3,),
            "flange": (4, 4),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), name, shape))
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

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def tcp_on_flange(self) -> FloatArray:
        """(3,) tool centre point in the frame of the robot description's last link, m.

        As `--tcp` has it: rounded to 1 nm, so that a rotation leaves no digits behind.
        """
        lever = self.tcp - self.flange[:3, 3]
        return np.asarray((lever @ self.flange[:3, :3]).round(9) + 0.0)

    def __repr__(self) -> str:
        """Return name, joints with their limits, and where the TCP is at zero positions."""
        units = {"revolute": ("deg", np.degrees(1.0)), "prismatic": ("mm", 1000.0)}
        limits = [
            f"{name} {low * factor:.0f}..{high * factor:.0f} {unit}"
            for name, low, high, (unit, factor) in zip(
                self.joint_names,
                self.lower,
                self.upper,
                (units[kind] for kind in self.joint_types),
                strict=True,
            )
        ]
        (place,) = 1000.0 * self.tcp_position(np.zeros((1, self.n_joints)))
        tcp = ", ".join(f"{length:.1f}" for length in place)
        return (
            f"Robot {self.name}, {self.n_joints} joints, {self.masses.sum():.1f} kg\n"
            f"  limits: {', '.join(limits)}\n  TCP at zero positions: ({tcp}) mm, base frame"
        )

    def checked_positions(self, q: FloatArray) -> FloatArray:
        """Return joint positions as (n, n_joints) float64.

        Raises:
            DataError: `q` has another number of joints than the robot.
        """
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
        from scipy.spatial.transform import Rotation  # 0.1 s, which `bench --help` does without

        q = self.checked_positions(q)
        rotation, origin = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        points = np.empty((len(q), self.n_joints + 1, 3))
        rotations = np.empty((len(q), self.n_joints, 3, 3))
        for joint, kind in enumerate(self.joint_types):
            origin = origin + rotation @ self.placements[joint, :3, 3]
            rotation = rotation @ self.placements[joint, :3, :3]
            motion = q[:, joint, None] * self.axes[joint]  # (n, 3) rad or m, joint frame
            if kind == "revolute":
                rotation = rotation @ Rotation.from_rotvec(motion).as_matrix()
            else:
                origin = origin + np.einsum("nij,nj->ni", rotation, motion)
            points[:, joint], rotations[:, joint] = origin, rotation
        points[:, -1] = origin + rotation @ self.tcp
        return ChainPoses(points, rotations)

    def tcp_position(self, q: FloatArray) -> FloatArray:
        """Return the (n, 3) position of the TCP [m]; argument and error as `forward`."""
        return self.forward(q).points[:, -1]

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Return the geometric Jacobian at the TCP, base frame.

        Args:
            q: (n, n_joints) joint positions, rad or m.

        Returns:
            (n, 6, n_joints): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation.

        Raises:
            DataError: `q` has another number of joints than the robot.
        """
        return self.jacobian_at(self.forward(q))

    def jacobian_at(self, found: ChainPoses) -> FloatArray:
        """Return the `jacobian` where the robot stands as `forward` has returned."""
        axes = np.einsum("njab,jb->nja", found.rotations, self.axes)  # (n, n_joints, 3)
        turns = np.array([kind == "revolute" for kind in self.joint_types])[:, None]
        lever = found.points[:, -1:] - found.points[:, :-1]
        translation = np.where(turns, np.cross(axes, lever), axes)
        rotation = np.where(turns, axes, 0.0)
        return np.concatenate([translation, rotation], axis=2).transpose(0, 2, 1)

    def inverse(self, pose: FloatArray, seed: FloatArray) -> FloatArray:
        """Return joint positions within the limits at which the TCP has a pose.

        Of several, it is the one that scipy's bounded least squares finds from `seed`.

        Args:
            pose: (4, 4) of the TCP, base frame, m.
            seed: (n_joints,) joint positions to begin with, rad or m.

        Returns:
            (n_joints,) rad or m.

        Raises:
            DataError: the pose is none, or is not reached from there.
        """
        from scipy.optimize import least_squares
        from scipy.spatial.transform import Rotation

        wanted = frozen_array(pose, "pose", (4, 4))
        start = np.clip(self.checked_positions(np.atleast_2d(seed))[0], self.lower, self.upper)

        def residual(q: FloatArray) -> FloatArray:
            tcp = self.forward(q[None]).tcp[0]
            turn = Rotation.from_matrix(tcp[:3, :3] @ wanted[:3, :3].T).as_rotvec()
            return np.concatenate([tcp[:3, 3] - wanted[:3, 3], turn])

        def rows(q: FloatArray) -> FloatArray:
            return np.asarray(self.jacobian(q[None])[0])

        found = least_squares(
            residual,
            start,
            jac=rows,
            bounds=(self.lower, self.upper),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        away = np.linalg.norm(found.fun.reshape(2, 3), axis=1)  # m, rad
        if away[0] > REACHED_M or away[1] > REACHED_RAD:
            raise DataError(
                f"robot {self.name!r} does not reach the pose from this seed: it stays "
                f"{1000.0 * away[0]:.3g} mm and {np.degrees(away[1]):.3g} deg away"
            )
        return np.asarray(found.x, dtype=np.float64)

    def gravity_torque(self, q: FloatArray) -> FloatArray:
        """Return the torque that the weights of the links exert on the joints.

        It has the sign of a load's torque: drives balance it with the opposite one. Loads and tools
        that the robot carries are not part of it.

        Args:
            q: (n, n_joints) joint positions, rad or m.

        Returns:
            (n, n_joints) N m, or N at a prismatic joint.

        Raises:
            DataError: `q` has another number of joints than the robot.
        """
        found = self.forward(q)
        axes = np.einsum("njab,jb->nja", found.rotations, self.axes)
        carried = np.einsum("njab,jb->nja", found.rotations, self.centres_of_mass)
        centres = found.points[:, :-1] + carried
        weights = self.masses[:, None] * self.gravity  # (n_joints, 3) N
        torque = np.empty((len(axes), self.n_joints))
        for joint, kind in enumerate(self.joint_types):
            force = np.broadcast_to(weights[joint:], centres[:, joint:].shape)
            if kind == "revolute":
                force = np.cross(centres[:, joint:] - found.points[:, joint, None], force)
            torque[:, joint] = np.einsum("na,nka->n", axes[:, joint], force)
        return torque
