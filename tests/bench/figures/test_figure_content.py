"""What the general figures show, against numbers by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from figure_results import SIZES, compared, learned, with_fields
from made_results import TWINS, MadeResults, made_data
from stiff_bench.figures import learning_curves, springs, variants
from stiff_bench.figures.catalog import FIGURES
from stiff_bench.figures.samples import (
    Series,
    WorkspaceErrors,
    regression_figure,
    workspace_figure,
)
from stiff_bench.figures.source import FigureSource, Predicted
from stiff_bench.figures.style import looks, power_of_ten, short
from stiff_bench.store.database import read_data

NET = {"name": "net"}  # the same model, whatever its options


def some_samples(n: int = 20) -> Predicted:
    rng = np.random.default_rng(0)
    measured = rng.normal(size=(n, 3)) * 1e-3
    return Predicted(np.arange(n), measured, measured + rng.normal(size=(n, 3)) * 1e-4)


def test_a_regression_diagram_has_millimetres_measured_across_and_predicted_up():
    samples = some_samples()
    figure = regression_figure([Series("a", samples)])
    for axis, axes in enumerate(figure.axes):
        points = next(line for line in axes.get_lines() if line.get_marker() == "o")
        np.testing.assert_allclose(points.get_xdata(), samples.measured[:, axis] * 1e3)
        np.testing.assert_allclose(points.get_ydata(), samples.predicted[:, axis] * 1e3)


def test_a_regression_diagrams_lines_hold_95_percent_of_the_samples():
    samples = some_samples(200)
    axes = regression_figure([Series("a", samples)]).axes[2]
    heights = sorted(line.get_xy1()[1] for line in axes.get_lines() if hasattr(line, "get_xy1"))
    half = np.quantile(samples.error[:, 2], 0.95) * 1e3
    np.testing.assert_allclose(heights, [-half, 0.0, half])


def test_overlaid_models_share_three_panels():
    figure = regression_figure(
        [Series("a", some_samples()), Series("b", some_samples())], overlaid=True
    )
    assert len(figure.axes) == 3


def test_a_published_error_stands_beside_ours():
    figure = regression_figure([Series("a", some_samples(), (0.07e-3, 0.08e-3, 0.09e-3))])
    for axes, published in zip(figure.axes, ("0.070", "0.080", "0.090"), strict=True):
        assert f"(paper {published})" in axes.get_title(loc="left")


def test_a_sample_of_several_splits_has_the_mean_of_its_errors():
    twice = Predicted(
        np.array([3, 1, 3]), np.zeros((3, 3)), np.array([[1.0] * 3, [5.0] * 3, [2.0] * 3])
    )
    rows, error = twice.mean_by_row(twice.error)
    np.testing.assert_array_equal(rows, [1, 3])
    np.testing.assert_array_equal(error, [[5.0] * 3, [1.5] * 3])


def test_a_workspace_colours_each_pose_by_the_length_of_its_error(tmp_path):
    MadeResults(tmp_path).add("vjm", [[0.1, 0.2, 0.3, 0.4]])
    source = FigureSource.of(tmp_path)
    side, above, *_ = FIGURES["workspace"].prepare(source).draw().axes
    data = read_data(tmp_path, source.contest().name.data_sha256)
    for axes, across in ((side, np.hypot(*data.tcp[:4, :2].T)), (above, data.tcp[:4, 0])):
        (points,) = axes.collections
        np.testing.assert_allclose(points.get_offsets()[:, 0], across)
        np.testing.assert_allclose(points.get_array(), [0.1, 0.2, 0.3, 0.4])


def test_all_models_of_a_workspace_share_one_scale_of_colours(tmp_path):
    compared(tmp_path)
    figure = FIGURES["workspace"].prepare(FigureSource.of(tmp_path)).draw()
    scales = {id(points.norm) for axes in figure.axes[:6] for points in axes.collections}
    assert len(scales) == 1


def test_a_springs_deflection_adds_up_the_segments_below_the_torque():
    spring = springs.Spring(np.array([10.0]), np.array([2e-5, 1e-5]))
    torque = np.array([0.0, 5.0, 10.0, 30.0])
    np.testing.assert_allclose(spring.deflection(torque), [0.0, 1e-4, 2e-4, 4e-4])


def test_springs_are_read_from_what_the_models_reported(tmp_path):
    made = compared(tmp_path)
    joints = made_data(0).robot.joint_names
    segments = {f"stiffness {j} segment {k} [Nm/rad]": 1e4 * k for j in joints for k in (1, 2)}
    bends = {f"breakpoint {j} 1 [Nm]": 0.1 for j in joints}
    with_fields(made, "mlp", diagnostics=segments | bends)
    with_fields(made, "vjm", diagnostics={f"stiffness {j} [Nm/rad]": 2e4 for j in joints})
    first = FIGURES["springs"].prepare(FigureSource.of(tmp_path)).draw().axes[0]
    *_, segmented, bend, linear = first.get_lines()
    torque, deflection = segmented.get_xydata()[-1]
    np.testing.assert_allclose(deflection, 1e3 * (0.1 / 1e4 + (torque - 0.1) / 2e4))
    np.testing.assert_allclose(bend.get_xdata(), [0.1])
    torque, deflection = linear.get_xydata()[-1]
    np.testing.assert_allclose(deflection, 1e3 * torque / 2e4)


def test_a_learning_curve_is_the_geometric_mean_with_students_interval(tmp_path):
    learned(tmp_path)
    content = learning_curves.gather(FigureSource.of(tmp_path))
    ((_, curves),) = content.paint.args[0].items()
    linear = next(curve for curve in curves if curve.name == "vjm")
    centre, low, high = linear.interval()
    np.testing.assert_allclose(centre, np.e * 1e-3 / np.array(SIZES))  # e^0, e^1, e^2
    reach = stats.t.ppf(0.975, 2) / np.sqrt(3.0)
    np.testing.assert_allclose(high / centre, np.exp(reach))
    np.testing.assert_allclose(centre / low, np.exp(reach))


def test_two_data_sets_make_a_learning_curve_without_an_interval(tmp_path):
    learned(tmp_path, n_twins=2)
    content = learning_curves.gather(FigureSource.of(tmp_path))
    ((_, curves),) = content.paint.args[0].items()
    assert np.isnan(curves[0].interval()[1]).all()


def test_a_data_set_that_lacks_a_size_is_no_part_of_a_learning_curve(tmp_path):
    made = learned(tmp_path)
    made.add(
        "vjm", [9.0], dataset="twin@specimen=4", protocol="sample-efficiency", condition="n = 5"
    )
    ((_, curves),) = learning_curves.gather(FigureSource.of(tmp_path)).paint.args[0].items()
    assert {curve.errors.shape for curve in curves} == {(3, 3)}


EFFICIENCY = {"protocol": "sample-efficiency", "n_train": 40}


def curves_of(folder, **asked):
    ((_, curves),) = learning_curves.gather(FigureSource.of(folder, **asked)).paint.args[0].items()
    return {curve.name: curve for curve in curves}


def test_a_model_that_lacks_a_draw_has_no_learning_curve(tmp_path):
    made = learned(tmp_path)
    for twin in TWINS[:3]:
        made.add("vjm", [0.1, 0.1], dataset=twin, condition="n = 5", **EFFICIENCY)
    assert set(curves_of(tmp_path)) == {"vjm"}
    content = learning_curves.gather(FigureSource.of(tmp_path, models=["vjm", "gp"]))
    assert "1 to 2 draws a size and data set" in content.caption
    assert "Without every draw of every size: gp." in content.caption


def test_learning_curves_are_over_the_data_sets_that_all_models_have(tmp_path):
    made = learned(tmp_path)
    for size in SIZES:
        made.add("other", [0.1], dataset=TWINS[0], condition=f"n = {size}", **EFFICIENCY)
    found = curves_of(tmp_path, models=["vjm", "other"])
    assert {one.errors.shape for one in found.values()} == {(3, 1)}
    np.testing.assert_allclose(found["vjm"].errors[:, 0], 1e-3 / np.array(SIZES))  # of TWINS[0]


def test_the_best_learning_curves_are_of_the_models_with_most_data_sets(tmp_path):
    made = learned(tmp_path)
    for size in SIZES:
        made.add("lucky", [1e-3], dataset=TWINS[0], condition=f"n = {size}", **EFFICIENCY)
    assert set(curves_of(tmp_path)) == {"gp", "vjm"}
    caption = learning_curves.gather(FigureSource.of(tmp_path)).caption
    assert "Shown: 2 of 3 models: of those with most data sets" in caption


def test_a_learning_curve_is_of_one_version_of_the_data_the_newest(tmp_path):
    made = learned(tmp_path)
    for size in SIZES:
        about = {"condition": f"n = {size}", "version": 1, "run_id": "run-2"}
        made.add("vjm", [7.0], dataset=TWINS[0], **about, **EFFICIENCY)
    errors = curves_of(tmp_path, models=["vjm"])["vjm"].errors
    np.testing.assert_allclose(errors[:, 0], 7e-3)
    assert errors.shape == (3, 3)


def swept(folder) -> None:
    made = MadeResults(folder)
    for depth in (3, 4):
        for width in (40, 80):
            name = f"net@layers={depth}@width={width}"
            made.add(name, [0.1, 0.1], options=NET | {"layers": depth, "width": width})
            error = depth * width / 1000.0
            with_fields(made, name, diagnostics={"source test MAE [mm]": error})


def test_a_map_has_the_mean_error_of_each_depth_and_width(tmp_path):
    swept(tmp_path)
    found = variants.sweep(FigureSource.of(tmp_path)).paint.args[0]
    assert (found.depths, found.widths) == ([3, 4], [40, 80])
    np.testing.assert_allclose(found.grid() * 1e3, [[0.12, 0.24], [0.16, 0.32]])


def test_networks_that_differ_in_more_than_size_are_no_part_of_a_map(tmp_path):
    swept(tmp_path)
    made = MadeResults(tmp_path)
    made.add(
        "net@activation=tanh", [0.1], options=NET | {"layers": 3, "width": 40, "activation": "tanh"}
    )
    with_fields(made, "net@activation=tanh", diagnostics={"source test MAE [mm]": 99.0})
    found = variants.sweep(FigureSource.of(tmp_path)).paint.args[0]
    assert max(map(np.max, found.values.values())) < 1e-3


def test_freeze_strategies_stand_with_single_layers_first_and_their_splits(tmp_path):
    made = MadeResults(tmp_path)
    made.add("vjm", [0.9, 0.9])
    for freeze, errors in (("layers:1,2", [0.3, 0.6]), ("layers:4", [0.6, 0.6]), ("full", [3, 3])):
        made.add(f"net@freeze={freeze}", errors, options=NET | {"freeze": freeze})
    content = variants.freezing(FigureSource.of(tmp_path))
    strategies, linear, _ = content.paint.args
    assert [one.label for one in variants.in_order(strategies)] == ["4", "1 + 2", "full"]
    of_pair = next(one.error for one in strategies if one.freeze == "layers:1,2")
    np.testing.assert_allclose(of_pair, [1e-4, 2e-4])  # all axes together: the error is along z
    assert linear == pytest.approx(3e-4)


def test_freeze_strategies_are_compared_on_the_splits_that_all_have(tmp_path):
    made = MadeResults(tmp_path)
    made.add("vjm", [0.9, 0.3])
    for freeze, errors in (("layers:1", [0.3]), ("layers:4", [0.6, 6.0])):
        made.add(f"net@freeze={freeze}", errors, options=NET | {"freeze": freeze})
    content = variants.freezing(FigureSource.of(tmp_path))
    strategies, linear, _ = content.paint.args
    np.testing.assert_allclose([one.error for one in strategies], [[1e-4], [2e-4]])
    assert linear == pytest.approx(3e-4)
    assert "1 split, seed 0." in content.caption
    assert "Splits that only some strategies have are left out." in content.caption


def test_a_sweep_says_the_least_and_the_largest_number_of_splits(tmp_path):
    swept(tmp_path)
    more = {"options": NET | {"layers": 4, "width": 80}}
    made = MadeResults(tmp_path)
    made.add("net@layers=4@width=80", [0.1] * 3, **more)
    error = {"source test MAE [mm]": 0.1}
    with_fields(made, "net@layers=4@width=80", diagnostics=error)
    assert "2 to 3 splits, seed 0." in variants.sweep(FigureSource.of(tmp_path)).caption


def test_looks_differ_without_colour_as_well():
    found = looks(8)
    assert len({one.color for one in found}) == len({one.marker for one in found}) == 8


def test_long_names_lose_their_middle_and_no_control_character_is_drawn():
    assert short("a" * 40 + "end").endswith("aend")
    assert len(short("a" * 99)) == 28
    assert short("a\x1b[2J") == "a\\x1b[2J"


@pytest.mark.parametrize(("value", "text"), [(1e-3, "10⁻³"), (100.0, "10²"), (0.5, "0.5")])
def test_decades_are_written_as_powers_of_ten(value, text):
    assert power_of_ten(value) == text


def test_one_pose_alone_can_be_drawn():

    alone = WorkspaceErrors("a", np.array([[0.5, 0.0, 0.5]]), np.array([0.0]))
    assert len(workspace_figure([alone]).axes) == 3
