"""List the mistakes that a file of measured samples may have, as hypotheses.

Each hypothesis undoes one mistake by changing the samples. Some have numbers that are fitted
(`FITTED_HYPOTHESES`). `diagnosis.py` compares them.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import nnls

from stiff_datasets.measured.sample_columns import DEG_PER_RAD, MM_PER_M, joint_columns
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.types import AXES, BoolArray, FloatArray, IntArray, Robot
from stiff_protocols.kinematics.serial_chain import unit_deflections

ZERO_WORDS = "looks as if its zero were"
POINT_GAIN, GAIN, RARE_GAIN = 0.05, 0.1, 0.15
"""Least shares by which a hypothesis has to lower the RMS residual: for another point of the
torques, for most hypotheses, and for units and odd orders of axes. In clean data of 30 poses the
largest share was 0.10, from a lower weight of the torques."""
POINT_EFFECT_GAIN = 0.03
"""The same for another point of the torques, by springs with all effects. In clean data of 36
specimens the largest gain beyond chance was negative."""
ALIGNED = np.deg2rad(1.0)
"""rad; axes of joints are parallel within this angle."""
UP = np.array([0.0, 0.0, 1.0])
LOAD_VECTORS, DEFLECTION = ("force", "torque"), ("deflection",)
EVERY_VECTOR = (*LOAD_VECTORS, *DEFLECTION)
LOOKS = {
    LOAD_VECTORS: "the wrench looks as if it",
    ("force",): "the forces look as if they",
    ("torque",): "the torques look as if they",
    DEFLECTION: "the deflections look as if they",
    EVERY_VECTOR: "wrench and deflections look as if they",
}
"""Vectors of the samples -> begin of the sentence on a mistake in them."""
LOAD_UNITS = {
    ("", "N mm"): (1.0, 1e-3),
    ("kg", ""): (STANDARD_GRAVITY, 1.0),
    ("kg", "N mm"): (STANDARD_GRAVITY, 1e-3),
    ("kN", ""): (1000.0, 1.0),
}
"""Units of forces and torques in the file other than N and N m -> factors to N and N m."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Samples as changed by a hypothesis; SI, base frame.

    Attributes:
        robot: the measured robot.
        q: (n, n_joints) rad or m.
        force, torque: (n, 3) N and N m at the TCP.
        deflection: (n, 3) m.
        jacobian: (n, 6, n_springs) at the TCP, linear part first; one spring per joint,
            and those that `with_tilting_joints` adds.
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
        """Return the samples of `rows`."""
        arrays = {name: value for name, value in vars(self).items() if name != "robot"}
        return Reading(self.robot, **{name: value[rows] for name, value in arrays.items()})

    def regressor(self) -> FloatArray:
        """Return (n, 3, n_springs) the deflection by each spring at unit compliance."""
        return unit_deflections(self.jacobian, np.hstack([self.force, self.torque]))


def reading(robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray) -> Reading:
    """Return unchanged samples with the kinematics of their joint positions."""
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
    """Add two springs across the axis of every revolute joint.

    They represent bearings that tilt and links that bend, as in the model `vjm-full`.
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
    """Return matrix (n_joints, n_joints) and right side (n_joints,) of the normal equations.

    They belong to `matrix` (n, 3, n_joints) and `deflection` (n, 3).
    """
    flat = matrix.reshape(-1, matrix.shape[-1])
    return flat.T @ flat, flat.T @ deflection.reshape(-1)


def solve_nonnegative(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution of normal equations without negative numbers."""
    size = np.sqrt(np.diagonal(gram))
    if not size.any():  # no load
        return np.zeros_like(right)
    size = np.where(size > 0.0, size, 1.0)
    values, axes = np.linalg.eigh(gram / np.outer(size, size))
    is_nonzero = values > 1e-12 * values[-1]
    root, axes = np.sqrt(values[is_nonzero]), axes[:, is_nonzero]
    return np.asarray(nnls((axes * root).T, (axes / root).T @ (right / size))[0] / size)


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis with free numbers.

    Attributes:
        text: format string with places for the numbers, in a unit that users know.
        change: returns the samples as changed by the (n_free,) numbers, SI.
        min_gain: least share by which the hypothesis has to lower the RMS residual. It is larger
            than without free numbers, which also fit the residual of data without a mistake.
        least: least length of the numbers, SI; less is usual.
        starts: (n_starts,) SI, further starts of the search for a single number.
        unit: factor from SI to the unit of the text.
        positive: true if the first number must be positive.
        n_unnamed: number of free numbers without a place in the text.
    """

    text: str
    change: Callable[[Reading, FloatArray], Reading]
    min_gain: float
    unit: float = 1.0
    positive: bool = False
    n_unnamed: int = 0
    least: float = 0.0
    starts: tuple[float, ...] = ()

    @property
    def n_free(self) -> int:
        """Number of free numbers."""
        return self.text.count("{") + self.n_unnamed


def fixed_hypotheses(data: Reading, joints_only: bool = False) -> list[tuple[str, Reading, float]]:
    """Return every hypothesis without free numbers, the likeliest first.

    Each is its text, the changed samples and the minimum gain.
    """
    joints = {_joint_hypotheses: GAIN}
    loads = {_point_hypotheses: POINT_GAIN, _wrench_hypotheses: GAIN, _unit_hypotheses: RARE_GAIN}
    makers = {**loads, **joints, _axis_hypotheses: GAIN, _row_hypotheses: GAIN}
    return [
        (text, changed_data, RARE_GAIN if "taken from" in text else gain)  # an odd order of axes
        for make_hypotheses, gain in (joints if joints_only else makers).items()
        for text, changed_data in make_hypotheses(data).items()
    ]


def _point_hypotheses(data: Reading) -> dict[str, Reading]:
    points = {"flange": data.lever, "base": data.tcp} if data.torque.any() else {}
    return {
        f"the torques look as if they were taken about the {name}, not the TCP": replace(
            data, torque=data.torque - np.cross(point, data.force)
        )
        for name, point in points.items()
    }


def _wrench_hypotheses(data: Reading) -> dict[str, Reading]:
    to_base = functools.partial(_turn, data.flange)
    in_flange = "were expressed in the flange frame"
    reaction = (
        f"{LOOKS[LOAD_VECTORS]} had the opposite sign (the reaction? or is the deflection unloaded "
        "minus loaded?)"
    )
    hypotheses = {
        reaction: _change_vectors(data, np.negative, *LOAD_VECTORS),
        f"{LOOKS[LOAD_VECTORS]} {in_flange}": _change_vectors(data, to_base, *LOAD_VECTORS),
    }
    if (data.deflection >= 0.0).all():
        hypotheses[f"{LOOKS[DEFLECTION]} had lost their signs"] = _with_signs_of_springs(data)
    if data.torque.any():
        opposite = _change_vectors(data, np.negative, "torque")
        hypotheses[f"{LOOKS['torque',]} had the opposite sign"] = opposite
        for name in ("torque", "force"):
            hypotheses[f"{LOOKS[name,]} {in_flange}"] = _change_vectors(data, to_base, name)
        swapped = replace(data, force=data.torque, torque=data.force)
        hypotheses["forces and torques look as if they were swapped"] = swapped
    return hypotheses


def _unit_hypotheses(data: Reading) -> dict[str, Reading]:
    hypotheses: dict[str, Reading] = {}
    if not data.torque.any():  # only the size of the stiffnesses could show it
        return hypotheses
    for (of_force, of_torque), (in_newton, in_newton_metres) in LOAD_UNITS.items():
        words = [f"the forces look as if they were in {of_force}"] if of_force else []
        words += [f"the torques look as if they were in {of_torque}"] if of_torque else []
        force, torque = data.force * in_newton, data.torque * in_newton_metres
        hypotheses[" and ".join(words)] = replace(data, force=force, torque=torque)
    without = replace(data, torque=np.zeros_like(data.torque))
    return hypotheses | {"the torques look as if they did not belong to the forces": without}


def _with_signs_of_springs(data: Reading) -> Reading:
    """Give the deflections the signs that joint springs predict."""
    matrix, changed, compliance = data.regressor(), data, np.ones(data.q.shape[1])
    for _ in range(10):
        changed = replace(data, deflection=np.copysign(data.deflection, matrix @ compliance))
        compliance = compliances(changed)
    return changed


def _axis_hypotheses(data: Reading) -> dict[str, Reading]:
    hypotheses: dict[str, Reading] = {}
    for matrix in _signed_permutations():
        proper = np.linalg.det(matrix) > 0.0
        same = bool((matrix == np.eye(3)).all())
        read = f"had to be read {axes_text(matrix)}"
        frame = "expressed in the flange frame" + ("" if same else f" and {read}")
        again = functools.partial(_turn, matrix)
        to_base = functools.partial(_turn, data.flange @ matrix)
        turned = _change_vectors(data, to_base, *LOAD_VECTORS)
        if not same:
            for names, looks in LOOKS.items():
                if proper or names != EVERY_VECTOR:  # else the same as a change of sign
                    hypotheses[f"{looks} {read}"] = _change_vectors(data, again, *names)
            hypotheses[f"{LOOKS[LOAD_VECTORS]} were {frame}"] = turned
        if data.torque.any():
            about = turned.torque - np.cross(data.lever, turned.force)
            text = f"{LOOKS[LOAD_VECTORS]} were {frame}, its torque about the flange"
            hypotheses[text] = replace(turned, torque=about)
        for names in (DEFLECTION, EVERY_VECTOR)[: 1 + proper]:
            hypotheses[f"{LOOKS[names]} were {frame}"] = _change_vectors(data, to_base, *names)
    return hypotheses


def _joint_hypotheses(data: Reading) -> dict[str, Reading]:
    positions_by_text = joint_positions(data.robot, data.q)
    return {text: data.at(positions) for text, positions in positions_by_text.items()}


def joint_positions(robot: Robot, q: FloatArray) -> dict[str, FloatArray]:
    """Return the joint positions (n, n_joints) in which each mistake of the joints is undone.

    Args:
        robot: the measured robot.
        q: (n, n_joints) rad or m.
    """
    names = robot.joint_names
    numbers = np.arange(len(names))
    revolute = robot.turns
    positions_by_text = {  # text -> (n, n_joints) joint positions, rad or m
        f"joint {name} looks as if it had the opposite sign": np.where(numbers == i, -q, q)
        for i, name in enumerate(names)
    }
    positions_by_text |= _coupled_positions(robot, q)
    for i in np.flatnonzero(revolute):
        for degrees in (90, -90, 180):
            text = f"joint {names[i]} looks as if it were {degrees:+d} deg off"
            if i == numbers[-1]:  # which turns only the tool
                text = (
                    f"the TCP looks as if it were {degrees:+d} deg off about the axis of joint "
                    f"{names[i]}, or joint {names[i]} as if it were"
                )
            positions_by_text[text] = q - (numbers == i) * np.deg2rad(degrees)
    for i, j in itertools.combinations(numbers, 2):
        order = numbers.copy()
        order[[i, j]] = j, i
        positions_by_text[f"joints {names[i]} and {names[j]} look as if they were swapped"] = q[
            :, order
        ]
    positions_by_text["the joints look as if they stood in reverse order"] = q[:, ::-1]
    positions_by_text["all joints look as if they had the opposite sign"] = -q
    in_rad = np.where(revolute, np.rad2deg(q), q)
    if revolute.any():
        positions_by_text["the joint angles look as if they were in rad"] = in_rad
    small = np.abs(np.rad2deg(q)).max(axis=0) <= 2.0 * np.pi
    for i in np.flatnonzero(revolute & small):
        positions_by_text[f"joint {names[i]} looks as if it were in rad"] = np.where(
            numbers == i, in_rad, q
        )
    return positions_by_text


def _coupled_positions(robot: Robot, q: FloatArray) -> dict[str, FloatArray]:
    """Return the joint positions in which a coupling of two joints is undone.

    A robot may move one joint with another: joint 3 with joint 2, or the wrist's joints. Its angles
    count from the ground, or from where the other joint put it.
    """
    positions_by_text = {}
    if robot.controller is not None:
        positions = robot.controller.to_description(q)
        if not np.array_equal(positions, q):
            ground = ", with joint 3 measured from the ground" * robot.controller.j3_from_ground
            text = (
                f"the joint angles look as if they were the controller's{ground}: convert them as "
                "the <controller> of the URDF says"
            )
            positions_by_text[text] = positions
    names, columns, n = robot.joint_names, joint_columns(robot), robot.n_joints
    numbers = np.arange(n)
    axes = (robot.forward(np.zeros((1, n))).rotations[0] @ robot.axes[:, :, None])[:, :, 0]
    pairs = [(i, i + 1) for i in range(n - 1)] + ([(n - 3, n - 1)] if n > 3 else [])
    for i, j in pairs:
        if not robot.turns[[i, j]].all():
            continue
        is_parallel = abs(float(axes[i] @ axes[j])) > np.cos(ALIGNED)
        how = "measured from the ground" if is_parallel else f"coupled to joint {names[i]}"
        for sign, word, undone in (
            (1.0, "+", f"subtract {columns[i]} from"),
            (-1.0, "-", f"add {columns[i]} to"),
        ):
            text = (
                f"joint {names[j]} looks as if it were {how} (J{j + 1} {word} J{i + 1}; {undone} "
                f"{columns[j]})"
            )
            positions_by_text[text] = q - sign * np.where(numbers == j, q[:, [i]], 0.0)
    return positions_by_text


def _row_hypotheses(data: Reading) -> dict[str, Reading]:
    hypotheses: dict[str, Reading] = {}
    for step, direction in ((-1, "down"), (1, "up")):
        words = f"look as if they were shifted {direction} by one row"
        has_neighbour = np.ones((len(data.q), 1))
        has_neighbour[-1 if step < 0 else 0] = 0.0  # this row has no neighbour
        q, force, torque, deflection = (
            np.roll(values, step, 0)
            for values in (data.q, data.force, data.torque, data.deflection)
        )
        loads = replace(data, force=data.force * has_neighbour, torque=data.torque * has_neighbour)
        given = replace(loads, deflection=data.deflection * has_neighbour)
        hypotheses |= {
            f"the deflections {words}": replace(loads, deflection=deflection * has_neighbour),
            f"the wrenches {words}": replace(
                given, force=force * has_neighbour, torque=torque * has_neighbour
            ),
            f"the joint angles {words}": given.at(q),
        }
    backwards = replace(data, deflection=data.deflection[::-1])
    return hypotheses | {"the deflections look as if their rows stood in reverse order": backwards}


def _with_tcp_moved(data: Reading, shift: FloatArray) -> Reading:
    """Move the TCP by (3,) m, flange frame."""
    linear, angular = data.jacobian[:, :3], data.jacobian[:, 3:]
    lever = data.flange @ shift  # (n, 3)
    linear = linear + np.cross(angular, lever[:, :, None], axis=1)
    moved = replace(data, tcp=data.tcp + lever, lever=data.lever + lever)
    return replace(moved, jacobian=np.concatenate([linear, angular], axis=1))


def _with_force_moved(data: Reading, shift: FloatArray) -> Reading:
    """Move the point of the force by (3,) m, flange frame."""
    return replace(data, torque=data.torque + np.cross(data.flange @ shift, data.force))


def _weight_removed(data: Reading, numbers: FloatArray) -> Reading:
    """Remove a weight [N] and its first moment (3,) [N m], flange frame."""
    torque = data.torque + np.cross(data.flange @ numbers[1:], UP)
    return replace(data, force=data.force + numbers[0] * UP, torque=torque)


def _turn_about_z(data: Reading, angle: FloatArray, *, names: Sequence[str]) -> Reading:
    """Turn the vectors `names` by an angle [rad] about z."""
    cosine, sine = np.cos(angle[0]), np.sin(angle[0])
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return _change_vectors(data, functools.partial(_turn, turn), *names)


WEIGHT_GAIN, OFFSET_GAIN, TCP_GAIN, TURN_GAIN = 0.15, 0.18, 0.2, 0.3
"""Free numbers also fit the residual of springs in clean data. By joint springs a weight gains 0.16
there, an offset 0.14. By springs with all effects, which have to confirm them, both gain 0.11 where
they are clear; a TCP gains 0.11 in twins and in the FANUC measurement."""
OFFSET_EFFECT_GAIN = 0.15
"""The same as `OFFSET_GAIN`, by springs with all effects."""
TCP_HYPOTHESIS = FittedHypothesis(
    "the TCP looks as if it lay ({:.0f}, {:.0f}, {:.0f}) mm from the given one, in the flange "
    "frame",
    _with_tcp_moved,
    min_gain=TCP_GAIN,
    unit=MM_PER_M,
)
OFFSET_HYPOTHESES = (
    FittedHypothesis(
        "the forces look as if the weight of a tool of {:.2g} kg were in them (not tared)",
        lambda data, weight: replace(data, force=data.force + weight * UP),
        min_gain=WEIGHT_GAIN,
        unit=1.0 / STANDARD_GRAVITY,
        positive=True,
    ),
    FittedHypothesis(
        "the wrench looks as if the weight of a tool of {:.2g} kg were in it (not tared)",
        _weight_removed,
        n_unnamed=3,
        min_gain=OFFSET_GAIN,
        unit=1.0 / STANDARD_GRAVITY,
        positive=True,
    ),
    FittedHypothesis(
        "the forces look as if they had a constant offset of ({:.2g}, {:.2g}, {:.2g}) N",
        lambda data, offset: replace(data, force=data.force - offset),
        min_gain=OFFSET_GAIN,
    ),
    FittedHypothesis(
        "the force sensor looks as if it had an offset of ({:.2g}, {:.2g}, {:.2g}) N in the flange "
        "frame",
        lambda data, offset: replace(data, force=data.force - data.flange @ offset),
        min_gain=OFFSET_GAIN,
    ),
    FittedHypothesis(
        "the torques look as if they had a constant offset of ({:.2g}, {:.2g}, {:.2g}) N m",
        lambda data, offset: replace(data, torque=data.torque - offset),
        min_gain=OFFSET_GAIN,
    ),
    TCP_HYPOTHESIS,
)
FITTED_HYPOTHESES = (
    *OFFSET_HYPOTHESES,
    *(
        FittedHypothesis(
            f"{LOOKS[names]} had to be read turned by {{:+.0f}} deg about z",
            functools.partial(_turn_about_z, names=names),
            min_gain=TURN_GAIN,
            unit=DEG_PER_RAD,
        )
        for names in (LOAD_VECTORS, DEFLECTION, EVERY_VECTOR)
    ),
)


def zero_hypotheses(robot: Robot) -> tuple[FittedHypothesis, ...]:
    """Return one hypothesis per revolute joint: its zero lies elsewhere.

    The number is what has to be added to the joint's angles.
    """
    last = robot.n_joints - 1  # which turns only the tool
    return tuple(
        FittedHypothesis(
            f"joint {robot.joint_names[i]} {ZERO_WORDS} {{:+.1f}} deg off (to be "
            f"added to its angles){', or the TCP turned about its axis' * bool(i == last)}",
            functools.partial(_with_zero_moved, joint=int(i)),
            min_gain=ZERO_GAIN,
            unit=DEG_PER_RAD,
            least=LEAST_ZERO,
            starts=ZERO_STARTS,
        )
        for i in np.flatnonzero(robot.turns)
    )


def _with_zero_moved(data: Reading, angle: FloatArray, *, joint: int) -> Reading:
    """Add an angle (1,) [rad] to the angles of a joint."""
    moved = data.at(data.q + angle * (np.arange(data.robot.n_joints) == joint))
    has_tilting_joints = data.jacobian.shape[2] > data.robot.n_joints
    return with_tilting_joints(moved) if has_tilting_joints else moved


ZERO_GAIN, LEAST_ZERO = 0.2, np.deg2rad(1.0)
"""Least gain, and least angle (rad) at which the zero of a joint is named. In clean data springs
about all axes gain 0.04 at most, in the FANUC measurement 0.14."""
ZERO_STARTS = tuple(np.deg2rad([-135.0, -45.0, 45.0, 135.0]))
"""rad; mistakes of 90 and 180 deg are hypotheses of their own."""

LEAST_TCP = 0.02
"""m; least distance between TCPs whose lengths have other signs or another order."""
MIN_POINT_DISTANCE = 0.1
"""m; least distance from the TCP at which a point is named. In clean data the points compensate
errors of the springs, up to 0.06 m from the TCP, and two of ten rough twins gain 0.21."""
POINT_HYPOTHESES = tuple(
    FittedHypothesis(
        f"{what} ({{:.0f}}, {{:.0f}}, {{:.0f}}) mm from the TCP",
        change,
        min_gain=TCP_GAIN,
        unit=MM_PER_M,
        least=MIN_POINT_DISTANCE,
    )
    for what, change in (("measured and loaded", _with_tcp_moved), ("loaded", _with_force_moved))
)
"""Other points where the tool was measured or loaded, flange frame. They are compared on joints
that tilt, which explain more of clean data than joint springs. The FANUC measurement gains 0.23 and
0.14."""


def effect_hypotheses(data: Reading, may_move: bool) -> list[tuple[str, Reading, float]]:
    """Return the hypotheses without free numbers that springs with all effects compare.

    They are small mistakes: the torques' point and, if another TCP `may_move` the residual, signs
    or order of the TCP's lengths. Each is its text, the changed samples and the minimum gain.
    """
    hypotheses = [
        (text, moved, POINT_EFFECT_GAIN) for text, moved in _point_hypotheses(data).items()
    ]
    given, points = data.robot.tcp_on_flange, [data.robot.tcp_on_flange]
    for matrix in _signed_permutations() if may_move else ():
        point = matrix @ given
        if min(np.linalg.norm(point - compared) for compared in points) > LEAST_TCP:
            points.append(point)
            place = ", ".join(f"{length:.0f}" for length in (point * MM_PER_M).round() + 0.0)
            read = axes_text(matrix).removesuffix(" (z down?)")
            text = f"the TCP looks as if it had to be read {read}: ({place}) mm"
            hypotheses.append((text, _with_tcp_moved(data, point - given), GAIN))
    return hypotheses


def fitted_effects(data: Reading, joints_only: bool) -> tuple[FittedHypothesis, ...]:
    """Return the hypotheses with free numbers that springs with all effects compare.

    One without a text is the force's point; it is not named as a mistake.
    """
    zeros = zero_hypotheses(data.robot)
    if joints_only:
        return zeros
    offsets = (
        replace(hypothesis, min_gain=OFFSET_EFFECT_GAIN)
        if hypothesis.min_gain == OFFSET_GAIN
        else hypothesis
        for hypothesis in OFFSET_HYPOTHESES
        if data.torque.any()
        or ("torque" not in hypothesis.text and "wrench" not in hypothesis.text)
    )
    return (*offsets, *zeros, replace(POINT_HYPOTHESES[1], text="", n_unnamed=3))


def _signed_permutations() -> list[FloatArray]:
    """Return the 48 signed permutations (3, 3), the smallest change first."""
    matrices = [
        np.diag(signs)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return sorted(matrices, key=lambda matrix: -float(np.trace(matrix)))


def axes_text(matrix: FloatArray) -> str:
    """Describe how a signed permutation changes the axes of a file."""
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
        first, second = (
            name for name, on_diagonal in zip(AXES, diagonal, strict=True) if not on_diagonal
        )
        return f"with {first} and {second} swapped"
    sources = np.abs(matrix).argmax(axis=1)
    signs = ("-" if row.sum() < 0.0 else "" for row in matrix)
    read = ", ".join(sign + AXES[source] for sign, source in zip(signs, sources, strict=True))
    return f"with x, y, z taken from its columns {read}"


def _change_vectors(
    data: Reading, change: Callable[[FloatArray], FloatArray], *names: str
) -> Reading:
    """Apply `change` to the vectors `names` of the samples."""
    vectors: dict[str, Any] = {name: change(getattr(data, name)) for name in names}
    return replace(data, **vectors)


def _turn(rotation: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn (n, 3) vectors by one rotation (3, 3), or by one each (n, 3, 3)."""
    return np.asarray((rotation @ vectors[:, :, None])[:, :, 0])
