"""Convert a controller's numbers to a robot's poses and joint positions, and back.

A target is a pose of the tool frame in a base frame. A model's robot has the pose of its last
joint's frame in the description's base frame, and a point of the tool, the TCP.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_apply.programs.program_file import Frame, Language, RobotProgram
from stiff_protocols.contract.controller import Controller
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.types import FloatArray, Robot

TCP_TOLERANCE_M = 1e-4
"""m between a program's tool centre point and the model's; controllers round to 0.001 mm."""


@dataclass(frozen=True, eq=False)
class ProgramPoses:
    """Targets as a robot's poses.

    Attributes:
        position: (n, 3) TCP, description's base frame, m; NaN for joint angles.
        rotation: (n, 3, 3) orientation of the last joint's frame; NaN for joint angles.
        q: (n, n_joints) joint positions of the description, rad or m; NaN for poses.
        bases: (n_frames, 4, 4) the program's base frames in the description's base frame, m.
        tools: (n_frames, 4, 4) its tool frames in the last joint's frame, m.
    """

    position: FloatArray
    rotation: FloatArray
    q: FloatArray
    bases: FloatArray
    tools: FloatArray


def controller_of(robot: Robot) -> Controller:
    """Return the conventions of a robot's controller; the default is the description's."""
    return robot.controller or Controller.same_as_description(robot.n_joints)


def frame_pose(frame: Frame, language: Language) -> FloatArray:
    """Return the (4, 4) pose of a program's frame, m."""
    pose, values = np.eye(4), np.array([frame.values])
    pose[:3, 3] = values[0, :3] * language.metres
    (pose[:3, :3],) = language.to_rotations(values[:, 3 : 3 + language.n_turns])
    return pose


def program_poses(
    program: RobotProgram,
    robot: Robot,
    *,
    tool: FloatArray | None = None,
    workpiece: FloatArray | None = None,
) -> ProgramPoses:
    """Return a program's targets as poses and joint positions of a robot.

    Args:
        program: the targets.
        robot: robot of the model.
        tool: (4, 4) tool in the controller's flange frame, m, for programs without this frame.
        workpiece: (4, 4) base frame in the controller's world frame, m, likewise.

    Raises:
        ConfigError: a frame is needed and not given, or given although the program contains it.
        DataError: the program's tool is not the model's, or the joints differ.
    """
    controller, language, n = controller_of(robot), program.language, len(program)
    bases, tools = _frames(program, tool, workpiece)
    flange = robot.flange @ controller.flange  # the controller's flange in the last joint's frame
    lever = np.linalg.inv(flange) @ np.r_[robot.tcp, 1.0]
    used = {*program.frame_index.tolist()}
    for index in used:
        tcp_distance = np.abs(tools[index][:3, 3] - lever[:3]).max()
        if tcp_distance > TCP_TOLERANCE_M:
            row = int(np.argmax(program.frame_index == index))
            text = ",".join(f"{number:g}" for number in (tools[index][:3, 3] * 1e3).round(3) + 0.0)
            valid = ",".join(f"{number:g}" for number in (lever[:3] * 1e3).round(3) + 0.0)
            raise DataError(
                f"{program.place(row)}: tool {program.frames[index][1].name} has its TCP at {text} "
                f"mm in the flange frame (valid: {valid} mm, the TCP at which the model predicts "
                f"deflections of {robot.name}; for another tool, fit a model with its --tcp)"
            )
    base_frames = np.stack([controller.world @ pose for pose in bases])
    tool_frames = np.stack([flange @ pose for pose in tools])
    position, rotation = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    q = np.full((n, robot.n_joints), np.nan)
    poses, joints = np.flatnonzero(~program.has_joints), np.flatnonzero(program.has_joints)
    if len(joints):
        if (
            robot.n_joints > program.values.shape[1]
            or np.isnan(program.values[joints, : robot.n_joints]).any()
        ):
            raise DataError(
                f"{program.place(joints[0])}: not the {robot.n_joints} joint angles of {robot.name}"
            )
        angles = program.values[joints, : robot.n_joints] * language.radians
        q[joints] = controller.to_description(angles)
    if len(poses):
        values, index = program.values[poses], program.frame_index[poses]
        lengths, turns = values[:, :3] * language.metres, values[:, 3 : 3 + language.n_turns]
        turn, tool_turn = base_frames[index, :3, :3], tool_frames[index, :3, :3]
        position[poses] = np.einsum("nij,nj->ni", turn, lengths) + base_frames[index, :3, 3]
        rotation[poses] = turn @ language.to_rotations(turns) @ tool_turn.transpose(0, 2, 1)
    return ProgramPoses(position, rotation, q, base_frames, tool_frames)


def lengths_in_base(language: Language, base: FloatArray, position: FloatArray) -> FloatArray:
    """Return (n, 3) positions in the program's base frame and unit.

    Args:
        language: language of the program.
        base: (n, 4, 4) base frames in the description's base frame, m.
        position: (n, 3) TCP, description's base frame, m.
    """
    turn = base[:, :3, :3].transpose(0, 2, 1)
    lengths = np.einsum("nij,nj->ni", turn, position - base[:, :3, 3])
    return np.asarray(lengths / language.metres)


def _frames(
    program: RobotProgram, tool: FloatArray | None, workpiece: FloatArray | None
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the (4, 4) base and tool of each pair of frames, m."""
    poses = []
    for side, (option, given_frame, frame_name) in enumerate(
        (("workpiece", workpiece, "base frame"), ("tool", tool, "tool frame"))
    ):
        side_poses, unknown = [], dict[str, int]()
        for index, pair in enumerate(program.frames):
            frame, rows = pair[side], program.frame_index == index
            rows = rows if side else rows & ~program.has_joints  # joint angles need no base
            if frame.values or not rows.any():
                values = frame_pose(frame, program.language) if frame.values else np.eye(4)
                side_poses.append(values)
                continue
            unknown.setdefault(frame.name, int(np.argmax(rows)))
            side_poses.append(np.eye(4) if given_frame is None else given_frame)
        if unknown and given_frame is None:
            name, row = next(iter(unknown.items()))
            raise ConfigError(
                f"{program.place(row)}: the program does not hold the {frame_name} {name} (valid: "
                "x,y,z,a,b,c in mm and deg, KUKA's angles)",
                option,
            )
        if len(unknown) > 1:
            (first, _), (second, row) = [*unknown.items()][:2]
            raise ConfigError(
                f"{program.place(row)}: {second} is another {frame_name} than {first} before "
                "(valid: one frame that the program does not hold)",
                option,
            )
        if given_frame is not None and not unknown:
            raise ConfigError(
                f"the program holds its {frame_name} {program.frames[0][side].name} "
                f"(valid: no {option})",
                option,
            )
        poses.append(side_poses)
    return poses[0], poses[1]
