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

CosSin = Callable[[Component], tuple[Component, Component]]

ORIGIN: Vector = (0.0, 0.0, 0.0)
AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class ChainJoint:
    """A joint of a chain: an independent one, or a mimic joint that follows an independent one.

    Attributes:
        joint_type: "revolute" or "prismatic".
        placement: (4, 4) pose of its frame in the frame of the chain's joint before, row by row, m.
        axis: unit axis in its own frame.
        mass: mass between it and the chain's next joint, kg.
        centre_of_mass: centre of this mass in its frame, m.
        master: number, from 0, of the independent joint that moves it; an independent joint's own.
        before: number of independent joints before it in the chain.
        multiplier, offset: its position is `multiplier` times the master's, plus `offset`; rad, m.
        name: name of a mimic joint; "" for an independent joint.
    """

    joint_type: JointType
    placement: tuple[tuple[float, ...], ...]
    axis: tuple[float, ...]
    mass: float
    centre_of_mass: tuple[float, ...]
    master: int
    before: int
    multiplier: float = 1.0
    offset: float = 0.0
    name: str = ""


class ChainGeometry:
    """Geometry and masses of a serial chain; `contract.robot.Robot` describes each attribute."""

    joint_types: tuple[JointType, ...]
    placements: FloatArray
    axes: FloatArray
    masses: FloatArray
    centres_of_mass: FloatArray
    tcp: FloatArray
    gravity: FloatArray
    mimics: tuple[ChainJoint, ...]

    @property
    def chain_joints(self) -> list[ChainJoint]:
        """All joints from the base to the tip: the independent joints and `mimics`."""
        joints = [
            ChainJoint(
                kind,
                tuple(map(tuple, self.placements[i].tolist())),
                tuple(self.axes[i].tolist()),
                float(self.masses[i]),
                tuple(self.centres_of_mass[i].tolist()),
                master=i,
                before=i,
            )
            for i, kind in enumerate(self.joint_types)
        ]
        return sorted([*self.mimics, *joints], key=lambda joint: joint.before)


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
        joint: the joint, which may be a mimic joint.
    """

    axes: tuple[Vector, ...]
    own_axes: tuple[Vector, ...]
    offset: Vector
    prismatic: bool
    mass: float
    centre: Vector
    joint: ChainJoint

    @property
    def own_motion(self) -> int:
        """Number of the joint's own motion among the six of `virtual_jacobian`."""
        return 5 if self.prismatic else 2


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

    In the methods `q` holds one component an independent joint, rad or m, and `compliance` one an
    independent joint, rad/(N m) or m/N. A mimic joint is coupled rigidly to its master: it has no
    spring of its own, and its motion and torque are parts of the master's.
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
        for joint in robot.chain_joints:
            placement, aligned = np.array(joint.placement), _basis_with_z(np.array(joint.axis))
            links.append(
                Link(
                    axes=tuple((basis.T @ placement[:3, :3] @ aligned).T.tolist()),
                    own_axes=tuple(aligned.tolist()),
                    offset=(basis.T @ placement[:3, 3]).tolist(),
                    prismatic=joint.joint_type == "prismatic",
                    mass=joint.mass,
                    centre=(aligned.T @ np.array(joint.centre_of_mass)).tolist(),
                    joint=joint,
                )
            )
            basis = aligned
        tcp, gravity = (basis.T @ robot.tcp).tolist(), robot.gravity.tolist()
        return cls(tuple(links), tcp, gravity, cos_sin)

    def frames(self, q: Sequence[Component]) -> Iterator[Frame]:
        """Yield the moved frame of every joint, also of mimic joints."""
        frame = Frame(ORIGIN, AXES)
        for link, position in zip(self.links, self._positions(q), strict=True):
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

    def _positions(self, q: Sequence[Component]) -> list[Component]:
        """Return the position of every link's joint."""
        joints = [link.joint for link in self.links]
        return [_sum(_times(joint.multiplier, q[joint.master]), joint.offset) for joint in joints]

    def poses(self, q: Sequence[Component]) -> list[Component]:
        """Return the components of all joints' origins, of the TCP, and of all rotations.

        n_joints x 3, 3, then n_joints x 3 x 3 row by row, of the independent joints' frames as the
        robot has them, and the 3 x 3 of the tool.
        """
        frames = list(self.frames(q))
        turned = list(map(_rotation, self.links, frames))
        independent = [i for i, link in enumerate(self.links) if not link.joint.name]
        origins = [component for i in independent for component in frames[i].origin]
        rotations = chain.from_iterable(turned[i] for i in (*independent, -1))
        return [*origins, *frames[-1].point(self.tcp), *rotations]

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

    def _columns(self, q: Sequence[Component]) -> list[Vector]:
        return self._own_parts(self._virtual_columns(q))

    def _virtual_columns(self, q: Sequence[Component]) -> list[list[Vector]]:
        """Return each joint's columns: turns about, then slides along, the moved frame's axes."""
        frames = list(self.frames(q))
        tcp = frames[-1].point(self.tcp)
        return self._by_joint(
            [(*_cross(axis, _minus(tcp, frame.origin)), *axis) for axis in frame.axes]
            + [(*axis, *ORIGIN) for axis in frame.axes]
            for frame in frames
        )

    def _by_joint(self, parts: Iterable[list[Vector]]) -> list[list[Vector]]:
        """Return the six parts of each independent joint from the six parts of every link.

        A mimic joint's own part, times its multiplier, is added to the master's own part.
        """
        pairs = list(zip(self.links, parts, strict=True))
        masters = [(link, six) for link, six in pairs if not link.joint.name]
        for link, six in pairs:
            if link.joint.name:
                master, sums = masters[link.joint.master]
                moved = _scaled(link.joint.multiplier, six[link.own_motion])
                sums[master.own_motion] = _plus(sums[master.own_motion], moved)
        return [six for _, six in masters]

    def _own_parts(self, parts: Iterable[list[Vector]]) -> list[Vector]:
        """Return each independent joint's own part of its six: along or about z."""
        own_motions = [link.own_motion for link in self.links if not link.joint.name]
        return [six[k] for k, six in zip(own_motions, parts, strict=True)]

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
        positions = self._positions(q)
        motions = [
            (0.0, 0.0) if link.prismatic else self.cos_sin(position)
            for link, position in zip(self.links, positions, strict=True)
        ]
        arms = []  # the TCP in each joint's frame before its motion; of a slide, x and y count
        tcp = self.tcp
        moves = list(zip(self.links, positions, motions, strict=True))
        for link, position, motion in reversed(moves):
            tcp = (*tcp[:2], _sum(tcp[2], position)) if link.prismatic else _turned(tcp, motion)
            arms.append(tcp)
            tcp = _plus(link.offset, _out_of(link.axes, tcp))
        arms.reverse()

        loads: list[Component] = [0.0] * len(compliance)
        force, torque = wrench[:3], wrench[3:]
        for link, motion, arm in zip(self.links, motions, arms, strict=True):
            force, torque = _into(link.axes, force), _into(link.axes, torque)
            load = force[2]
            if not link.prismatic:
                swung = _less(_times(arm[0], force[1]), _times(arm[1], force[0]))
                load = _sum(torque[2], swung)
                force, torque = _turned_back(force, motion), _turned_back(torque, motion)
            master = link.joint.master
            loads[master] = _sum(loads[master], _times(link.joint.multiplier, load))
        bent = [_times(c, load) for c, load in zip(compliance, loads, strict=True)]

        moved: Vector = ORIGIN
        for link, motion, arm in reversed(list(zip(self.links, motions, arms, strict=True))):
            turn = _times(link.joint.multiplier, bent[link.joint.master])
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
        return [torque for (torque,) in self._own_parts(self._weights(q))]

    def virtual_gravity_torque(self, q: Sequence[Component]) -> list[Component]:
        """Return the n_joints x 6 torques [N m] and forces [N] of the weights, joint by joint.

        They act on the virtual joints: about, then along the moved frame's axes.
        """
        return [torque for six in self._weights(q) for (torque,) in six]

    def _weights(self, q: Sequence[Component]) -> list[list[Vector]]:
        """Return each joint's moments about, then forces along, its axes by what it bears."""
        loads: list[list[Vector]] = []
        mass, first_moment = 0.0, ORIGIN  # of all that a joint carries, kg and kg m, base frame
        frames = list(self.frames(q))
        for link, frame in reversed(list(zip(self.links, frames, strict=True))):
            mass += link.mass
            first_moment = _plus(first_moment, _scaled(link.mass, frame.point(link.centre)))
            lever = _minus(first_moment, _scaled(mass, frame.origin))
            pull = _cross(lever, self.gravity), _scaled(mass, self.gravity)
            loads.append([[_dot(axis, part)] for part in pull for axis in frame.axes])
        return self._by_joint(loads[::-1])


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


def _by_rows(columns: Iterable[Vector]) -> list[Component]:
    """Return columns of a Jacobian (translation [m/rad or m/m], rotation) row by row."""
    return list(chain.from_iterable(zip(*columns, strict=True)))


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
