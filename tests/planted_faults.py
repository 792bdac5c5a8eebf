"""Mistakes of a measurement, planted in clean data: which of them does `validate` name?

`python tests/planted_faults.py` prints the table of docs/how-to/own-robot.md (minutes).
"""

from __future__ import annotations

import functools
import re
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.measured.hypotheses import reading
from stiff_datasets.measured.sample_files import (
    DEFLECTION_COLUMNS,
    WRENCH_COLUMNS,
    sample_table,
    write_table,
)
from stiff_datasets.measured.validate import ValidationReport, validate
from stiff_datasets.robots.robot import ChainModel
from stiff_datasets.robots.shipped import named_robot
from stiff_datasets.twin.kr10_twin import Kr10Twin, Kr10TwinMultiload, Kr10TwinOmni
from stiff_datasets.twin.robot_twin import Ur5Twin

FORCE, TORQUE, MOVED = [*WRENCH_COLUMNS[:3]], [*WRENCH_COLUMNS[3:]], [*DEFLECTION_COLUMNS]
JOINTS = [f"q{i}_deg" for i in range(1, 7)]
TWINS = {"kr10-twin": Kr10Twin, "kr10-twin-omni": Kr10TwinOmni, "ur5-twin": Ur5Twin}
SOURCES = {**TWINS, "kr10-twin-multiload": Kr10TwinMultiload}


@dataclass(frozen=True, eq=False)
class Clean:
    """A clean file: its table in the units of files, and what the faults need of its robot."""

    table: pd.DataFrame
    chain: ChainModel
    no_torque: bool = False

    def report(self, path, table=None, **options) -> ValidationReport:
        write_table(path, self.table if table is None else table)
        return validate(path, self.chain, **options)

    @functools.cached_property
    def kinematics(self):
        q = np.deg2rad(self.table[JOINTS].to_numpy())
        return reading(self.chain, q, np.zeros((len(q), 6)), np.zeros((len(q), 3)))


@functools.cache
def clean(source: str, specimen: int = 0, seed: int = 0) -> Clean:
    if source == "FANUC":
        data, robot = FanucR2000iC().load(), "fanuc-r2000ic"
    else:
        data = SOURCES[source](specimen=specimen, seed=seed).load()
        robot = "ur5" if source == "ur5-twin" else "kr10-r1100-2"
    chain, table = named_robot(robot).chain(), sample_table(data.samples, data.robot)
    return Clean(table, chain, no_torque=source == "FANUC")


Change = Callable[[Clean], pd.DataFrame]


def scaled(columns: list[str], factor: float) -> Change:
    return lambda data: data.table.assign(**{name: data.table[name] * factor for name in columns})


def renamed(*columns: list[str]) -> Change:
    """The numbers of the first columns stand under the names of the second, and so on."""
    groups = zip(columns, [*columns[1:], columns[0]], strict=True)
    names = {old: new for group in groups for old, new in zip(*group, strict=True)}
    return lambda data: data.table.rename(columns=names)[data.table.columns]


def added(columns: list[str], *offsets: float) -> Change:
    return lambda data: data.table.assign(
        **{name: data.table[name] + each for name, each in zip(columns, offsets, strict=True)}
    )


def turned(columns: list[list[str]], rotation: Callable[[Clean], np.ndarray]) -> Change:
    """Force, torque or deflection in another frame, by one matrix or one a row."""

    def change(data: Clean) -> pd.DataFrame:
        table = data.table.copy()
        for names in columns:
            table[names] = (rotation(data) @ table[names].to_numpy()[:, :, None])[:, :, 0]
        return table

    return change


def about_z(degrees: float) -> Callable[[Clean], np.ndarray]:
    sine, cosine = np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))
    return lambda _: np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def to_flange(data: Clean) -> np.ndarray:
    return data.kinematics.flange.transpose(0, 2, 1)


def torque_about(point: str) -> Change:
    def change(data: Clean) -> pd.DataFrame:
        table, lever = data.table.copy(), getattr(data.kinematics, point)
        table[TORQUE] += np.cross(lever, table[FORCE].to_numpy())
        return table

    return change


def sensor_bias(data: Clean) -> pd.DataFrame:
    table, force = data.table.copy(), np.linalg.norm(data.table[FORCE], axis=1).mean()
    table[FORCE] += data.kinematics.flange @ np.array([0.3, -0.2, 0.2]) * force
    return table


def both(first: Change, second: Change) -> Change:
    return lambda data: second(replace(data, table=first(data)))


def shifted(columns: list[str]) -> Change:
    def change(data: Clean) -> pd.DataFrame:
        table = data.table.copy()
        table[columns] = table[columns].shift(1)
        return table.iloc[1:].reset_index(drop=True)

    return change


def rows_ten_times(*rows: int) -> Change:
    def change(data: Clean) -> pd.DataFrame:
        table = data.table.copy()
        table.loc[[*rows], MOVED] *= 10.0
        return table

    return change


def unchanged(data: Clean) -> pd.DataFrame:
    """Wrench and deflection are those of a TCP that the validator is not told: see `WRONG_TCP`."""
    return data.table


WRONG_TCP = {
    "TCP wrong by (-60, 20, 100) mm": (-0.06, 0.02, 0.1),
    "TCP wrong by 200 mm": (0.0, 0.2, 0.0),
    "x of the TCP wrong by 120 mm": (-0.12, 0.0, 0.0),
}
FAULTS: dict[str, tuple[Change, str]] = {
    "wrench of opposite sign": (scaled(FORCE + TORQUE, -1.0), "wrench .* opposite sign"),
    "deflection unloaded minus loaded": (scaled(MOVED, -1.0), "unloaded minus loaded"),
    "forces of opposite sign": (scaled(FORCE, -1.0), "(forces|wrench) .* opposite sign"),
    "torques of opposite sign": (scaled(TORQUE, -1.0), "torques .* opposite sign"),
    "torque about the flange": (torque_about("lever"), "torques .* about the flange"),
    "torque about the base": (torque_about("tcp"), "torques .* about the base"),
    "torque in N mm": (scaled(TORQUE, 1000.0), "torques .* N mm"),
    "torques all zero": (scaled(TORQUE, 0.0), "every torque is zero"),
    "forces in kg": (scaled(FORCE, 1 / 9.81), "forces .* kg"),
    "forces and torques in kg": (scaled(FORCE + TORQUE, 1 / 9.81), "forces and torques in kg"),
    "forces in kg, torques in N mm": (
        both(scaled(FORCE, 1 / 9.81), scaled(TORQUE, 1000.0)),
        "forces .* in kg and the torques .* in N mm",
    ),
    "forces in kN": (scaled(FORCE, 0.001), "in kN"),
    "forces and torques swapped": (renamed(FORCE, TORQUE), "forces and torques .* swapped"),
    "wrench in the flange frame": (
        turned([FORCE, TORQUE], to_flange),
        "(wrench|forces) .* flange frame",
    ),
    "wrench in the flange frame, torque about the flange": (
        both(torque_about("lever"), turned([FORCE, TORQUE], to_flange)),
        "wrench .* flange frame",
    ),
    "torques in the flange frame": (turned([TORQUE], to_flange), "torques .* flange frame"),
    "deflections in the flange frame": (turned([MOVED], to_flange), "deflections .* flange frame"),
    "wrench in a base frame turned by 90 deg": (
        turned([FORCE, TORQUE], about_z(90.0)),
        "wrench .* -90 deg about z",
    ),
    "wrench in a base frame turned by 45 deg": (
        turned([FORCE, TORQUE], about_z(45.0)),
        "wrench .* -4. deg about z",
    ),
    "wrench and deflections in a base frame turned by 90 deg": (
        turned([FORCE, TORQUE, MOVED], about_z(90.0)),
        "90 deg (off|about z)",
    ),
    "fy and fz swapped": (renamed(["fy_N"], ["fz_N"]), "(forces|wrench) .* y and z swapped"),
    "fx of opposite sign": (scaled(["fx_N"], -1.0), "(forces|wrench) .* sign of x flipped"),
    "dx and dy swapped": (renamed(["dx_mm"], ["dy_mm"]), "deflections .* x and y swapped"),
    "dz of opposite sign": (scaled(["dz_mm"], -1.0), "deflections .* sign of z flipped"),
    "deflection without signs": (
        lambda data: data.table.assign(**{name: data.table[name].abs() for name in MOVED}),
        "deflections .* lost their signs",
    ),
    "dz all zero": (scaled(["dz_mm"], 0.0), "every dz_mm is zero"),
    "deflection in micrometres": (scaled(MOVED, 1000.0), "micrometres"),
    "deflection in m": (scaled(MOVED, 0.001), "metres"),
    "joint angles in rad": (scaled(JOINTS, np.pi / 180), "look like radians"),
    "joint 1 in rad": (scaled(["q1_deg"], np.pi / 180), "joint (A1|shoulder_pan|J1).* in rad"),
    "joint 3 in rad": (scaled(["q3_deg"], np.pi / 180), "joint (A3|elbow|J3).* in rad"),
    "joint 1 of opposite sign": (
        scaled(["q1_deg"], -1.0),
        "joint (A1|shoulder_pan|J1).* opposite",
    ),
    "joint 3 of opposite sign": (scaled(["q3_deg"], -1.0), "joint (A3|elbow|J3).* opposite"),
    "joint 3 off by -90 deg": (added(["q3_deg"], -90.0), "joint (A3|elbow|J3).* -90 deg"),
    "joint 2 off by +90 deg": (
        added(["q2_deg"], 90.0),
        r"joint (A2|shoulder_lift|J2).* \+90 deg",
    ),
    "joints 4 and 5 swapped": (
        renamed(["q4_deg"], ["q5_deg"]),
        "joints (A4 and A5|wrist_1.* and wrist_2|J4 and J5).* swapped",
    ),
    "deflections shifted by one row": (shifted(MOVED), "deflections .* shifted"),
    "wrenches shifted by one row": (shifted(FORCE + TORQUE), "wrenches .* shifted"),
    "sensor bias of 40 % of the force": (sensor_bias, "force sensor .* offset"),
    "force offset of (30, -20, 20) N": (added(FORCE, 30.0, -20.0, 20.0), "forces .* offset"),
    "tool of 1 kg not tared": (added(["fz_N"], -9.81), r"tool .* \(not tared"),
    "tool of 2.5 kg not tared": (added(["fz_N"], -9.81 * 2.5), r"tool .* \(not tared"),
    **{name: (unchanged, "TCP looks") for name in WRONG_TCP},
    "one deflection ten times too large": (rows_ten_times(40), "row 42 by"),
    "three deflections ten times too large": (
        rows_ten_times(10, 25, 40),
        "(?=.*row 12 by)(?=.*row 27 by)(?=.*row 42 by)",
    ),
}
OF_TORQUE = {
    name for name, (change, _) in FAULTS.items() if name.startswith("torque") or "torques" in name
}
"""Not to be planted where there are none."""


def outcome(fault: str, data: Clean, path: Path) -> str:
    """Whether a fault of a file is "named", "wrongly named", only "suspected", or "missed"."""
    change, words = FAULTS[fault]
    table = change(data)
    if fault in WRONG_TCP:
        tcp = data.chain.flange.act(data.chain.flange.actInv(data.chain.tcp) + WRONG_TCP[fault])
        data = replace(data, chain=replace(data.chain, tcp=tcp))
    report = data.report(path, table, no_torque=data.no_torque)
    found = [each.message.split("; as well")[0] for each in (*report.errors, *report.warnings)]
    if any(re.search(words, message) for message in found):
        return "named"
    if any(re.search("looks? as if", message) for message in found):
        return "wrongly named"
    return "missed" if report.verdict == "ok" else "suspected"


OUTCOMES = ("named", "wrongly named", "suspected", "missed")


def table_of_faults(specimens: int = 3) -> str:
    """Return a line a fault with its outcomes, those that are always named in one line."""
    counts: dict[str, dict[str, Counter[str]]] = {fault: {} for fault in FAULTS}
    sources = ("kr10-twin", "kr10-twin-omni", "ur5-twin", "FANUC")
    with tempfile.TemporaryDirectory() as folder:
        for source in sources:
            for specimen in range(1 if source == "FANUC" else specimens):
                data = clean(source, specimen)
                for fault in FAULTS:
                    if not (data.no_torque and fault in OF_TORQUE):
                        counted = counts[fault].setdefault(source, Counter())
                        counted[outcome(fault, data, Path(folder) / "my.csv")] += 1
    always = {
        fault for fault, each in counts.items() if all(set(c) == {"named"} for c in each.values())
    }

    def line(name: str, faults: list[str]) -> str:
        sums = [
            sum((counts[fault].get(source, Counter()) for fault in faults), Counter())
            for source in sources
        ]
        cells = ["/".join(str(each[what]) for what in OUTCOMES) if each else "" for each in sums]
        return "| " + " | ".join([name, *cells]) + " |"

    rest = sorted(always, key=list(FAULTS).index)
    return "\n".join(
        [
            "| mistake | `kr10-twin` | `kr10-twin-omni` | `ur5-twin` | FANUC |",
            "|---" * (len(sources) + 1) + "|",
            *(line(fault, [fault]) for fault in FAULTS if fault not in always),
            line(f"{len(rest)} others: {'; '.join(rest)}", rest),
            line(f"together, {len(FAULTS)}", list(FAULTS)),
        ]
    )


if __name__ == "__main__":
    print(table_of_faults())
