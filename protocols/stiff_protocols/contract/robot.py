"""A serial robot: its geometry, limits and masses, checked once."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, freeze
from stiff_protocols.contract.controller import Controller
from stiff_protocols.contract.display import Screen, ShownObject
from stiff_protocols.contract.errors import DataError
from stiff_protocols.kinematics.chain_formulas import ChainJoint, JointType
from stiff_protocols.kinematics.serial_chain import SerialChain

STANDARD_GRAVITY = 9.81
"""m/s2, rounded like Pinocchio's default."""

LONGEST_M = 100.0
"""Largest distance between two joints of a robot, m; a larger number is in mm."""

USUAL_TURN_RAD = 4.0 * np.pi
"""Beyond this limit a joint's angles may be in degrees: two turns."""
LARGEST_TURN_RAD = 16.0 * np.pi
"""Beyond this limit they are: the wrists that turn most have +-2700 deg, 7.5 turns."""
UNLIMITED_RAD = 1000.0
"""Limits from here stand for "no limits": no joint has as many degrees."""
USUAL_KG_PER_M3 = 0.05, 3000.0
"""Limits of an arm's mass divided by the cube of its length. Arms with 0.3 kg to 2 t of payload
have 10 to 300; a mass in grams or tonnes is wrong by a factor of 1000."""
LIGHTEST_IN_GRAMS_KG = 500.0
"""An arm with this mass or less is not too heavy, whatever its length."""

LIMIT_HINT = (
    'write degrees as rad (170 deg is 2.967), and type="continuous" for a joint that turns without '
    "end"
)


@dataclass(frozen=True, eq=False, repr=False)
class Robot(ShownObject, SerialChain):
    """A serial chain of revolute or prismatic joints with a tool centre point.

    Its kinematics are the methods of `SerialChain`.

    Attributes:
        name: name of the robot.
        joint_names: names from the base to the tip.
        joint_types: "revolute" or "prismatic", one per joint.
        placements: (n_joints, 4, 4) pose of each joint frame in the previous joint's
            frame (the base for the first) at zero joint position; lengths in m.
        axes: (n_joints, 3) unit axis of each joint in its own frame.
        lower, upper: (n_joints,) joint limits, rad or m; infinite without limits.
        masses: (n_joints,) mass between each joint and the next joint, kg.
        centres_of_mass: (n_joints, 3) its centre of mass in the joint's frame, m.
        tcp: (3,) tool centre point in the last joint's frame, m; `mimics` count as joints here.
        gravity: (3,) acceleration of gravity in the base frame, m/s2.
        flange: (4, 4) pose of the robot description's last link in the last joint's frame, m: the
            usual frame for a TCP. No number depends on it.
        controller: joint angles and frames of its controller; None: the same as the description's.
        held: joints of its description that were fixed at a position when it was read, such as
            "rail=500 mm"; its placements have these positions.
        stand: (3,) where the arm stands on held slides at the base, base frame, m.
        mimics: joints of the chain that follow one of its joints, from the base to the tip. A
            placement is then in the frame of the joint or mimic joint before it.
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
    controller: Controller | None = field(default=None, metadata={"shapes_no_result": True})
    held: tuple[str, ...] = field(default=(), metadata={"shapes_no_result": True})
    stand: FloatArray = field(
        default_factory=lambda: np.zeros(3), metadata={"shapes_no_result": True}
    )
    mimics: tuple[ChainJoint, ...] = field(default=(), metadata={"hashed_where_stated": True})

    def __post_init__(self) -> None:
        n = len(self.joint_names)
        if n == 0 or len(self.joint_types) != n:
            raise DataError(f"robot {self.name!r}: {n} joint names, {len(self.joint_types)} types")
        freeze(self, placements=(n, 4, 4), axes=(n, 3), masses=(n,), centres_of_mass=(n, 3))
        freeze(self, tcp=(3,), gravity=(3,), flange=(4, 4), stand=(3,))
        for name in ("lower", "upper"):  # only limits may be infinite
            limits = np.array(getattr(self, name), dtype=np.float64)
            if limits.shape != (n,) or np.isnan(limits).any():
                raise DataError(f"robot {self.name!r}: {name} limits are {limits}, expected {n}")
            limits.flags.writeable = False
            object.__setattr__(self, name, limits)
        axis_lengths = np.linalg.norm([joint.axis for joint in self.chain_joints], axis=1)
        if not np.allclose(axis_lengths, 1.0, atol=1e-9):
            lengths = ", ".join(f"{length:g}" for length in axis_lengths)
            raise DataError(
                f"robot {self.name!r}: joint axes must have unit length, here {lengths}"
            )
        for mimic in self.mimics:
            if not (mimic.name and 0 <= mimic.before <= n and 0 <= mimic.master < n):
                raise DataError(
                    f"robot {self.name!r}: mimic joint {mimic.name!r} follows joint {mimic.master} "
                    f"and has {mimic.before} joints before it (valid: joints of 0..{n - 1})"
                )
        self._check_sizes()
        self._check_limits()
        if self.controller is not None and len(self.controller.signs) != n:
            raise DataError(
                f"robot {self.name!r}: its controller has {len(self.controller.signs)} joints, "
                f"expected {n}"
            )

    def _check_sizes(self) -> None:
        """Check that no mass is negative and that placements are poses within `LONGEST_M`."""
        joints = self.chain_joints
        masses, centres = zip(
            *((joint.mass, joint.centre_of_mass) for joint in joints), strict=True
        )
        if min(masses) < 0.0:
            raise DataError(f"robot {self.name!r}: masses are {masses} kg, expected >= 0")
        placements = {
            joint.name or self.joint_names[joint.master]: np.array(joint.placement)
            for joint in joints
        }
        for name, placement in (placements | {"the flange": self.flange}).items():
            turn, longest = placement[:3, :3], np.abs(placement[:3, 3]).max()
            if longest > LONGEST_M:
                raise DataError(
                    f"robot {self.name!r}: {name} is placed {longest:g} m from the joint before, "
                    f"expected at most {LONGEST_M:g}; lengths are in m, not mm"
                )
            if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0.0:
                raise DataError(f"robot {self.name!r}: the placement of {name} is not a rotation")
        if max(np.abs(self.tcp).max(), np.abs(centres).max()) > LONGEST_M:
            raise DataError(
                f"robot {self.name!r}: the TCP or a centre of mass is farther than {LONGEST_M:g} m "
                "from its joint; lengths are in m, not mm"
            )

    def _check_limits(self) -> None:
        """Check that the limits of revolute joints are in rad; see `LARGEST_TURN_RAD`."""
        if far := self._joints_beyond(LARGEST_TURN_RAD):
            raise DataError(
                f"robot {self.name!r}: {far}: more than {LARGEST_TURN_RAD:.0f} rad; {LIMIT_HINT}"
            )

    def _joints_beyond(self, limit: float) -> str:
        """Return the revolute joints with a larger finite limit, and their limits as text."""
        ends = np.stack([self.lower, self.upper])
        largest = np.where(np.abs(ends) < UNLIMITED_RAD, np.abs(ends), 0.0).max(axis=0)
        far = np.flatnonzero(self.turns & (largest > limit))
        texts = [f"{self.joint_names[i]} {self.lower[i]:g}..{self.upper[i]:g}" for i in far]
        return f"limits of joint{'s' * (len(far) > 1)} {', '.join(texts)}" if texts else ""

    @property
    def limit_doubt(self) -> str:
        """Question on the unit of its limits, if a joint turns more than twice each way; ""."""
        far = self._joints_beyond(USUAL_TURN_RAD)
        return f"{far} rad: are they in degrees? {LIMIT_HINT}" if far else ""

    @property
    def turns(self) -> BoolArray:
        """(n_joints,) true for revolute joints."""
        return np.array([kind == "revolute" for kind in self.joint_types])

    @property
    def endless(self) -> BoolArray:
        """(n_joints,) true for revolute joints without limits: whole turns are the same pose."""
        return self.turns & np.isinf(self.lower) & np.isinf(self.upper)

    @property
    def n_slides(self) -> int:
        """Number of prismatic joints at the base, such as a track or a lift: they carry the arm."""
        return int(np.argmax([*self.turns, True]))

    def arm_base(self, points: FloatArray) -> FloatArray:
        """Return the (n, 3) positions of the arm on its `n_slides` joints, base frame, m.

        Without such joints they are `stand`. Args: `points` as in `ChainPoses`.
        """
        slides = self.n_slides
        return points[:, slides - 1] if slides else np.tile(self.stand, (len(points), 1))

    @property
    def reach(self) -> float:
        """Length of the arm from its first turning joint to the last joint, m."""
        places = [joint.placement for joint in self.chain_joints if joint.before > self.n_slides]
        return float(np.linalg.norm(np.reshape(places, (-1, 4, 4))[:, :3, 3], axis=1).sum())

    @property
    def has_masses(self) -> bool:
        """Return whether a link between its joints and its tip has a mass."""
        return any(joint.mass for joint in self.chain_joints)

    @property
    def mass_doubt(self) -> str:
        """Question on the unit of its masses, if the turning joints' links cannot have them; ""."""
        turning = [joint.mass for joint in self.chain_joints if joint.joint_type == "revolute"]
        mass, length = sum(turning), self.reach + float(np.linalg.norm(self.flange[:3, 3]))
        low, high = (limit * length**3 for limit in USUAL_KG_PER_M3)
        if mass > max(high, LIGHTEST_IN_GRAMS_KG):
            return f"the moving links weigh {mass:.0f} kg: are the masses of the URDF in grams?"
        if 0.0 < mass < low:
            return f"the moving links weigh {mass:.2g} kg: are the masses of the URDF in tonnes?"
        return ""

    @property
    def tcp_on_flange(self) -> FloatArray:
        """(3,) tool centre point in the frame of the robot description's last link, m.

        The format of `--tcp`: rounded to 1 nm, to remove rounding errors of a rotation.
        """
        lever = self.tcp - self.flange[:3, 3]
        return np.asarray((lever @ self.flange[:3, :3]).round(9) + 0.0)

    def lever(self, q: FloatArray, point: FloatArray) -> FloatArray:
        """Return the (n, 3) vectors from the TCP to a point of the last link, m, base frame.

        Args:
            q: (n, n_joints) joint positions, rad or m.
            point: (3,) or (n, 3), frame of the robot description's last link, m.
        """
        from_tcp = point @ self.flange[:3, :3].T + self.flange[:3, 3] - self.tcp
        turned = self.forward(q).rotation @ np.atleast_2d(from_tcp)[..., None]
        return np.asarray(turned[..., 0])

    def points(self, q: FloatArray, lever: FloatArray) -> FloatArray:
        """Return the (n, 3) points of the last link to which (n, 3) vectors of `lever` lead, m."""
        from_tcp = np.einsum("nji,nj->ni", self.forward(q).rotation, lever)
        return np.asarray((self.tcp + from_tcp - self.flange[:3, 3]) @ self.flange[:3, :3])

    @property
    def joints_text(self) -> str:
        """Name, number of joints and held joints in a line."""
        held = f" ({', '.join(self.held)} held)" if self.held else ""
        return f"{self.name}, {self.n_joints} joints{held}"

    @property
    def summary(self) -> str:
        """Name, number of joints, held joints and mass in a line."""
        mass = sum(joint.mass for joint in self.chain_joints)
        return f"{self.joints_text}, {mass:.1f} kg"

    @property
    def tcp_text(self) -> str:
        """TCP at zero joint positions, base frame, mm."""
        (place,) = 1000.0 * self.tcp_position(np.zeros((1, self.n_joints)))
        return f"{_lengths(place)} mm at zero positions, base frame"

    def view(self) -> Screen:
        """Return its joints with their limits, deg or mm, and its TCP."""
        rows = []
        joints = zip(self.joint_names, self.joint_types, self.lower, self.upper, strict=True)
        for name, kind, low, high in joints:
            unit, factor = ("deg", np.degrees(1.0)) if kind == "revolute" else ("mm", 1000.0)
            ends = np.array([low, high]) * factor
            limits = (f"{end:.0f} {unit}" if np.isfinite(end) else "-" for end in ends)
            rows.append([name, kind, *limits])
        tcp = f"{_lengths(1000.0 * self.tcp_on_flange)} mm in the frame of the last link"
        facts = [("TCP", f"{tcp}; {self.tcp_text}")]
        return Screen(
            f"Robot {self.summary}", facts, ("joint", "type", "lower limit", "upper limit"), rows
        )


def _lengths(vector: FloatArray) -> str:
    """Return a vector, mm, as "(1270.0, 0.0, 365.0)"."""
    return f"({', '.join(f'{length + 0.0:.1f}' for length in vector.round(1))})"
