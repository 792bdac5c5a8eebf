"""Two competitors over several data sets of one robot type."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.comparison import NORM, Comparison
from stiff_bench.estimates import Verdict
from stiff_bench.grouped import grouped
from stiff_bench.same_robot import dataset_of, family_of
from stiff_protocols.paired import wilcoxon_signed_rank
from stiff_protocols.ranks import FEWEST_DATASETS


@dataclass(frozen=True)
class Across:
    """A and B over several data sets of one robot type, under one protocol and condition.

    Attributes:
        family: the data sets' name without their specimen.
        protocol, condition, seed: shared.
        verdicts: of the mean length of the error, one a data set; "open" where repeats of one
            data set disagree.
        of_fits: a verdict among them is of fitted models alone (one split, or all scored together).
        mean_difference: over the data sets, A less B, m.
        p_value: Wilcoxon over the data sets' differences; None where they are too few.
        selects_on_test: the protocol lets models choose on the test part.
    """

    family: str
    protocol: str
    condition: str
    seed: int
    verdicts: tuple[Verdict, ...]
    of_fits: bool
    mean_difference: float
    p_value: float | None
    selects_on_test: bool


def across_datasets(comparisons: Sequence[Comparison]) -> list[Across]:
    """Sum up over the data sets of one robot type, wherever there are several.

    Splits of one data set are never counted as data sets, nor are repeats of it with another seed,
    whose differences are averaged. Where one name stands for different data, there is no sum.
    """
    found = []
    for key, group in grouped(comparisons, _setting).items():
        by_dataset = grouped(group, lambda one: dataset_of(one.name.dataset))
        unambiguous = len({one.name.dataset for one in group}) == len(group)
        if len(by_dataset) > 1 and unambiguous:
            found.append(_across(key, list(by_dataset.values())))
    return found


def _setting(comparison: Comparison) -> tuple[str, str, str, int]:
    """Return what data sets that are summed up share."""
    name = comparison.name
    return family_of(name.dataset), name.protocol, name.condition, name.seed


def _across(key: tuple[str, str, str, int], datasets: Sequence[Sequence[Comparison]]) -> Across:
    differences = [
        float(np.mean([one.row(NORM).difference for one in repeats])) for repeats in datasets
    ]
    return Across(
        *key,
        verdicts=tuple(_common_verdict(repeats) for repeats in datasets),
        of_fits=not all(one.over_splits for repeats in datasets for one in repeats),
        mean_difference=float(np.mean(differences)),
        p_value=wilcoxon_signed_rank(differences) if len(datasets) >= FEWEST_DATASETS else None,
        selects_on_test=any(one.selects_on_test for repeats in datasets for one in repeats),
    )


def _common_verdict(repeats: Sequence[Comparison]) -> Verdict:
    first, *others = [one.row(NORM).verdict for one in repeats]
    return first if all(other == first for other in others) else "open"
