"""The paper's regression diagrams: Figures 4, 8 and 9."""

from __future__ import annotations

import warnings
from functools import partial

import numpy as np

from stiff_bench.figures.figure import Content
from stiff_bench.figures.samples import SHARE, Series, regression_figure
from stiff_bench.figures.source import Predicted, pooled
from stiff_bench.paper.names import DT_CNN, FT_MLP, VJM
from stiff_bench.paper.network_figures import DATA, paper_setting
from stiff_bench.paper.results import PaperResults, SharedSplits, shared_splits
from stiff_bench.paper.study import DATASET, PAPER_PROTOCOL, SEED
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import loaded
from stiff_bench.tables.published import published_rows
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StiffBenchWarning, StoreError
from stiff_protocols.contract.types import AXES

_LINES = (
    f"Grey: identity; coloured lines: identity ± the error that {SHARE:.0%} of the samples keep."
)
_METHODS = {VJM: "VJM", FT_MLP: "FT-MLP", DT_CNN: "DT-CNN"}
"""Names in the published tables."""


def figure_4(_: PaperResults) -> Content:
    """Fit the VJM to all samples and predict them: no stored result is needed."""
    registry = build_registry()
    data = loaded(Choice.of(registry.datasets[DATASET]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)
        model = registry.model(VJM).load()().fit(data.samples, robot=data.robot, seed=SEED)
    samples = data.samples
    tested = Predicted(
        rows=np.arange(len(samples)),
        measured=samples.deflection,
        predicted=model.predict(samples.q, samples.wrench),
    )
    caption = (
        f"The paper's Figure 4: measured deflection against that of the linear VJM ({VJM}), fitted "
        f"to the same {len(samples)} samples that are shown (in sample, no split). Data: {DATA}. "
        f"{_LINES} Beside our MAE: the paper's (its Table 2)."
    )
    series = [Series(VJM, tested, _published("table_2", VJM))]
    return Content(caption, partial(regression_figure, series))


def figure_8(results: PaperResults) -> Content:
    """Take DT-CNN's test samples."""
    series, shared = _tested(results, (DT_CNN,))
    caption = (
        f"The paper's Figure 8: measured deflection against that of {DT_CNN}, of the test samples "
        f"of all splits together. {_setting(shared)} {_LINES} Beside our MAE: the paper's (its "
        "Table 10, of its own measurements)."
    )
    return Content(caption, partial(regression_figure, series))


def figure_9(results: PaperResults) -> Content:
    """Take the test samples of FT-MLP and the VJM."""
    series, shared = _tested(results, (FT_MLP, VJM))
    caption = (
        f"The paper's Figure 9: measured deflection against that of {FT_MLP} and of {VJM}, of the "
        f"test samples of all splits together. {_setting(shared)} {_LINES} Beside our MAE: the "
        "paper's (its Table 10, of its own measurements)."
    )
    return Content(caption, partial(regression_figure, series, overlaid=True))


def _tested(results: PaperResults, models: tuple[str, ...]) -> tuple[list[Series], SharedSplits]:
    """Return the models' test samples on the splits that all have, and their results.

    Raises:
        StoreError: a model has no result.
    """
    shared = shared_splits(results, models, PAPER_PROTOCOL)
    lacking = [*shared.missing, *shared.failures]
    if lacking:
        why = "; ".join(shared.failures.values()) or "not run"
        raise StoreError(
            f"--results {results.folder}: no result of {', '.join(lacking)} on {DATASET} under "
            f"{PAPER_PROTOCOL}: {why}; `bench reproduce` makes it"
        )
    series = [
        Series(name, pooled(found), _published("table_10", name))
        for name, found in shared.results.items()
    ]
    return series, shared


def _setting(shared: SharedSplits) -> str:
    return " ".join([paper_setting(shared.results), *shared.absences()])


def _published(table: str, model: str) -> tuple[float, ...]:
    """Return a method's published mean absolute errors along x, y and z, m."""
    row = next(row for row in published_rows(table) if row.method == _METHODS[model])
    return tuple(row.values_mm["mae", axis] / MM for axis in AXES)
