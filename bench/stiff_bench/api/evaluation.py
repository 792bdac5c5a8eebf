"""Fitting and testing of models under protocols."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stiff_bench.api.catalog import registry
from stiff_bench.api.data import Dataset, check_dataset, choice_of
from stiff_bench.api.model import Model, model_choice
from stiff_bench.api.process import pinned
from stiff_bench.api.results import Results
from stiff_bench.api.run import Run
from stiff_bench.plan.options import Chosen
from stiff_bench.plan.request import plan_run, with_reference
from stiff_bench.run.runner import chosen_execution
from stiff_protocols.contract.errors import ConfigError


def evaluate(
    models: str | type | Model | Sequence[str | type | Model],
    datasets: str | Dataset | Sequence[str | Dataset] = "kr10-twin",
    *,
    protocol: str | Sequence[str] = "holdout",
    splits: int | None = None,
    seed: int = 0,
    metrics: Sequence[str] = (),
    coverage: float | None = None,
    jobs: int = 1,
    device: str = "auto",
    output: Path | str | None = None,
) -> Results:
    """Fit and test models on data sets under protocols.

    Args:
        models: names, models of `make_model` (each cell fits a new one), or classes.
        datasets: names, or data sets of `load_dataset` and `read_samples`.
        protocol: names, with their options: "kfold@folds=10".
        splits: how many; None: the protocol's own number.
        seed: of splits and models.
        metrics: keys, that the tables show; none: mae, stde and me, of tool paths norm, norm-p95,
            norm-max and removed. All are computed.
        coverage: nominal coverage of intervals, where a metric needs them; None: 0.9.
        jobs: how many cells run at once, each in a process of its own. Classes that are defined in
            a script or notebook are computed in this process.
        device: "auto", "cpu" or "cuda", where networks run.
        output: a folder that keeps the results: what it holds is not computed again. None: they
            are gone with the `Results`.

    Raises:
        ConfigError: a name, an option or a value is wrong, or `output` is to keep results of a
            class that is defined in a script or notebook: nobody could tell later what it was.
        DataError: a data set cannot be loaded.
    """
    if splits is not None and splits < 1:
        raise ConfigError(f"splits={splits}: give 1 or more, or None for the protocol's own number")
    asked = [model_choice(one, {}) for one in _listed(models)]
    local = [one for one in asked if one.cls.__module__ == "__main__"]
    if local and output is not None:
        raise ConfigError(
            f"{local[0].info.key}: a class of a script or notebook, whose results cannot be kept; "
            "leave out output=..., or define it in a file and call use_plugin(file)"
        )
    if local and jobs > 1:
        raise ConfigError(
            f"jobs={jobs}: {local[0].info.key} is a class of a script or notebook, which other "
            "processes cannot import; leave out jobs=..., or define it in a file and call "
            "use_plugin(file)"
        )
    data = [
        Dataset(choice_of("dataset", one, {})) if isinstance(one, str) else one
        for one in _listed(datasets)
    ]
    for dataset in data:
        check_dataset(dataset)
    names = [choice_of("protocol", one, {}) for one in _listed(protocol)]
    folder = Path(tempfile.mkdtemp(prefix="stiffbench-") if output is None else output)
    plan = plan_run(
        with_reference(Chosen(asked, [one.choice for one in data], names), registry()),
        registry(),
        output=folder,
        metrics=metrics,
        splits=splits,
        seed=seed,
        device=device,
        coverage=coverage,
        command="stiffbench.evaluate(...)",
    )
    isolate = False if local else None
    execution = chosen_execution(plan, registry(), threads=pinned(), jobs=jobs, isolate=isolate)
    results = Run([plan], execution).compute()
    if output is None:
        weakref.finalize(results, shutil.rmtree, folder, ignore_errors=True)
    return results


def _listed(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]
