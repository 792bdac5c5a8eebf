"""The mistakes a file of measured samples may have: a table of hypotheses.

Each undoes one mistake: it makes other samples of the given ones, some with numbers that are fitted
(`FITTED`). `diagnosis.py` compares them.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import nnls

from stiff_datasets.measured.sample_columns import DEG_PER_RAD, MM_PER_M
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.types import AXES, BoolArray, FloatArray, IntArray, Robot
from stiff_protocols.kinematics.serial_chain import unit_deflections

POINT_GAIN, GAIN, RARE_GAIN = 0.05, 0.1, 0.15
"""Shares by which a hypothesis must lower the RMS residual: another point of the torques, any
other, units and odd orders of axes. The most in clean data of 30 poses was 0.10, by less weight on
the torques."""
UP = np.array([0.0, 0.0, 1.0])
LOAD = ("force", "torque")
UNITS = {
    ("", "N mm"): (1.0, 1e-3),
    ("kg", ""): (STANDARD_GRAVITY, 1.0),
    ("kg", "N mm"): (STANDARD_GRAVITY, 1e-3),
    ("kN", ""): (1000.0, 1.0),
}
"""Of forces and torques in the file, where they are not N and N m -> factors to N and N m."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Samples as a hypothesis reads them; SI, base frame.

    Attributes:
        robot: that was measured.
        q: (n, n_joints) rad or m.
        force, torque: (n, 3) N and N m at the TCP.
        deflection: (n, 3) m.
        jacobian: (n, 6, n_springs) at the TCP, linear part first; a spring a joint, unless
            `with_tilting_joints` adds others.
        flange: (n, 3, 3) orientation of the last link.
        lever: (n, 3) from the last link's origin to the TCP, m.
        tcp: (n, 3) position of the TCP, m.
    """

    robot: Robot
    q: FloatArray
    force: FloatArray
    torque: FloatArray
    deflection: FloatArray
    jacobian: FloatArray
    flange: FloatArray
    lever: FloatArray
    tcp: FloatArray

    def at(self, q: FloatArray) -> Reading:
        """Return the same samples at other joint positions."""
        return reading(self.robot, q, np.hstack([self.force, self.torque]), self.deflection)

    def take(self, rows: BoolArray | IntArray) -> Reading:
        """Return some of the samples."""
        arrays = {name: value for name, value in vars(self).items() if name != "robot"}
        return Reading(self.robot, **{name: value[rows] for name, value in arrays.items()})

    def regressor(self) -> FloatArray:
        """Return (n, 3, n_springs) the deflection by each spring at unit compliance."""
        return unit_deflections(self.jacobian, np.hstack([self.force, self.torque]))


def reading(robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray) -> Reading:
    """Return samples, as their file has them, with the kinematics of their joint positions."""
    poses = robot.forward(q)
    return Reading(
        robot=robot,
        q=q,
        force=wrench[:, :3],
        torque=wrench[:, 3:],
        deflection=deflection,
        jacobian=robot.jacobian(q),
        flange=poses.rotation @ robot.flange[:3, :3],
        lever=poses.rotation @ (robot.tcp - robot.flange[:3, 3]),
        tcp=poses.points[:, -1],
    )


def with_tilting_joints(data: Reading) -> Reading:
    """Return the samples with two more springs at every revolute joint, across its axis.

    They stand for bearings that tilt and links that bend, as in the model `vjm-full`.
    """
    poses, robot = data.robot.forward(data.q), data.robot
    across = np.array([np.linalg.svd(axis[None])[2][1:] for axis in robot.axes[robot.turns]])
    rotations, origins = poses.rotations[:, robot.turns], poses.points[:, :-1][:, robot.turns]
    turn = np.einsum("njab,jkb->njka", rotations, across)  # (n, n_revolute, 2, 3)
    move = np.cross(turn, (data.tcp[:, None] - origins)[:, :, None])
    springs = np.concatenate([move, turn], axis=-1).reshape(len(data.q), -1, 6)
    jacobian = np.concatenate([data.jacobian, springs.transpose(0, 2, 1)], axis=2)
    return replace(data, jacobian=jacobian)


def compliances(data: Reading) -> FloatArray:
    """Return (n_springs,) compliances by least squares, none negative; rad/(N m), m/N."""
    return solve_nonnegative(*normal_equations(data.regressor(), data.deflection))


def normal_equations(matrix: FloatArray, deflection: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n_joints, n_joints) and (n_joints,) of (n, 3, n_joints) and (n, 3)."""
    flat = matrix.reshape(-1, matrix.shape[-1])
    return flat.T @ flat, flat.T @ deflection.reshape(-1)


def solve_nonnegative(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Return what solves normal equations without a negative number."""
    size = np.sqrt(np.diagonal(gram))
    if not size.any():  # no load
        return np.zeros_like(right)
    size = np.where(size > 0.0, size, 1.0)
    values, axes = np.linalg.eigh(gram / np.outer(size, size))
    kept = values > 1e-12 * values[-1]
    root, axes = np.sqrt(values[kept]), axes[:, kept]
    return np.asarray(nnls((axes * root).T, (axes / root).T @ (right / size))[0] / size)


@dataclass(frozen=True)
class Fitted:
    """A hypothesis with free numbers.

    Attributes:
        text: with places for them in a unit that a user knows.
        change: what (n_free,) of them, SI, make of the samples.
        must_gain: share by which it must lower the RMS residual; more than without free numbers,
            which also take up what joint springs leave of data without a mistake.
        unit: factor from SI to the unit of the text.
        positive: the first of them is.
        n_unnamed: how many have no place in the text.
    """

    text: str
    change: Callable[[Reading, FloatArray], Reading]
    must_gain: float
    unit: float = 1.0
    positive: bool = False
    n_unnamed: int = 0

    @property
    def n_free(self) -> int:
        """Number of free numbers."""
        return self.text.count("{") + self.n_unnamed


def readings(data: Reading, joints_only: bool = False) -> list[tuple[str, Reading, float]]:
    """Return every hypothesis without free numbers, what it makes of the samples, and `must_gain`.

    The likeliest come first.
    """
    kinds = [(_points, POINT_GAIN), (_wrenches, GAIN), (_units, RARE_GAIN), (_joints, GAIN)]
    kinds += [(_axes, GAIN), (_rows, GAIN)]
    return [
        (text, each, RARE_GAIN if "taken from" in text else gain)  # an odd order of axes
        for made, gain in ([(_joints, GAIN)] if joints_only else kinds)
        for text, each in made(data).items()
    ]


def _points(data: Reading) -> dict[str, Reading]:
    points = {"flange": data.lever, "base": data.tcp} if data.torque.any() else {}
    return {
        f"the torques look as if they were taken about the {name}, not the TCP": replace(
            data, torque=data.torque - np.cross(point, data.force)
        )
        for name, point in points.items()
    }


def _wrenches(data: Reading) -> dict[str, Reading]:
    to_base = functools.partial(_turned, data.flange)
    found = {
        "the wrench looks as if it had the opposite sign (the reaction? or is the deflection "
        "unloaded minus loaded?)": _changed(data, np.negative, *LOAD),
        "the wrench looks as if it were expressed in the flange frame": _changed(
            data, to_base, *LOAD
        ),
    }
    if (data.deflection >= 0.0).all():
        found["the deflections look as if they had lost their signs"] = _signed(data)
    if data.torque.any():
        opposite = _changed(data, np.negative, "torque")
        found["the torques look as if they had the opposite sign"] = opposite
        for name in ("torque", "force"):
            text = f"the {name}s look as if they were expressed in the flange frame"
            found[text] = _changed(data, to_base, name)
        swapped = replace(data, force=data.torque, torque=data.force)
        found["forces and torques look as if they were swapped"] = swapped
    return found


def _units(data: Reading) -> dict[str, Reading]:
    found: dict[str, Reading] = {}
    if not data.torque.any():  # the size of the stiffnesses is all that tells
        return found
    for (of_force, of_torque), (in_newton, in_newton_metres) in UNITS.items():
        words = [f"the forces look as if they were in {of_force}"] if of_force else []
        words += [f"the torques look as if they were in {of_torque}"] if of_torque else []
        force, torque = data.force * in_newton, data.torque * in_newton_metres
        found[" and ".join(words)] = replace(data, force=force, torque=torque)
    without = replace(data, torque=np.zeros_like(data.torque))
    return found | {"the torques look as if they did not belong to the forces": without}


def _signed(data: Reading) -> Reading:
    """Return the samples with the signs of deflections that joint springs would have."""
    matrix, changed, found = data.regressor(), data, np.ones(data.q.shape[1])
    for _ in range(10):
        changed = replace(data, deflection=np.copysign(data.deflection, matrix @ found))
        found = compliances(changed)
    return changed


def _axes(data: Reading) -> dict[str, Reading]:
    found: dict[str, Reading] = {}
    for matrix in _signed_permutations():
        proper = np.linalg.det(matrix) > 0.0
        same = bool((matrix == np.eye(3)).all())
        read = f"had to be read {_words(matrix)}"
        frame = "expressed in the flange frame" + ("" if same else f" and {read}")
        again = functools.partial(_turned, matrix)
        to_base = functools.partial(_turned, data.flange @ matrix)
        turned = _changed(data, to_base, *LOAD)
        if not same:
            found[f"the wrench looks as if it {read}"] = _changed(data, again, *LOAD)
            for name in ("force", "torque", "deflection"):
                found[f"the {name}s look as if they {read}"] = _changed(data, again, name)
            if proper:  # else one of opposite signs, which is the same
                text = f"wrench and deflections look as if they {read}"
                found[text] = _changed(data, again, *LOAD, "deflection")
            found[f"the wrench looks as if it were {frame}"] = turned
        if data.torque.any():
            about = turned.torque - np.cross(data.lever, turned.force)
            text = f"the wrench looks as if it were {frame}, its torque about the flange"
            found[text] = replace(turned, torque=about)
        text = f"the deflections look as if they were {frame}"
        found[text] = _changed(data, to_base, "deflection")
        if proper:
            text = f"wrench and deflections look as if they were {frame}"
            found[text] = _changed(turned, to_base, "deflection")
    return found


def _joints(data: Reading) -> dict[str, Reading]:
    names, q = data.robot.joint_names, data.q
    numbers = np.arange(len(names))
    revolute = data.robot.turns
    read = {  # text -> (n, n_joints) joint positions, rad or m
        f"joint {name} looks as if it had the opposite sign": np.where(numbers == i, -q, q)
        for i, name in enumerate(names)
    }
    for i in np.flatnonzero(revolute):
        for degrees in (90, -90, 180):
            text = f"joint {names[i]} looks as if it were {degrees:+d} deg off"
            if i == numbers[-1]:  # which turns the tool alone
                text = (
                    f"the TCP looks as if it were {degrees:+d} deg off about the axis of joint "
                    f"{names[i]}, or joint {names[i]} as if it were"
                )
            read[text] = q - (numbers == i) * np.deg2rad(degrees)
    for i, j in itertools.combinations(numbers, 2):
        order = numbers.copy()
        order[[i, j]] = j, i
        read[f"joints {names[i]} and {names[j]} look as if they were swapped"] = q[:, order]
    read["the joints look as if they stood in reverse order"] = q[:, ::-1]
    read["all joints look as if they had the opposite sign"] = -q
    in_rad = np.where(revolute, np.rad2deg(q), q)
    if revolute.any():
        read["the joint angles look as if they were in rad"] = in_rad
    small = np.abs(np.rad2deg(q)).max(axis=0) <= 2.0 * np.pi
    for i in np.flatnonzero(revolute & small):
        read[f"joint {names[i]} looks as if it were in rad"] = np.where(numbers == i, in_rad, q)
    return {text: data.at(positions) for text, positions in read.items()}


def _rows(data: Reading) -> dict[str, Reading]:
    found: dict[str, Reading] = {}
    for step, where in ((-1, "down"), (1, "up")):
        words = f"look as if they were shifted {where} by one row"
        kept = np.ones((len(data.q), 1))
        kept[-1 if step < 0 else 0] = 0.0  # nothing belongs to this row
        q, force, torque, deflection = (
            np.roll(each, step, 0) for each in (data.q, data.force, data.torque, data.deflection)
        )
        loads = replace(data, force=data.force * kept, torque=data.torque * kept)
        given = replace(loads, deflection=data.deflection * kept)
        found |= {
            f"the deflections {words}": replace(loads, deflection=deflection * kept),
            f"the wrenches {words}": replace(given, force=force * kept, torque=torque * kept),
            f"the joint angles {words}": given.at(q),
        }
    backwards = replace(data, deflection=data.deflection[::-1])
    return found | {"the deflections look as if their rows stood in reverse order": backwards}


def _moved_tcp(data: Reading, shift: FloatArray) -> Reading:
    """Return the samples of a TCP that lies elsewhere by (3,) m, flange frame."""
    linear, angular = data.jacobian[:, :3], data.jacobian[:, 3:]
    lever = data.flange @ shift  # (n, 3)
    linear = linear + np.cross(angular, lever[:, :, None], axis=1)
    return replace(data, jacobian=np.concatenate([linear, angular], axis=1))


def _moved_force(data: Reading, shift: FloatArray) -> Reading:
    """Return the samples of a force that acts elsewhere by (3,) m, flange frame."""
    return replace(data, torque=data.torque + np.cross(data.flange @ shift, data.force))


def _weight_removed(data: Reading, numbers: FloatArray) -> Reading:
    """Return the samples without a weight [N], and its first moment (3,) [N m], flange frame."""
    torque = data.torque + np.cross(data.flange @ numbers[1:], UP)
    return replace(data, force=data.force + numbers[0] * UP, torque=torque)


def _about_z(data: Reading, angle: FloatArray, *, names: Sequence[str]) -> Reading:
    """Return the samples with vectors turned by an angle [rad] about z."""
    cosine, sine = np.cos(angle[0]), np.sin(angle[0])
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return _changed(data, functools.partial(_turned, turn), *names)


WEIGHT_GAIN, OFFSET_GAIN, TCP_GAIN, TURN_GAIN = 0.15, 0.18, 0.2, 0.3
"""Free numbers also take up what joint springs leave of clean data: the most that was seen is 0.10
of the KR10's twins, 0.14 of the FANUC measurement, and 0.01."""
FITTED = (
    Fitted(
        "the forces look as if the weight of a tool of {:.2g} kg were in them (not tared)",
        lambda data, weight: replace(data, force=data.force + weight * UP),
        must_gain=WEIGHT_GAIN,
        unit=1.0 / STANDARD_GRAVITY,
        positive=True,
    ),
    Fitted(
        "the wrench looks as if the weight of a tool of {:.2g} kg were in it (not tared)",
        _weight_removed,
        n_unnamed=3,
        must_gain=OFFSET_GAIN,
        unit=1.0 / STANDARD_GRAVITY,
        positive=True,
    ),
    Fitted(
        "the forces look as if they had a constant offset of ({:.2g}, {:.2g}, {:.2g}) N",
        lambda data, offset: replace(data, force=data.force - offset),
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the force sensor looks as if it had an offset of ({:.2g}, {:.2g}, {:.2g}) N in the flange "
        "frame",
        lambda data, offset: replace(data, force=data.force - data.flange @ offset),
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the torques look as if they had a constant offset of ({:.2g}, {:.2g}, {:.2g}) N m",
        lambda data, offset: replace(data, torque=data.torque - offset),
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the TCP looks as if it lay ({:.0f}, {:.0f}, {:.0f}) mm from the given one, in the flange "
        "frame",
        _moved_tcp,
        must_gain=TCP_GAIN,
        unit=MM_PER_M,
    ),
    *(
        Fitted(
            f"{what} had to be read turned by {{:+.0f}} deg about z",
            functools.partial(_about_z, names=names),
            must_gain=TURN_GAIN,
            unit=DEG_PER_RAD,
        )
        for what, names in (
            ("the wrench looks as if it", LOAD),
            ("the deflections look as if they", ("deflection",)),
            ("wrench and deflections look as if they", (*LOAD, "deflection")),
        )
    ),
)


ELSEWHERE = tuple(
    Fitted(
        f"{what} ({{:.0f}}, {{:.0f}}, {{:.0f}}) mm from the TCP",
        change,
        must_gain=TCP_GAIN,
        unit=MM_PER_M,
    )
    for what, change in (("measured and loaded", _moved_tcp), ("loaded", _moved_force))
)
"""Where else the tool was measured or loaded, flange frame: compared with joints that tilt, which
explain more of sound data than joint springs. The FANUC measurement gains 0.23 and 0.14."""
FARTHEST_SOUND = 0.1
"""m from the TCP that a point must lie to be named: in sound data the points make up for what the
springs miss, up to 0.06 m from it, and two of ten rough twins gain 0.21."""


def _signed_permutations() -> list[FloatArray]:
    """Return the 48 (3, 3) signed permutations, the least change first."""
    found = [
        np.diag(signs)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return sorted(found, key=lambda matrix: -float(np.trace(matrix)))


def _words(matrix: FloatArray) -> str:
    """Say in words what a signed permutation makes of the axes of a file."""
    diagonal, proper = np.diag(matrix), np.linalg.det(matrix) > 0.0
    if (diagonal == -1.0).all():
        return "with the opposite sign"
    if diagonal.all() and proper:
        axis = int(np.argmax(diagonal))
        return f"turned by 180 deg about {AXES[axis]}" + ("" if axis == 2 else " (z down?)")
    if diagonal.all():
        axis = int(np.argmin(diagonal))
        return f"with the sign of {AXES[axis]} flipped" + (" (z down?)" if axis == 2 else "")
    if proper and diagonal.sum() == 1.0:
        axis = int(np.argmax(diagonal))
        sine = matrix[(axis + 2) % 3, (axis + 1) % 3]
        return f"turned by {90 * sine:+.0f} deg about {AXES[axis]}"
    if not proper and (matrix >= 0.0).all():
        first, second = (name for name, kept in zip(AXES, diagonal, strict=True) if not kept)
        return f"with {first} and {second} swapped"
    sources = np.abs(matrix).argmax(axis=1)
    signs = ("-" if row.sum() < 0.0 else "" for row in matrix)
    read = ", ".join(sign + AXES[source] for sign, source in zip(signs, sources, strict=True))
    return f"with x, y, z taken from its columns {read}"


def _changed(data: Reading, change: Callable[[FloatArray], FloatArray], *names: str) -> Reading:
    """Return the samples with these of their vectors changed."""
    vectors: dict[str, Any] = {name: change(getattr(data, name)) for name in names}
    return replace(data, **vectors)


def _turned(rotation: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return (n, 3) vectors turned by one rotation (3, 3), or each by its own (n, 3, 3)."""
    return np.asarray((rotation @ vectors[:, :, None])[:, :, 0])
