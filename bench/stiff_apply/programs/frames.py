"""Convert a controller's numbers to a robot's poses and joint positions, and back.

A target is a pose of the tool frame in a base frame. A model's robot has the pose of its last
joint's frame in the description's base frame, and a point of the tool, the TCP.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stiff_apply.programs.flow import Frame
from stiff_apply.programs.program import Language, RobotProgram
from stiff_protocols.contract.controller import Controller
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.types import FloatArray, Robot, TextArray

TCP_TOLERANCE_M = 1e-4
"""m between a program's tool centre point and the model's; controllers round to 0.001 mm."""
UNSET = ("$BASE", "$TOOL", "set_tcp", "UF[F]", "UT[F]")
"""Names of frames that a program uses before it sets them."""
Frames = Mapping[str, FloatArray]
"""Number or name of a frame, "" for the only one that a program does not hold -> (4, 4) pose, m."""


@dataclass(frozen=True, eq=False)
class ProgramPoses:
    """Targets as a robot's poses.

    Attributes:
        position: (n, 3) TCP of the program, description's base frame, m; NaN for joint angles.
        rotation: (n, 3, 3) orientation of the last joint's frame; NaN for joint angles.
        q: (n, n_joints) joint positions of the description, rad or m; NaN for poses.
        bases: (n_frames, 4, 4) the program's base frames in the description's base frame, m; NaN
            for frames that are not known.
        tools: (n_frames, 4, 4) its tool frames in the last joint's frame, m; likewise.
        problem: (n,) why the pose is not known; "" if it is.
    """

    position: FloatArray
    rotation: FloatArray
    q: FloatArray
    bases: FloatArray
    tools: FloatArray
    problem: TextArray

    def points(self, robot: Robot) -> FloatArray:
        """Return (n_frames, 3) TCPs in the last joint's frame, m; the robot's if they are equal."""
        points = self.tools[:, :3, 3]
        is_same = np.abs(points - robot.tcp).max(axis=1) <= TCP_TOLERANCE_M
        return np.where(is_same[:, None], robot.tcp, points)


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
    program: RobotProgram, robot: Robot, *, tools: Frames, workpieces: Frames
) -> ProgramPoses:
    """Return a program's targets as poses and joint positions of a robot.

    Args:
        program: the targets.
        robot: robot of the model.
        tools: tool frames in the controller's flange frame, for frames not in the program.
        workpieces: base frames in the controller's world frame, likewise.

    Raises:
        ConfigError: a given frame is not used, or one frame is given for several.
        DataError: the joints of robot and program differ.
    """
    controller, language, n = controller_of(robot), program.language, len(program)
    problem = np.full(n, "", dtype=object)
    bases = _poses(program, 0, "workpiece", workpieces, problem)
    tool_poses = _poses(program, 1, "tool", tools, problem)
    flange = robot.flange @ controller.flange  # the controller's flange in the last joint's frame
    base_frames, tool_frames = controller.world @ bases, flange @ tool_poses
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
    return ProgramPoses(position, rotation, q, base_frames, tool_frames, problem.astype(str))


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


def _poses(
    program: RobotProgram, side: int, option: str, given: Frames, problem: TextArray
) -> FloatArray:
    """Return (n_frames, 4, 4) bases (side 0) or tools (1), m; note the problems of targets."""
    poses = np.full((len(program.frames), 4, 4), np.nan)
    used, plain, held = set[str](), dict[str, int](), ""
    is_only_unset = all(
        pair[side].values or pair[side].name in UNSET
        for index, pair in enumerate(program.frames)
        if (side or not program.has_joints[program.frame_index == index].all())
    )
    for index, pair in enumerate(program.frames):
        frame, rows = pair[side], program.frame_index == index
        if side == 0:
            rows &= ~program.has_joints  # joint angles need no base
        number = re.search(r"\[(\d+)\]", frame.name)
        names = [frame.name, frame.name.lower(), frame.name.lstrip("$")]
        names += [number[1]] if number else []
        takes_plain = "" in given and (is_only_unset or frame.name not in UNSET)
        name = next((name for name in names if name in given), "" if takes_plain else None)
        if frame.values:
            poses[index] = frame_pose(frame, program.language)
            held = held or frame.name
        elif name is not None:
            poses[index] = given[name]
            used |= {name} if rows.any() else set()
            if name == "" and rows.any():
                plain.setdefault(frame.name, int(np.argmax(rows)))
        elif rows.any():
            key = number[1] if number else frame.name.lstrip("$")
            problem[rows & (problem == "")] = (
                f"{frame.name} is not set before (give --{option} {key}=x,y,z,a,b,c)"
                if frame.name in UNSET
                else f"{frame.name} is in the controller (give --{option} {key}=x,y,z,a,b,c)"
            )
    if len(plain) > 1:
        (first, _), (second, row) = [*plain.items()][:2]
        raise ConfigError(
            f"{program.place(row)}: {second} is another frame than {first} before (valid: "
            "NAME=x,y,z,a,b,c for each)",
            option,
        )
    if (unused := given.keys() - used) and not any(program.reasons):
        name = min(unused)
        cause = f"the program holds {held}" if held else "no target needs this frame"
        raise ConfigError(f"{name or 'x,y,z,a,b,c'}: {cause} (valid: no {option})", option)
    return poses
