"""Compare A and B in subgroups of the samples: pose regions, loads, joint torques.

Each factor divides the tested samples into three subgroups ("places") of about equal size; parts of
the measurement plan are not divided. There are dozens of places, so their p-values are corrected
for each other (Holm). For each kind of factor, the division that explains most of the differences
between poses is reported.
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
"""Smallest range of a divided factor, relative to its largest value."""
PARTS = 3
FEWEST_POSES = 11
"""Fewest poses per part. With n poses the smallest p of the signed-rank test is 2/2^n. After the
correction for about 30 places it is below 0.05 from 11 poses on."""


@dataclass(frozen=True, eq=False)
class Factor:
    """A quantity that every sample of a data set has.

    Attributes:
        kind: kind of factor.
        name: printed name, e.g. "torque on A2".
        unit: "m", "N", "Nm", or "" for names.
        values: (n,) in that unit, or names.
    """

    kind: FactorKind
    name: str
    unit: str
    values: FloatArray | TextArray


@dataclass(frozen=True, eq=False)
class Place:
    """A subgroup of the tested samples, with the verdict on A and B there.

    Attributes:
        factor: factor that defines the subgroup.
        values: smallest and largest value of the factor there, or its name there.
        n_samples: number of different samples.
        errors: lengths of the errors of A and of B on its poses, m.
        estimate: estimate over its poses, with the fitted models held fixed; the p-value is
            corrected for all tested places.
        verdict: verdict of the estimate.
    """

    factor: Factor
    values: tuple[float, float] | str
    n_samples: int
    errors: PoseErrors
    estimate: Estimate
    verdict: Verdict = "open"

    @property
    def means(self) -> tuple[float, float]:
        """Return the mean lengths of the errors of A and of B, m."""
        a, b = self.errors.mean.tolist()
        return a, b


def where_better(
    a: Sequence[CellResult], b: Sequence[CellResult], data: StoredData, question: Question
) -> list[Place]:
    """Return all places with verdicts on their mean length of the error.

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
        replace(place, estimate=estimate, verdict=decide([estimate], question.confidence))
        for place, estimate in zip(every, for_all, strict=True)
    ]


def best_divisions(places: Sequence[Place]) -> list[Place]:
    """Return the places of the best explaining division of each kind."""
    divisions = grouped(places, lambda place: place.factor).values()
    of_kinds = grouped(divisions, lambda division: division[0].factor.kind).values()
    return [place for of_kind in of_kinds for place in max(of_kind, key=_explained)]


def factors(data: StoredData) -> list[Factor]:
    """Return the factors that divide the samples of a data set."""
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
    """Return the places without correction; none unless several have `FEWEST_POSES`."""
    values = factor.values[rows]
    names = values.astype(np.str_)
    if factor.unit:
        different = factor.values[np.unique(rows)].astype(np.float64)
        if np.ptp(different) < LEAST_SPREAD * np.abs(different).max():
            return []  # for example the same force at all poses, apart from rounding
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
    """Return the share (0..1) of the variance of differences that is between the parts."""
    differences = [part.errors.differences(0, 1) for part in parts]
    together = np.concatenate(differences)
    total = float(((together - together.mean()) ** 2).sum())
    between = sum(len(part) * (part.mean() - together.mean()) ** 2 for part in differences)
    return float(between / total) if total > 0.0 else 0.0
