"""The studies of other physics and of simulated data: errors relative to the VJM's, and orders."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from helpers.made_results import MadeResults
from stiff_bench.paper import effects
from stiff_bench.paper.study import ARMS, BEAM, EFFECT_STEPS, TRANSFER_DATA, transfer_study
from stiff_bench.store.database import ResultStore
from stiff_protocols.contract.errors import StoreError

STEPS = [variant.name for variant in EFFECT_STEPS.values()]
EVERYWHERE = [*STEPS, BEAM.name, *(arm.name for arm in ARMS)]
SPECIMENS = [one.name for one in TRANSFER_DATA["default"]]


def errors(**relative):
    """Errors [m], of which those of all but the VJM are given relative to its 0.2 mm.

    The last number stands for all data sets that come after.
    """
    rows = {"vjm": [1.0]} | relative
    n = len(EVERYWHERE)
    values = [2e-4 * np.array([*row, *[row[-1]] * (n - len(row))]) for row in rows.values()]
    return pd.DataFrame(values, index=[*rows], columns=EVERYWHERE)


def cells_of(table):
    """Row -> column -> cell."""
    heads = [column.name for column in table.columns[1:]]
    return {row[0]: dict(zip(heads, row[1:], strict=True)) for row in table.rows}


def test_errors_are_relative_to_the_vjms_and_the_arms_are_one_column():
    made = errors(gp=[0.5] * 7 + [0.8])
    made.loc["gp", ARMS[0].name] = 1e-4
    rows = cells_of(effects.effects_table(made))
    assert [*rows] == ["gp", "vjm"]  # best on the rough twin first
    assert [*rows["gp"]][-2:] == ["beam", "arms"]
    assert rows["vjm"]["default"].value == 1.0
    assert rows["gp"]["default"].value == pytest.approx(0.5)
    arms, ratios = rows["gp"]["arms"], [0.5, *[0.8] * 9]
    assert (arms.value, arms.n) == (pytest.approx(np.mean(ratios)), 10)
    assert arms.spread == pytest.approx(np.std(ratios, ddof=1))


def test_what_was_not_computed_has_no_column():
    made = errors(gp=[0.5]).drop(columns=[arm.name for arm in ARMS])
    assert effects.effects_table(made).columns[-1].name == "beam"
    assert set(effects.orders(made)) == {"default", "rough", "beam"}


def test_tau_is_one_for_the_same_order_and_minus_one_for_the_other_way_round():
    turned = len(STEPS)  # from the beam twin on
    made = errors(
        a=[0.2] * turned + [0.9], b=[0.4], c=[0.9] * turned + [0.2], oracle=[0.01]
    )  # the last is no competitor
    made.loc["a", STEPS[1]] = np.nan  # a step that is no twin of its own does not count
    table = effects.taus_table(made)
    tau = cells_of(table)
    assert "4 models" in table.title
    assert tau["default"]["rough"] == tau["beam"]["arms"] == 1.0
    assert tau["rough"]["beam"] == tau["beam"]["rough"] == pytest.approx(0.0)


def test_a_page_with_its_picture_is_written_from_stored_results(tmp_path):
    made = MadeResults(tmp_path / "effects" / "runs")
    keys = []
    for data in [*STEPS, BEAM.name]:
        for model, error in (("vjm", 0.2), ("gp", 0.1)):
            keys += made.add(model, [error], dataset=data, protocol="holdout")
    made.add_run("run-1", keys)
    files = [*effects.write_effects(tmp_path, "bench reproduce effects", 7)]
    page = files[-1].read_text(encoding="utf-8")
    assert files[-1] == tmp_path / "effects.md" and all(file.stat().st_size for file in files)
    assert "| gp " in page and "Kendall" in page and "7 fits not computed" in page
    assert "figures/figure_effects.png" in page


def test_without_the_vjm_there_is_nothing_to_be_relative_to(tmp_path):
    made = MadeResults(tmp_path)
    made.add_run("run-1", made.add("gp", [0.1], dataset=BEAM.name, protocol="holdout"))
    with pytest.raises(StoreError, match="no result of vjm"):
        effects.stored_errors(tmp_path)


def test_of_two_versions_of_a_model_the_newest_counts_alone(tmp_path):
    made, on = MadeResults(tmp_path), {"dataset": BEAM.name, "protocol": "holdout"}
    made.add("vjm", [0.2], **on)
    (key,) = made.add("gp", [0.1], **on)
    store = ResultStore(tmp_path)
    first = store.result(key)
    measured = first.prediction.measured
    newer = replace(
        first,
        cell=replace(first.cell, model_version="2"),
        run_id="run-2",
        prediction=replace(first.prediction, predicted=measured + np.array([0.0, 0.0, 4e-4])),
    )
    store.write_cells([newer])
    errors = effects.stored_errors(tmp_path)[BEAM.name]
    assert errors["gp"] == pytest.approx(4e-4) and errors["vjm"] == pytest.approx(2e-4)


def test_the_specimens_of_a_twin_are_one_column_with_their_spread():
    columns = [*SPECIMENS, "fanuc-r2000ic"]
    tuned = [0.4, 0.5, 0.6, 0.7, 0.8, 1.5]
    made = pd.DataFrame([[1.0] * 6, tuned], index=["vjm", "ft-mlp"], columns=columns)
    rows = cells_of(effects.transfer_table(2e-4 * made))
    assert [*rows] == ["ft-mlp", "vjm"]  # the better one on the default twin
    assert [*rows["vjm"]] == ["default", "FANUC"]
    default, fanuc = rows["ft-mlp"].values()
    assert (default.value, default.n) == (pytest.approx(0.6), 5)
    assert default.spread == pytest.approx(np.std(tuned[:5], ddof=1))
    assert fanuc.value == pytest.approx(1.5) and fanuc.spread is None


def test_the_page_of_transfer_says_what_was_not_computed(tmp_path):
    made = MadeResults(tmp_path / "transfer" / "runs")
    on = {"dataset": "kr10-twin", "protocol": "holdout"}
    made.add_run(
        "run-1", [key for model in ("vjm", "ft-mlp") for key in made.add(model, [1], **on)]
    )
    *_, page = effects.write_transfer(tmp_path, "bench reproduce transfer", 12)
    text = page.read_text(encoding="utf-8")
    assert "12 fits not computed" in text and "| ft-mlp" in text


def test_models_that_share_a_pretraining_are_no_neighbours():
    """Two jobs start neighbours together, and each would make the pre-training."""
    network = {"mlp-pretrained": "mlp", "ft-mlp": "mlp", "dt-cnn": "cnn"}
    of_its_own = {"source_teacher", "alignment", "preset"}
    for run in transfer_study():
        shared = [network.get(m.key) for m in run.models if of_its_own.isdisjoint(m.options)]
        assert not any(one is not None and one == other for one, other in pairwise(shared))


def test_what_is_of_the_kr10_runs_on_the_kr10_alone():
    for run in transfer_study():
        of_the_paper = [model for model in run.models if model.options.get("preset") == "paper"]
        assert not of_the_paper or all(one.key.startswith("kr10") for one in run.datasets)
