"""Robots made for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiff_protocols.contract.types import FloatArray, JointType, Robot


def chain(name: str, kinds: Sequence[JointType], placements: FloatArray, **fields: Any) -> Robot:
    """Return a robot without masses, with limits of 3 rad unless `fields` has others."""
    n = len(kinds)
    usual = {
        "joint_names": tuple(f"j{i + 1}" for i in range(n)),
        "lower": np.full(n, -3.0),
        "upper": np.full(n, 3.0),
        "masses": np.zeros(n),
        "centres_of_mass": np.zeros((n, 3)),
    }
    about = {"name": name, "joint_types": tuple(kinds), "placements": placements}
    return Robot(**(usual | about | fields))


def random_chain(rng: np.random.Generator, kinds: tuple[JointType, ...]) -> Robot:
    """Return a chain with joints of these kinds, random axes and offsets."""
    n = len(kinds)
    placements = np.tile(np.eye(4), (n, 1, 1))
    placements[:, :3, 3] = rng.normal(size=(n, 3))
    placements[:, :3, :3] = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)]
    placements[:, :3, :3] *= np.linalg.det(placements[:, :3, :3])[:, None, None]
    axes = rng.normal(size=(n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return chain("chain", kinds, placements, axes=axes, tcp=rng.normal(size=3))


def planar_arm(n_joints: int, axis: tuple[float, float, float], mass: float = 0.0) -> Robot:
    """Return links of 1 m along x that turn about `axis`, with the mass [kg] at the ends."""
    placements = np.tile(np.eye(4), (n_joints, 1, 1))
    placements[1:, 0, 3] = 1.0
    along = np.array([1.0, 0.0, 0.0])
    return chain(
        "planar",
        ("revolute",) * n_joints,
        placements,
        axes=np.tile(axis, (n_joints, 1)),
        lower=np.full(n_joints, -np.pi),
        upper=np.full(n_joints, np.pi),
        masses=np.full(n_joints, mass),
        centres_of_mass=np.tile(along, (n_joints, 1)),
        tcp=along,
    )


def seven_joint_arm() -> Robot:
    """Return an arm with the lengths of a KUKA LBR iiwa 7 and a marker off its flange."""
    n = 7
    placements = np.tile(np.eye(4), (n, 1, 1))
    placements[:, 2, 3] = (0.15, 0.19, 0.21, 0.19, 0.21, 0.19, 0.081)
    along, across = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    limits = np.deg2rad([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
    return chain(
        "seven",
        ("revolute",) * n,
        placements,
        joint_names=tuple(f"J{i + 1}" for i in range(n)),
        axes=np.array([along, across, along, across, along, across, along]),
        lower=-limits,
        upper=limits,
        masses=np.full(n, 3.0),
        tcp=np.array([0.05, 0.02, 0.12]),
    )


LIMITS = {"revolute": (-2.0, 2.0), "prismatic": (0.0, 0.04)}
INERTIA = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'


def tree_urdf(path: Path, joints: str) -> Path:
    """Write a URDF whose joints are lines "parent child type", with options.

    These are `x=`, `y=`, `z=` (m; of a moving joint z=0.2), `axis=` (x, y or z, the default),
    `limits=low..high` and `mimic=JOINT` with `multiplier=` and `offset=`. Joints are called
    to_CHILD, links have 1 kg.
    """
    parts, links = [], dict.fromkeys(["base"])
    for line in filter(None, map(str.strip, joints.splitlines())):
        parent, child, kind, *words = line.split()
        given = dict(word.split("=") for word in words)
        links |= dict.fromkeys([parent, child])
        moves = kind != "fixed"
        xyz = [given.get(k, "0.2" if k == "z" and moves else "0") for k in "xyz"]
        axis = " ".join(str(int(k == given.get("axis", "z"))) for k in "xyz")
        low, high = given["limits"].split("..") if "limits" in given else LIMITS.get(kind, (0, 0))
        limit = f'<limit lower="{low}" upper="{high}" effort="9" velocity="9"/>'
        rule = {"joint": given.get("mimic")} | {
            key: given[key] for key in ("multiplier", "offset") if key in given
        }
        words = [f'{key}="{value}"' for key, value in rule.items()]
        mimic = f"<mimic {' '.join(words)}/>" if "mimic" in given else ""
        parts.append(
            f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{" ".join(xyz)}"/><axis xyz="{axis}"/>'
            f"{limit if kind in LIMITS else ''}{mimic}</joint>"
        )
    bodies = [
        f'<link name="{name}"><inertial><mass value="1"/>{INERTIA}</inertial></link>'
        for name in links
    ]
    path.write_text(f'<robot name="{path.stem}">{"".join(bodies + parts)}</robot>')
    return path


def arm_lines(root: str, name: str, n_joints: int) -> str:
    """Lines of `tree_urdf` for an arm NAME1..n whose axes are z, y, y, x, y, x, z."""
    links = [root, *(f"{name}{i + 1}" for i in range(n_joints))]
    place = {"x": "x=0.3 z=0", "y": "z=0.3", "z": "z=0.2"}
    return "\n".join(
        f"{links[i]} {links[i + 1]} revolute axis={axis} {place[axis]}"
        for i, axis in enumerate("zyyxyxz"[:n_joints])
    )


def gripper_lines(palm: str) -> str:
    """Lines of `tree_urdf` for a hand with a frame between its fingers, one of which mimics."""
    return f"""
        {palm} hand fixed z=0.1
        hand hand_tcp fixed z=0.1
        hand left prismatic axis=y
        hand right prismatic axis=y mimic=to_left
    """


def track_lines(n_joints: int = 6) -> str:
    """Lines of `tree_urdf` for an arm on a track of 4 m along x."""
    slide = "base cart prismatic axis=x z=0.3 limits=0..4"
    return f"{slide}\n{arm_lines('cart', 'a', n_joints)}"
