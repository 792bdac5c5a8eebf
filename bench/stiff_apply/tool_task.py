"""A task of the tool for a fitted model: tool, load, held joints and start, checked once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from stiff_apply.rotations import euler_rotations
from stiff_bench.api.model import Model
from stiff_bench.tables.picture_file import check_suffix
from stiff_datasets.measured.sample_columns import MAX_NUMBER, MM_PER_M, file_units
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.types import FloatArray, frozen_array
from stiff_protocols.paths.inverse import held_position, joint_number

LoadFrame = Literal["base", "tool"]
LOAD_VALUES = "fx,fy,fz in N, or fx,fy,fz,tx,ty,tz in N and N m"
TCP_TOLERANCE_M = 1e-5


@dataclass(frozen=True, eq=False)
class ToolTask:
    """The tool of a fitted model and its robot, with the load.

    Attributes:
        model: fitted model.
        robot: robot of the model.
        tool: (4, 4) tool frame in the last joint's frame, m.
        load: (6,) N and N m at the TCP, in `frame`; None: not given.
        frame: frame in which the load is constant while the tool turns.
        hold: position of each held joint, deg or mm, by name or number; None: as in the start.
        start: (n_joints,) joint positions, rad or m; None: not given.
    """

    model: Model
    robot: Robot
    tool: FloatArray
    load: FloatArray | None
    frame: LoadFrame
    hold: Mapping[str, float | None]
    start: FloatArray | None

    @property
    def near(self) -> FloatArray:
        """Return the (n_joints,) middle of the training poses, rad or m."""
        return self.model.training_range.middle

    def held(self, positions: FloatArray | None = None) -> FloatArray:
        """Return `held_positions`; without a value they have the (n_joints,) positions given."""
        return held_positions(self.robot, self.hold, positions)

    def in_base(self, wrench: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return (n, 6) loads in the base frame.

        Args:
            wrench: (6,) or (n, 6) N and N m, in `frame`.
            rotation: (n, 3, 3) orientations of the last joint's frame.
        """
        n = len(rotation)
        axes = (
            rotation @ self.tool[:3, :3] if self.frame == "tool" else np.tile(np.eye(3), (n, 1, 1))
        )
        parts = np.broadcast_to(wrench, (n, 6)).reshape(n, 2, 3)
        return np.asarray(np.einsum("nij,nkj->nki", axes, parts).reshape(n, 6))


def tool_task(
    model: Model,
    *,
    tool: Sequence[float] | None = None,
    load: Sequence[float] | None = None,
    frame: LoadFrame = "base",
    hold: Mapping[str, float | None] | None = None,
    start: Sequence[float] | None = None,
    start_option: str = "start",
    coverage: float | None = None,
    files: Sequence[Path | str | None] = (),
    figure: Path | str | None = None,
) -> ToolTask:
    """Check what the functions of this package have in common, and return the task.

    Args:
        model: fitted model.
        tool: see `tool_of`.
        load: see `six_numbers`.
        frame: frame of the load.
        hold: see `held_positions`.
        start: see `given_positions`.
        start_option: name of its option.
        coverage: coverage of intervals.
        files: files to write; they must be new.
        figure: picture to write.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong.
        StoreError: a file exists.
    """
    check_word("frame", frame, ("base", "tool"))
    model.check_fitted()
    if figure is not None:
        check_suffix(Path(figure))
    for file in (*files, figure):
        if file is not None:
            check_new_file(Path(file))
    model.check_coverage(coverage)
    robot: Robot = model.fitted.robot_
    return ToolTask(
        model,
        robot,
        tool_of(robot, tool),
        None if load is None else six_numbers(load),
        frame,
        hold or {},
        None if start is None else given_positions(robot, start, start_option),
    )


def check_word(option: str, word: str | None, valid: Sequence[str | None]) -> None:
    """Raise ConfigError for a word that is not among the valid ones of an option."""
    if word not in valid:
        raise unknown_name(option, str(word), [str(name) for name in valid])


def frame_matrix(numbers: Sequence[float]) -> FloatArray:
    """Return the (4, 4) pose, m, of x, y, z [mm], a, b, c [deg]."""
    pose_numbers, pose = frozen_array(numbers, "x,y,z,a,b,c of a frame", (6,)), np.eye(4)
    pose[:3, 3] = pose_numbers[:3] / MM_PER_M
    (pose[:3, :3],) = euler_rotations("ZYX", pose_numbers[None, 3:])
    return pose


def six_numbers(load: Sequence[float]) -> FloatArray:
    """Return a load of three forces, or of forces and torques, as (6,) N and N m.

    Raises:
        ConfigError: it has another length, or a number is too large or NaN.
    """
    if len(load) not in (3, 6):
        raise ConfigError(f"has {len(load)} numbers (valid: {LOAD_VALUES})", "load")
    for number in load:
        if not abs(number) <= MAX_NUMBER:  # neither is nan
            valid = f"numbers within +-{MAX_NUMBER:g} N and N m"
            raise ConfigError(f"{number:g}: not a valid load (valid: {valid})", "load")
    return np.array((*load, 0.0, 0.0, 0.0)[:6], dtype=np.float64)


def tool_of(robot: Robot, tool: Sequence[float] | None) -> FloatArray:
    """Return the (4, 4) tool frame in the last joint's frame, m.

    Args:
        robot: robot of the model, with its TCP.
        tool: x, y, z [mm], a, b, c [deg] in the frame of the robot description's last link; None:
            the robot's TCP with the orientation of the last link.

    Raises:
        ConfigError: the tool's point is not the robot's TCP, where a model predicts deflections.
    """
    pose = np.eye(4)
    pose[:3, 3] = robot.tcp_on_flange
    if tool is not None:
        pose = frame_matrix(tool)
        if np.abs(pose[:3, 3] - robot.tcp_on_flange).max() > TCP_TOLERANCE_M:
            tcp = ",".join(f"{number:g}" for number in robot.tcp_on_flange * MM_PER_M)
            raise ConfigError(
                f"x,y,z of {','.join(f'{number:g}' for number in tool)} is not the TCP at "
                f"which the model predicts deflections of {robot.name} (valid: {tcp} mm; for "
                "another tool, fit a model with its --tcp)",
                "tool",
            )
    return np.asarray(robot.flange @ pose)


def held_positions(
    robot: Robot, hold: Mapping[str, float | None], path_positions: FloatArray | None = None
) -> FloatArray:
    """Return (n_joints,) positions of held joints, rad or m, NaN for the others.

    Args:
        robot: robot with these joints.
        hold: deg or mm by joint name or number; None: the value from `path_positions`.
        path_positions: (n_joints,) rad or m.

    Raises:
        ConfigError: the free joints of a larger robot are not six, a joint is unknown, or a value
            is missing or beyond the joint's limits.
    """
    held = np.full(robot.n_joints, np.nan)
    try:
        numbers = {name: joint_number(robot.joint_names, name) for name in hold}
    except ConfigError as error:
        raise ConfigError(str(error), "hold") from error
    spare = max(robot.n_joints - 6, 0)
    if hold and not spare:
        raise ConfigError(f"{', '.join(hold)}: {robot.name} has no joint to hold", "hold")
    if not len({*numbers.values()}) == len(hold) == spare:
        pairs = zip(robot.joint_names, robot.turns, strict=True)
        joints = ", ".join(f"{name} [{'deg' if turns else 'mm'}]" for name, turns in pairs)
        raise ConfigError(
            f"{', '.join(hold) or 'none'} (valid: {spare} of {joints}, each once as JOINT=VALUE; "
            f"a pose of the tool determines the other joints of {robot.name})",
            "hold",
        )
    for name, number in numbers.items():
        if hold[name] is None and path_positions is not None:
            held[number] = path_positions[number]
        else:
            limits = float(robot.lower[number]), float(robot.upper[number])
            held[number] = held_position(name, hold[name], robot.turns[number], *limits)
    return held


def given_positions(robot: Robot, positions: Sequence[float], option: str) -> FloatArray:
    """Return the (n_joints,) joint positions, rad or m, of an option in deg or mm."""
    if len(positions) != robot.n_joints:
        raise ConfigError(
            f"{len(positions)} joint positions (valid: the {robot.n_joints} of {robot.name})",
            option,
        )
    return np.asarray(positions, dtype=np.float64) / file_units(robot)
