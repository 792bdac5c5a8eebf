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
from stiff_bench.store.names import grouped
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


@dataclass(frozen=True, eq=False)
class Part:
    """The tested samples that a factor divides from the others.

    Attributes:
        factor: what they were divided by.
        label: names them; "" where they are a range.
        low, high: smallest and largest value of the factor; None where `label` names them.
        n_samples: different ones.
        a, b: lengths of the errors on their poses, m, in one column.
    """

    factor: Factor
    label: str
    low: float | None
    high: float | None
    n_samples: int
    a: PoseErrors
    b: PoseErrors

    @property
    def mean_a(self) -> float:
        """Mean length of A's error, m."""
        return float(self.a.mean[0])

    @property
    def mean_b(self) -> float:
        """Mean length of B's error, m."""
        return float(self.b.mean[0])

    @property
    def difference(self) -> float:
        """A less B, m; negative where A is better."""
        return self.mean_a - self.mean_b


@dataclass(frozen=True, eq=False)
class Place(Part):
    """A part, and who is better there.

    Attributes:
        estimate: over its poses, with the fitted models held fixed; its p-value is corrected for
            all places that were looked at.
        verdict: of the estimate.
    """

    estimate: Estimate
    verdict: Verdict


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
    divisions = [[*_parts(factor, rows, a, b, data)] for factor in factors(data)]
    every = [
        part
        for parts in divisions
        if len(parts) > 1 and min(len(part.a.poses) for part in parts) >= FEWEST_POSES
        for part in parts
    ]
    estimates = corrected([estimates_over_poses(one.a, one.b, question)[0] for one in every])
    places = [
        Place(**vars(part), estimate=one, verdict=decide([one], question.confidence))
        for part, one in zip(every, estimates, strict=True)
    ]
    of_factors = grouped(places, lambda place: place.factor).items()
    of_kinds = grouped(of_factors, lambda division: division[0].kind).values()
    strongest = [max((parts for _, parts in of_kind), key=_explained) for of_kind in of_kinds]
    verdicts = [place.verdict for place in places]
    return Where(
        places=tuple(place for parts in strongest for place in parts),
        n_places=len(places),
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


def _parts(
    factor: Factor, rows: IntArray, a: FloatArray, b: FloatArray, data: StoredData
) -> Iterator[Part]:
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
        chosen = names == name
        pose_id = data.samples.pose_id[rows[chosen]]
        yield Part(
            factor,
            label="" if factor.unit else str(name),
            low=float(values[chosen].min()) if factor.unit else None,
            high=float(values[chosen].max()) if factor.unit else None,
            n_samples=len(np.unique(rows[chosen])),
            a=pose_errors(pose_id, a[chosen][:, None]),
            b=pose_errors(pose_id, b[chosen][:, None]),
        )


def _explained(parts: Sequence[Part]) -> float:
    """Return which share (0..1) of the poses' differences' variance lies between the parts."""
    differences = [pose_differences(part.a, part.b)[:, 0] for part in parts]
    together = np.concatenate(differences)
    total = float(((together - together.mean()) ** 2).sum())
    between = sum(len(one) * (one.mean() - together.mean()) ** 2 for one in differences)
    return float(between / total) if total > 0.0 else 0.0
