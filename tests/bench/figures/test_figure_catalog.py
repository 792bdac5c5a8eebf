"""Every general figure: drawn at a journal's size, or refused with the command to run."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from helpers.figure_results import compared, learned, with_fields
from stiff_bench.figures import losses
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.style import COLUMN_INCH
from stiff_bench.results.selection import Selection
from stiff_protocols.contract.errors import ConfigError, StoreError

NEEDS = {
    "losses": "`bench run --model ft-mlp`",
    "sweep": "`bench reproduce paper`",
    "freezing": "`bench reproduce paper`",
    "learning-curves": "`bench run --protocol sample-efficiency",
    "springs": "`bench run --model vjm --model bayes-springs`",
    "what-bends": "`bench run --model bayes-springs`",
    "calibration": "`bench run --metric coverage`",
}
"""Figure that predictions of one robot cannot show -> command that makes it possible."""
SEVEN = ("vjm", "gp", "mlp", "a", "b", "c", "d")


def caption_of(name, source: FigureSource) -> str:
    return FIGURES[name](source).caption


@pytest.mark.parametrize("name", FIGURES)
def test_predictions_of_one_robot_show_a_figure_or_the_command_that_makes_it_possible(
    name, tmp_path
):
    compared(tmp_path)
    source = FigureSource.of(tmp_path)
    if name not in NEEDS:
        assert FIGURES[name](source).title
        return
    with pytest.raises((ConfigError, StoreError)) as refused:
        FIGURES[name](source)
    assert NEEDS[name] in str(refused.value) and str(tmp_path) in str(refused.value)


@pytest.mark.slow
def test_a_picture_is_reproducible_as_wide_as_a_column_and_names_data_and_models(tmp_path):
    """At 300 dots per inch; a name is drawn as it is written."""
    compared(tmp_path)
    picture = FIGURES["scores"](FigureSource.of(tmp_path)).picture
    png, svg = picture(".png"), picture(".svg")
    assert (png, svg) == (picture(".png"), picture(".svg"))
    assert struct.unpack(">I", png[16:20])[0] == pytest.approx(300 * COLUMN_INCH, abs=1)
    text = svg.decode()
    assert "twin (simulated), holdout" in text
    assert "$x_1$ &lt;b&gt;" in text and "<b>" not in text


def test_an_unknown_model_and_models_without_a_common_split_are_refused(tmp_path):
    made = compared(tmp_path)
    with pytest.raises(ConfigError, match="'nobody'"):
        caption_of("regression", FigureSource.of(tmp_path, Selection(models=("nobody",))))
    made.add("late", [0.1, 0.1], failed=[0, 1])
    made.add("later", [0.0, 0.0, 0.1], failed=[0, 1])
    with pytest.raises(StoreError, match="no split on which all have a result"):
        caption_of("errors", FigureSource.of(tmp_path, Selection(models=("later", "gp"))))


def test_a_fair_protocol_comes_before_one_that_picks_on_the_test_part(tmp_path):
    made = compared(tmp_path)
    made.add("extra", [0.1])
    for name in SEVEN:
        made.add(name, [0.1], protocol="paper-holdout", selects_on_test=True)
    assert FigureSource.of(tmp_path).compared(1).task.name.protocol == "holdout"


def test_a_protocol_that_reports_training_rows_is_drawn_only_without_other_results(tmp_path):
    made = compared(tmp_path)
    for name in SEVEN:
        made.add(name, [0.1], protocol="paper-holdout@read_on=all", reports_training=True)
    assert {task.name.protocol for task in FigureSource.of(tmp_path).newest} == {"holdout"}
    source = FigureSource.of(tmp_path, Selection(protocols=("paper-holdout",)))
    assert source.compared(1).task.name.protocol == "paper-holdout@read_on=all"
    assert "training samples among those reported" in caption_of("errors", source)


def test_the_best_of_the_models_with_most_splits_are_shown_and_the_linear_one_in_any_case(tmp_path):
    compared(tmp_path).add("quick", [0.01])
    source = FigureSource.of(tmp_path)
    assert source.compared(3).models == ("gp", "mlp", "vjm")
    caption = caption_of("regression", source)
    assert "twin (simulated), holdout, 2 splits, seed 0." in caption
    assert "Best 3 of 5 models; vjm is always among them." in caption
    assert FigureSource.of(tmp_path, Selection(models=("mlp",))).compared(3).models == ("mlp",)


def test_captions_name_the_models_that_no_target_label_trained(tmp_path):
    learned(tmp_path, regime="no labels")
    caption = caption_of("learning-curves", FigureSource.of(tmp_path))
    assert " All models shown: no labels." in caption


@pytest.mark.parametrize("value", [np.nan, 0.0, np.inf])
def test_a_curve_without_a_finite_positive_loss_is_none(tmp_path, value):
    made = compared(tmp_path)
    with_fields(made, "mlp", curves={"training": np.full((3, 3), value)})
    with pytest.raises(StoreError, match="training curve"):
        losses.loss_curves(FigureSource.of(tmp_path))
