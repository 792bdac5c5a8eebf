"""The study of other physics: errors relative to the VJM's, and how alike the orders are."""

from __future__ import annotations

import numpy as np
import pytest

from made_results import MadeResults
from stiff_bench.paper.effects import (
    effects_table,
    orders,
    stored_errors,
    taus_table,
    write_effects,
)
from stiff_bench.paper.study import ARMS, BEAM, EFFECT_STEPS
from stiff_protocols.contract.errors import StoreError

STEPS = [variant.name for variant in EFFECT_STEPS.values()]
EVERYWHERE = [*STEPS, BEAM.name, *(arm.name for arm in ARMS)]


def errors(vjm, **others):
    """Model -> data set -> error [m]; `others` are relative to the VJM's."""
    found = {"vjm": dict.fromkeys(EVERYWHERE, vjm)}
    return found | {
        name: {data: vjm * ratio[min(i, len(ratio) - 1)] for i, data in enumerate(EVERYWHERE)}
        for name, ratio in others.items()
    }


def test_errors_are_relative_to_the_vjms_and_the_arms_are_one_column():
    made = errors(2e-4, gp=[0.5] * 7 + [0.8])
    made["gp"][ARMS[0].name] = 1e-4
    table = effects_table(made)
    assert [column.name for column in table.columns[-2:]] == ["beam", "arms"]
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["vjm"][0].value == 1.0 and rows["gp"][0].value == pytest.approx(0.5)
    arms = rows["gp"][-1]
    ratios = [0.5, *[0.8] * 9]
    assert (arms.value, arms.n) == (pytest.approx(np.mean(ratios)), 10)
    assert arms.spread == pytest.approx(np.std(ratios, ddof=1))
    assert [row[0] for row in table.rows] == ["gp", "vjm"]  # best on the rough twin first


def test_what_was_not_computed_has_no_column():
    made = errors(2e-4, gp=[0.5])
    for of in made.values():
        for arm in ARMS:
            del of[arm.name]
    assert effects_table(made).columns[-1].name == "beam"
    assert set(orders(made)) == {"default", "rough", "beam"}


def test_tau_is_one_for_the_same_order_and_minus_one_for_the_other_way_round():
    turned = len(STEPS)  # from the beam twin on
    made = errors(
        1e-4, a=[0.2] * turned + [0.9], b=[0.4] * turned + [0.4], c=[0.9] * turned + [0.2]
    )
    del made["a"][STEPS[1]]  # a step that is no twin of its own does not count
    made["oracle"] = dict.fromkeys(EVERYWHERE, 1e-6)  # no competitor
    table = taus_table(made)
    tau = {
        row[0]: dict(zip([c.name for c in table.columns[1:]], row[1:], strict=True))
        for row in table.rows
    }
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
    files = [*write_effects(tmp_path, "bench reproduce effects", 7)]
    page = files[-1].read_text(encoding="utf-8")
    assert files[-1] == tmp_path / "effects.md" and all(file.stat().st_size for file in files)
    assert "| gp " in page and "Kendall" in page and "7 fits" in page
    assert "figures/figure_effects.png" in page


def test_without_the_vjm_there_is_nothing_to_be_relative_to(tmp_path):
    made = MadeResults(tmp_path)
    made.add_run("run-1", made.add("gp", [0.1], dataset=BEAM.name, protocol="holdout"))
    with pytest.raises(StoreError, match="no result of vjm"):
        stored_errors(tmp_path)
