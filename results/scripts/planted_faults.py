"""Mistakes of a measurement, planted in clean data: which of them does `validate` name?

`python results/scripts/planted_faults.py` prints the table of docs/faults.md (minutes).
"""

from __future__ import annotations

import functools
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.measured.fault_hypotheses import reading
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.sample_columns import DEFLECTION_COLUMNS, WRENCH_COLUMNS
from stiff_datasets.measured.table_reader import sample_table, write_table
from stiff_datasets.measured.validation_report import ValidationReport, validate
from stiff_datasets.twin.kr10_twin import Kr10Twin, Kr10TwinMultiload, Kr10TwinOmni
from stiff_datasets.twin.robot_twin import Ur5Twin
from stiff_protocols.contract.types import Robot

FORCE, TORQUE, MOVED = [*WRENCH_COLUMNS[:3]], [*WRENCH_COLUMNS[3:]], [*DEFLECTION_COLUMNS]
JOINTS = [f"q{i}_deg" for i in range(1, 7)]
TWINS = {"kr10-twin": Kr10Twin, "kr10-twin-omni": Kr10TwinOmni, "ur5-twin": Ur5Twin}
SOURCES = {**TWINS, "kr10-twin-multiload": Kr10TwinMultiload}


@dataclass(frozen=True, eq=False)
class Clean:
    """A clean file: its table in the units of files, and what the faults need of its robot."""

    table: pd.DataFrame
    robot: Robot
    no_torque: bool = False

    def report(self, path, table=None, **options) -> ValidationReport:
        write_table(path, [self.table if table is None else table])
        return validate(path, self.robot, FileOptions(**options))

    @functools.cached_property
    def kinematics(self):
        q = np.deg2rad(self.table[JOINTS].to_numpy())
        return reading(self.robot, q, np.zeros((len(q), 6)), np.zeros((len(q), 3)))


@functools.cache
def clean(source: str, specimen: int = 0, seed: int = 0) -> Clean:
    if source == "FANUC":
        data = FanucR2000iC().load()
    else:
        data = SOURCES[source](specimen=specimen, seed=seed).load()
    table = sample_table(data.samples, data.robot)
    return Clean(table, data.robot, no_torque=source == "FANUC")


Change = Callable[[Clean], pd.DataFrame]


def replaced(data: Clean, columns: list[str], values: ArrayLike) -> pd.DataFrame:
    """The table with other numbers in some columns."""
    return data.table.assign(**dict(zip(columns, np.asarray(values).T, strict=True)))


def scaled(columns: list[str], factor: float) -> Change:
    return lambda data: replaced(data, columns, data.table[columns] * factor)


def added(columns: list[str], *offsets: float) -> Change:
    return lambda data: replaced(data, columns, data.table[columns] + np.array(offsets))


def renamed(*columns: list[str]) -> Change:
    """The numbers of the first columns stand under the names of the second, and so on."""
    groups = zip(columns, [*columns[1:], columns[0]], strict=True)
    names = {old: new for group in groups for old, new in zip(*group, strict=True)}
    return lambda data: data.table.rename(columns=names)[data.table.columns]


def turned(columns: list[str], rotation: Callable[[Clean], np.ndarray]) -> Change:
    """Forces, torques or deflections in another frame, by one matrix or one a row."""

    def change(data: Clean) -> pd.DataFrame:
        vectors = data.table[columns].to_numpy().reshape(len(data.table), -1, 3)
        turned_vectors = vectors @ rotation(data).swapaxes(-1, -2)
        return replaced(data, columns, turned_vectors.reshape(len(turned_vectors), -1))

    return change


def about_z(degrees: float) -> Callable[[Clean], np.ndarray]:
    return lambda _: Rotation.from_euler("z", degrees, degrees=True).as_matrix()


def to_flange(data: Clean) -> np.ndarray:
    return data.kinematics.flange.transpose(0, 2, 1)


def torque_about(point: str) -> Change:
    def change(data: Clean) -> pd.DataFrame:
        moved = np.cross(getattr(data.kinematics, point), data.table[FORCE])
        return replaced(data, TORQUE, data.table[TORQUE] + moved)

    return change


def sensor_bias(data: Clean) -> pd.DataFrame:
    force = np.linalg.norm(data.table[FORCE], axis=1).mean()
    bias = data.kinematics.flange @ np.array([0.3, -0.2, 0.2]) * force
    return replaced(data, FORCE, data.table[FORCE] + bias)


def both_changes(first: Change, second: Change) -> Change:
    return lambda data: second(replace(data, table=first(data)))


def shifted(columns: list[str]) -> Change:
    def change(data: Clean) -> pd.DataFrame:
        table = replaced(data, columns, data.table[columns].shift(1))
        return table.iloc[1:].reset_index(drop=True)

    return change


def rows_ten_times(*rows: int) -> Change:
    def change(data: Clean) -> pd.DataFrame:
        factor = np.where(data.table.index.isin(rows), 10.0, 1.0)
        return replaced(data, MOVED, data.table[MOVED].mul(factor, axis=0))

    return change


def one_row_ten_times(rank: int) -> Change:
    """Of the smallest deflection (0), or of the largest (-1)."""

    def change(data: Clean) -> pd.DataFrame:
        size = np.linalg.norm(data.table[MOVED], axis=1)
        return rows_ten_times(int(np.argsort(size)[rank]))(data)

    return change


def off_by(millimetres: float, course: Callable[[np.ndarray], np.ndarray]) -> Change:
    """dz off by so much times what a course makes of the share of rows before a row."""

    def change(data: Clean) -> pd.DataFrame:
        share = np.linspace(0.0, 1.0, len(data.table))
        return replaced(
            data, ["dz_mm"], data.table[["dz_mm"]] + millimetres * course(share)[:, None]
        )

    return change


def clipped(data: Clean) -> pd.DataFrame:
    """A force sensor that reaches its limit in every eighth row."""
    limit = data.table["fz_N"].quantile(0.875)
    return replaced(data, ["fz_N"], data.table[["fz_N"]].clip(upper=limit))


def on_a_rail(data: Clean) -> pd.DataFrame:
    return data.table.assign(E1=np.linspace(0.0, 1500.0, len(data.table)))


def without_deflections(data: Clean) -> pd.DataFrame:
    return data.table.assign(**dict.fromkeys(MOVED, ""))


def unchanged(data: Clean) -> pd.DataFrame:
    """Wrench and deflection are those of a TCP that the validator is not told: see `WRONG_TCP`."""
    return data.table


IN_KG, IN_NMM = scaled(FORCE, 1 / 9.81), scaled(TORQUE, 1000.0)
A1, A2, A3 = "joint (A1|shoulder_pan|J1)", "joint (A2|shoulder_lift|J2)", "joint (A3|elbow|J3)"
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
    "torque in N mm": (IN_NMM, "torques .* N mm"),
    "torques all zero": (scaled(TORQUE, 0.0), "every torque is zero"),
    "forces in kg": (IN_KG, "forces .* kg"),
    "forces and torques in kg": (scaled(FORCE + TORQUE, 1 / 9.81), "forces and torques in kg"),
    "forces in kg, torques in N mm": (
        both_changes(IN_KG, IN_NMM),
        "forces .* in kg and the torques .* in N mm",
    ),
    "forces in kN": (scaled(FORCE, 0.001), "in kN"),
    "forces and torques swapped": (renamed(FORCE, TORQUE), "forces and torques .* swapped"),
    "wrench in the flange frame": (
        turned(FORCE + TORQUE, to_flange),
        "(wrench|forces) .* flange frame",
    ),
    "wrench in the flange frame, torque about the flange": (
        both_changes(torque_about("lever"), turned(FORCE + TORQUE, to_flange)),
        "wrench .* flange frame",
    ),
    "torques in the flange frame": (turned(TORQUE, to_flange), "torques .* flange frame"),
    "deflections in the flange frame": (turned(MOVED, to_flange), "deflections .* flange frame"),
    "wrench in a base frame turned by 90 deg": (
        turned(FORCE + TORQUE, about_z(90.0)),
        "wrench .* -90 deg about z",
    ),
    "wrench in a base frame turned by 45 deg": (
        turned(FORCE + TORQUE, about_z(45.0)),
        "wrench .* -4. deg about z",
    ),
    "wrench and deflections in a base frame turned by 90 deg": (
        turned(FORCE + TORQUE + MOVED, about_z(90.0)),
        "90 deg (off|about z)",
    ),
    "fy and fz swapped": (renamed(["fy_N"], ["fz_N"]), "(forces|wrench) .* y and z swapped"),
    "fx of opposite sign": (scaled(["fx_N"], -1.0), "(forces|wrench) .* sign of x flipped"),
    "dx and dy swapped": (renamed(["dx_mm"], ["dy_mm"]), "deflections .* x and y swapped"),
    "dz of opposite sign": (scaled(["dz_mm"], -1.0), "deflections .* sign of z flipped"),
    "deflection without signs": (
        lambda data: replaced(data, MOVED, data.table[MOVED].abs()),
        "deflections .* lost their signs",
    ),
    "dz all zero": (scaled(["dz_mm"], 0.0), "dz_mm: every cell is 0"),
    "deflection in micrometres": (scaled(MOVED, 1000.0), "micrometres"),
    "deflection in m": (scaled(MOVED, 0.001), "metres"),
    "joint angles in rad": (scaled(JOINTS, np.pi / 180), "look like radians"),
    "joint 1 in rad": (scaled(["q1_deg"], np.pi / 180), f"{A1}.* in rad"),
    "joint 3 in rad": (scaled(["q3_deg"], np.pi / 180), f"{A3}.* in rad"),
    "joint 1 of opposite sign": (scaled(["q1_deg"], -1.0), f"{A1}.* opposite"),
    "joint 3 of opposite sign": (scaled(["q3_deg"], -1.0), f"{A3}.* opposite"),
    "joint 3 off by -90 deg": (added(["q3_deg"], -90.0), f"{A3}.* -90 deg"),
    "joint 2 off by +90 deg": (added(["q2_deg"], 90.0), rf"{A2}.* \+90 deg"),
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
    "the smallest deflection ten times too large": (one_row_ten_times(0), "far from .* row .* by"),
    "the largest deflection ten times too large": (one_row_ten_times(-1), "far from .* row .* by"),
    "dz drifts by 0.6 mm": (off_by(0.6, lambda share: share), "had drifted by .* row 2 "),
    "dz jumps by 0.6 mm half-way": (off_by(0.6, lambda share: share > 0.5), "had jumped by"),
    "force clipped at a limit of the sensor": (clipped, "fz_N is exactly"),
    "deflection in 1/10 mm": (scaled(MOVED, 10.0), "deflections in .*1/10 mm"),
    "deflection in 1/100 mm": (scaled(MOVED, 100.0), "deflections in .*1/100 mm"),
    "deflection in 0.001 inch": (scaled(MOVED, 1000.0 / 25.4), "deflections in .*0.001 inch"),
    "an external axis that moves": (on_a_rail, "E1 looks like an axis that moved"),
    "a plan that is not filled in": (without_deflections, "not filled in yet"),
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
        tcp = data.robot.tcp + data.robot.flange[:3, :3] @ WRONG_TCP[fault]
        data = replace(data, robot=replace(data.robot, tcp=tcp))
    report = data.report(path, table, no_torque=data.no_torque)
    messages = [
        finding.message.split("; as well")[0] for finding in (*report.errors, *report.warnings)
    ]
    if any(re.search(words, message) for message in messages):
        return "named"
    if any(re.search("looks? as if", message) for message in messages):
        return "wrongly named"
    return "missed" if report.verdict == "ok" else "suspected"


OUTCOMES = ("named", "wrongly named", "suspected", "missed")


def table_of_faults(specimens: int = 1) -> str:
    """Return a line a fault with its outcomes, those that are always named in one line."""
    outcomes, sources = [], [*TWINS, "FANUC"]
    with tempfile.TemporaryDirectory() as folder:
        for source in sources:
            for specimen in range(1 if source == "FANUC" else specimens):
                data = clean(source, specimen)
                faults = [name for name in FAULTS if not (data.no_torque and name in OF_TORQUE)]
                outcomes += [
                    (fault, source, outcome(fault, data, Path(folder) / "my.csv"))
                    for fault in faults
                ]
    outcome_table = pd.DataFrame(outcomes, columns=["fault", "source", "outcome"])
    not_always = {*outcome_table["fault"][outcome_table["outcome"] != "named"]}
    always = [fault for fault in FAULTS if fault not in not_always]

    def line(name: str, faults: list[str]) -> list[str]:
        line_outcomes = outcome_table[outcome_table["fault"].isin(faults)]
        counts = pd.crosstab(line_outcomes["source"], line_outcomes["outcome"])
        counts = counts.reindex(index=sources, columns=OUTCOMES, fill_value=0)
        return [name, *("/".join(map(str, row)) if any(row) else "" for row in counts.to_numpy())]

    rows = [
        ["mistake", *(f"`{name}`" for name in TWINS), "FANUC"],
        ["---"] * (len(sources) + 1),
        *(line(fault, [fault]) for fault in FAULTS if fault in not_always),
        line(f"{len(always)} others: {'; '.join(always)}", always),
        line(f"together, {len(FAULTS)}", list(FAULTS)),
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    print(table_of_faults())
