"""Describe a data set in numbers: poses, loads, deflections, and joint torques."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np

from stiff_bench.store.samples import load_torque
from stiff_bench.tables.table import Column, Entry, Quantity, Table, text_columns
from stiff_bench.tables.units import MM, first_few
from stiff_bench.tables.writers import plain_text
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.training_range import in_smallest_arcs
from stiff_protocols.contract.types import AXES, BenchmarkData, FloatArray

COUNTING_SHARE = 0.05
"""Smallest share of the vectors' squared length on a principal axis that counts. Directions spread
evenly within 26 degrees of a line are then along it, within 22 degrees of a plane in it."""
NO_SCATTER = 0.01
"""Smallest scatter about the mean, as a share of the vectors' size; below, vectors are equal."""
_LIE = ("all the same", "along a line", "in a plane", "in all directions")
MOST_GROUPS = 8  # in the printed table


def principal_shares(vectors: FloatArray) -> tuple[float, ...]:
    """Return the shares of (n, 3) vectors' squared length along principal axes, descending."""
    squared = np.linalg.eigvalsh(vectors.T @ vectors)[::-1].clip(min=0.0)  # (3,) singular values^2
    return tuple(float(share) for share in squared / (squared.sum() or 1.0))


def directions(vectors: FloatArray) -> FloatArray:
    """Return (n, 3) vectors scaled to unit length, without zero vectors."""
    length = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors[length > 0.0] / length[length > 0.0, None])


def about_mean(vectors: FloatArray) -> FloatArray:
    """Return (n, 3) vectors minus their mean; zeros if they are almost equal."""
    centred = vectors - vectors.mean(axis=0)
    scatters = np.linalg.norm(centred) > NO_SCATTER * np.linalg.norm(vectors)
    return np.asarray(centred * scatters)


def facts(data: BenchmarkData) -> list[Table]:
    """Return the facts of a data set: counts, sizes, spread of loads, and joints.

    Raises:
        DataError: the data set is empty.
    """
    if len(data.samples) == 0:
        raise DataError(f"the data set of robot {data.robot.name!r} has no samples")
    return [_counts(data), _sizes(data), _lie(data), _joints(data)]


def _counts(data: BenchmarkData) -> Table:
    samples = data.samples
    loads = np.unique(samples.pose_id, return_counts=True)[1]
    names, first, counts = np.unique(samples.group, return_index=True, return_counts=True)
    groups = [f"{names[i]} ({counts[i]})" for i in np.argsort(first)]
    least, most = int(loads.min()), int(loads.max())
    rows: list[list[Entry]] = [
        ["robot", data.robot.joints_text],
        ["samples", len(samples)],
        ["poses", len(loads)],
        ["loads per pose", least if least == most else Quantity(low=least, high=most)],
        ["groups", first_few(groups, MOST_GROUPS)],
        ["sha256", data.sha256],
    ]
    return Table("", text_columns("data set", ""), rows)


def _sizes(data: BenchmarkData) -> Table:
    """Return minimum, median, mean and maximum of loads and deflections."""
    samples = data.samples
    force, torque = samples.wrench[:, :3], samples.wrench[:, 3:]
    sizes = {
        "|force| [N]": np.linalg.norm(force, axis=1),
        "|torque| [N m]": np.linalg.norm(torque, axis=1),
        "|deflection| [mm]": np.linalg.norm(samples.deflection, axis=1) * MM,
        **{f"|d{a}| [mm]": np.abs(samples.deflection[:, i]) * MM for i, a in enumerate(AXES)},
    }
    rows: list[list[Entry]] = [
        [name, *(float(of(size)) for of in (np.min, np.median, np.mean, np.max))]
        for name, size in sizes.items()
    ]
    columns = [Column(name, format=".4g") for name in ("min", "median", "mean", "max")]
    return Table("", [Column("over the samples", "text"), *columns], rows)


def _lie(data: BenchmarkData) -> Table:
    force, torque = data.samples.wrench[:, :3], data.samples.wrench[:, 3:]
    rows: list[list[Entry]] = []
    for name, vectors, are_directions in (
        ("force directions", directions(force), True),
        ("forces about their mean", about_mean(force), False),
        ("torque directions", directions(torque), True),
    ):
        shares = principal_shares(vectors)
        n_axes = sum(share >= COUNTING_SHARE for share in shares)
        lie = _LIE[n_axes] if len(vectors) else "none"
        has_mean = are_directions and n_axes > 0
        mean = float(np.linalg.norm(vectors.mean(axis=0))) if has_mean else None
        rows.append([name, lie, " / ".join(f"{share:.2f}" for share in shares), mean])
    texts = text_columns("loads", "spread", "principal axes")
    note = (
        "Principal axes: shares of the squared length; the spread ignores shares below "
        f"{COUNTING_SHARE:g}. Mean direction: 1 is one direction, 0.5 half a sphere, 0 uniform."
    )
    return Table("", [*texts, Column("mean direction", format=".2f")], rows, [note])


def _joints(data: BenchmarkData) -> Table:
    """Return ranges of position and torque, and limits, of each joint."""
    robot, on_joints = data.robot, load_torque(data.robot, data.samples)
    weights = robot.gravity_torque(data.samples.q) if robot.has_masses else None
    q = in_smallest_arcs(data.samples.q, robot)
    rows: list[list[Entry]] = []
    for i, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_types, strict=True)):
        factor, units = (MM, "mm, N") if kind == "prismatic" else (180.0 / np.pi, "deg, N m")
        limits = factor * np.array([robot.lower[i], robot.upper[i]])
        rows.append(
            [
                name,
                units,
                _range(factor * q[:, i]),
                _range(limits) if np.isfinite(limits).any() else None,
                _range(on_joints[:, i]),
                None if weights is None else _range(weights[:, i]),
            ]
        )
    positions = [Column(name, format=".1f") for name in ("positions", "limits")]
    torques = [Column(name, format=".4g") for name in ("load torque", "gravity torque")]
    missing = "" if weights is not None else " The robot has no masses, hence no gravity torques."
    note = f"Torques on the joints, of the load (J^T w) and of the links' weight.{missing}"
    return Table("", [*text_columns("joint", "units"), *positions, *torques], rows, [note])


def _range(values: FloatArray) -> Quantity:
    low, high = (np.round(end, 1) + 0.0 for end in (values.min(), values.max()))  # no -0.0
    return Quantity(low=float(low), high=float(high))


def dataset_info(info: DatasetInfo, data: BenchmarkData, picture: Path, options: str = "") -> str:
    """Return the catalogue line of a data set, its facts and the path of its picture.

    Raises:
        DataError: the data set is empty.
    """
    lines = [f"{info.key} ({info.kind}): {info.summary}"]
    if options:
        note = " (its data card describes the defaults)" if info.card else ""
        lines.append(f"options: {options}{note}")
    if info.reference:
        lines.append(f"reference: {info.reference}")
    lines += [f"caveat: {caveat}" for caveat in info.caveats]
    tables = map(plain_text, facts(data))
    return "\n\n".join(["\n".join(lines), *tables, f"picture: {picture}"])


def card_text(key: str, card: str) -> str:
    """Read a data card by its path inside stiff_datasets; "" for no card.

    Raises:
        DataError: the package does not contain the card.
    """
    if not card:
        return ""
    try:
        text = files("stiff_datasets").joinpath(card).read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(
            f"data set {key!r}: card {card!r} cannot be read ({error.strerror or error}); use a "
            "path inside the package stiff_datasets such as data/fanuc_r2000ic.md"
        ) from error
    return text.strip()
