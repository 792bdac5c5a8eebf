"""Figures of several data sets: their panels, the order, and shared axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.figure_results import CURVE, SIZES, with_fields
from helpers.made_results import MadeResults, made_data
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import MOST_PANELS, FigureSource
from stiff_bench.results.selection import Selection
from stiff_bench.store.database import ResultStore, read_results

NAMES = ("z-twin", "measured-data", "a", "longest-name-of-all")
"""Data sets in the requested order; the second is measured."""
ERRORS = {"vjm": 0.4, "gp": 0.1, "knn": 0.8}
NOISE_MM = 0.05


def make_results(folder, names=NAMES, measured=1, **about) -> MadeResults:
    """Store three models on some data sets; errors depend on their places."""
    made, keys = MadeResults(folder), []
    for place, name in enumerate(names):
        kind = "measured" if place == measured else "simulated"
        for model, error in ERRORS.items():
            errors = [error * (1 + place), error]
            keys += made.add(model, errors, name, data=made_data(place), kind=kind, **about)
    made.add_run("run-1", keys)
    return made


def with_noise(folder, *datasets: str) -> None:
    """Add a prediction with instrument noise to results of some data sets."""
    store = ResultStore(folder)
    for result in list(read_results(folder)):
        if result.presentation.dataset in datasets:
            tested = result.prediction
            noise = tested.measured + np.array([0.0, 0.0, NOISE_MM * 1e-3])
            prediction = replace(tested, bound_deflections={"noise": noise})
            store.write_fits([replace(result, prediction=prediction)])


def drawn(folder, name="scores", **words):
    return FIGURES[name](FigureSource.of(folder, Selection(**words))).draw()


def titles_of(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def lines_of(axes, label):
    return [line.get_xdata() for line in axes.get_lines() if line.get_label() == label]


IN_ORDER = ("measured-data", "z-twin", "a", "longest-name-of-all")


@pytest.mark.parametrize("name", ["scores", "errors"])
def test_each_data_set_has_a_panel_measured_first_then_in_the_requested_order(name, tmp_path):
    make_results(tmp_path)
    figure = drawn(tmp_path, name)
    assert len(figure.axes) == len(NAMES)
    for dataset, title in zip(IN_ORDER, titles_of(figure), strict=True):
        assert dataset in title
    assert figure.get_suptitle() == "holdout"


def test_one_requested_data_set_is_one_panel_that_names_it_in_the_picture(tmp_path):
    make_results(tmp_path)
    figure = drawn(tmp_path, datasets=("a",))
    assert titles_of(figure) == [""]
    assert figure.get_suptitle() == "a (simulated), holdout"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scores", "errors", "regression"])
def test_a_renamed_data_set_gives_the_same_picture_except_its_title(name, tmp_path):
    """The length of a name and its place in the alphabet change nothing."""

    def numbers(figure):
        lines = [line.get_xydata() for axes in figure.axes for line in axes.get_lines()]
        return [line.tolist() for line in lines]

    make_results(tmp_path / "one")
    make_results(tmp_path / "two", ("b", "zz", "y-with-a-far-longer-name-than-before", "c"))
    first, second = (drawn(tmp_path / folder, name) for folder in ("one", "two"))
    assert numbers(first) == numbers(second)
    assert titles_of(first) != titles_of(second)


def test_more_data_sets_than_panels_are_named_in_the_caption(tmp_path):
    names = tuple(f"d{number}" for number in range(MOST_PANELS, -2, -1))
    make_results(tmp_path, names)
    content = FIGURES["errors"](FigureSource.of(tmp_path))
    assert len(content.draw().axes) == MOST_PANELS
    assert f"Not shown: {names[-2]}, {names[-1]}." in content.caption


@pytest.mark.parametrize("name", ["scores", "errors", "regression"])
def test_data_sets_whose_names_are_alike_when_shortened_keep_their_panels(name, tmp_path):
    long = "a-name-that-is-long-{}-and-goes-on-for-a-while"
    make_results(tmp_path, (long.format(1), long.format(2)), measured=0)
    titles = [title for title in titles_of(drawn(tmp_path, name)) if "a-name" in title]
    assert len(titles) == 2


def test_the_plain_protocol_is_drawn_before_its_conditions_and_other_words_choose(tmp_path):
    made = MadeResults(tmp_path)
    keys = made.add("vjm", [0.1], condition="n = 5", protocol="sample-efficiency")
    keys += made.add("vjm", [0.2, 0.2], protocol="space-transfer")
    keys += made.add("gp", [0.2], condition="n = 5", protocol="sample-efficiency")
    made.add_run("run-1", keys)
    assert drawn(tmp_path).get_suptitle() == "twin (simulated), space-transfer"
    chosen = drawn(tmp_path, protocols=("sample-efficiency",))
    assert chosen.get_suptitle() == "twin (simulated), sample-efficiency, n = 5"


def test_panels_of_different_protocols_name_them(tmp_path):
    made = MadeResults(tmp_path)
    keys = made.add("vjm", [0.1], "a") + made.add("vjm", [0.1], "b", "space-transfer")
    made.add_run("run-1", keys)
    first, second = titles_of(drawn(tmp_path))
    assert "holdout" in first and "space-transfer" in second


def test_scores_share_the_models_and_have_the_linear_ones_line_and_the_noise_where_known(tmp_path):
    make_results(tmp_path)
    with_noise(tmp_path, "a")
    panels = drawn(tmp_path).axes
    assert [label.get_text() for label in panels[0].get_yticklabels()] == ["gp", "vjm", "knn"]
    assert len({axes.get_ylim() for axes in panels}) == 1
    for axes, dataset in zip(panels, IN_ORDER, strict=True):
        mean = 0.4 * (2 + NAMES.index(dataset)) / 2  # mm, of two splits
        np.testing.assert_allclose(lines_of(axes, "vjm"), [[mean, mean]])
        floor = lines_of(axes, "instrument noise")
        np.testing.assert_allclose(floor, [[NOISE_MM] * 2] if dataset == "a" else np.empty((0,)))


def test_scores_without_the_linear_model_have_the_line_of_what_each_cell_stores_of_it(tmp_path):
    MadeResults(tmp_path).add("gp", [0.1])
    (axes,) = drawn(tmp_path).axes
    np.testing.assert_allclose(lines_of(axes, "vjm"), [[np.sqrt(3.0)] * 2])  # 1 mm on each axis


def test_errors_are_a_curve_per_model_from_nothing_to_all_samples_with_the_noise_floor(tmp_path):
    make_results(tmp_path)
    with_noise(tmp_path, *NAMES)
    figure = drawn(tmp_path, "errors")
    (legend,) = figure.legends
    assert {text.get_text() for text in legend.get_texts()} == {*ERRORS, "instrument noise"}
    for axes in figure.axes:
        assert axes.get_ylim() == figure.axes[0].get_ylim()
        np.testing.assert_allclose(lines_of(axes, "instrument noise"), [[NOISE_MM] * 2])
        for model in ERRORS:
            (curve,) = [line for line in axes.get_lines() if line.get_label() == model]
            assert (curve.get_ydata()[0], curve.get_ydata()[-1]) == (0.0, 1.0)


def test_regression_has_a_row_per_data_set_whose_axes_share_the_scale_of_errors(tmp_path):
    make_results(tmp_path, NAMES[:2])
    figure = drawn(tmp_path, "regression")
    rows = np.reshape(figure.axes, (2, 3))
    for row, dataset in zip(rows, IN_ORDER, strict=False):
        assert dataset in row[0].get_title(loc="left")
        assert len({axes.get_ylim() for axes in row}) == 1
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["gp", "vjm", "knn"]


def test_a_model_whose_name_begins_with_an_underscore_is_in_the_legend(tmp_path):
    MadeResults(tmp_path).add_each({"vjm": [0.1], "_mine": [0.2]})
    (legend,) = drawn(tmp_path, "errors").legends
    assert {text.get_text().strip() for text in legend.get_texts()} == {"vjm", "_mine"}


@pytest.mark.parametrize("datasets", [["a"], ["a", "b"]])
def test_long_names_are_inside_the_figure(datasets, tmp_path):
    results = MadeResults(tmp_path)
    for place, dataset in enumerate(datasets):
        for number in range(5):
            name = f"ft-mlp@anchor=none@training=best-{number}"
            results.add(name, [0.1], dataset, data=made_data(place))
    figure = drawn(tmp_path, "errors")
    (legend,) = figure.legends
    figure.canvas.draw()
    inside, outside = figure.bbox, legend.get_window_extent()
    assert len(legend.get_texts()) == 5
    assert inside.x0 <= outside.x0 and outside.x1 <= inside.x1


def test_calibration_has_a_row_per_data_set_in_the_same_order(tmp_path):
    make_results(tmp_path, coverage=0.9)
    (axes,) = drawn(tmp_path, "calibration").axes
    labels = [label.get_text().partition(" ")[0] for label in axes.get_yticklabels()]
    assert labels == [*IN_ORDER]


def test_losses_have_a_row_per_data_set_and_a_panel_per_phase(tmp_path):
    made = make_results(tmp_path, NAMES[:2])
    with_fields(made, "gp", curves={"pre-training": CURVE, "fine-tuning": CURVE})
    figure = drawn(tmp_path, "losses")
    titles = titles_of(figure)
    assert len(titles) == 4
    assert "measured-data" in titles[0] and "z-twin" in titles[2]


@pytest.mark.slow
def test_learning_curves_share_the_errors_axis_and_have_the_noise_floor(tmp_path):
    made, keys = MadeResults(tmp_path), []
    for place, dataset in enumerate(("z", "measured", "a")):
        for size in SIZES:
            about = {"protocol": "sample-efficiency", "condition": f"n = {size}", "n_train": size}
            about |= {"kind": "measured" if dataset == "measured" else "simulated"}
            for model in ("vjm", "gp"):
                keys += made.add(model, [10.0**place / size], dataset, **about)
    made.add_run("run-1", keys)
    with_noise(tmp_path, "z")
    figure = drawn(tmp_path, "learning-curves")
    named = [title.split()[1] for title in titles_of(figure)]
    assert named == ["measured", "z", "a"]
    assert len({axes.get_ylim() for axes in figure.axes}) == 1
    floors = [
        [line.get_ydata()[0] for line in axes.get_lines() if line.get_label() == "instrument noise"]
        for axes in figure.axes
    ]
    assert floors == [[], [pytest.approx(NOISE_MM)], []]


def test_freeze_strategies_have_a_panel_per_data_set_that_has_two(tmp_path):
    made, keys = MadeResults(tmp_path), []
    for dataset, strategies in (
        ("z", ("layers:1", "full")),
        ("b", ("full",)),
        ("a", ("layers:1", "full")),
    ):
        for freeze in strategies:
            options = {"name": "net", "freeze": freeze}
            keys += made.add(f"net@freeze={freeze}", [0.1, 0.2], dataset, options=options)
    made.add_run("run-1", keys)
    first, second = titles_of(drawn(tmp_path, "freezing"))
    assert "z (simulated)" in first and "a (simulated)" in second


def test_results_on_older_data_of_a_name_are_left_out_and_named(tmp_path):
    made = MadeResults(tmp_path)
    made.add("vjm", [0.1], "a", run_id="run-1")
    made.add("vjm", [0.3], "a", version=1, run_id="run-2")
    source = FigureSource.of(tmp_path)
    (axes,) = FIGURES["scores"](source).draw().axes
    np.testing.assert_allclose(lines_of(axes, "vjm"), [[0.3, 0.3]])
    assert "Results on older data named a are left out." in FIGURES["scores"](source).caption
