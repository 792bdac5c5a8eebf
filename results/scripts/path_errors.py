"""Compare the error left on tool paths with the error of the predictions there.

`python results/scripts/path_errors.py` prints the table of docs/findings.md: the 12 simulated
robots of the leaderboard in their four ways, the first split (a quarter of an hour of one core).
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy.stats import gmean
from tabulate import tabulate

import stiffbench as sb
from stiff_bench.paper.study_file import find_study
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.splits.path_compensation import HoldoutPaths

MODELS = ("vjm", "vjm-full", "vjm-multisegment", "vjm-gp", "bayes-springs")
PLACES = ("test poses", "predicted at path points", "left on the paths")


def mean_length(errors: FloatArray) -> float:
    return float(np.linalg.norm(errors, axis=1).mean())


def errors_on(dataset: str) -> list[dict[str, object]]:
    """Return the mean 3-D errors [m] of each model on one data set."""
    protocol = HoldoutPaths()
    data = protocol.prepared(sb.load_dataset(dataset).data)
    assert data.paths is not None
    (split,) = protocol.splits(data.samples, n_splits=1, seed=0)
    train = data.samples.take(np.concatenate([split.train, split.validation]))
    test, paths = data.samples.take(split.test), data.paths
    rows = []
    for key in MODELS:
        model = sb.make_model(key).fit(sb.Dataset.from_samples(train, data.robot))
        commands = protocol.path_commands(model.predict, data.robot, paths.q, paths.wrench)
        errors = (
            model.predict(test.q, test.wrench) - test.deflection,
            model.predict(paths.q, paths.wrench) - paths.deflection,
            protocol.path_errors(commands, data),
        )
        means = map(mean_length, errors)
        rows.append(
            {"robot": data.robot.name, "model": key, **dict(zip(PLACES, means, strict=True))}
        )
    return rows


def main() -> None:
    groups = find_study("leaderboard").groups
    rows = [
        {"group": name, **row}
        for name, group in groups.items()
        for data in group
        for row in errors_on(data)
    ]
    frame = pd.DataFrame(rows)
    means = frame.groupby(["group", "model"], sort=False)[[*PLACES]].agg(gmean)
    ratios = means / means.xs("vjm", level="model").reindex(means.index, level="group")
    of_path = means[PLACES[2]] / means[PLACES[1]]
    table = ratios.round(2).assign(**{"left / predicted": of_path.round(3)}).reset_index()
    print(tabulate(table, [*table.columns], tablefmt="github", showindex=False))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
