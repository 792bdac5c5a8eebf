"""Stiffness maps: the deflection or compliance that a model predicts over the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from stiff_apply.path_file import (
    POSITION_COLUMNS,
    LoadFrame,
    frame_matrix,
    six_numbers,
    tool_of,
)
from stiff_apply.reached_poses import BLANK_REASONS
from stiff_apply.tool_paths import held_positions
from stiff_apply.workspace_grid import PLANES, plane_grid, reach_box, reachable_region
from stiff_apply.workspace_map import (
    MAP_AXES,
    QUANTITIES,
    MappedPoints,
    Quantity,
    WorkspaceTask,
    mapped_points,
)
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
from stiff_bench.tables.picture_file import METADATA, check_suffix
from stiff_bench.tables.units import MM
from stiff_datasets.measured.rows_beyond_training import extrapolation_warning
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.sheet_files import PARQUET, write_table
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    unknown_name,
    unsupported_extension,
    warn,
)
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.screen import Screen, ShownObject
from stiff_protocols.contract.types import (
    AXES,
    BoolArray,
    FloatArray,
    TextArray,
    frozen_array,
)
from stiff_protocols.paths.inverse import JUMP
from stiff_protocols.springs.cartesian_stiffness import cartesian_stiffness

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.figures.prepared_figure import Prepared

Extreme = Literal["stiffest", "softest"]
EXTREMES: tuple[Extreme, ...] = ("stiffest", "softest")
DOWN, DOWN_DEG = "down", tuple((angle, 0.0, 180.0) for angle in (0.0, 90.0, 180.0, -90.0))
"""Word for a tool whose z axis points down, and its possible orientations a, b, c."""
LEVEL_M = 0.01
"""Rounding of the position of a default plane, m."""
LARGEST_MM = 1e5


@dataclass(frozen=True, eq=False, repr=False)
class StiffnessMap(ShownObject):
    """Predicted deflections or compliances over parallel planes of the workspace.

    The arrays have (n_planes, n_rows, n_columns) points: columns run along the plane's first axis,
    rows along its second one.

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
        for axis in (1, 2):
            far = np.abs(np.diff(self.q, axis=axis)).max(axis=-1, initial=0.0) > JUMP
            ends = [(0, 0)] * 3
            ends[axis] = (1, 0)
            jump |= np.pad(far, ends)
            ends[axis] = (0, 1)
            jump |= np.pad(far, ends)
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

    def extreme(self, kind: Extreme, *, near: bool = False) -> tuple[int, int, int]:
        """Return the numbers of plane, row and column of the stiffest or softest point.

        A component counts without its sign. `near` looks only at points that are not far from the
        training poses; at least one point must be left.
        """
        size = np.abs(self.values)
        if near:
            size = np.where(self.is_far, np.nan, size)
        place = np.nanargmin(size) if kind == "stiffest" else np.nanargmax(size)
        plane, row, column = map(int, np.unravel_index(place, size.shape))
        return plane, row, column

    def extremes_text(self, *, near: bool = False) -> str:
        """Return the stiffest and softest points with values and positions."""
        texts = []
        for kind in EXTREMES:
            at = self.extreme(kind, near=near)
            place = ", ".join(f"{length:.0f}" for length in self.positions[at] * MM + 0.0)
            texts.append(f"{kind} {self.values_in_unit[at]:.3g} {self.unit} at ({place}) mm")
        return ", ".join(texts)

    @property
    def answer(self) -> str:
        """Return the stiffest and softest point, and numbers of reachable and far points."""
        reached, far = self.is_reached, self.is_far
        text = (
            f"{self.extremes_text()}; {reached.sum():,} of {reached.size:,} points reachable, "
            f"{far.sum():,} of these far from the training poses"
        )
        if far.any() and (reached & ~far).any():
            text += f"\nnear the training poses: {self.extremes_text(near=True)}"
        return text

    @property
    def report(self) -> str:
        """Return the answer, the mapped quantity and the number of blank points in words."""
        lines = [
            self.answer,
            f"{self.model_name}, robot {self.robot.name}: {self.quantity_text}",
            f"{self.place_text}; blank: {self.blank_text}",
        ]
        return "\n".join(lines)

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
        """Return the planes, their ends and the orientation of the tool in words."""
        first, second, normal = PLANES[self.plane]
        points = self.positions.reshape(-1, 3) * MM
        levels = ", ".join(f"{level:.0f}" for level in self.positions[:, 0, 0, normal] * MM + 0.0)
        ends = [
            f"{AXES[axis]} {points[:, axis].min() + 0.0:.0f} to {points[:, axis].max() + 0.0:.0f}"
            for axis in (first, second)
        ]
        n_planes, n_rows, n_columns = self.blank.shape
        size = f"{n_columns} x {n_rows} points" + " each" * (n_planes > 1)
        tool = f"tool a, b, c = {_numbers(self.tool_angles_deg)} deg"
        return f"{self.plane} at {AXES[normal]} = {levels} mm, {', '.join(ends)} mm, {size}; {tool}"

    @property
    def blank_text(self) -> str:
        """Return the number of blank points by reason in words; "none" for no blank point."""
        counts = {reason: int((self.blank == reason).sum()) for reason in BLANK_REASONS}
        return ", ".join(f"{n:,} {reason}" for reason, n in counts.items() if n) or "none"

    def frame(self) -> DataFrame:
        """Return a row per point: position, joints, value, deflection, in mm and deg."""
        import pandas as pd

        def rows(values: Any) -> Any:
            return values.reshape(-1, *values.shape[self.blank.ndim :])

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
        """Return the picture: the values over each plane, with the arm at the stiffest point."""
        from stiff_apply.figures.stiffness_map import (
            DrawnPlane,
            MapContent,
            MapMark,
            arm_line,
            stiffness_map_picture,
        )

        first, second, normal = PLANES[self.plane]
        values, places = self.values_in_unit, self.positions * MM + 0.0
        planes = [
            DrawnPlane(
                f"{AXES[normal]} = {points[0, 0, normal]:.0f} mm",
                points[0, :, first],
                points[:, 0, second],
                values[number],
                self.is_far[number],
                self.is_jump[number],
            )
            for number, points in enumerate(places)
        ]
        marks: dict[str, MapMark] = {
            kind: MapMark(at[0], places[at][[first, second]], float(values[at]))
            for kind in EXTREMES
            for at in [self.extreme(kind)]
        }
        stiffest, force = self.extreme("stiffest"), self.load[:3]
        if self.load_frame == "tool":
            force = rotation_of(self.tool_angles_deg) @ force
        content = MapContent(
            planes=planes,
            marks=marks,
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

    def view(self) -> Screen:
        """Return a screen with the mapped quantity, its extremes, and reachable and far points."""
        reached, far = self.is_reached, self.is_far
        facts = [
            ("map", self.quantity_text),
            ("plane", self.place_text),
            ("all points", self.extremes_text()),
        ]
        if (reached & ~far).any():
            facts.append(("near training", self.extremes_text(near=True)))
        facts += [
            ("reachable", f"{reached.sum():,} of {reached.size:,} points"),
            ("far", f"{far.sum():,} of these, from the training poses"),
            ("blank", self.blank_text),
        ]
        return Screen(f"Stiffness map of {self.model_name}, robot {self.robot.name}", facts)


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
    model.check_fitted()
    valid_axes = (*MAP_AXES, *[None] * (axis is None))
    for kind, word, valid in (
        ("quantity", quantity, QUANTITIES),
        ("axis", axis, valid_axes),
        ("plane", plane, PLANES),
        ("frame", frame, ("base", "tool")),
    ):
        if word not in valid:
            raise unknown_name(kind, str(word), [str(name) for name in valid])
    files = [Path(file) for file in (output, figure) if file is not None]
    _check_files(files, figure)
    fitted = model.fitted
    robot: Robot = fitted.robot_
    held = held_positions(robot, hold or {})
    springs = fitted.springs_.compliance if type(fitted) is VirtualJointModel else None
    if quantity == "compliance" and springs is None:
        raise ConfigError(f"compliance requires the model vjm, not {model.name}", "quantity")

    training_range, tool_frame = model.training_range, tool_of(robot, tool)[:3, :3]
    angles = _tool_angles(orientation, robot, tool_frame, training_range.poses)
    task = WorkspaceTask(
        robot=robot,
        training_range=training_range,
        predict=model.predict_at_tcp,
        joint_compliance=springs,
        tool=tool_frame,
        orientation=rotation_of(angles),
        load=_load(load, quantity),
        in_tool_frame=frame == "tool",
        quantity=quantity,
        axis=axis,
        held=held,
    )
    region = None if box is None else _box(box, plane)
    levels = _levels(at, region, plane, task)
    with display():
        if region is None:
            reach = reach_box(robot, held)
            region = reachable_region(plane, levels, reach, task.are_reached)
        positions = plane_grid(plane, levels, region, grid)
        mapped = mapped_points(task, positions)
    shape = positions.shape[:-1]
    parts = {key: part.reshape(*shape, *part.shape[1:]) for key, part in vars(mapped).items()}
    vectors = parts.pop("vectors")
    is_deflection = quantity == "deflection"
    new_map = StiffnessMap(
        model_name=model.name,
        robot=robot,
        plane=plane,
        quantity=quantity,
        axis=axis,
        load=task.load,
        load_frame=frame,
        positions=positions,
        tool_angles_deg=angles,
        deflections=vectors if is_deflection else None,
        compliance=None if is_deflection else vectors,
        joint_compliance=springs,
        **parts,
    )
    reached = new_map.is_reached
    if not reached.any():
        hint = "try another --orientation, --at or --box"
        raise DataError(
            f"{robot.name} reaches no point of {new_map.place_text}: {new_map.blank_text} ({hint})"
        )
    _warn_extrapolation(new_map, task, mapped)
    for file in files:
        if file.suffix.lower() in METADATA:
            new_map.plot().save(file)
        else:
            write_table(file, [new_map.frame()])
    return new_map


def _check_files(files: Sequence[Path], figure: Path | str | None) -> None:
    """Check that files to write are new and have a known extension."""
    tables = (".csv", PARQUET)
    for file in files:
        if file.suffix.lower() not in (*tables, *METADATA):
            raise unsupported_extension(file, (*tables, *METADATA), "output")
        check_new_file(file)
    if figure is not None:
        check_suffix(Path(figure))
    if len({file.resolve() for file in files}) < len(files):
        raise ConfigError(f"{files[0]} is also the output; give another name", "figure")


def _load(load: Sequence[float] | None, quantity: Quantity) -> FloatArray:
    """Return the (6,) load, N and N m, from three or six numbers."""
    valid = "fx,fy,fz in N, or fx,fy,fz,tx,ty,tz in N and N m"
    if load is None:
        if quantity == "deflection":
            raise ConfigError(f"is missing: give {valid}, or quantity compliance", "load")
        return np.zeros(6)
    wrench = np.array(six_numbers(load))
    if quantity == "deflection" and not wrench.any():
        raise ConfigError(f"is zero, and so is every deflection (valid: {valid})", "load")
    return wrench


def _tool_angles(
    orientation: Sequence[float] | str, robot: Robot, tool: FloatArray, training_q: FloatArray
) -> FloatArray:
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
    training = (robot.forward(training_q).rotation @ tool).sum(axis=0)
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


def _levels(
    at: float | None, region: FloatArray | None, plane: str, task: WorkspaceTask
) -> FloatArray:
    """Return the (1,) position of the plane on its normal, m."""
    normal = PLANES[plane][2]
    if at is not None:
        if not abs(at) <= LARGEST_MM:
            raise ConfigError(f"{at} (valid: a number up to {LARGEST_MM:.0f} mm)", "at")
        return np.array([at / MM_PER_M])
    if region is not None:
        return np.array([region[normal].mean()])
    training = task.robot.tcp_position(task.training_range.poses)[:, normal]
    return np.array([np.rint(np.median(training) / LEVEL_M) * LEVEL_M])


def _warn_extrapolation(new_map: StiffnessMap, task: WorkspaceTask, mapped: MappedPoints) -> None:
    """Warn about points far from the training samples, with numbers."""
    rows = mapped.blank == ""
    wrench = np.tile(task.wrench, (int(rows.sum()), 1))
    words = mapped.extrapolates[rows].tolist()
    text = extrapolation_warning(task.training_range, new_map.robot, mapped.q[rows], wrench, words)
    if text:
        message = f"{text}; see the column extrapolates"
        warn(message, stacklevel=3)


def _numbers(values: FloatArray) -> str:
    """Return numbers with commas between, such as "0, 0, -100"."""
    return ", ".join(f"{value:.4g}" for value in values + 0.0)
