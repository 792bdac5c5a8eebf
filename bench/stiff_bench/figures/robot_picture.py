"""Arm at one pose, unloaded and loaded, with shares of joint springs."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.final_fit import final_fit
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import joint_torque
from stiff_protocols.springs.identification import IdentifiedSprings

ARM_COLOR, LOADED_COLOR, FORCE_COLOR = "#5b6673", style.COLORS[1], style.COLORS[0]
SHOWN_SHARE = 0.3
"""Largest length of the drawn deflection, as a share of the arm's extent."""
ARROW_SHARE = 0.22
"""Length of a force in the plane of the picture, as a share of the arm's extent."""
LEAST_NAMED_SHARE = 0.05
"""Share of the deflection from which a joint's name is written at its dot."""
DOT_AREA, SMALLEST_DOT = 170.0, 9.0
"""Area of a dot whose joint causes all of the deflection or none, square points."""
SIZE_INCH, CORNER_INCH = np.array([style.PAGE_INCH, 3.3]), np.array([0.5, 0.4])
PANEL_INCH, MARGIN_INCH = np.array([4.5, 2.7]), np.array([0.65, 0.3])
"""Size and place of the axes, and the margin in them that names need."""
SNAP_DEG = 10.0
"""Angle from the x or y axis up to which that axis is the picture's horizontal one."""
MOST_POSES, MOST_LOADS = 60, 20
"""Training poses and load directions that are tried for a model without a data set."""


@dataclass(frozen=True, eq=False)
class LoadedArm:
    """An arm at one pose under one load.

    Attributes:
        robot: its kinematics.
        q: (n_joints,) joint positions without load, rad or m.
        wrench: (6,) force [N] and torque [N m] at the TCP, base frame.
        deflections: source -> (3,) deflection of the TCP, m, base frame. The first is drawn.
        compliance: (n_joints,) compliance of the joints' springs, rad/(N m) or m/N.
    """

    robot: Robot
    q: FloatArray
    wrench: FloatArray
    deflections: dict[str, FloatArray]
    compliance: FloatArray

    @property
    def deflection(self) -> FloatArray:
        """(3,) the drawn deflection of the TCP, m, base frame."""
        return next(iter(self.deflections.values()))

    @property
    def joint_turns(self) -> FloatArray:
        """(n_joints,) deflection of each spring under the load, rad or m."""
        (torque,) = joint_torque(self.robot.jacobian(self.q[None]), self.wrench[None])
        return np.asarray(self.compliance * torque)

    @property
    def shares(self) -> FloatArray:
        """(n_joints,) length of the TCP's motion by each spring, as a share of their sum."""
        lengths = np.linalg.norm(
            self.robot.jacobian(self.q[None])[0, :3] * self.joint_turns, axis=0
        )
        return np.asarray(lengths / (lengths.sum() or 1.0))

    def points(self, q: FloatArray) -> FloatArray:
        """Return the (n_joints + 2, 3) base, joints and TCP at `q` (n_joints,), m, base frame."""
        return np.asarray(arm_points(self.robot, q[None])[0])

    def magnified(self, factor: float) -> FloatArray:
        """Return joint positions that put the TCP at `factor` times its deflection, rad or m.

        They are as near as possible to `factor` times the turns of the springs. A soft joint moves
        more easily than a stiff one.
        """
        start = factor * self.joint_turns
        target = self.robot.tcp_position(self.q[None])[0] + factor * self.deflection
        ease = np.sqrt(self.compliance / (self.compliance.max() or 1.0)).clip(min=1e-3)

        def residuals(turn: FloatArray) -> FloatArray:
            gap = self.robot.tcp_position((self.q + turn)[None])[0] - target
            return np.concatenate([1e4 * gap, (turn - start) / ease])

        return np.asarray(self.q + least_squares(residuals, start).x)


def arm_points(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the (n, n_joints + 2, 3) base, joints and TCP at (n, n_joints) `q`, m, base frame."""
    points = robot.forward(q).points
    return np.concatenate([np.zeros((len(points), 1, 3)), points], axis=1)


def horizontal_axis(arm: LoadedArm) -> tuple[FloatArray, str]:
    """Return the (3,) horizontal unit vector of the picture, and its label.

    The plane through it and z shows most of the arm, the force and the deflection.
    """
    points = arm.points(arm.q)
    seen = [points / (np.abs(points).max() or 1.0) / np.sqrt(len(points))]
    for vector in (arm.wrench[:3], arm.deflection):
        seen.append(vector[None] / (np.linalg.norm(vector) or 1.0))
    x, y = np.concatenate(seen)[:, :2].T
    angle = 0.5 * np.degrees(np.arctan2(2.0 * (x @ y), x @ x - y @ y))  # of the longer main axis
    for axis, name in ((0.0, "x [m]"), (90.0, "y [m]")):
        if abs((angle - axis + 90.0) % 180.0 - 90.0) <= SNAP_DEG:
            return np.array([np.cos(np.radians(axis)), np.sin(np.radians(axis)), 0.0]), name
    right = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
    if points[-1] @ right < 0.0:
        right, angle = -right, angle + 180.0
    angle = (angle + 180.0) % 360.0 - 180.0
    return right, f"horizontal distance, {angle:.0f}° from x [m]"


def robot_figure(arm: LoadedArm) -> Figure:
    """Draw arm, load, deflection and the shares of the joints."""
    right, label = horizontal_axis(arm)
    unloaded = arm.points(arm.q)
    extent = float(np.ptp(unloaded, axis=0).max())
    length = float(np.linalg.norm(arm.deflection))
    factor = style.round_factor(SHOWN_SHARE * extent / length) if length > 0.0 else 1.0
    loaded = arm.points(arm.magnified(factor))
    force, force_n = arm.wrench[:3], float(np.linalg.norm(arm.wrench[:3]))
    arrow = loaded[-1] + ARROW_SHARE * extent * force / (force_n or 1.0)

    def flat(points: FloatArray) -> FloatArray:
        return np.column_stack([points @ right, points[..., 2]])

    figure = Figure(figsize=(SIZE_INCH[0], SIZE_INCH[1]))  # limits are chosen for this panel
    corner, size = CORNER_INCH / SIZE_INCH, PANEL_INCH / SIZE_INCH
    axes = figure.add_axes((*corner, *size))
    side_axes = figure.add_axes(
        (corner[0] + size[0], corner[1], 1.0 - corner[0] - size[0], size[1])
    )
    side_axes.set_axis_off()
    axes.axhline(0.0, color="black", linewidth=0.8, zorder=1.0)
    wide: dict[str, Any] = {"solid_capstyle": "round", "solid_joinstyle": "round", "linewidth": 5.0}
    axes.plot(*flat(unloaded).T, color=ARM_COLOR, **wide, label="unloaded", zorder=2.0)
    dashes: dict[str, Any] = {"linestyle": (0, (2.5, 1.0)), "linewidth": 2.5}
    name = f"loaded (deflection times {factor:g})"
    axes.plot(*flat(loaded).T, color=LOADED_COLOR, **dashes, label=name, zorder=3.0)
    for source, deflection in list(arm.deflections.items())[1:]:
        place = flat(unloaded[-1:] + factor * deflection)
        axes.plot(*place.T, "x", color="black", ms=6.0, mew=1.5, label=f"TCP, {source}", zorder=4.0)
    force_line = np.stack([loaded[-1], arrow])
    names = _Names.on(axes, flat(np.concatenate([*map(_between, (unloaded, loaded, force_line))])))
    if force_n > 0.0:
        _draw_force(names, flat(force_line), arm.wrench)
    _draw_joints(names, arm, flat(unloaded)[1:-1])
    if unloaded[-1] @ right < 0.0:  # seen from the other side: the arm points to the right
        axes.invert_xaxis()
    axes.set(xlabel=label, ylabel="z [m]")
    axes.locator_params(nbins=7)
    lengths = {source: np.linalg.norm(vector) * MM for source, vector in arm.deflections.items()}
    lines = [f"{length:.3g} mm ({source})" for source, length in lengths.items()]
    axes.annotate(
        "\n".join(["deflection of the TCP", *(style.short(line) for line in lines)]),
        tuple(flat(loaded)[-1]),
        xytext=(0.08, 0.98),
        textcoords=side_axes.transAxes,
        ha="left",
        va="top",
        arrowprops={"arrowstyle": "-", "linewidth": 0.7, "relpos": (0.0, 0.5), "shrinkB": 3.0},
    )
    side_axes.legend(*axes.get_legend_handles_labels(), loc="lower left", labelspacing=0.9)
    return figure


@dataclass
class _Names:
    """Writer of names next to places of a picture, in its empty parts.

    Attributes:
        axes: of the picture.
        inch: length of the robot per inch of the picture, m.
        drawn: (n, 2) occupied places, m.
    """

    axes: Axes
    inch: float
    drawn: FloatArray

    @classmethod
    def on(cls, axes: Axes, drawn: FloatArray) -> _Names:
        """Show (n, 2) places and a margin, m, with equal scales; they fill the panel."""
        low, high = drawn.min(axis=0), drawn.max(axis=0)
        inch = float(((high - low) / (PANEL_INCH - 2.0 * MARGIN_INCH)).max())
        middle, half = 0.5 * (low + high), 0.5 * inch * PANEL_INCH
        corners = np.stack([middle - half, middle + half])
        axes.set(xlim=tuple(corners[:, 0]), ylim=tuple(corners[:, 1]), aspect="equal")
        (first, last), _ = corners.T
        ground = np.column_stack([np.linspace(first, last, 60), np.zeros(60)])
        return cls(axes, inch, np.concatenate([drawn, ground]))

    def write(self, text: str, place: FloatArray, **look: Any) -> None:
        """Write a text next to a (2,) place, m, inside the axes."""
        half = 0.5 * self.inch * np.array([0.065 * len(text), 0.13])  # of the text's box
        angles = np.radians(np.arange(0.0, 360.0, 15.0))
        around = np.column_stack([np.cos(angles), np.sin(angles)])
        centres = place + around * (half + 0.12 * self.inch)
        limits = np.array([self.axes.get_xlim(), self.axes.get_ylim()]).T
        inside = ((centres - half >= limits[0]) & (centres + half <= limits[1])).all(axis=1)
        beyond = (np.abs(centres[:, None] - self.drawn) - half).clip(min=0.0)
        gaps = np.linalg.norm(beyond, axis=2).min(axis=1) + inside
        x, y = centres[int(gaps.argmax())]
        self.axes.text(x, y, text, ha="center", va="center", zorder=7.0, **look)
        box = np.stack(np.meshgrid([-1.0, -0.5, 0.0, 0.5, 1.0], [-1.0, 0.0, 1.0]), axis=-1)
        self.drawn = np.concatenate([self.drawn, (x, y) + half * box.reshape(-1, 2)])


def _draw_joints(names: _Names, arm: LoadedArm, places: FloatArray) -> None:
    """Draw a dot per joint at (n_joints, 2) places; its area is its share of the deflection."""
    look: dict[str, Any] = {"facecolor": "white", "edgecolor": "black", "linewidth": 0.9}
    order = np.argsort(-arm.shares)  # small dots on top
    x, y = places[order].T
    names.axes.scatter(x, y, _dot_areas(arm.shares)[order], **look, zorder=5.0)
    for share in (0.1, 0.5):
        (area,) = _dot_areas(np.array([share]))
        label = f"joint: {_rounded(share)} of the deflection"
        names.axes.scatter([], [], area, **look, label=label)
    for name, share, place in zip(arm.robot.joint_names, arm.shares, places, strict=True):
        if share >= LEAST_NAMED_SHARE:
            names.write(f"{style.short(name, 12)} {_rounded(share)}", place)


def _rounded(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _between(points: FloatArray) -> FloatArray:
    """Return (20 (n - 1), 3) points on the lines between (n, 3) points."""
    along = np.linspace(0.0, 1.0, 20)[:, None, None]
    return np.asarray((points[:-1] + along * np.diff(points, axis=0)).reshape(-1, 3))


def _dot_areas(shares: FloatArray) -> FloatArray:
    return SMALLEST_DOT + DOT_AREA * shares


def _draw_force(names: _Names, ends: FloatArray, wrench: FloatArray) -> None:
    """Draw the (6,) load as an arrow between (2, 2) places, with its size."""
    force, torque = np.linalg.norm(wrench[:3]), np.linalg.norm(wrench[3:])
    arrow = {"arrowstyle": "-|>", "color": FORCE_COLOR, "lw": 1.8, "shrinkA": 0.0, "shrinkB": 0.0}
    names.axes.annotate("", tuple(ends[1]), xytext=tuple(ends[0]), arrowprops=arrow, zorder=6.0)
    text = f"load {force:.0f} N" if force >= 100.0 else f"load {force:.3g} N"
    text += f", {torque:.2g} N m" if torque >= 5e-3 * force else ""
    names.write(text, ends[1], color=FORCE_COLOR)


def robot_picture(
    samples: Samples,
    robot: Robot,
    about: str,
    kind: str,
    *,
    model: Any = None,
    model_name: str = "",
    row: int | None = None,
) -> Prepared:
    """Draw an arm at a sample's pose and load.

    Args:
        samples: of the data set; at least one.
        robot: that they belong to.
        about: name of the data set, for the picture.
        kind: "measured" or "simulated".
        model: a fitted model whose prediction is drawn; None: the deflection of the sample.
        model_name: of that model.
        row: number of the sample, from 0; None: the sample with the largest deflection.

    Raises:
        ConfigError: the row does not exist, or the model is of another robot.
        ModelError: no joint spring explains the samples.
    """
    lengths = np.linalg.norm(samples.deflection, axis=1)
    if row is not None and not 0 <= row < len(samples):
        raise ConfigError(f"{row}: {about} has rows 0 to {len(samples) - 1}", "row")
    at = int(lengths.argmax()) if row is None else row
    q, wrench = samples.q[at : at + 1], samples.wrench[at : at + 1]
    deflections = {kind: samples.deflection[at]}
    if model is not None:
        _check_same_robot(model.robot_, robot, q, f"{model_name}: fitted to", about)
        deflections = {f"predicted by {model_name}": np.asarray(model.predict(q, wrench))[0]}
        deflections |= {kind: samples.deflection[at]}
    compliance, spring_source = _joint_compliances(samples, robot, model, model_name)
    arm = LoadedArm(robot, q[0], wrench[0], deflections, compliance)
    which = ", the sample with the largest deflection" if row is None else ""
    pose = f"pose {samples.pose_id[at]}, load {samples.load_id[at]}"
    where = f"{about}: robot {robot.name}, row {at}{which}"
    return _prepared(arm, where, spring_source, f"{about}, {pose}")


def _prepared(arm: LoadedArm, which: str, spring_source: str, subtitle: str) -> Prepared:
    right, _ = horizontal_axis(arm)
    seen = [_in_plane(vector, right) for vector in (arm.wrench[:3], arm.deflection)]
    shares = ", ".join(
        f"{style.short(name)} {_rounded(share)}"
        for name, share in zip(arm.robot.joint_names, arm.shares, strict=True)
    )
    caption = (
        f"{which}. Turn of a joint: torque of the load over {spring_source}; corrected so that the "
        f"TCP has its deflection. Dots: joints; area: share of the deflection ({shares}). The "
        f"plane of the picture shows {seen[0]} of the force and {seen[1]} of the deflection."
    )
    return Prepared("Arm under load", caption, partial(robot_figure, arm), subtitle)


def _in_plane(vector: FloatArray, right: FloatArray) -> str:
    """Return the share of a (3,) vector's length in the plane of `right` and z, such as "95 %"."""
    length = float(np.linalg.norm(vector)) or 1.0
    return _rounded(float(np.hypot(vector @ right, vector[2])) / length)


def _joint_compliances(
    samples: Samples, robot: Robot, model: Any, model_name: str
) -> tuple[FloatArray, str]:
    """Return the (n_joints,) joint compliances, and their origin in words.

    They are from the model, or from a VJM that is fitted to the samples.
    """
    joint_springs = getattr(model, "springs_", None)
    if isinstance(joint_springs, IdentifiedSprings) and joint_springs.names == robot.joint_names:
        return joint_springs.compliance, f"stiffness ({model_name})"
    choice = Choice.of(build_registry().model(REFERENCE_MODEL))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # such as joints without torque
        fitted, _ = final_fit(choice, samples, robot)
    reason = "" if model is None else f", because {model_name} has no springs of joints"
    springs: IdentifiedSprings = fitted.springs_
    return (
        springs.compliance,
        f"the joint stiffnesses of {REFERENCE_MODEL}, fitted to the samples{reason}",
    )


def _check_same_robot(fitted: Robot, robot: Robot, q: FloatArray, model: str, about: str) -> None:
    """Check that two robots have the same TCP position at (1, n_joints) `q`.

    Raises:
        ConfigError: the positions differ.
    """
    same = fitted.n_joints == robot.n_joints and np.allclose(
        fitted.tcp_position(q), robot.tcp_position(q), atol=1e-6
    )
    if not same:
        raise ConfigError(
            f"{model} robot {fitted.name} with its TCP at {fitted.tcp_on_flange} m, but {about} is "
            f"of robot {robot.name} with its TCP at {robot.tcp_on_flange} m"
        )


def model_picture(model: Any, model_name: str) -> Prepared:
    """Return the picture of a model's robot at its largest prediction.

    Candidates are training poses under training loads with the largest training force.

    Raises:
        ModelError: no joint spring explains the predictions.
    """
    samples, robot = _predicted_samples(model), model.robot_
    at = int(np.linalg.norm(samples.deflection, axis=1).argmax())
    compliance, spring_source = _joint_compliances(samples, robot, model, model_name)
    predicted = {f"predicted by {model_name}": samples.deflection[at]}
    arm = LoadedArm(robot, samples.q[at], samples.wrench[at], predicted, compliance)
    about = f"{model_name}, robot {robot.name}"
    which = (
        f"{about}: the largest prediction for {len(np.unique(samples.pose_id))} training poses, "
        "each under directions of the training loads with the largest training force"
    )
    return _prepared(arm, which, spring_source, about)


def _predicted_samples(model: Any) -> Samples:
    """Return training poses under training loads, with the deflections that a model predicts."""
    training_range = model.training_range_
    poses, loads = (
        _thinned(training_range.poses, MOST_POSES),
        _thinned(training_range.directions, MOST_LOADS),
    )
    sizes = np.linalg.norm(loads[:, :3], axis=1, keepdims=True)
    loads = loads * np.divide(
        training_range.force, sizes, out=np.ones_like(sizes), where=sizes > 0.0
    )
    q, wrench = np.repeat(poses, len(loads), axis=0), np.tile(loads, (len(poses), 1))
    pose_id = np.repeat(np.arange(len(poses)), len(loads)).astype(str)
    load_id = np.tile(np.arange(len(loads)), len(poses)).astype(str)
    deflection = np.asarray(model.predict(q, wrench))
    return Samples(q, wrench, deflection, pose_id, load_id, np.full(len(q), "training"))


def _thinned(rows: FloatArray, most: int) -> FloatArray:
    return np.asarray(rows[np.linspace(0, len(rows) - 1, min(len(rows), most)).astype(int)])


def robot(source: FigureSource, **chosen: Any) -> Prepared:
    """Show the arm at the pose of the largest deflection, unloaded and loaded.

    `chosen` are keywords of `robot_picture`.
    """
    task = source.task(lambda _: True, "a result")
    stored = read_data(source.folder, task.name.data_sha256)
    kind = task.presentation.kind
    about = f"{task.name.dataset} ({kind})"
    return robot_picture(stored.measured, stored.robot, about, kind, **chosen)
