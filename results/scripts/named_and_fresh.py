"""Compare the models' order on the board's named robots and on fresh robots.

    python results/scripts/named_and_fresh.py

It prints each model's error over the VJM's, against the true robot: on named and on fresh robots in
the worlds friction, structure and all, and on fresh robots in the world unseen; and Kendall's rank
agreement. It reads the stored results of the studies leaderboard and fresh.
"""

from pathlib import Path

import pandas as pd
from scipy.stats import kendalltau

from stiff_bench.results.load import StoredResults
from stiff_bench.results.scored_task import sort_key
from stiff_bench.results.scores import Scores, robot_logs
from stiff_protocols.scoring.over_robots import mean_ratio

WORLDS = ("friction", "structure", "all")
RESULTS = Path(__file__).parents[1]


def ratios(study: str, protocol: str, worlds: tuple[str, ...]) -> dict[str, str]:
    """Return each model's mean ratio over robots with its 95 % interval."""
    stored = StoredResults.read(RESULTS / study / "runs")
    tasks = [task for task in stored.tasks if task.name.protocol == protocol]
    rows = Scores.of(stored, sort_key("true-norm"), tasks).rows
    logs = robot_logs(rows[rows["world"].isin(worlds)], "error ratio").dropna(axis="columns")
    return {str(model): mean_ratio(logs[model]) for model in logs}


def main() -> None:
    """Print the table."""
    columns = {
        "named": ratios("leaderboard", "holdout-paths", WORLDS),
        "fresh": ratios("fresh", "holdout", WORLDS),
        "unseen": ratios("fresh", "holdout", ("unseen",)),
    }
    models = [model for model in columns["fresh"] if all(model in of for of in columns.values())]
    means = pd.DataFrame({n: {m: of[m].ratio for m in models} for n, of in columns.items()})
    texts = {
        name: {m: f"{of[m].ratio:.2f} ({of[m].low:.2f} to {of[m].high:.2f})" for m in models}
        for name, of in columns.items()
    }
    print(pd.DataFrame(texts).loc[means.sort_values("named").index].to_string())
    for side in ("fresh", "unseen"):
        tau = kendalltau(means["named"], means[side])
        print(f"Kendall's tau of named and {side}: {tau.statistic:.2f} ({len(models)} models)")


if __name__ == "__main__":
    main()
