"""What a data set holds, in numbers: poses, loads, deflections and torques on the joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
from tabulate import tabulate

from stiff_bench.data_tools.picture import DEFLECTION
from stiff_bench.store.samples import load_torque
from stiff_models.physics.kinematics import gravity_torque
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.plugin import STIFFNESS, DatasetInfo
from stiff_protocols.contract.types import AXES, BenchmarkData, FloatArray, JointType

COUNTING_SHARE = 0.05
"""A principal axis counts when it holds this share of the vectors' squared length. Directions
spread evenly within 26 degrees of a line then lie along it, within 22 degrees of a plane in it."""
ONE_SIDED = 0.4
"""Length of the mean of unit vectors: 1 for one direction, 0.64 for half a circle, 0.5 for half
a sphere; 0 for a whole circle or sphere and for both ways of a line."""
NO_SCATTER = 0.01
"""Vectors that scatter about their mean by less than this share of their own size are one."""


@dataclass(frozen=True)
class VectorSpread:
    """How vectors lie in space.

    Attributes:
        shares: of the squared length along the three principal axes, largest first: the squared
            singular values of the (n, 3) matrix of vectors over their sum; zeros if there is
            nothing to spread.
        resultant: length of the mean of the unit vectors; None for vectors about their mean.
    """

    shares: tuple[float, ...]
    resultant: float | None

    @property
    def dimensions(self) -> int:
        """Number of principal axes that hold at least `COUNTING_SHARE`."""
        return sum(share >= COUNTING_SHARE for share in self.shares)

    @property
    def text(self) -> str:
        """The spread in words."""
        if self.dimensions == 0:
            return "all the same" if self.resultant is None else "none"
        if self.resultant is None:
            return ("along a line", "in a plane", "in all three dimensions")[self.dimensions - 1]
        one_sided = (
            "along a line, one way",
            "in a plane, on one side",
            "over one side of the sphere",
        )
        all_round = ("along a line, both ways", "in a plane, all round", "over the whole sphere")
        words = one_sided if self.resultant >= ONE_SIDED else all_round
        return words[self.dimensions - 1]


def directions(vectors: FloatArray) -> VectorSpread:
    """Return how the directions of (n, 3) vectors lie; vectors of length zero have none."""
    length = np.linalg.norm(vectors, axis=1)
    unit = vectors[length > 0.0] / length[length > 0.0, None]
    if len(unit) == 0:
        return VectorSpread((0.0, 0.0, 0.0), 0.0)
    return VectorSpread(_shares(unit), float(np.linalg.norm(unit.mean(axis=0))))


def about_mean(vectors: FloatArray) -> VectorSpread:
    """Return how (n, 3) vectors lie about their mean."""
    centred = vectors - vectors.mean(axis=0)
    if np.linalg.norm(centred) <= NO_SCATTER * np.linalg.norm(vectors):
        return VectorSpread((0.0, 0.0, 0.0), None)
    return VectorSpread(_shares(centred), None)


def _shares(vectors: FloatArray) -> tuple[float, ...]:
    squared = np.linalg.eigvalsh(vectors.T @ vectors)[::-1].clip(min=0.0)  # (3,) singular values^2
    return tuple(float(share) for share in squared / squared.sum())


MOST_GROUPS = 8  # in the printed table
_FILE_UNITS: dict[JointType, tuple[float, str, str]] = {  # position's factor, units
    "revolute": (180.0 / np.pi, "deg", "N m"),
    "prismatic": (1000.0, "mm", "N"),
}


@dataclass(frozen=True, eq=False)
class DatasetFacts:
    """A data set in numbers, SI units.

    Attributes:
        sha256: of the data.
        robot: its name.
        n_samples, n_poses: counts.
        loads_a_pose: fewest and most samples of one pose.
        groups: name and number of samples, in the data's order.
        sizes: least, median, mean and most of |force| [N], |torque| [N m], |deflection|, |dx|,
            |dy| and |dz| [m] over the samples, a row each.
        spreads: how unit vectors of the loads that are not zero lie, and forces less their mean:
            they lie along a line when the forces do, even if that line misses zero.
        joints: a row a joint, base to tip: its kind; least and most position, and its limits (rad,
            or m of a prismatic joint; infinite where there are none); least and most torque by the
            loads and by the links' weights (N m, or N; NaN for a robot without masses).
    """

    sha256: str
    robot: str
    n_samples: int
    n_poses: int
    loads_a_pose: tuple[int, int]
    groups: tuple[tuple[str, int], ...]
    sizes: pd.DataFrame
    spreads: Mapping[str, VectorSpread]
    joints: pd.DataFrame


def facts(data: BenchmarkData) -> DatasetFacts:
    """Compute the facts of a data set.

    Raises:
        DataError: there are no samples.
    """
    samples, robot = data.samples, data.robot
    if len(samples) == 0:
        raise DataError(f"the data set of robot {robot.name!r} has no samples")
    force, torque = samples.wrench[:, :3], samples.wrench[:, 3:]
    loads = np.unique(samples.pose_id, return_counts=True)[1]
    names, first, counts = np.unique(samples.group, return_index=True, return_counts=True)
    along = {f"|d{axis}|": np.abs(samples.deflection[:, k]) for k, axis in enumerate(AXES)}
    lengths = {"|force|": force, "|torque|": torque, "|deflection|": samples.deflection}
    sizes = pd.DataFrame({k: np.linalg.norm(of, axis=1) for k, of in lengths.items()} | along)
    on_joints = load_torque(data)
    weights = gravity_torque(robot, samples.q) if robot.masses.any() else on_joints * np.nan
    ends = {
        "position": (samples.q.min(axis=0), samples.q.max(axis=0)),
        "limit": (robot.lower, robot.upper),
        "load": (on_joints.min(axis=0), on_joints.max(axis=0)),
        "gravity": (weights.min(axis=0), weights.max(axis=0)),
    }
    columns = {f"{what}_low": low for what, (low, _) in ends.items()}
    columns |= {f"{what}_high": high for what, (_, high) in ends.items()}
    return DatasetFacts(
        sha256=data.sha256,
        robot=robot.name,
        n_samples=len(samples),
        n_poses=len(loads),
        loads_a_pose=(int(loads.min()), int(loads.max())),
        groups=tuple((str(names[i]), int(counts[i])) for i in np.argsort(first)),
        sizes=sizes.agg(["min", "median", "mean", "max"]).T,
        spreads={
            "force directions": directions(force),
            "forces about their mean": about_mean(force),
            "torque directions": directions(torque),
        },
        joints=pd.DataFrame({"kind": robot.joint_types} | columns, index=list(robot.joint_names)),
    )


def render_facts(found: DatasetFacts) -> str:
    """Return the facts as plain-text tables, in deg, mm, N and N m."""
    return "\n\n".join(
        [_overview(found), _magnitudes(found), _spreads(found), _joint_table(found.joints)]
    )


def _overview(found: DatasetFacts) -> str:
    fewest, most = found.loads_a_pose
    groups = [f"{name} ({count})" for name, count in found.groups[:MOST_GROUPS]]
    left = len(found.groups) - len(groups)
    rows = [
        ["robot", f"{found.robot}, {len(found.joints)} joints"],
        ["samples", f"{found.n_samples}"],
        ["poses", f"{found.n_poses}"],
        ["loads a pose", str(most) if fewest == most else f"{fewest} .. {most}"],
        ["groups", ", ".join(groups) + (f" and {left} more" if left else "")],
        ["sha256", found.sha256],
    ]
    return tabulate(rows, tablefmt="plain", disable_numparse=True, maxcolwidths=[None, 70])


def _magnitudes(found: DatasetFacts) -> str:
    units = {"|force|": (1.0, "N"), "|torque|": (1.0, "N m")}
    rows = []
    for name, sizes in found.sizes.iterrows():
        factor, unit = units.get(str(name), (1000.0, "mm"))
        rows.append([str(name), *(_number(factor * size) for size in sizes), unit])
    headers = ["over the samples", "least", "median", "mean", "most", "unit"]
    align = ("left", "right", "right", "right", "right", "left")
    return tabulate(rows, headers=headers, colalign=align, disable_numparse=True)


def _spreads(found: DatasetFacts) -> str:
    rows = [
        [
            name,
            spread.text,
            " / ".join(f"{share:.2f}" for share in spread.shares) if spread.dimensions else "-",
            "-" if spread.resultant is None or not spread.dimensions else f"{spread.resultant:.2f}",
        ]
        for name, spread in found.spreads.items()
    ]
    headers = ["the loads", "lie", "principal shares", "mean"]
    table = tabulate(rows, headers=headers, disable_numparse=True)
    return (
        f"{table}\nRule: an axis counts from a share of {COUNTING_SHARE:g} of the squared length; "
        f"directions lie on one side\nwhen their mean is at least {ONE_SIDED:g} long "
        "(1: one direction, 0.5: half a sphere, 0: the whole sphere)."
    )


def _joint_table(joints: pd.DataFrame) -> str:
    rows = []
    for name, joint in joints.iterrows():
        factor, unit, torque_unit = _FILE_UNITS[joint["kind"]]
        position, limits, load, gravity = (
            (joint[f"{what}_low"], joint[f"{what}_high"])
            for what in ("position", "limit", "load", "gravity")
        )
        limited = np.isfinite(limits).any()
        rows.append(
            [
                name,
                _range(position, factor),
                _range(limits, factor, decimals=0) if limited else "none",
                unit,
                _range(load),
                "-" if np.isnan(gravity).all() else _range(gravity),
                torque_unit,
            ]
        )
    headers = ["joint", "positions", "limits", "unit", "load torque", "gravity torque", "unit"]
    align = ("left", "right", "right", "left", "right", "right", "left")
    table = tabulate(rows, headers=headers, colalign=align, disable_numparse=True)
    note = "Torques are what the load (J^T w) and the weight of the links exert on a joint."
    if joints["gravity_low"].isna().all():
        note += "\nThe robot has no masses, hence no gravity torques."
    return f"{table}\n{note}"


def _range(ends: tuple[float, float], factor: float = 1.0, decimals: int = 1) -> str:
    rounded = (round(factor * end, decimals) + 0.0 for end in ends)  # no -0.0
    return " .. ".join(f"{end:.{decimals}f}" for end in rounded)


def _number(value: float) -> str:
    return f"{value:.3f}" if value < 10.0 else f"{value:.1f}"


_CARD_NOTE = " (the card below is that of the defaults)"


def dataset_info(
    info: DatasetInfo, data: BenchmarkData, picture: Path | None, options: str = ""
) -> str:
    """Return what is known of a data set: catalogue line, facts, card, place of the picture.

    Args:
        info: its catalogue line.
        data: what its `load` gave.
        picture: a file that `save_picture` has written; None: there is none.
        options: what was set, "name=value, ..."; the card describes the defaults.

    Raises:
        DataError: there are no samples, or the card is not in the package.
    """
    parts = [_heading(info, options), render_facts(facts(data))]
    if info.card:
        parts.append(_card_text(info.key, info.card))
    if picture is not None:
        parts.append(f"picture: {picture}")
    return "\n\n".join(parts)


def picture_title(info: DatasetInfo) -> str:
    """Return the first line of the picture: the key, and whether anything was measured."""
    return f"{info.key} ({info.label})"


def picture_quantity(info: DatasetInfo) -> str:
    """Return what the data set's deflections are."""
    return DEFLECTION if info.task == STIFFNESS else f"The {info.task} (no load is applied)"


def _heading(info: DatasetInfo, options: str) -> str:
    lines = [f"{info.key} ({info.label}): {info.summary}"]
    if options:
        lines.append(f"options: {options}{_CARD_NOTE if info.card else ''}")
    if info.reference:
        lines.append(f"reference: {info.reference}")
    lines += [f"caveat: {caveat}" for caveat in info.caveats]
    return "\n".join(lines)


def _card_text(key: str, card: str) -> str:
    """Read a data card, named by its path inside stiff_datasets."""
    try:
        text = files("stiff_datasets").joinpath(card).read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(
            f"data set {key!r}: card {card!r} cannot be read, expected a path inside the package "
            f"stiff_datasets such as data/fanuc_r2000ic.md: {error.strerror or error}"
        ) from error
    return text.strip()
