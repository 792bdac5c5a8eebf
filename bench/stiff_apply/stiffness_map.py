"""Stiffness maps: the deflection or compliance that a model predicts over the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from stiff_apply.cartesian_stiffness import (
    cartesian_compliance,
    cartesian_stiffness,
    largest_compliance,
)
from stiff_apply.path_file import POSITION_COLUMNS
from stiff_apply.tool_task import (
    LOAD_VALUES,
    LoadFrame,
    ToolTask,
    check_word,
    frame_matrix,
    tool_task,
)
from stiff_apply.workspace import (
    BLANK_REASONS,
    PLANES,
    plane_grid,
    reach_box,
    reachable_region,
    reached_poses,
)
from stiff_bench.analysis.extrapolation import extrapolation_warning
from stiff_bench.api.model import Model
from stiff_bench.parameter_types import (
    Angles,
    Bounds,
    Box,
    FilePath,
    Form,
    Frame,
    HeldJoints,
    Load,
    Picture,
)
from stiff_bench.run.progress import display
from stiff_bench.tables.picture_file import METADATA
from stiff_bench.tables.units import MM
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.table_reader import PARQUET, write_table
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.display import printable
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    unsupported_extension,
    warn,
)
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.types import (
    AXES,
    BoolArray,
    FloatArray,
    TextArray,
    frozen_array,
)
from stiff_protocols.paths.inverse import JUMP

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.figures.prepared_figure import Prepared

Quantity = Literal["deflection", "compliance"]
QUANTITIES: tuple[Quantity, ...] = ("deflection", "compliance")
MAP_AXES = (*AXES, "tool")
"""Directions of a component: axes of the base frame, and the tool's own z axis."""
Extreme = Literal["stiffest", "softest"]
EXTREMES: tuple[Extreme, ...] = ("stiffest", "softest")
DOWN, DOWN_DEG = "down", tuple((angle, 0.0, 180.0) for angle in (0.0, 90.0, 180.0, -90.0))
"""Word for a tool whose z axis points down, and its possible orientations a, b, c."""
LEVEL_M = 0.01
"""Rounding of the position of a default plane, m."""
LARGEST_MM = 1e5


@dataclass(frozen=True, eq=False, repr=False)
class StiffnessMap:
    """Predicted deflections or compliances over a plane of the workspace.

    The arrays have (n_rows, n_columns) points: columns run along the plane's first axis, rows along
    its second one.

    Attributes:
        model_name: key of the model, with its options.
        robot: robot of the fitted model.
        plane: "xy", "xz" or "yz".
        quantity: "deflection" or "compliance".
        axis: "x", "y", "z" or "tool" of the component; None: the length of the deflection, or the
            largest principal compliance.
        load: (6,) N and N m at the TCP.
        load_frame: frame of the load, "base" or "tool".
        positions: (..., 3) TCP, base frame, m.
        tool_angles_deg: (3,) KUKA's angles a, b, c of the tool frame in the base frame, deg.
        q: (..., n_joints) joint positions, rad or m; NaN where blank.
        deflections: (..., 3) m, base frame, of a map of deflections, else None; NaN where blank.
        compliance: (..., 3, 3) translational compliance, m/N, base frame, of a map of compliances,
            else None; NaN where blank.
        values: (...) the mapped quantity, m or m/N; NaN where blank.
        blank: (...) reason why a point has no value: "out of reach", "joint limits", "singular" or
            "" for none.
        extrapolates: (...) quantities beyond the training range, with the words of
            `TrainingRange.extrapolates`.
        joint_compliance: (n_joints,) compliance of the springs of `vjm`, rad/(N m) or m/N; else
            None.
    """

    model_name: str
    robot: Robot
    plane: str
    quantity: Quantity
    axis: str | None
    load: FloatArray
    load_frame: LoadFrame
    positions: FloatArray
    tool_angles_deg: FloatArray
    q: FloatArray
    deflections: FloatArray | None
    compliance: FloatArray | None
    values: FloatArray
    blank: TextArray
    extrapolates: TextArray
    joint_compliance: FloatArray | None = field(repr=False)

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def is_reached(self) -> BoolArray:
        """Return a mask (...) of the points with a value."""
        return np.asarray(self.blank == "")

    @property
    def is_far(self) -> BoolArray:
        """Return a mask (...) of the points far from the training poses.

        A joint is beyond its training range ("joints"), or the nearest training pose is far
        ("pose-gap"). The load does not count.
        """
        words = np.char.add(self.extrapolates, " ")
        return np.asarray(
            (np.char.find(words, "joints ") >= 0) | (np.char.find(words, "pose-gap ") >= 0)
        )

    @property
    def is_jump(self) -> BoolArray:
        """Return a mask (...) of the points with a jump of more than 0.5 rad (m) to a neighbour.

        The arm has another configuration there, or is close to a singularity.
        """
        jump = np.zeros(self.blank.shape, dtype=bool)
        rows = np.abs(np.diff(self.q, axis=0)).max(axis=-1, initial=0.0) > JUMP
        columns = np.abs(np.diff(self.q, axis=1)).max(axis=-1, initial=0.0) > JUMP
        jump[1:] |= rows
        jump[:-1] |= rows
        jump[:, 1:] |= columns
        jump[:, :-1] |= columns
        return jump

    @property
    def unit(self) -> str:
        """Return the unit of the values in texts, tables and pictures."""
        return "mm" if self.quantity == "deflection" else "mm/kN"

    @property
    def values_in_unit(self) -> FloatArray:
        """Return (...) values in `unit`; NaN where blank."""
        return self.values * (MM if self.quantity == "deflection" else MM * 1000.0)

    @property
    def cartesian_stiffness(self) -> FloatArray:
        """Return (..., 6, 6) K_X = J^-T K J^-1 at the TCP, base frame, N/m, N/rad and N m/rad.

        Force before torque. NaN where blank, and where a spring is rigid.

        Raises:
            ConfigError: the model is not `vjm`, with one spring per joint.
        """
        if self.joint_compliance is None:
            raise ConfigError(f"{self.model_name} has no Cartesian stiffness matrix (valid: vjm)")
        stiffness = np.full((*self.blank.shape, 6, 6), np.nan)
        reached = self.is_reached
        jacobian = self.robot.jacobian(self.q[reached])
        stiffness[reached] = cartesian_stiffness(jacobian, self.joint_compliance)
        return stiffness

    def extreme(self, kind: Extreme, *, near: bool = False) -> tuple[int, int]:
        """Return the numbers of row and column of the stiffest or softest point.

        A component counts without its sign. `near` looks only at points that are not far from the
        training poses; at least one point must be left.
        """
        size = np.abs(self.values)
        if near:
            size = np.where(self.is_far, np.nan, size)
        place = np.nanargmin(size) if kind == "stiffest" else np.nanargmax(size)
        row, column = map(int, np.unravel_index(place, size.shape))
        return row, column

    def extremes_text(self, *, near: bool = False) -> str:
        """Return the stiffest and softest points with values and positions."""
        texts = []
        for kind in EXTREMES:
            at = self.extreme(kind, near=near)
            place = ", ".join(f"{length:.0f}" for length in self.positions[at] * MM + 0.0)
            texts.append(f"{kind} {self.values_in_unit[at]:.3g} {self.unit} at ({place}) mm")
        return ", ".join(texts)

    def __repr__(self) -> str:
        """Return extremes, the mapped quantity, and reachable, far and blank points in words."""
        reached, far = self.is_reached, self.is_far
        lines = [
            f"{self.extremes_text()}; {reached.sum():,} of {reached.size:,} points reachable, "
            f"{far.sum():,} of these far from the training poses"
        ]
        if far.any() and (reached & ~far).any():
            lines.append(f"near the training poses: {self.extremes_text(near=True)}")
        lines.append(f"{self.model_name}, robot {self.robot.name}: {self.quantity_text}")
        lines.append(f"{self.place_text}; blank: {self.blank_text}")
        return printable("\n".join(lines))

    @property
    def load_text(self) -> str:
        """Return the load with its units and, if it is not the base, its frame."""
        force, torque = self.load[:3], self.load[3:]
        text = f"{_numbers(force)} N" + f", {_numbers(torque)} N m" * bool(torque.any())
        return text + " in the tool frame" * (self.load_frame == "tool")

    @property
    def quantity_name(self) -> str:
        """Return the mapped quantity in words."""
        along = {None: "", "tool": " along the tool axis"}.get(self.axis, f" along {self.axis}")
        if self.quantity == "deflection":
            return f"predicted deflection{along}"
        return f"predicted compliance{along}" if along else "largest principal compliance"

    @property
    def quantity_text(self) -> str:
        """Return the mapped quantity and its load in words."""
        if self.quantity == "deflection":
            return f"{self.quantity_name} under {self.load_text}"
        return self.quantity_name

    @property
    def place_text(self) -> str:
        """Return the plane, its ends and the orientation of the tool in words."""
        return _place_text(self.plane, self.positions, self.tool_angles_deg)

    @property
    def blank_text(self) -> str:
        """Return the number of blank points by reason in words; "none" for no blank point."""
        return _blank_text(self.blank)

    def frame(self) -> DataFrame:
        """Return a row per point: position, joints, value, deflection, in mm and deg."""
        import pandas as pd

        def rows(values: Any) -> Any:
            return values.reshape(-1, *values.shape[2:])

        columns = dict(zip(POSITION_COLUMNS, rows(self.positions).T * MM, strict=True))
        name = f"{self.quantity}_{self.axis}" if self.axis else self.quantity
        columns[f"{name}_{self.unit.replace('/', '_per_')}"] = rows(self.values_in_unit)
        if self.deflections is not None:
            columns |= dict(zip(DEFLECTION_COLUMNS, rows(self.deflections).T * MM, strict=True))
        joints = (rows(self.q) * file_units(self.robot)).T
        columns |= dict(zip(joint_columns(self.robot), joints, strict=True))
        numbers = pd.DataFrame(columns).round(8) + 0.0
        return numbers.assign(extrapolates=rows(self.extrapolates), blank=rows(self.blank))

    def plot(self) -> Prepared:
        """Return the picture: the values over the plane, with the arm at the stiffest point."""
        from stiff_apply.figures.stiffness_map import MapContent, arm_line, stiffness_map_picture

        first, second, normal = PLANES[self.plane]
        values, places = self.values_in_unit, self.positions * MM + 0.0
        stiffest, force = self.extreme("stiffest"), self.load[:3]
        if self.load_frame == "tool":
            force = rotation_of(self.tool_angles_deg) @ force
        content = MapContent(
            title=f"{AXES[normal]} = {places[0, 0, normal]:.0f} mm",
            first=places[0, :, first],
            second=places[:, 0, second],
            values=values,
            is_far=self.is_far,
            is_jump=self.is_jump,
            marks={
                kind: (places[at][[first, second]], float(values[at]))
                for kind in EXTREMES
                for at in [self.extreme(kind)]
            },
            axes=(first, second),
            arm=arm_line(self.robot, self.q[stiffest]),
            force=force if self.quantity == "deflection" else np.zeros(3),
            label=f"{self.quantity_name} [{self.unit}]",
            unit=self.unit,
        )
        about = f"{self.model_name}, robot {self.robot.name}"
        if self.quantity == "deflection":
            about += f", load {self.load_text}"
        return stiffness_map_picture(content, about, self.quantity_text, self.place_text)


def stiffness_map(
    model: Model,
    *,
    load: Load | None = None,
    quantity: Quantity = "deflection",
    axis: Literal["x", "y", "z", "tool"] | None = None,
    plane: Literal["xy", "xz", "yz"] = "xz",
    at: Annotated[float, Form("MM")] | None = None,
    box: Box | None = None,
    grid: Annotated[int, Bounds(at_least=2, at_most=500)] = 100,
    orientation: Angles = DOWN,
    tool: Frame | None = None,
    frame: LoadFrame = "base",
    hold: HeldJoints | None = None,
    output: FilePath | None = None,
    figure: Picture | None = None,
) -> StiffnessMap:
    """Map the predicted deflection or compliance over the workspace.

    Each point has the configuration of the arm that is nearest to the model's training poses.
    Points out of reach, beyond joint limits or at a singularity are blank; points far from the
    training poses are hatched.

    Args:
        model: fitted model.
        load: (3,) or (6,) process load at the TCP, in N and N m; by default none, for a compliance.
        quantity: deflection under `load`, or compliance of the TCP, from the joint springs of vjm.
        axis: component along an axis of the base frame or the tool's z axis; by default the length
            of the deflection, or the largest principal compliance.
        plane: plane of the map in the base frame.
        at: place of the plane on the third axis, in mm; by default the middle of `box`, or of the
            training poses.
        box: ends x0, x1, y0, y1, z0, z1 of the region, in mm; by default all that the robot
            reaches.
        grid: number of points along the longer edge of a plane.
        orientation: orientation of the tool in the base frame: a, b, c in deg; down: its z axis
            down, its x axis along the base's axis that is nearest to the training poses.
        tool: tool frame in the frame of the last link: x, y, z in mm and a, b, c in deg; by default
            the model's TCP with the axes of the last link.
        frame: frame that the load is expressed in.
        hold: joint of a robot with more than six joints that is held at a value in deg or mm, by
            name or number (rail, J3, 3); may be repeated.
        output: new file: a row per point (.csv, .parquet) or the picture (.png, .svg, .pdf).
        figure: new picture, with `output` for the table.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the load is missing.
        DataError: the robot reaches no point.
        StoreError: a file cannot be written, or exists.
    """
    for kind, word, valid in (
        ("quantity", quantity, QUANTITIES),
        ("axis", axis, (*MAP_AXES, *[None] * (axis is None))),
        ("plane", plane, PLANES),
    ):
        check_word(kind, word, [*valid])
    files = [Path(file) for file in (output, figure) if file is not None]
    _check_extensions(files)
    task = tool_task(
        model, tool=tool, load=load, frame=frame, hold=hold, files=(output,), figure=figure
    )
    robot, held, fitted = task.robot, task.held(), model.fitted
    springs: FloatArray | None = None
    if type(fitted) is VirtualJointModel:
        springs = fitted.springs_.compliance
    elif quantity == "compliance":
        raise ConfigError(f"compliance requires the model vjm, not {model.name}", "quantity")
    if quantity == "deflection" and (task.load is None or not task.load.any()):
        reason = "is missing" if task.load is None else "is zero, and so is every deflection"
        raise ConfigError(f"{reason}: give {LOAD_VALUES}, or quantity compliance", "load")

    training_range = model.training_range
    angles = _tool_angles(orientation, task)
    rotation = rotation_of(angles) @ task.tool[:3, :3].T
    wrench = task.in_base(np.zeros(6) if task.load is None else task.load, rotation[None])
    region = None if box is None else _box(box, plane)
    level = _level(at, region, plane, task)

    def reached(points: FloatArray) -> tuple[FloatArray, TextArray]:
        return reached_poses(robot, points, rotation, training_range, held)

    with display():
        if region is None:
            region = reachable_region(
                plane, level, reach_box(robot, held), lambda points: reached(points)[1] == ""
            )
        positions = plane_grid(plane, level, region, grid)
        q, blank = reached(positions)
        rows = blank == ""
        if not rows.any():
            raise DataError(
                f"{robot.name} reaches no point of {_place_text(plane, positions, angles)}: "
                f"{_blank_text(blank)} (try another --orientation, --at or --box)"
            )
        loads = np.tile(wrench, (int(rows.sum()), 1))
        if quantity == "deflection" or springs is None:
            vectors = model.predict_at_tcp(q[rows], loads)
        else:
            vectors = cartesian_compliance(robot.jacobian(q[rows])[:, :3], springs)
        words = training_range.extrapolates(q[rows], loads)

    def over_plane(values: FloatArray) -> FloatArray:
        every = np.full((*blank.shape, *values.shape[1:]), np.nan)
        every[rows] = values
        return every

    extrapolates = np.full(blank.shape, "", dtype="<U32")
    extrapolates[rows] = words
    new_map = StiffnessMap(
        model_name=model.name,
        robot=robot,
        plane=plane,
        quantity=quantity,
        axis=axis,
        load=np.zeros(6) if task.load is None else task.load,
        load_frame=frame,
        positions=positions,
        tool_angles_deg=angles,
        q=q,
        deflections=over_plane(vectors) if quantity == "deflection" else None,
        compliance=over_plane(vectors) if quantity == "compliance" else None,
        values=over_plane(_component(vectors, axis, rotation_of(angles))),
        blank=blank,
        extrapolates=extrapolates,
        joint_compliance=springs,
    )
    if text := extrapolation_warning(training_range, robot, q[rows], loads, words):
        warn(f"{text}; see the column extrapolates")
    for file in files:
        if file.suffix.lower() in METADATA:
            new_map.plot().save(file)
        else:
            write_table(file, [new_map.frame()])
    return new_map


def _component(vectors: FloatArray, axis: str | None, orientation: FloatArray) -> FloatArray:
    """Return the (n,) mapped quantity of (n, 3) deflections or (n, 3, 3) compliances.

    Args:
        vectors: m or m/N, base frame.
        axis: of `MAP_AXES`; None: the length, or the largest principal compliance.
        orientation: (3, 3) of the tool frame in the base frame.
    """
    is_deflection = vectors.ndim == 2
    if axis is None:
        lengths = np.linalg.norm(vectors, axis=1) if is_deflection else largest_compliance(vectors)
        return np.asarray(lengths)
    along = np.column_stack([np.eye(3), orientation[:, 2]])[:, MAP_AXES.index(axis)]
    values = vectors @ along
    return np.asarray(values if is_deflection else values @ along)


def _place_text(plane: str, positions: FloatArray, angles: FloatArray) -> str:
    first, second, normal = PLANES[plane]
    points = positions.reshape(-1, 3) * MM + 0.0
    ends = ", ".join(
        f"{AXES[axis]} {points[:, axis].min():.0f} to {points[:, axis].max():.0f}"
        for axis in (first, second)
    )
    n_rows, n_columns = positions.shape[:2]
    return (
        f"{plane} at {AXES[normal]} = {points[0, normal]:.0f} mm, {ends} mm, "
        f"{n_columns} x {n_rows} points; tool a, b, c = {_numbers(angles)} deg"
    )


def _blank_text(blank: TextArray) -> str:
    counts = {reason: int((blank == reason).sum()) for reason in BLANK_REASONS}
    return ", ".join(f"{n:,} {reason}" for reason, n in counts.items() if n) or "none"


def _check_extensions(files: Sequence[Path]) -> None:
    """Check that files to write differ and have a known extension."""
    valid = (".csv", PARQUET, *METADATA)
    for file in files:
        if file.suffix.lower() not in valid:
            raise unsupported_extension(file, valid, "output")
    if len({file.resolve() for file in files}) < len(files):
        raise ConfigError(f"{files[0]} is also the output; give another name", "figure")


def _tool_angles(orientation: Sequence[float] | str, task: ToolTask) -> FloatArray:
    """Return the (3,) angles a, b, c [deg] of the tool frame in the base frame.

    For "down" they are the angles nearest to the training poses.
    """
    valid = f"{DOWN}, or a,b,c in deg"
    if not isinstance(orientation, str):
        if len(orientation) != 3:
            raise ConfigError(f"has {len(orientation)} numbers (valid: {valid})", "orientation")
        return frozen_array(orientation, "orientation", (3,))
    if orientation != DOWN:
        raise ConfigError(f"{orientation!r} (valid: {valid})", "orientation")
    poses = task.robot.forward(task.model.training_range.poses)
    training = (poses.rotation @ task.tool[:3, :3]).sum(axis=0)
    closeness = [round(float((training * rotation_of(angles)).sum()), 9) for angles in DOWN_DEG]
    return np.array(DOWN_DEG[int(np.argmax(closeness))])


def rotation_of(angles: Sequence[float] | FloatArray) -> FloatArray:
    """Return the (3, 3) rotation of KUKA's angles a, b, c [deg]."""
    return frame_matrix((0.0, 0.0, 0.0, *angles))[:3, :3]


def _box(box: Sequence[float], plane: str) -> FloatArray:
    """Return the (3, 2) ends of a box along x, y and z, m."""
    valid = "x0,x1,y0,y1,z0,z1 in mm, each end at least the one before"
    if len(box) != 6:
        raise ConfigError(f"has {len(box)} numbers (valid: {valid})", "box")
    ends = frozen_array(box, "box", (6,)).reshape(3, 2)
    text = ",".join(f"{end:g}" for end in box)
    if (ends[:, 0] > ends[:, 1]).any() or np.abs(ends).max() > LARGEST_MM:
        raise ConfigError(f"{text} (valid: {valid}, up to {LARGEST_MM:g} mm)", "box")
    if not np.ptp(ends[[*PLANES[plane][:2]]], axis=1).any():
        raise ConfigError(f"{text} has no extent in the plane {plane} (valid: {valid})", "box")
    return ends / MM_PER_M


def _level(at: float | None, region: FloatArray | None, plane: str, task: ToolTask) -> float:
    """Return the place of the plane on its normal, m."""
    normal = PLANES[plane][2]
    if at is not None:
        if not abs(at) <= LARGEST_MM:
            raise ConfigError(f"{at} (valid: a number up to {LARGEST_MM:.0f} mm)", "at")
        return at / MM_PER_M
    if region is not None:
        return float(region[normal].mean())
    training = task.robot.tcp_position(task.model.training_range.poses)[:, normal]
    return float(np.rint(np.median(training) / LEVEL_M) * LEVEL_M)


def _numbers(values: FloatArray) -> str:
    """Return numbers with commas between, such as "0, 0, -100"."""
    return ", ".join(f"{value:.4g}" for value in values + 0.0)
