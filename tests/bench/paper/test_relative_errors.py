"""Errors relative to the VJM's, and how far the orders of the models agree."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from seaborn.utils import relative_luminance

from helpers.made_results import MadeResults
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.paper.relative_errors import RelativeErrors, mean_errors
from stiff_bench.paper.study_file import Study, StudyRun
from stiff_protocols.contract.errors import StoreError

ARMS = ("arm 0", "arm 1", "arm 2")
STUDY = Study(
    name="s",
    title="t",
    run=(StudyRun(models=("vjm",), datasets=("arms",)),),
    groups={"plain": ("plain",), "rough": ("rough",), "arms": ARMS, "other": ("other",)},
    sort_by="rough",
    table_notes=("a note",),
    orders={"plain": "default", "rough": "rough", "arms": "many arms"},
)


def relative(study=STUDY, **ratios):
    """Errors of models relative to the VJM's 0.2 mm on plain, rough and the arms."""
    rows = {"vjm": [1.0] * 5} | ratios
    errors = pd.DataFrame(2e-4 * np.array([*rows.values()]), [*rows], ["plain", "rough", *ARMS])
    return RelativeErrors(study, errors)


def cells_of(table):
    """Row -> column -> cell."""
    heads = [column.name for column in table.columns[1:]]
    return {row[0]: dict(zip(heads, row[1:], strict=True)) for row in table.rows}


def test_a_group_is_a_column_with_mean_and_spread_of_the_errors_relative_to_the_vjms():
    table = relative(gp=[0.5, 0.8, 0.2, 0.4, 0.6]).table()
    rows = cells_of(table)
    assert [*rows] == ["gp", "vjm"]  # the best on the rough one first
    assert [*rows["gp"]] == ["plain", "rough", "arms"]  # "other" has no results
    assert rows["gp"]["plain"].value == pytest.approx(0.5) and rows["gp"]["plain"].n is None
    arms = rows["gp"]["arms"]
    assert (arms.value, arms.spread, arms.n) == (pytest.approx(0.4), pytest.approx(0.2), 3)
    assert rows["vjm"]["arms"].value == 1.0
    assert table.notes == [
        "3-D error of the VJM [mm]: plain 0.200, rough 0.200, arms 0.200.",
        "a note",
    ]


def test_a_model_without_a_result_on_a_group_has_a_dash_and_no_place_in_the_orders():
    errors = relative(gp=[0.5, 0.8, np.nan, np.nan, np.nan])
    assert cells_of(errors.table())["gp"]["arms"] is None
    assert errors.orders.index.tolist() == ["vjm"]


def test_tau_is_one_for_the_same_order_and_minus_one_for_the_other_way_round():
    made = relative(
        a=[0.2, 0.3, 2.0, 2.0, 2.0],
        b=[0.4, 0.5, 1.5, 1.5, 1.5],
        oracle=[0.01, 2.0, 0.01, 0.01, 0.01],  # no model
    )
    table = made.agreement()
    tau = cells_of(table)
    assert "3 models" in table.title
    assert tau["default"]["rough"] == 1.0
    assert tau["rough"]["many arms"] == tau["many arms"]["rough"] == -1.0


def test_without_the_vjm_there_is_nothing_to_be_relative_to(tmp_path):
    made = MadeResults(tmp_path)
    made.add_run("run-1", made.add("gp", [0.1]))
    with pytest.raises(StoreError, match="no result of vjm"):
        mean_errors(StoredResults.read(tmp_path))


def test_the_heat_table_has_the_ratios_in_cells_coloured_alike_for_a_ratio_and_its_inverse():
    made = relative(gp=[0.5, 0.8, 0.2, 0.4, 0.6], worse=[2.0, 2.0, np.nan, np.nan, np.nan])
    axes, _ = made.figure().draw().axes
    rows = [label.get_text() for label in axes.get_yticklabels()]
    groups = [label.get_text() for label in axes.get_xticklabels()]
    assert (rows, groups) == (["gp", "vjm", "worse"], ["plain", "rough", "arms"])
    numbers = [number.get_text() for number in axes.texts]
    assert numbers == ["0.50", "0.80", "0.40", "1.00", "1.00", "1.00", "2.00", "2.00"]
    (cells,) = axes.collections
    low, high = cells.get_clim()
    assert low == -high
    np.testing.assert_allclose(cells.get_array()[0][0], -cells.get_array()[2][0])


def test_every_number_of_the_heat_table_has_a_contrast_of_at_least_4_5_to_its_cell():
    made = relative(**{f"m{step}": [0.2 * 1.15**step] * 5 for step in range(25)})
    axes, _ = made.figure().draw().axes
    colors = axes.collections[0].get_facecolor()
    for number, color in zip(axes.texts, colors, strict=True):
        light, dark = sorted(map(relative_luminance, (number.get_color(), color)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.5
