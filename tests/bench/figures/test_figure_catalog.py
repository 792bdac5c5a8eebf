"""Every general figure: drawn from results at a journal's size, or refused with what makes them."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from figure_results import CURVE, compared, learned, ranked, with_fields
from stiff_bench.figures.catalog import FIGURES, available, missing
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.journal_style import COLUMN_INCH, DOTS_PER_INCH, PAGE_INCH
from stiff_protocols.errors import ConfigError, StoreError

FROM_PREDICTIONS = ["regression", "errors", "workspace"]


def png_width(content: bytes) -> int:
    return int(struct.unpack(">I", content[16:20])[0])


def test_what_predictions_alone_show_can_be_drawn_of_any_results(tmp_path):
    compared(tmp_path)
    assert [one.name for one in available(FigureSource.of(tmp_path))] == FROM_PREDICTIONS


@pytest.mark.parametrize("name", FROM_PREDICTIONS)
def test_a_figure_of_panels_is_as_wide_as_a_page(tmp_path, name):
    compared(tmp_path)
    assert FIGURES[name].draw(FigureSource.of(tmp_path)).get_size_inches()[0] == PAGE_INCH


def test_a_figure_of_one_panel_is_as_wide_as_a_column_at_300_dots_an_inch(tmp_path):
    learned(tmp_path)
    content = FIGURES["learning-curves"].prepare(FigureSource.of(tmp_path)).picture("png")
    assert png_width(content) == pytest.approx(COLUMN_INCH * DOTS_PER_INCH, abs=1)


@pytest.mark.parametrize("kind", ["svg", pytest.param("pdf", marks=pytest.mark.slow)])
def test_the_same_results_give_the_same_file(tmp_path, kind):
    learned(tmp_path)
    line, source = FIGURES["learning-curves"], FigureSource.of(tmp_path)
    assert line.prepare(source).picture(kind) == line.prepare(source).picture(kind)


def test_a_models_name_is_drawn_as_it_is_written(tmp_path):
    compared(tmp_path)
    source = FigureSource.of(tmp_path, models=["$x_1$ <b>", "gp"])
    text = FIGURES["errors"].prepare(source).picture("svg").decode()
    assert "$x_1$ &lt;b&gt;" in text
    assert "<b>" not in text


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("losses", "bench run --model ft-mlp"),
        ("sweep", "bench reproduce"),
        ("freezing", "bench reproduce"),
        ("learning-curves", "bench run --protocol sample-efficiency"),
        ("springs", "bench run --model vjm --model vjm-multisegment"),
    ],
)
def test_what_is_missing_is_said_with_the_command_that_makes_it(tmp_path, name, command):
    compared(tmp_path)
    why = missing(FigureSource.of(tmp_path))[name]
    assert command in why
    assert str(tmp_path) in why


def test_ranks_over_too_few_robots_are_refused(tmp_path):
    compared(tmp_path)
    with pytest.raises(ConfigError, match="at least 5 data sets of different robots"):
        FIGURES["ranks"].draw(FigureSource.of(tmp_path))


def test_ranks_over_five_robots_name_every_model(tmp_path):
    ranked(tmp_path)
    text = FIGURES["ranks"].prepare(FigureSource.of(tmp_path)).picture("svg").decode()
    for shown in ("gp (1.00)", "mlp (2.00)", "(3.00) vjm", "critical difference"):
        assert shown in text


def test_the_best_models_are_shown_and_the_linear_one_in_any_case(tmp_path):
    compared(tmp_path)
    source = FigureSource.of(tmp_path)
    assert source.compared(source.contest(), 3).models == ("gp", "mlp", "vjm")


def test_models_that_were_asked_for_are_the_ones_shown(tmp_path):
    compared(tmp_path)
    source = FigureSource.of(tmp_path, models=["mlp"])
    assert source.compared(source.contest(), 3).models == ("mlp",)


def test_an_unknown_model_is_refused_by_name(tmp_path):
    compared(tmp_path)
    with pytest.raises(ConfigError, match="'nobody'"):
        FIGURES["regression"].draw(FigureSource.of(tmp_path, models=["nobody"]))


def test_models_without_a_common_split_are_refused(tmp_path):
    made = compared(tmp_path)
    made.add("late", [0.1, 0.1], failed=[0, 1])
    made.add("later", [0.0, 0.0, 0.1], failed=[0, 1])
    with pytest.raises(StoreError, match="no split on which all have a result"):
        FIGURES["errors"].draw(FigureSource.of(tmp_path, models=["later", "gp"]))


def test_a_fair_protocol_comes_before_one_that_picks_on_the_test_part(tmp_path):
    made = compared(tmp_path)
    made.add("extra", [0.1])
    for name in ("vjm", "gp", "mlp", "a", "b", "c", "d"):
        made.add(name, [0.1], protocol="paper-holdout", selects_on_test=True)
    assert FigureSource.of(tmp_path).contest().name.protocol == "holdout"


def test_the_caption_says_data_protocol_splits_and_seed(tmp_path):
    compared(tmp_path)
    caption = FIGURES["regression"].caption(FigureSource.of(tmp_path))
    assert "twin (simulated), holdout, 2 splits, seed 0." in caption
    assert "3 of 4 models" in caption


def test_a_caption_warns_where_the_test_part_picked_the_epoch(tmp_path):
    made = compared(tmp_path)
    made.add("vjm", [0.1], protocol="paper-holdout", selects_on_test=True)
    source = FigureSource.of(tmp_path, protocols=["paper-holdout"])
    assert "chose it on the test part" in FIGURES["errors"].caption(source)


def test_losses_mark_the_step_of_the_least_validation_loss(tmp_path):
    made = compared(tmp_path)
    with_fields(made, "mlp", curves={"training": CURVE})
    (axes,) = FIGURES["losses"].draw(FigureSource.of(tmp_path)).axes
    train, validation, best = axes.get_lines()
    np.testing.assert_array_equal(train.get_xydata(), CURVE[:, :2])
    np.testing.assert_array_equal(validation.get_ydata(), CURVE[:, 2])
    np.testing.assert_array_equal(best.get_xydata(), [[20.0, 0.3]])
