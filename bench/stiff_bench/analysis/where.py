"""Where is A better than B? Regions of the workspace, sizes of the load, torques on the joints.

The tested samples are divided by each of these into three parts of about equal number (a part of
the measurement plan stays one), and every part is tested by itself. There are dozens of them, so
the p-values are corrected for all that were looked at (Holm). What is shown is, of each kind, the
division that explains most of the differences between poses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_bench.analysis.verdict import (
    Estimate,
    Question,
    Verdict,
    corrected,
    decide,
    estimates_over_poses,
)
from stiff_bench.store.samples import StoredData
from stiff_protocols.contract.types import FloatArray, IntArray, TextArray
from stiff_protocols.scoring.bootstrap import PoseErrors, pose_differences, pose_errors

Kind = Literal["pose region", "load", "joint torque"]
LEAST_SPREAD = 0.02
"""What varies by a smaller part of its largest value is not divided."""
PARTS = 3
FEWEST_POSES = 11
"""Parts with fewer poses say nothing: with n poses the smallest p of the signed-rank test is 2/2^n,
which after the correction for about 30 places is below 0.05 from 11 poses on."""


@dataclass(frozen=True, eq=False)
class Factor:
    """A quantity that every sample of a data set has.

    Attributes:
        kind: what it belongs to.
        name: for people, e.g. "torque on A2".
        unit: "m", "N", "Nm", or "" for names.
        values: (n,) in that unit, or names.
    """

    kind: Kind
    name: str
    unit: str
    values: FloatArray | TextArray


@dataclass(frozen=True)
class Place:
    """A part of the tested samples, and who is better there.

    Attributes:
        kind, factor, unit: what it was divided by, as in `Factor`.
        low, high: smallest and largest value in it; None where `label` names it.
        label: name; "" where it is a range.
        n_samples, n_poses: different ones that were tested.
        mean_a, mean_b: mean length of the error, m.
        estimate: over its poses, with the fitted models held fixed; its p-value is corrected for
            all places that were looked at.
        verdict: of the estimate.
    """

    kind: Kind
    factor: str
    unit: str
    low: float | None
    high: float | None
    label: str
    n_samples: int
    n_poses: int
    mean_a: float
    mean_b: float
    estimate: Estimate
    verdict: Verdict

    @property
    def difference(self) -> float:
        """A less B, m; negative where A is better."""
        return self.mean_a - self.mean_b


@dataclass(frozen=True)
class Where:
    """What was found.

    Attributes:
        places: of the division that explains most, kind by kind.
        n_places: how many places of all divisions were looked at.
        a_better, b_better: in how many of them the verdict is so.
    """

    places: tuple[Place, ...]
    n_places: int
    a_better: int
    b_better: int


def where_better(
    rows: IntArray, a: FloatArray, b: FloatArray, data: StoredData, question: Question
) -> Where:
    """Look for the places where the mean length of the error differs.

    A division counts if it has several parts and `FEWEST_POSES` in each.

    Args:
        rows: (n,) row numbers in the data set that were tested.
        a: (n,) lengths of A's error there, m.
        b: the same of B.
        data: the samples, their loads and TCP positions.
        question: what is asked of each place.
    """
    divisions = [
        parts
        for factor in factors(data)
        if len(parts := list(_parts(factor, rows, a, b, data))) > 1
        and min(len(part.a.poses) for part in parts) >= FEWEST_POSES
    ]
    every = [part for parts in divisions for part in parts]
    estimates = corrected([estimates_over_poses(one.a, one.b, question)[0] for one in every])
    verdicts = [decide([estimate], question.confidence) for estimate in estimates]
    strongest: dict[Kind, list[_Part]] = {}  # kind -> the division that explains most
    for parts in divisions:
        best = strongest.setdefault(parts[0].factor.kind, parts)
        if _explained(parts) > _explained(best):
            strongest[parts[0].factor.kind] = parts
    shown = [part for parts in strongest.values() for part in parts]
    numbers = [every.index(part) for part in shown]
    return Where(
        places=tuple(_place(every[n], rows, estimates[n], verdicts[n]) for n in numbers),
        n_places=len(every),
        a_better=verdicts.count("a"),
        b_better=verdicts.count("b"),
    )


def factors(data: StoredData) -> list[Factor]:
    """Return what the samples of a data set are divided by."""
    x, y, z = data.tcp.T
    force, torque = data.samples.wrench[:, :3], data.samples.wrench[:, 3:]
    return [
        Factor("pose region", "part of the plan", "", data.samples.group),
        Factor("pose region", "TCP reach (from the base's z axis)", "m", np.hypot(x, y)),
        Factor("pose region", "TCP height", "m", z),
        Factor("load", "force", "N", np.linalg.norm(force, axis=1)),
        Factor("load", "torque at the TCP", "Nm", np.linalg.norm(torque, axis=1)),
        *(
            Factor("joint torque", f"torque on {name}", unit, np.abs(data.torque[:, joint]))
            for joint, (name, unit) in enumerate(
                zip(data.joint_names, data.torque_units, strict=True)
            )
        ),
    ]


@dataclass(frozen=True, eq=False)
class _Part:
    """The tested rows of one place, by number in the list of tested rows, and its poses' errors."""

    factor: Factor
    label: str
    chosen: IntArray
    a: PoseErrors
    b: PoseErrors


def _parts(
    factor: Factor, rows: IntArray, a: FloatArray, b: FloatArray, data: StoredData
) -> Iterator[_Part]:
    values = factor.values[rows]
    if factor.unit:
        different = factor.values[np.unique(rows)].astype(np.float64)
        if np.ptp(different) < LEAST_SPREAD * np.abs(different).max():
            return  # such as one force at all poses, to the digits of its file
        edges = np.quantile(different, np.arange(1, PARTS) / PARTS)
        names = np.searchsorted(edges, values).astype(np.str_)
    else:
        names = values.astype(np.str_)
    for name in np.unique(names):
        chosen = np.flatnonzero(names == name)
        pose_id = data.samples.pose_id[rows[chosen]]
        of_a, of_b = (pose_errors(pose_id, errors[chosen][:, None]) for errors in (a, b))
        yield _Part(factor, "" if factor.unit else str(name), chosen, of_a, of_b)


def _explained(parts: Sequence[_Part]) -> float:
    """Return which share (0..1) of the poses' differences' variance lies between the parts."""
    differences = [pose_differences(part.a, part.b)[:, 0] for part in parts]
    together = np.concatenate(differences)
    total = float(((together - together.mean()) ** 2).sum())
    between = sum(len(one) * (one.mean() - together.mean()) ** 2 for one in differences)
    return float(between / total) if total > 0.0 else 0.0


def _place(part: _Part, rows: IntArray, estimate: Estimate, verdict: Verdict) -> Place:
    factor, tested = part.factor, rows[part.chosen]
    values = factor.values[tested]
    return Place(
        kind=factor.kind,
        factor=factor.name,
        unit=factor.unit,
        low=float(values.min()) if factor.unit else None,
        high=float(values.max()) if factor.unit else None,
        label=part.label,
        n_samples=len(np.unique(tested)),
        n_poses=len(part.a.poses),
        mean_a=float(part.a.mean[0]),
        mean_b=float(part.b.mean[0]),
        estimate=estimate,
        verdict=verdict,
    )
