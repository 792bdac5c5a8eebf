"""Predicted axial compliance against the measured breakthrough surge of real drilled holes.

`python results/scripts/drilled_holes.py` prints the tables of docs/faults.md: rank
correlations (Spearman) over all holes and within each site, of models that are fitted to the 43
measured deflections of the same robot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import pandas as pd
from scipy.stats import rankdata, spearmanr, t
from tabulate import tabulate

import stiffbench as sb
from stiff_apply.postures import axial_compliance
from stiff_datasets.measured.drilled_holes import DRILL_AXIS, FURTHER_TESTS
from stiff_protocols.contract.types import FloatArray

MODELS = ("vjm", "vjm-full", "bayes-springs")
FORCE_N = 500.0  # in the middle of the training loads
COVERAGE, SHUFFLES = 0.9, 20_000
MICROMETRES_PER_N = 1e6


def rank_correlation(holes: pd.DataFrame) -> float:
    """Return Spearman's coefficient of predicted compliance and measured surge."""
    return float(spearmanr(holes.compliance, holes.surge_mm_s).statistic)


def partial_rank_correlation(holes: pd.DataFrame) -> float:
    """Return the same without what the ranks of the feed explain."""
    design = np.column_stack([np.ones(len(holes)), rankdata(holes.feed_mm_s)])
    ranks = [rankdata(holes.compliance), rankdata(holes.surge_mm_s)]
    rests = [rank - design @ np.linalg.lstsq(design, rank, rcond=None)[0] for rank in ranks]
    return float(np.corrcoef(rests)[0, 1])


def interval_over_sites(
    sites: Sequence[pd.DataFrame], statistic: Callable[[pd.DataFrame], float]
) -> tuple[float, float]:
    """Return the percentile interval of a bootstrap that draws sites: all 256 draws of four."""
    draws = product(sites, repeat=len(sites))
    values = [statistic(pd.concat(drawn)) for drawn in draws]
    low, high = np.quantile(values, [0.5 - COVERAGE / 2.0, 0.5 + COVERAGE / 2.0])
    return float(low), float(high)


def mean_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the t interval of the mean of a few values."""
    error = np.std(values, ddof=1) / np.sqrt(len(values))
    half = t.ppf(0.5 + COVERAGE / 2.0, len(values) - 1) * error
    return float(np.mean(values) - half), float(np.mean(values) + half)


def shuffle_p(sites: Sequence[pd.DataFrame]) -> float:
    """Return the one-sided p of the mean within sites: surges are shuffled inside each site."""
    rng, chance = np.random.default_rng(0), np.zeros(SHUFFLES)
    for site in sites:
        ranks, surges = rankdata(site.compliance), rankdata(site.surge_mm_s)
        centred = ranks - ranks.mean()
        shuffled = rng.permuted(np.tile(surges - surges.mean(), (SHUFFLES, 1)), axis=1)
        chance += shuffled @ centred / (centred @ centred)
    measured = sum(map(rank_correlation, sites))
    return float((1 + (chance >= measured - 1e-9).sum()) / (SHUFFLES + 1))


def with_compliance(key: str) -> pd.DataFrame:
    """Return the holes with the compliance that a model predicts, micrometres per newton."""
    holes = sb.drilled_holes()
    model = sb.make_model(key).fit(sb.load_dataset("fanuc-r2000ic"))
    q: FloatArray = np.radians(holes[[f"q{i}_deg" for i in range(1, 7)]].to_numpy())
    compliance = axial_compliance(model, q, DRILL_AXIS, FORCE_N)
    return holes.assign(compliance=MICROMETRES_PER_N * compliance)


def main() -> None:
    """Print the tables."""
    rows, ranges = [], []
    for key in MODELS:
        holes = with_compliance(key)
        drilled = holes[holes.site != FURTHER_TESTS]
        names, sites = zip(*drilled.groupby("site"), strict=True)
        within = [rank_correlation(site) for site in sites]
        low, high = interval_over_sites(sites, rank_correlation)
        mean_low, mean_high = mean_interval(within)
        rows.append(
            [
                key,
                f"{rank_correlation(drilled):.2f} ({low:.2f}..{high:.2f})",
                f"{partial_rank_correlation(drilled):.2f}",
                *(f"{value:.1f}" for value in within),
                f"{np.mean(within):.2f} ({mean_low:.2f}..{mean_high:.2f})",
                f"{shuffle_p(sites):.2f}",
                f"{rank_correlation(holes):.2f}",
            ]
        )
        spans = (f"{site.compliance.min():.2f}..{site.compliance.max():.2f}" for site in sites)
        ranges.append([f"{key} [um/N]", *spans])
    surges = (f"{site.surge_mm_s.min():.0f}..{site.surge_mm_s.max():.0f}" for site in sites)
    feeds = (f"{site.feed_mm_s.min():.0f}..{site.feed_mm_s.max():.0f}" for site in sites)
    ranges += [["measured surge [mm/s]", *surges], ["feed [mm/s]", *feeds]]
    headers = ("20 holes", "without feed", *names, "mean of sites", "p", "28 holes")
    print(tabulate(rows, ("model", *headers), tablefmt="github", disable_numparse=True))
    print()
    print(tabulate(ranges, ("", *names), tablefmt="github", disable_numparse=True))


if __name__ == "__main__":
    main()
