"""Compare measured positions of the unloaded TCP with the forward kinematics of the joint angles.

They show the frame of the positions, mistakes in the joint angles, and another TCP.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stiff_datasets.measured.fault_hypotheses import (
    TCP_HYPOTHESIS,
    axes_text,
    joint_positions,
    zero_hypotheses,
)
from stiff_datasets.measured.sample_columns import MM_PER_M
from stiff_protocols.contract.types import FloatArray, IntArray, Robot

MAX_MEDIAN, MAX_IN_ROW, ROW_RATIO = 5e-3, 5e-3, 6.0
"""m; largest median distance from the forward kinematics, and in one row the larger of a distance
and a multiple of the median. Robots that are not calibrated reach poses within some mm."""
MIN_POSES = 5
MIN_WIDTH = 0.02
"""m; RMS distance from a line at which positions determine how their frame is turned."""
EXACT = 1e-5
"""m; smaller distances do not rank mistakes: numbers of a file are rounded."""
CLEAR_RATIO = 0.5
"""Share of the median distance that a mistake may leave, and ratio of two likely ones."""
ZERO_STEP = np.deg2rad(15.0)
MAX_COMPARED = 200
"""Rows, spread evenly, in which mistakes are tried."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of positions, by its pose against the base.

    Attributes:
        rotation: (3, 3) from the base to the frame.
        shift: (3,) position of the base in the frame, m.
        distance: (n,) distances that it leaves, m.
    """

    rotation: FloatArray
    shift: FloatArray
    distance: FloatArray

    @property
    def text(self) -> str:
        """Turn and shift of the frame."""
        from scipy.spatial.transform import Rotation

        shift = ", ".join(f"{length:.4g}" for length in self.shift.round(5) + 0.0)
        vector = Rotation.from_matrix(self.rotation).as_rotvec()
        angle = float(np.linalg.norm(vector))
        axis = ", ".join(f"{part:.2f}" for part in vector / max(angle, 1e-12))
        turn = (
            f"turned {np.rad2deg(angle):.3g} deg about ({axis})" if angle > 1e-9 else "not turned"
        )
        return f"{turn}, shifted by ({shift}) m"

    def to_base(self, vectors: FloatArray) -> FloatArray:
        """Turn (n, 3) vectors of the frame to the base."""
        return np.asarray(vectors @ self.rotation)


def fit_frame(positions: FloatArray, tcp: FloatArray, *, turns: bool = True) -> Frame:
    """Fit a frame to positions in it, without rows that lie far from it (Kabsch).

    Args:
        positions: (n, 3) m.
        tcp: (n, 3) the same in the base frame, m.
        turns: false if the frame is only shifted.
    """
    from scipy.spatial.transform import Rotation

    rotation, shift = np.eye(3), np.median(positions - tcp, axis=0)
    distance = np.linalg.norm(positions - tcp - shift, axis=1)
    weights = np.ones(len(tcp))
    for _ in range(10 if turns else 0):
        middles = [np.average(points, axis=0, weights=weights) for points in (positions, tcp)]
        vectors = positions - middles[0], tcp - middles[1]
        with warnings.catch_warnings():  # for poses on one line
            warnings.simplefilter("ignore", UserWarning)
            rotation = Rotation.align_vectors(*vectors, weights=weights)[0].as_matrix()
        shift = middles[0] - rotation @ middles[1]
        distance = np.linalg.norm(positions - tcp @ rotation.T - shift, axis=1)
        is_near = distance <= max(ROW_RATIO * float(np.median(distance)), EXACT)
        if (is_near == weights).all():
            break
        weights = is_near.astype(np.float64)
    return Frame(rotation, shift, distance)


def frame_doubt(positions: FloatArray, tcp: FloatArray) -> str:
    """Say why (n, 3) positions do not determine a frame against (n, 3) `tcp`, m; "" if they do."""
    if len(np.unique(tcp.round(3), axis=0)) < MIN_POSES:
        return f"fewer than {MIN_POSES} positions differ"
    for points in (positions, tcp):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spread[1] < MIN_WIDTH * np.sqrt(len(points)):
            return "all positions lie near one line"
    return ""


def in_mm(length: float | np.floating) -> str:
    """Return a length [m] as text: "733 mm", "0.02 mm"; less than 1 nm is zero."""
    number = float(length) * MM_PER_M
    return (
        f"{number:.0f} mm" if number >= 100.0 else f"{number:.2g} mm" if number > 1e-6 else "0 mm"
    )


@dataclass(frozen=True, eq=False)
class Comparison:
    """Unloaded positions against forward kinematics.

    Attributes:
        measured: (m,) rows with a position, counted from 0.
        distance: (m,) distance from the forward kinematics, after a shift or a mistake is undone,
            m.
        shift: (3,) m, of positions in a frame with the base's axes; zero if they need none.
        text: the contradiction, and the mistake that explains it; "" for none.
        frame: the positions' frame that explains them; None: none is needed, or none does.
        q: (n, n_joints) joint positions in which the mistake is undone, rad or m.
        robot: the robot with the TCP that explains the positions.
        is_undone: a mistake explains the positions, and the other attributes undo it.
    """

    measured: IntArray
    distance: FloatArray
    shift: FloatArray
    text: str
    frame: Frame | None
    q: FloatArray
    robot: Robot

    is_undone: bool = False

    @property
    def far_rows(self) -> IntArray:
        """Rows, counted from 0, whose position lies far from where the others lie."""
        limit = max(ROW_RATIO * float(np.median(self.distance)), MAX_IN_ROW)
        return np.asarray(self.measured[self.distance > limit])


@dataclass(frozen=True, eq=False)
class _Mistake:
    """A mistake that may explain positions: its text, what undoes it, and what it leaves."""

    text: str
    median: float
    q: FloatArray
    robot: Robot
    frame: Frame | None = None


def compare_positions(positions: FloatArray, q: FloatArray, robot: Robot) -> Comparison:
    """Compare unloaded positions with the forward kinematics, and name what explains both.

    A shift is not a contradiction: only the axes of the frame matter to deflections.

    Args:
        positions: (n, 3) m.
        q: (n, n_joints) rad or m.
        robot: the measured robot.
    """
    measured = np.flatnonzero(np.isfinite(positions).all(axis=1))
    positions, tcp = positions[measured], robot.forward(q[measured]).points[:, -1]
    raw = np.linalg.norm(positions - tcp, axis=1)
    agrees = Comparison(measured, raw, np.zeros(3), "", None, q, robot)
    if not len(measured) or np.median(raw) <= MAX_MEDIAN:
        return agrees
    shifted = fit_frame(positions, tcp, turns=False)
    enough = len(np.unique(tcp.round(3), axis=0)) >= MIN_POSES
    if enough and np.median(shifted.distance) <= MAX_MEDIAN:
        return replace(agrees, distance=shifted.distance, shift=shifted.shift)
    text = (
        f"the unloaded positions are up to {in_mm(raw.max())} (median {in_mm(np.median(raw))}) "
        "from the forward kinematics of the joint angles"
    )
    mistake = _likeliest_mistake(positions, q, measured, robot, shifted) if enough else None
    if mistake is None:
        more = "; check the joint angles, the TCP, the robot and the frame of the positions"
        return replace(agrees, text=text + more)
    tcp = mistake.robot.forward(mistake.q[measured]).points[:, -1]
    fitted = fit_frame(positions, tcp, turns=mistake.frame is not None)
    if mistake.frame and np.linalg.det(mistake.frame.rotation) < 0.0:
        return replace(agrees, text=f"{text}; {mistake.text}")
    frame = fitted if mistake.frame else None
    frame_text = f"the positions look as if they were in another frame ({fitted.text})"
    names = [mistake.text] * bool(mistake.text) + [frame_text] * bool(frame)
    remaining = in_mm(np.median(fitted.distance))
    text += f"; {' and '.join(names)}: then they are {remaining} (median) from it"
    if frame and not mistake.text:
        text += "; --register turns deflections to the base frame"
    is_shifted = frame is None and float(np.linalg.norm(fitted.shift)) > MAX_MEDIAN
    shift = fitted.shift if is_shifted else np.zeros(3)
    return Comparison(
        measured, fitted.distance, shift, text, frame, mistake.q, mistake.robot, is_undone=True
    )


def _likeliest_mistake(
    positions: FloatArray, q: FloatArray, measured: IntArray, robot: Robot, shifted: Frame
) -> _Mistake | None:
    """Return the first mistake that leaves little and hardly more than the best, or None.

    `positions` belong to the `measured` rows.
    """
    compared = np.unique(np.linspace(0, len(measured) - 1, MAX_COMPARED).astype(np.int64))
    limit = min(MAX_MEDIAN, CLEAR_RATIO * float(np.median(shifted.distance)))
    mistakes = []
    for mistake in _mistakes(positions[compared], q, measured[compared], robot):
        if mistake.median <= limit:
            mistakes.append(mistake)
        if mistake.median <= EXACT:  # no further one is clearly better
            break
    least = max(min((mistake.median for mistake in mistakes), default=0.0), EXACT)
    likely = [mistake for mistake in mistakes if mistake.median <= least / CLEAR_RATIO]
    return likely[0] if likely else None


def _mistakes(
    positions: FloatArray, q: FloatArray, rows: IntArray, robot: Robot
) -> Iterator[_Mistake]:
    """Yield each mistake, the likeliest first; `positions` belong to the `rows`."""
    tcp = robot.forward(q[rows]).points[:, -1]
    frame = None if frame_doubt(positions, tcp) else fit_frame(positions, tcp)
    if frame:
        yield _Mistake("", float(np.median(frame.distance)), q, robot, frame)
        yield _mirrored(positions, tcp, q, robot)
    for turns in (False, True) if frame else (False,):
        shift, median = _other_tcp(positions, q[rows], robot, frame if turns else None)
        moved_robot = replace(robot, tcp=robot.tcp + robot.flange[:3, :3] @ shift)
        text = TCP_HYPOTHESIS.text.format(*(shift * MM_PER_M).round() + 0.0)
        yield _Mistake(text, median, q, moved_robot, frame if turns else None)
        for text, undone in _joints_undone(positions, q, rows, robot, turns):
            fitted = fit_frame(positions, robot.forward(undone[rows]).points[:, -1], turns=turns)
            median = float(np.median(fitted.distance))
            yield _Mistake(text, median, undone, robot, fitted if turns else None)


def _joints_undone(
    positions: FloatArray, q: FloatArray, rows: IntArray, robot: Robot, turns: bool
) -> Iterator[tuple[str, FloatArray]]:
    """Yield each mistake of the joints, and the joint positions (n, n_joints) without it."""
    yield from joint_positions(robot, q).items()
    joints = np.flatnonzero(robot.turns)
    for hypothesis, joint in zip(zero_hypotheses(robot), joints, strict=True):
        if not turns or joint > 0:  # the first joint turns as the frame does
            angle = _zero(positions, q[rows], robot, int(joint), turns)
            text = hypothesis.text.format(np.rad2deg(angle))
            yield text, q + angle * (np.arange(robot.n_joints) == joint)


def _mirrored(positions: FloatArray, tcp: FloatArray, q: FloatArray, robot: Robot) -> _Mistake:
    """Return the mistake of a left-handed frame."""
    frame = fit_frame(-positions, tcp)
    rotation = -frame.rotation
    nearest = rotation.round()
    is_permutation = np.abs(rotation - nearest).max() < 0.05
    how = f"had to be read {axes_text(nearest.T)}" if is_permutation else "were in a mirrored frame"
    median = float(np.median(frame.distance))
    mirrored = Frame(rotation, -frame.shift, frame.distance)
    return _Mistake(f"the positions look as if they {how}", median, q, robot, mirrored)


def _zero(positions: FloatArray, q: FloatArray, robot: Robot, joint: int, turns: bool) -> float:
    """Return the angle [rad] to be added to a joint that brings the TCPs nearest."""
    from scipy.optimize import minimize_scalar

    def distance(angle: float) -> float:
        tcp = robot.forward(q + angle * (np.arange(robot.n_joints) == joint)).points[:, -1]
        return float(np.median(fit_frame(positions, tcp, turns=turns).distance))

    start = min(np.arange(-np.pi, np.pi, ZERO_STEP), key=distance)
    ends = start - ZERO_STEP, start + ZERO_STEP
    return float(minimize_scalar(distance, bounds=ends, options={"xatol": 1e-7}).x)


def _other_tcp(
    positions: FloatArray, q: FloatArray, robot: Robot, frame: Frame | None
) -> tuple[FloatArray, float]:
    """Return the shift (3,) of the TCP in the flange frame that fits best, and the median left, m.

    With a `frame`, its pose is fitted, too, from there on.
    """
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    poses = robot.forward(q)
    flange, tcp = poses.rotation @ robot.flange[:3, :3], poses.points[:, -1]

    def misfit(numbers: FloatArray) -> FloatArray:
        points = tcp + flange @ numbers[:3]
        if frame is not None:
            points = Rotation.from_rotvec(numbers[3:6]).apply(points) + numbers[6:]
        return np.asarray((points - positions).reshape(-1))

    start = np.zeros(3)
    if frame is not None:
        turn = Rotation.from_matrix(frame.rotation).as_rotvec()
        start = np.concatenate([start, turn, frame.shift])
    numbers = least_squares(misfit, start, loss="soft_l1", f_scale=1e-3).x
    distance = np.linalg.norm(misfit(numbers).reshape(-1, 3), axis=1)
    return numbers[:3], float(np.median(distance))
