"""Where is A better than B? Regions of the workspace, sizes of the load, torques on the joints.

Each of these divides the tested samples into three places of about equal number (a part of the
measurement plan stays one). There are dozens, so their p-values are corrected for one another
(Holm). Of each kind the division that explains most of the differences between poses is shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiff_bench.analysis.verdict import (
    Estimate,
    Question,
    SharedErrors,
    Verdict,
    corrected,
    decide,
    estimates,
)
from stiff_bench.store.names import grouped
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.metric_table import pooled_prediction
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray, IntArray, TextArray
from stiff_protocols.scoring.bootstrap import PoseErrors, pose_errors
from stiff_protocols.scoring.metrics import norm_errors

FactorKind = Literal["pose region", "load", "joint torque"]
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

    kind: FactorKind
    name: str
    unit: str
    values: FloatArray | TextArray


@dataclass(frozen=True, eq=False)
class Place:
    """The tested samples that a factor divides from the others, and who is better there.

    Attributes:
        factor: what they were divided by.
        values: the factor's smallest and largest value there, or the name that all of them have.
        n_samples: different ones.
        errors: lengths of A's errors on their poses, and of B's, m.
        estimate: over its poses, with the fitted models held fixed; its p-value is corrected for
            all places that were looked at.
        verdict: of the estimate.
    """

    factor: Factor
    values: tuple[float, float] | str
    n_samples: int
    errors: PoseErrors
    estimate: Estimate
    verdict: Verdict = "open"

    @property
    def means(self) -> tuple[float, float]:
        """Mean length of A's error, and of B's, m."""
        a, b = self.errors.mean.tolist()
        return a, b


def where_better(
    a: Sequence[CellResult], b: Sequence[CellResult], data: StoredData, question: Question
) -> list[Place]:
    """Return all places, with the verdict on the mean length of the error in each.

    `a` and `b` are results on the same splits.
    """
    of_a, of_b = map(pooled_prediction, (a, b))
    lengths = np.column_stack([norm_errors(of_a), norm_errors(of_b)])  # (n, 2) m
    every = [
        place
        for factor in factors(data)
        for place in _divided(factor, of_a.rows, lengths, data.samples.pose_id, question)
    ]
    for_all = corrected([place.estimate for place in every])
    return [
        replace(place, estimate=one, verdict=decide([one], question.confidence))
        for place, one in zip(every, for_all, strict=True)
    ]


def telling(places: Sequence[Place]) -> list[Place]:
    """Return the places of the division that explains most, kind by kind."""
    divisions = grouped(places, lambda place: place.factor).values()
    of_kinds = grouped(divisions, lambda division: division[0].factor.kind).values()
    return [place for of_kind in of_kinds for place in max(of_kind, key=_explained)]


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
                zip(data.robot.joint_names, data.torque_units, strict=True)
            )
        ),
    ]


def _divided(
    factor: Factor,
    rows: IntArray,
    lengths: FloatArray,
    pose_id: TextArray,
    question: Question,
) -> list[Place]:
    """Return the places, not corrected; none unless there are several of `FEWEST_POSES` each."""
    values = factor.values[rows]
    names = values.astype(np.str_)
    if factor.unit:
        different = factor.values[np.unique(rows)].astype(np.float64)
        if np.ptp(different) < LEAST_SPREAD * np.abs(different).max():
            return []  # such as one force at all poses, to the digits of its file
        edges = np.quantile(different, np.arange(1, PARTS) / PARTS)
        names = np.searchsorted(edges, values).astype(np.str_)
    parts = [(str(name), names == name) for name in np.unique(names)]
    fewest = min(len(np.unique(pose_id[rows[chosen]])) for _, chosen in parts)
    if len(parts) < 2 or fewest < FEWEST_POSES:
        return []
    places = []
    for name, chosen in parts:
        of_poses = pose_errors(pose_id[rows[chosen]], lengths[chosen])
        inside = values[chosen]
        ends = (float(inside.min()), float(inside.max())) if factor.unit else name
        errors = SharedErrors(None, 0.0, of_poses, question.seed)
        ((estimate,),) = estimates(errors, [(0, 1)], question)
        n_samples = len(np.unique(rows[chosen]))
        places.append(Place(factor, ends, n_samples, of_poses, estimate))
    return places


def _explained(parts: Sequence[Place]) -> float:
    """Return which share (0..1) of the poses' differences' variance lies between the parts."""
    differences = [part.errors.differences(0, 1) for part in parts]
    together = np.concatenate(differences)
    total = float(((together - together.mean()) ** 2).sum())
    between = sum(len(one) * (one.mean() - together.mean()) ** 2 for one in differences)
    return float(between / total) if total > 0.0 else 0.0
