"""Does bayes-springs find links, masses or errors of the rig where there are none?

`python results/scripts/groups_without_cause.py` prints how far each group moves the tool that has
no cause in the world clean, over the joints, for the leaderboard's 12 robots and two plans.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from tabulate import tabulate

import stiffbench as sb

RUNS = Path(__file__).parents[1] / "leaderboard/runs"
CAUSED = ("joints", "bearings", "lost motion", "load curves")
"""Groups that the gears and tilting bearings of the world clean explain."""
LEAST = 0.01


def main() -> None:
    """Print a row per group: robots and plans under 1 %, and the largest share."""
    numbers = sb.open_results(RUNS).diagnostics()
    is_clean = ~numbers["dataset"].str.contains("world=(?!clean)") & (
        numbers["dataset"].str.contains("world=clean") | ~numbers["dataset"].str.startswith("arm")
    )
    chosen = is_clean & (numbers["model"] == "bayes-springs")
    chosen &= (numbers["protocol"] == "holdout-paths") & (numbers["kind"] == "simulated")
    names = numbers["diagnostic"].str.extract(r"^contribution of ([^\[]*) \[mm\]$")[0]
    chosen &= names.notna() & ~names.str.contains("interval", na=True)
    table = numbers[chosen].assign(group=names[chosen])
    sizes = table.pivot_table(index="dataset", columns="group", values="value")
    shares = sizes.drop(columns=[*CAUSED]).div(sizes["joints"], axis="index")
    rows = pd.DataFrame(
        {
            "under 1 %": (shares < LEAST).sum(),
            "of": shares.count(),
            "largest [%]": 100.0 * shares.max(),
        }
    )
    print(tabulate(rows, headers="keys", floatfmt=("", ".0f", ".0f", ".2f")))


if __name__ == "__main__":
    main()
