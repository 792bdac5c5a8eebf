"""Robot programs for tests: the programs of the docs, and others written from poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

DOCS = Path(__file__).parents[2] / "docs/assets/programs"
FILES = ("pocket.src", "pocket.mod", "pocket.ls", "pocket.script")
ROBOTS = dict(zip(FILES, ("kr10-r1100-2", "irb120-3-06", "lr-mate-200id", "ur5"), strict=True))
EXTERNAL = "[9E9,9E9,9E9,9E9,9E9,9E9]"


def program_of_poses(suffix: str, tool, position_mm, rotation) -> str:
    """Return a program of point-to-point motions to poses in the world frame.

    Args:
        suffix: of the language.
        tool: (3,) TCP in the controller's flange frame, mm.
        position_mm: (n, 3).
        rotation: (n, 3, 3) of the tool frame.
    """
    turns = Rotation.from_matrix(rotation)
    x, y, z = tool
    if suffix == ".src":
        head = "DEF all()\n$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\n"
        head += f"$TOOL={{X {x:.6f},Y {y:.6f},Z {z:.6f},A 0,B 0,C 0}}\n"
        rows = np.hstack([position_mm, turns.as_euler("ZYX", degrees=True)])
        line = "PTP {{X {:.6f},Y {:.6f},Z {:.6f},A {:.6f},B {:.6f},C {:.6f}}}\n"
        return head + "".join(line.format(*row) for row in rows) + "END\n"
    if suffix == ".mod":
        head = f"MODULE All\nPERS tooldata t1:=[TRUE,[[{x:.6f},{y:.6f},{z:.6f}],[1,0,0,0]],"
        head += "[1,[0,0,1],[1,0,0,0],0,0,0]];\nPROC main()\nConfJ\\Off;\n"
        rows = np.hstack([position_mm, turns.as_quat(scalar_first=True)])
        line = "MoveJ [[{:.6f},{:.6f},{:.6f}],[{:.9f},{:.9f},{:.9f},{:.9f}],[0,0,0,0],"
        line += EXTERNAL + "],v100,fine,t1;\n"
        return head + "".join(line.format(*row) for row in rows) + "ENDPROC\nENDMODULE\n"
    if suffix == ".ls":
        rows = np.hstack([position_mm, turns.as_euler("xyz", degrees=True)])
        body = "".join(f"{i + 1:4}:J P[{i + 1}] 50% FINE    ;\n" for i in range(len(rows)))
        line = "P[{}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\n\tX = {:.6f}  mm,\tY = {:.6f}  mm,\t"
        line += "Z = {:.6f}  mm,\n\tW = {:.6f} deg,\tP = {:.6f} deg,\tR = {:.6f} deg\n}};\n"
        blocks = "".join(line.format(i + 1, *row) for i, row in enumerate(rows))
        return f"/PROG  ALL\n/ATTR\n/MN\n{body}/POS\n{blocks}/END\n"
    rows = np.hstack([position_mm / 1000.0, turns.as_rotvec()])
    head = f"def all():\n  set_tcp(p[{x / 1e3:.9f}, {y / 1e3:.9f}, {z / 1e3:.9f}, 0, 0, 0])\n"
    line = "  movej(p[{:.9f}, {:.9f}, {:.9f}, {:.9f}, {:.9f}, {:.9f}], a=1.4)\n"
    return head + "".join(line.format(*row) for row in rows) + "end\n"


def poses_of_program(suffix: str, text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3) positions, mm, and (n, 3, 3) rotations of `program_of_poses`, by plain text."""
    import re

    number = r"[+-]?\d+\.\d+"
    patterns = {
        ".src": (r"PTP \{(.*?)\}", 6),
        ".mod": (r"MoveJ \[(\[.*?\],\[.*?\]),", 7),
        ".ls": (r"P\[\d+\]\{(.*?)\}", 6),
        ".script": (r"movej\(p\[(.*?)\]", 6),
    }
    pattern, count = patterns[suffix]
    targets = re.findall(pattern, text, re.DOTALL)
    rows = np.array([[float(n) for n in re.findall(number, row)][:count] for row in targets])
    if suffix == ".src":
        return rows[:, :3], Rotation.from_euler("ZYX", rows[:, 3:], degrees=True).as_matrix()
    if suffix == ".mod":
        return rows[:, :3], Rotation.from_quat(rows[:, 3:], scalar_first=True).as_matrix()
    if suffix == ".ls":
        return rows[:, :3], Rotation.from_euler("xyz", rows[:, 3:], degrees=True).as_matrix()
    return 1000.0 * rows[:, :3], Rotation.from_rotvec(rows[:, 3:]).as_matrix()
