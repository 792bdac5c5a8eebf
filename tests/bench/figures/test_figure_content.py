"""Content of the general figures, against numbers by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from helpers.figure_results import CURVE, SIZES, compared, learned, with_fields
from helpers.made_results import TWINS, MadeResults, made_data
from stiff_bench.figures import learning_curves, variants
from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource, marks
from stiff_bench.figures.samples import errors_by_row, regression_figure
from stiff_bench.figures.style import short, short_names
from stiff_bench.results.selection import Selection
from stiff_bench.store.database import ResultStore, read_data, read_results
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import Presentation
from stiff_protocols.contract.types import Interval, Prediction
from stiff_protocols.scoring.metrics import absolute_errors

NET = {"name": "net"}  # the same model, whatever its options


def some_samples(n: int) -> Prediction:
    rng = np.random.default_rng(0)
    measured = rng.normal(size=(n, 3)) * 1e-3
    return Prediction(np.arange(n), measured + rng.normal(size=(n, 3)) * 1e-4, measured)


def test_a_regression_diagram_has_mm_error_over_true_deflection_lines_and_the_papers_error():
    """The lines hold 95 % of the samples; all panels have one scale of errors."""
    samples = some_samples(200)
    figure = regression_figure({"a": samples}, {"a": (0.07e-3, 0.08e-3, 0.09e-3)})
    for axis, (axes, published) in enumerate(
        zip(figure.axes, ("0.070", "0.080", "0.090"), strict=True)
    ):
        points = next(line for line in axes.get_lines() if line.get_marker() == "o")
        error = (samples.predicted - samples.measured)[:, axis] * 1e3
        np.testing.assert_allclose(points.get_xdata(), samples.measured[:, axis] * 1e3)
        np.testing.assert_allclose(points.get_ydata(), error, atol=1e-12)
        lines = [line for line in axes.get_lines() if line is not points]
        half = np.quantile(absolute_errors(samples)[:, axis], 0.95) * 1e3
        heights = sorted(line.get_ydata()[0] for line in lines)
        np.testing.assert_allclose(heights, [-half, 0.0, half])
        assert f"(paper {published})" in axes.get_title(loc="left")
        assert axes.get_ylim() == figure.axes[0].get_ylim()


def test_a_mark_names_the_models_that_have_it_unless_all_do():
    def mark_text(*picked):
        return marks(
            Presentation(model, "twin", "holdout", "simulated", picked_on_test=model in picked)
            for model in ("a", "b", "c")
        )

    assert mark_text() == ""
    assert mark_text("b") == " b: epoch picked on test part."
    assert mark_text("a", "b", "c") == " All models shown: epoch picked on test part."


def test_a_sample_of_several_splits_has_the_mean_of_its_3_d_errors():
    predicted = np.array([[1.0, 2.0, 2.0], [0.0, 3.0, 4.0], [0.0, 0.0, 1.0]])
    errors = errors_by_row(Prediction(np.array([3, 1, 3]), predicted, np.zeros((3, 3))))
    assert errors.index.tolist() == [1, 3]
    np.testing.assert_array_equal(errors, [5.0, 2.0])


def test_a_workspace_colours_each_pose_by_the_length_of_its_error(tmp_path):
    MadeResults(tmp_path).add("vjm", [[0.1, 0.2, 0.3, 0.4]])
    source = FigureSource.of(tmp_path)
    side, above, *_ = FIGURES["workspace"](source).draw().axes
    data = read_data(tmp_path, source.compared(1).task.name.data_sha256)
    for axes, across in ((side, np.hypot(*data.tcp[:4, :2].T)), (above, data.tcp[:4, 0])):
        (points,) = axes.collections
        np.testing.assert_allclose(points.get_offsets()[:, 0], across)
        np.testing.assert_allclose(points.get_array(), [0.1, 0.2, 0.3, 0.4])


def test_a_workspace_shows_the_difference_to_the_vjm_on_a_scale_around_zero(tmp_path):
    MadeResults(tmp_path).add("net", [[1.0, 2.0, 3.0, 1.5]])
    figure = FIGURES["workspace"](FigureSource.of(tmp_path)).draw()
    (difference,) = (axes for axes in figure.axes if "VJM" in axes.get_title(loc="left"))
    (points,) = difference.collections
    vjm_mm = np.sqrt(3.0)  # of these made results: 1 mm along each axis
    np.testing.assert_allclose(np.sort(points.get_array()), np.array([1.0, 1.5, 2.0, 3.0]) - vjm_mm)
    assert points.norm.vmin == -points.norm.vmax


def test_a_workspace_draws_the_arm_from_its_base_to_a_tcp(tmp_path):
    MadeResults(tmp_path).add("vjm", [0.1])
    source = FigureSource.of(tmp_path)
    side, above, *_ = FIGURES["workspace"](source).draw().axes
    data = read_data(tmp_path, source.compared(1).task.name.data_sha256)
    arm = np.column_stack([above.lines[0].get_xydata(), side.lines[0].get_ydata()])
    np.testing.assert_allclose(arm[0], 0.0)
    assert np.isclose(arm[-1], data.tcp).all(axis=1).any()


def test_a_calibration_has_a_panel_for_each_coverage_that_every_split_has(tmp_path):
    made = MadeResults(tmp_path)
    for coverage in (0.8, 0.5, 0.9):  # other figures show the newest, of one split
        made.add("gp", [0.1] if coverage == 0.9 else [0.1, 0.2], coverage=coverage)
        made.add("vjm", [0.3, 0.3], coverage=None if coverage == 0.9 else coverage)
    store = ResultStore(tmp_path)
    for result in list(read_results(tmp_path)):
        if result.presentation.model == "gp" and result.fit.coverage == 0.5:
            shift = np.where(np.arange(len(result.prediction.rows)) % 2, 1.0, 0.0)[:, None]
            old = result.prediction.interval
            moved = Interval(old.lower + shift, old.upper + shift, 0.5)
            store.write_fits(
                [replace(result, prediction=replace(result.prediction, interval=moved))]
            )
    half, most = FIGURES["calibration"](FigureSource.of(tmp_path)).draw().axes
    for axes, nominal, gp_coverage in ((half, 50.0, 50.0), (most, 80.0, 100.0)):
        dots = {dot.get_label(): dot.lines[0].get_xdata() for dot in axes.containers}
        assert dots == {"gp": [gp_coverage], "vjm": [100.0]}
        (line,) = [
            drawn_line for drawn_line in axes.get_lines() if drawn_line.get_label() == "nominal"
        ]
        assert line.get_xdata() == [nominal, nominal]


@pytest.mark.slow
@pytest.mark.parametrize("identifiable", [True, False])
def test_springs_are_drawn_as_the_models_reported_them_or_with_the_priors_slope(
    tmp_path, identifiable
):
    made = compared(tmp_path)
    joints = made_data(0).robot.joint_names
    segments = {f"stiffness {j} segment {k} [Nm/rad]": 1e4 * k for j in joints for k in (1, 2)}
    bends = {f"breakpoint {j} 1 [Nm]": 0.1 for j in joints}
    key = f"stiffness {joints[0]} segment 2 [Nm/rad]"
    prior = {} if identifiable else {key: np.nan, f"prior {key}": 5e4}
    with_fields(made, "mlp", diagnostics=segments | bends | prior)
    with_fields(made, "vjm", diagnostics={f"stiffness {j} [Nm/rad]": 2e4 for j in joints})
    first = FIGURES["springs"](FigureSource.of(tmp_path)).draw().axes[0]
    *_, segmented, bend, linear = first.get_lines()
    torque, deflection = segmented.get_xydata()[-1]
    slope = 2e4 if identifiable else 5e4
    np.testing.assert_allclose(deflection, 1e3 * (0.1 / 1e4 + (torque - 0.1) / slope))
    np.testing.assert_allclose(bend.get_xdata(), [0.1])
    torque, deflection = linear.get_xydata()[-1]
    np.testing.assert_allclose(deflection, 1e3 * torque / 2e4)
    bottom, top = first.get_ylim()
    assert bottom == 0.0 and top > max(line.get_ydata().max() for line in first.get_lines())


def test_parts_are_drawn_from_the_largest_down_and_those_not_found_are_named(tmp_path):
    made = compared(tmp_path)
    for split, sizes in enumerate([(0.1, 0.3, 0.0), (0.2, 0.5, 0.0)]):
        names = [f"contribution of {part} [mm]" for part in ("base", "joints", "links")]
        diagnostics = dict(zip(names, sizes, strict=True))
        diagnostics["contribution of joints 90 % interval from [mm]"] = 0.25
        diagnostics["contribution of joints 90 % interval to [mm]"] = 0.35
        with_fields(made, "gp", split=split, diagnostics=diagnostics)
    figure = FIGURES["what-bends"](FigureSource.of(tmp_path))
    axes = figure.draw().axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["base", "joints"]
    bar, dots = axes.get_lines()[2:4]
    assert bar.get_xdata().tolist() == [0.25, 0.35]
    assert list(dots.get_xdata()) == [0.3, 0.5] and list(dots.get_ydata()) == [1, 1]
    assert "None found: links" in figure.caption


def test_curves_of_springs_are_drawn_with_the_band_of_the_first_split_and_the_linear_springs(
    tmp_path,
):
    made, joints = compared(tmp_path), made_data(0).robot.joint_names
    at = np.array([-2.0, 0.0, 2.0])
    curves = {f"spring {j}": np.stack([at, 1e-4 * at, 1e-5 * np.ones(3)], axis=1) for j in joints}
    with_fields(made, "gp", curves=curves)
    with_fields(made, "vjm", diagnostics={f"stiffness {j} [Nm/rad]": 2e4 for j in joints})
    panels = FIGURES["springs"](FigureSource.of(tmp_path)).draw().axes
    assert len(panels) == len(joints)
    *_, curve, linear = panels[0].get_lines()
    np.testing.assert_allclose(curve.get_xydata(), np.stack([at, 0.1 * at], axis=1))
    np.testing.assert_allclose(linear.get_ydata(), 1e3 * at / 2e4)
    assert panels[0].get_ylim()[0] < curve.get_ydata().min()
    (band,) = panels[0].collections
    heights = band.get_paths()[0].vertices[:, 1]
    np.testing.assert_allclose(heights.max(), 0.2 + 1e-2 * stats.norm.ppf(0.95))
    with pytest.raises(StoreError, match="training curve"):
        FIGURES["losses"](FigureSource.of(tmp_path))


def test_a_joint_without_torque_has_a_panel_without_a_curve_and_an_unreached_segment_no_line(
    tmp_path,
):
    made, joints = compared(tmp_path), made_data(0).robot.joint_names
    at = np.array([-2.0, 0.0, 2.0])
    curve = np.stack([at, 1e-4 * at, 1e-5 * np.ones(3)], axis=1)
    with_fields(made, "gp", curves={f"spring {joints[1]}": curve})
    panels = FIGURES["springs"](FigureSource.of(tmp_path)).draw().axes
    assert [text.get_text() for text in panels[0].texts] == ["no torque in the samples"]
    assert not panels[1].texts and panels[1].get_lines()
    with_fields(made, "gp", curves={})
    segments = {f"stiffness {j} segment 1 [Nm/rad]": 1e4 for j in joints}
    bends = {f"breakpoint {j} 1 [Nm]": 0.1 for j in joints}
    with_fields(made, "mlp", diagnostics=segments | bends)
    axes = FIGURES["springs"](FigureSource.of(tmp_path)).draw().axes[0]
    torque, deflection = axes.get_lines()[0].get_xydata().T
    first = torque <= 0.1
    np.testing.assert_allclose(deflection[first], 1e3 * torque[first] / 1e4)
    assert np.isnan(deflection[~first]).all()


EFFICIENCY = {"protocol": "sample-efficiency", "n_train": 40}


def errors_of(folder, **selection):
    """Return the errors [m] of learning curves: a row per model and data set."""
    source = FigureSource.of(folder, Selection(**selection))
    ((_, errors),) = learning_curves.learning_curves(source).paint.args[0].items()
    return errors


def test_a_learning_curve_is_the_geometric_mean_with_students_interval_of_three_or_more(tmp_path):
    learned(tmp_path)
    (axes,) = FIGURES["learning-curves"](FigureSource.of(tmp_path)).draw().axes
    mean = np.e / np.array(SIZES)  # mm; of e^0, e^1 and e^2
    lines = [line for line in axes.get_lines() if len(line.get_ydata())]
    line = next(candidate for candidate in lines if np.allclose(candidate.get_ydata()[:3], mean))
    np.testing.assert_allclose(line.get_xdata(), SIZES)
    reach = np.exp(stats.t.ppf(0.975, 2) / np.sqrt(3.0))
    bands = [band.get_paths()[0].vertices[:, 1] for band in axes.collections]
    assert any(
        np.isclose([band.max(), band.min()], [mean[0] * reach, mean[-1] / reach]).all()
        for band in bands
    )


def test_the_size_is_the_number_of_poses_that_is_stored(tmp_path):
    """Results of an older stiffbench have no such number; they count rows."""
    made, store = MadeResults(tmp_path), ResultStore(tmp_path)
    for size in SIZES:
        about = EFFICIENCY | {"condition": f"n = {size}", "n_train": 1}
        for model in ("vjm", "gp"):
            (key,) = made.add(model, [0.1], **about)
            store.write_fits([replace(store.result(key), n_poses=size)])
    assert list(errors_of(tmp_path).columns) == list(SIZES)


def test_a_model_without_every_draw_has_no_learning_curve(tmp_path):
    made = learned(tmp_path)
    for twin in TWINS[:3]:
        made.add("vjm", [0.1, 0.1], dataset=twin, condition="n = 5", **EFFICIENCY)
    source = FigureSource.of(tmp_path, Selection(models=("vjm", "gp")))
    content = learning_curves.learning_curves(source)
    assert content.paint.args[1] == ["vjm"]
    assert "1 to 2 draws per size and data set" in content.caption
    assert "Not shown: gp." in content.caption


def test_learning_curves_are_over_the_data_sets_that_all_models_have(tmp_path):
    made = learned(tmp_path)
    for size in SIZES:
        made.add("lucky", [1e-3], dataset=TWINS[0], condition=f"n = {size}", **EFFICIENCY)
    assert set(errors_of(tmp_path).index.unique("model")) == {"gp", "vjm"}  # most data sets first
    errors = errors_of(tmp_path, models=["vjm", "lucky"])
    np.testing.assert_allclose(errors.xs("vjm"), [1e-3 / np.array(SIZES)])  # of TWINS[0]


def swept(folder) -> None:
    made = MadeResults(folder)
    for depth in (3, 4):
        for width in (40, 80):
            name = f"net@layers={depth}@width={width}"
            made.add(name, [0.1, 0.1], options=NET | {"layers": depth, "width": width})
            error = depth * width / 1000.0
            with_fields(made, name, diagnostics={"source test MAE [mm]": error})


def test_a_sweep_has_the_mean_error_of_networks_that_differ_only_in_size(tmp_path):
    swept(tmp_path)
    options = {"layers": 3, "width": 40, "activation": "tanh"}
    made = MadeResults(tmp_path)
    made.add("net@activation=tanh", [0.1], options=NET | options)
    with_fields(made, "net@activation=tanh", diagnostics={"source test MAE [mm]": 99.0})
    made.add("net@layers=4@width=80", [0.1] * 3, options=NET | {"layers": 4, "width": 80})
    with_fields(made, "net@layers=4@width=80", diagnostics={"source test MAE [mm]": 0.32})
    content = variants.sweep(FigureSource.of(tmp_path))
    (axes,) = content.paint().axes
    lines = [line for line in axes.get_lines() if len(line.get_ydata())]
    assert [line.get_ydata().tolist() for line in lines] == [
        pytest.approx([0.12, 0.24]),
        pytest.approx([0.16, 0.32]),
    ]
    assert "2 to 3 splits, seed 0." in content.caption


def test_a_sweep_over_more_depths_than_widths_has_the_depth_across(tmp_path):
    made = MadeResults(tmp_path)
    for depth in (2, 3, 4, 5):
        name = f"net@layers={depth}"
        made.add(name, [0.1], options=NET | {"layers": depth, "width": 40})
        with_fields(made, name, diagnostics={"source test MAE [mm]": 1.0 / depth})
    (axes,) = variants.sweep(FigureSource.of(tmp_path)).draw().axes
    (line,) = [drawn_line for drawn_line in axes.get_lines() if len(drawn_line.get_ydata())]
    np.testing.assert_allclose(line.get_xydata(), [(n, 1.0 / n) for n in (2, 3, 4, 5)])
    assert axes.get_xlabel() == "hidden layers"


def frozen(folder, **errors_of_strategies):
    made = MadeResults(folder)
    made.add("vjm", [0.9, 0.3])
    for freeze, errors in errors_of_strategies.items():
        made.add(f"net@freeze={freeze}", errors, options=NET | {"freeze": freeze})
    return variants.freezing(FigureSource.of(folder))


def test_freeze_strategies_are_listed_with_single_layers_first_and_their_splits(tmp_path):
    pair = {"layers:1,2": [0.3, 0.6], "layers:4": [0.6, 0.6], "full": [3, 3]}
    ((_, (errors, linear)),) = frozen(tmp_path, **pair).paint.args[0]
    assert errors["layers"].unique().tolist() == ["4", "1 + 2", "full"]
    of_pair = errors.loc[errors["layers"] == "1 + 2", "error"]
    np.testing.assert_allclose(of_pair, [0.1, 0.2])  # all axes together: the error is along z
    assert linear == pytest.approx([0.3, 0.1])


def test_losses_are_relative_to_the_first_of_their_kind(tmp_path):
    """Training loss and validation error have different units."""
    made = compared(tmp_path)
    with_fields(made, "mlp", curves={"training": CURVE})
    (axes,) = FIGURES["losses"](FigureSource.of(tmp_path)).draw().axes
    training, validation = axes.get_lines()[:2]
    np.testing.assert_allclose(training.get_ydata(), [1.0, 0.4, 0.2])
    np.testing.assert_allclose(validation.get_ydata(), [1.0, 0.5, 2 / 3])
    assert axes.get_ylabel() == "loss / first loss"


def test_long_names_lose_their_middle_and_no_control_character_is_drawn():
    assert short("a" * 40 + "end").endswith("aend")
    assert len(short("a" * 99)) == 34
    assert short("a\x1b[2J") == "a\\x1b[2J"


def test_names_that_are_alike_when_short_differ_in_a_legend():
    long = "net@a-first-option=300@freeze={}@the-last-option=9999"
    names = [
        long.format("layers:1"),
        long.format("full"),
        "vjm",
        "x" * 50 + "y" * 50,
        "x" * 60 + "y" * 40,
    ]
    texts = short_names(names)
    assert len(set(texts.values())) == len(names) and max(map(len, texts.values())) <= 34
    assert "freeze=full" in texts[names[1]] and texts["vjm"] == "vjm"
