"""The closed forms of a serial chain, component by component.

The chain is rewritten once so that each joint moves about or along its own z axis; what lies
between two joints is then a constant rotation and a constant offset. A component is anything that
can be added and multiplied: a torch tensor, or a symbol of `straight_line.py`. Plain floats 0 or 1
cost nothing, and most of a robot's constants are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Literal, Self

import numpy as np

from stiff_protocols.contract.arrays import FloatArray

JointType = Literal["revolute", "prismatic"]

Component = Any
"""A plain float, a torch tensor, or a symbol; components of a computation broadcast together."""

Vector = Sequence[Component]
"""Components along x, y, z."""

Column = tuple[Vector, Vector]
"""Column of a Jacobian: translation [m/rad or m/m] and rotation of the TCP by one joint."""

CosSin = Callable[[Component], tuple[Component, Component]]

ORIGIN: Vector = (0.0, 0.0, 0.0)
AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class ChainGeometry:
    """Geometry and masses of a serial chain; `contract.robot.Robot` describes each attribute."""

    joint_types: tuple[JointType, ...]
    placements: FloatArray
    axes: FloatArray
    masses: FloatArray
    centres_of_mass: FloatArray
    tcp: FloatArray
    gravity: FloatArray


@dataclass(frozen=True, eq=False)
class Link:
    """Geometry and mass between a joint's z-aligned frame and the next joint's.

    Attributes:
        axes: x, y and z axis of the joint's frame, in the previous frame.
        own_axes: x, y and z axis of the robot's joint frame, in this frame.
        offset: origin of the joint's frame, in the previous frame, m.
        prismatic: true if the joint slides.
        mass: mass between the joint and the next joint, kg.
        centre: its centre of mass in the joint's moved frame, m.
    """

    axes: tuple[Vector, ...]
    own_axes: tuple[Vector, ...]
    offset: Vector
    prismatic: bool
    mass: float
    centre: Vector


@dataclass(frozen=True, eq=False)
class Frame:
    """A joint's frame after its motion, in the base frame: origin [m] and axes x, y, z."""

    origin: Vector
    axes: Sequence[Vector]

    def point(self, offset: Vector) -> Vector:
        """Return the position of a point of the frame, base frame."""
        return _plus(self.origin, _out_of(self.axes, offset))


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain whose joints all move about or along z.

    Attributes:
        links: base to tip.
        tcp: tool centre point in the last joint's frame, m.
        gravity: acceleration in the base frame, m/s2.
        cos_sin: returns the cosine and the sine of an angle [rad].

    In the methods `q` holds one component a joint, rad or m, and `compliance` one a joint,
    rad/(N m) or m/N.
    """

    links: tuple[Link, ...]
    tcp: Vector
    gravity: Vector
    cos_sin: CosSin

    @classmethod
    def of(cls, robot: ChainGeometry, cos_sin: CosSin) -> Self:
        """Rewrite a robot."""
        links = []
        basis = np.eye(3)  # the previous joint's z-aligned frame, seen from its own URDF frame
        for i, placement in enumerate(robot.placements):
            aligned = _basis_with_z(robot.axes[i])
            links.append(
                Link(
                    axes=tuple((basis.T @ placement[:3, :3] @ aligned).T.tolist()),
                    own_axes=tuple(aligned.tolist()),
                    offset=(basis.T @ placement[:3, 3]).tolist(),
                    prismatic=robot.joint_types[i] == "prismatic",
                    mass=float(robot.masses[i]),
                    centre=(aligned.T @ robot.centres_of_mass[i]).tolist(),
                )
            )
            basis = aligned
        tcp, gravity = (basis.T @ robot.tcp).tolist(), robot.gravity.tolist()
        return cls(tuple(links), tcp, gravity, cos_sin)

    def frames(self, q: Sequence[Component]) -> Iterator[Frame]:
        """Yield every joint's moved frame."""
        frame = Frame(ORIGIN, AXES)
        for link, position in zip(self.links, q, strict=True):
            origin = frame.point(link.offset)
            x, y, z = (_out_of(frame.axes, axis) for axis in link.axes)
            if link.prismatic:
                origin = _plus(origin, _scaled(position, z))
            else:
                cosine, sine = self.cos_sin(position)
                x, y = (
                    _plus(_scaled(cosine, x), _scaled(sine, y)),
                    _minus(_scaled(cosine, y), _scaled(sine, x)),
                )
            frame = Frame(origin, (x, y, z))
            yield frame

    def poses(self, q: Sequence[Component]) -> list[Component]:
        """Return the components of all joints' origins, of the TCP, and of all rotations.

        n_joints x 3, 3, then n_joints x 3 x 3 row by row, of the joints' frames as the robot has
        them.
        """
        frames = list(self.frames(q))
        origins = [component for frame in frames for component in frame.origin]
        turned = map(_rotation, self.links, frames)
        return [*origins, *frames[-1].point(self.tcp), *chain.from_iterable(turned)]

    def tcp_position(self, q: Sequence[Component]) -> Vector:
        """Return the TCP [m], base frame."""
        return list(self.frames(q))[-1].point(self.tcp)

    def tool(self, q: Sequence[Component]) -> list[Component]:
        """Return the components of the TCP, of the last joint's rotation and of the `jacobian`."""
        last = list(self.frames(q))[-1]
        return [*last.point(self.tcp), *_rotation(self.links[-1], last), *self.jacobian(q)]

    def jacobian(self, q: Sequence[Component]) -> list[Component]:
        """Return the 6 x n_joints components of the Jacobian at the TCP, base frame, row by row.

        A revolute joint's column is ``[z x (p - o); z]`` and a prismatic one's ``[z; 0]``, with the
        joint's axis z and origin o, and the TCP p.
        """
        return _by_rows(self._columns(q))

    def virtual_jacobian(self, q: Sequence[Component]) -> list[Component]:
        """Return the 6 x n_joints x 6 components of the virtual joints' Jacobian, row by row."""
        return _by_rows(chain.from_iterable(self._virtual_columns(q)))

    def _columns(self, q: Sequence[Component]) -> list[Column]:
        return [
            columns[5 if link.prismatic else 2]  # along or about z
            for link, columns in zip(self.links, self._virtual_columns(q), strict=True)
        ]

    def _virtual_columns(self, q: Sequence[Component]) -> list[list[Column]]:
        """Return each joint's columns: turns about, then slides along, the moved frame's axes."""
        frames = list(self.frames(q))
        tcp = frames[-1].point(self.tcp)
        return [
            [(_cross(axis, _minus(tcp, frame.origin)), axis) for axis in frame.axes]
            + [(axis, ORIGIN) for axis in frame.axes]
            for frame in frames
        ]

    def deflection(
        self,
        q: Sequence[Component],
        wrench: Sequence[Component],
        compliance: Sequence[Component],
    ) -> Vector:
        """Return ``J_v diag(c) J^T w`` [m], base frame, without the Jacobian: three sweeps.

        The TCP is carried to the base, the wrench from there to the tip, and the deflection back
        to the base, each in the frame of the joint that is reached. There a joint's torque is
        ``m_z + (p x f)_z``, and its turn moves the TCP by ``(-p_y, p_x, 0)``. `wrench` holds N and
        N m at the TCP, base frame.
        """
        motions = [
            (0.0, 0.0) if link.prismatic else self.cos_sin(position)
            for link, position in zip(self.links, q, strict=True)
        ]
        arms = []  # the TCP in each joint's frame before its motion; of a slide, x and y count
        tcp = self.tcp
        for link, position, motion in reversed(list(zip(self.links, q, motions, strict=True))):
            tcp = (*tcp[:2], _sum(tcp[2], position)) if link.prismatic else _turned(tcp, motion)
            arms.append(tcp)
            tcp = _plus(link.offset, _out_of(link.axes, tcp))
        arms.reverse()

        bent = []
        force, torque = wrench[:3], wrench[3:]
        for link, motion, arm, c in zip(self.links, motions, arms, compliance, strict=True):
            force, torque = _into(link.axes, force), _into(link.axes, torque)
            if link.prismatic:
                bent.append(_times(c, force[2]))
                continue
            swung = _less(_times(arm[0], force[1]), _times(arm[1], force[0]))
            bent.append(_times(c, _sum(torque[2], swung)))
            force, torque = _turned_back(force, motion), _turned_back(torque, motion)

        moved: Vector = ORIGIN
        for link, motion, arm, turn in reversed(
            list(zip(self.links, motions, arms, bent, strict=True))
        ):
            if link.prismatic:
                moved = (*moved[:2], _sum(moved[2], turn))
            else:
                x, y, z = _turned(moved, motion)
                moved = (_less(x, _times(turn, arm[1])), _sum(y, _times(turn, arm[0])), z)
            moved = _out_of(link.axes, moved)
        return moved

    def gravity_torque(self, q: Sequence[Component]) -> list[Component]:
        """Return the torque [N m] (force [N]) of the links' weights on each joint.

        A joint bears the weights beyond it: ``z . (sum_l m_l (r_l - o) x g)``, with the centres
        of mass r, or ``z . (sum_l m_l g)`` where it slides.
        """
        return [
            _dot(axes[2], force if link.prismatic else moment)
            for link, (axes, moment, force) in zip(self.links, self._weights(q), strict=True)
        ]

    def virtual_gravity_torque(self, q: Sequence[Component]) -> list[Component]:
        """Return the n_joints x 6 torques [N m] and forces [N] of the weights, joint by joint.

        They act on the virtual joints: about, then along the moved frame's axes.
        """
        return [
            _dot(axis, load)
            for axes, moment, force in self._weights(q)
            for load in (moment, force)
            for axis in axes
        ]

    def _weights(self, q: Sequence[Component]) -> list[tuple[Sequence[Vector], Vector, Vector]]:
        """Return each moved frame's axes, and moment and force of the weights that it bears."""
        loads = []
        mass, first_moment = 0.0, ORIGIN  # of all that a joint carries, kg and kg m, base frame
        frames = list(self.frames(q))
        for link, frame in reversed(list(zip(self.links, frames, strict=True))):
            mass += link.mass
            first_moment = _plus(first_moment, _scaled(link.mass, frame.point(link.centre)))
            lever = _minus(first_moment, _scaled(mass, frame.origin))
            loads.append((frame.axes, _cross(lever, self.gravity), _scaled(mass, self.gravity)))
        return loads[::-1]


def _basis_with_z(axis: FloatArray) -> FloatArray:
    """Return a right-handed orthonormal basis (columns) whose third axis is `axis`."""
    helper = np.zeros(3)
    helper[np.argmin(np.abs(axis))] = 1.0
    x_axis = np.cross(helper, axis)
    x_axis /= np.linalg.norm(x_axis)
    return np.stack([x_axis, np.cross(axis, x_axis), axis], axis=1)


def _rotation(link: Link, frame: Frame) -> list[Component]:
    """Return the 3 x 3 components of a joint frame's rotation, as the robot has it, row by row."""
    axes = [_out_of(frame.axes, axis) for axis in link.own_axes]
    return list(chain.from_iterable(zip(*axes, strict=True)))


def _by_rows(columns: Iterable[Column]) -> list[Component]:
    return list(chain.from_iterable(zip(*((*move, *turn) for move, turn in columns), strict=True)))


def _turned(vector: Vector, motion: tuple[Component, Component]) -> Vector:
    """Return a vector of the moved frame in the frame before a turn of (cosine, sine) about z."""
    (cosine, sine), (x, y, z) = motion, vector
    return (
        _less(_times(cosine, x), _times(sine, y)),
        _sum(_times(sine, x), _times(cosine, y)),
        z,
    )


def _turned_back(vector: Vector, motion: tuple[Component, Component]) -> Vector:
    (cosine, sine), (x, y, z) = motion, vector
    return (
        _sum(_times(cosine, x), _times(sine, y)),
        _less(_times(cosine, y), _times(sine, x)),
        z,
    )


def _out_of(axes: Sequence[Vector], vector: Vector) -> Vector:
    """Return a vector of a frame with these axes in the frame that the axes are given in."""
    return [_dot([axis[k] for axis in axes], vector) for k in range(3)]


def _into(axes: Sequence[Vector], vector: Vector) -> Vector:
    return [_dot(axis, vector) for axis in axes]


def _plus(a: Vector, b: Vector) -> Vector:
    return [_sum(x, y) for x, y in zip(a, b, strict=True)]


def _minus(a: Vector, b: Vector) -> Vector:
    return [_less(x, y) for x, y in zip(a, b, strict=True)]


def _scaled(factor: Component, vector: Vector) -> Vector:
    return [_times(factor, x) for x in vector]


def _cross(a: Vector, b: Vector) -> Vector:
    return [_less(_times(a[j], b[k]), _times(a[k], b[j])) for j, k in ((1, 2), (2, 0), (0, 1))]


def _dot(a: Sequence[Component], b: Sequence[Component]) -> Component:
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total = _sum(total, _times(x, y))
    return total


def _times(a: Component, b: Component) -> Component:
    """Return a b; a plain factor of 0, 1 or -1 needs no product."""
    for factor, cofactor in ((a, b), (b, a)):
        if isinstance(factor, float) and abs(factor) in (0.0, 1.0):
            if factor == 0.0:
                return 0.0
            return cofactor if factor == 1.0 else -cofactor
    return a * b


def _sum(a: Component, b: Component) -> Component:
    if isinstance(a, float) and a == 0.0:
        return b
    return a if isinstance(b, float) and b == 0.0 else a + b


def _less(a: Component, b: Component) -> Component:
    if isinstance(a, float) and a == 0.0:
        return -b
    return a if isinstance(b, float) and b == 0.0 else a - b
