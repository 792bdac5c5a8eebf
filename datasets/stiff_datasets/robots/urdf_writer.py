"""Write a robot as a URDF file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

import numpy as np

from stiff_datasets.robots.shipped_robots import ShippedRobot
from stiff_datasets.robots.urdf_reader import roll_pitch_yaw
from stiff_protocols.contract.types import FloatArray, Robot
from stiff_protocols.springs.identification import IdentifiedSprings

MAX_SLIDE_M = 1e6
"""m; limit of a prismatic joint without limits, which a URDF cannot express."""


def shipped_urdf(robot: ShippedRobot) -> str:
    """Return the unchanged file of a shipped robot, with its sources and licence."""
    path = files("stiff_datasets") / "robots" / f"{robot.urdf}.urdf"
    return path.read_text(encoding="utf-8")


def robot_urdf(robot: Robot, springs: IdentifiedSprings | None = None) -> str:
    """Return a robot's chain as URDF: joints, limits, masses and centres of mass.

    Placements read back with rounding errors of 1e-15. Without springs it does not contain the
    TCP, which is `robot.tcp_on_flange` in the frame of the last link ``tip``. The controller and
    the inertias, which models do not use, are omitted.

    Args:
        robot: the robot.
        springs: springs of its joints, named as the joint or with the joint's name before a blank.
            Each is an element ``stiffness`` of its joint, and the TCP is a further link ``tcp``.
    """
    joints = robot.chain_joints
    links = ["base", *(f"link{i + 1}" for i in range(len(joints))), "tip"]
    lines = [f'<robot name="{escape(robot.name)}">']
    weights = [(joint.mass, joint.centre_of_mass) for joint in joints]
    no_weight = (0.0, (0.0, 0.0, 0.0))
    for link, (mass, centre) in zip(links, [no_weight, *weights, no_weight], strict=True):
        lines.append(f'  <link name="{link}"{_inertial(mass, centre)}')
    for i, joint in enumerate(joints):
        kind, master = joint.joint_type, escape(robot.joint_names[joint.master])
        low, high = float(robot.lower[joint.master]), float(robot.upper[joint.master])
        mimic = (
            f'<mimic joint="{master}" multiplier="{joint.multiplier!r}" offset="{joint.offset!r}"/>'
        )
        if joint.name:  # the master has its limits
            low, high = -np.inf, np.inf
        is_free = not np.isfinite([low, high]).all()
        if is_free and kind == "prismatic":
            low, high = max(low, -MAX_SLIDE_M), min(high, MAX_SLIDE_M)
        written_kind = "continuous" if is_free and kind == "revolute" else kind
        limit = f'<limit lower="{low!r}" upper="{high!r}" effort="0" velocity="0"/>'
        lines += [
            f'  <joint name="{escape(joint.name) or master}" type="{written_kind}">',
            f'    <parent link="{links[i]}"/><child link="{links[i + 1]}"/>',
            f"    {_origin(np.array(joint.placement))}",
            f'    <axis xyz="{_numbers(joint.axis)}"/>',
            *([] if written_kind == "continuous" else [f"    {limit}"]),
            *([f"    {mimic}"] if joint.name else []),
            *([] if joint.name or springs is None else _stiffness(robot, springs, joint.master)),
            "  </joint>",
        ]
    lines += [
        '  <joint name="to tip" type="fixed">',
        f'    <parent link="{links[-2]}"/><child link="tip"/>',
        f"    {_origin(robot.flange)}",
        "  </joint>",
    ]
    if springs is not None:
        lever = (robot.tcp - robot.flange[:3, 3]) @ robot.flange[:3, :3]
        lines += [
            '  <link name="tcp"/>',
            '  <joint name="to tcp" type="fixed">',
            '    <parent link="tip"/><child link="tcp"/>',
            f'    <origin xyz="{_numbers(lever)}" rpy="0 0 0"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>"]) + "\n"


def _stiffness(robot: Robot, springs: IdentifiedSprings, joint: int) -> list[str]:
    """Return an element for each spring of a joint; the stiffness of a rigid one is inf."""
    lines = []
    for name, unit, compliance, is_known in zip(
        springs.names, springs.units, springs.compliance, springs.is_identified, strict=True
    ):
        if _joint_of(name, robot.joint_names) == robot.joint_names[joint]:
            stiffness = 1.0 / float(compliance) if compliance else np.inf
            lines.append(
                f'    <stiffness spring="{escape(name)}" value="{stiffness!r}" '
                f'unit="{escape(unit)}" identified="{str(bool(is_known)).lower()}"/>'
            )
    return lines


def _joint_of(spring: str, joint_names: Sequence[str]) -> str:
    """Return the joint of a spring: of joints "A" and "A 1" the second has the spring "A 1 rz"."""
    return max((name for name in joint_names if f"{spring} ".startswith(f"{name} ")), key=len)


def _inertial(mass: float, centre: Iterable[float]) -> str:
    if not mass:
        return "/>"
    inertia = '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'>\n    <inertial><origin xyz="{_numbers(centre)}"/><mass value="{float(mass)!r}"/>'
        f"{inertia}</inertial>\n  </link>"
    )


def _origin(placement: FloatArray) -> str:
    angles = roll_pitch_yaw(placement[:3, :3])
    return f'<origin xyz="{_numbers(placement[:3, 3])}" rpy="{_numbers(angles)}"/>'


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
