"""The picture of the arm: kinematics, magnified deflection, load and shares of the springs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbench as sb
from helpers.contrast import pale_lines
from helpers.made_results import ROBOT, MadeResults, made_data
from stiff_bench.figures.robot_picture import (
    LoadedArm,
    arm_points,
    horizontal_axis,
    robot_figure,
    robot_picture,
)
from stiff_protocols.contract.errors import ConfigError, NotFittedError

POSE = np.array([0.0, -0.3, 0.6, 0.0, 0.4, 0.0])
LOAD = np.array([30.0, 0.0, -90.0, 0.0, 2.0, 0.0])
COMPLIANCE = np.array([2e-5, 1e-5, 2e-5, 2e-4, 2e-4, 4e-4])


@pytest.fixture(scope="module")
def data():
    return sb.load_dataset("kr10-twin")


def loaded_arm(deflection=None, wrench=LOAD, compliance=COMPLIANCE, q=POSE) -> LoadedArm:
    """Return an arm whose TCP moves by its springs, or by a given deflection."""
    if deflection is None:
        (deflection,) = ROBOT.joint_deflection(compliance, q[None], wrench[None])
    return LoadedArm(ROBOT, q, wrench, {"measured": np.asarray(deflection)}, compliance)


def lines_of(figure) -> dict[str, np.ndarray]:
    return {line.get_label(): line.get_xydata() for line in figure.axes[0].get_lines()}


def texts_of(figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_the_arm_is_drawn_from_the_base_through_the_joints_to_the_tcp():
    (points,) = arm_points(ROBOT, POSE[None])
    np.testing.assert_array_equal(points[0], 0.0)
    np.testing.assert_allclose(points[-1], ROBOT.tcp_position(POSE[None])[0])
    drawn = lines_of(robot_figure(loaded_arm()))["unloaded"]
    np.testing.assert_allclose(drawn, points[:, [0, 2]], atol=1e-12)


@pytest.mark.parametrize("more", [[0.0, 0.0, 0.0], [3e-4, 0.0, 2e-4]])
def test_the_drawn_tcp_moves_by_the_deflection_times_the_factor_of_the_legend(more):
    """The springs may give another deflection; the links keep their lengths."""
    arm = loaded_arm()
    arm = loaded_arm(arm.deflection + more)
    lines = lines_of(robot_figure(arm))
    (name,) = (label for label in lines if label.startswith("loaded"))
    factor = float(name.partition("times ")[2].rstrip(")"))
    moved = lines[name][-1] - lines["unloaded"][-1]
    np.testing.assert_allclose(moved, factor * arm.deflection[[0, 2]], atol=1e-3)
    size = np.linalg.norm(np.diff(arm.points(arm.magnified(factor)), axis=0), axis=1)
    np.testing.assert_allclose(size, np.linalg.norm(np.diff(arm.points(arm.q), axis=0), axis=1))


def test_a_springs_share_is_its_deflection_without_the_others():
    arm = loaded_arm()
    lengths = [
        np.linalg.norm(ROBOT.joint_deflection(compliance, POSE[None], LOAD[None]))
        for compliance in np.diag(COMPLIANCE)
    ]
    np.testing.assert_allclose(arm.shares, np.array(lengths) / np.sum(lengths))
    dots = robot_figure(arm).axes[0].collections[0]
    assert np.all(np.diff(dots.get_sizes()) <= 0.0) and len(dots.get_sizes()) == 6
    assert dots.get_sizes()[0] > 4.0 * dots.get_sizes()[-1]


def test_the_picture_has_the_load_in_newtons_and_the_deflection_in_millimetres():
    texts = texts_of(robot_figure(loaded_arm()))
    assert any("94.9 N" in text for text in texts)
    arm = loaded_arm()
    mm = f"{1e3 * np.linalg.norm(arm.deflection):.3g} mm (measured)"
    assert any(mm in text for text in texts)


@pytest.mark.parametrize(
    ("turn", "label"), [(0.0, "x [m]"), (np.pi / 2, "y [m]"), (0.7, "40° from x [m]")]
)
def test_the_plane_follows_the_arm_and_its_force(turn, label):
    q = POSE + np.array([-turn, 0.0, 0.0, 0.0, 0.0, 0.0])  # the KR10's first axis points down
    force = [30.0 * np.cos(turn), 30.0 * np.sin(turn), -90.0, 0.0, 0.0, 0.0]
    arm = loaded_arm(wrench=np.array(force), q=q)
    right, text = horizontal_axis(arm)
    assert label in text
    assert abs(right @ [np.cos(turn), np.sin(turn), 0.0]) == pytest.approx(1.0, abs=1e-3)


def test_axes_have_one_scale_a_ground_line_and_dark_enough_lines():
    figure = robot_figure(loaded_arm())
    axes = figure.axes[0]
    assert axes.get_aspect() == 1.0 and axes.get_ylabel() == "z [m]"
    assert any(np.allclose(line.get_ydata(), 0.0) for line in axes.get_lines())
    assert pale_lines(figure) == []


def test_no_load_and_no_deflection_can_be_drawn():
    figure = robot_figure(loaded_arm(np.zeros(3), np.zeros(6), np.zeros(6)))
    assert any("0 mm (measured)" in text for text in texts_of(figure))


def test_the_largest_deflection_is_drawn_unless_a_row_is_requested(data):
    largest = int(np.linalg.norm(data.samples.deflection, axis=1).argmax())
    (arm,) = sb.figure("robot", data).paint.args
    np.testing.assert_array_equal(arm.q, data.samples.q[largest])
    np.testing.assert_array_equal(arm.deflection, data.samples.deflection[largest])
    chosen = sb.figure("robot", data, row=7)
    np.testing.assert_array_equal(chosen.paint.args[0].q, data.samples.q[7])
    assert chosen.subtitle.startswith("kr10-twin (simulated), pose ")
    for row in (-1, len(data)):
        with pytest.raises(ConfigError, match="0 to 150"):
            sb.figure("robot", data, row=row)


def test_a_model_draws_its_prediction_and_marks_where_the_tcp_was(data):
    model = sb.make_model("vjm").fit(data)
    picture = sb.figure("robot", data, model=model, row=7)
    (arm,) = picture.paint.args
    row = slice(7, 8)
    (predicted,) = model.predict(data.samples.q[row], data.samples.wrench[row])
    np.testing.assert_allclose(arm.deflection, predicted)
    np.testing.assert_array_equal(arm.compliance, model.fitted.springs_.compliance)
    figure = picture.draw()
    assert "TCP, simulated" in lines_of(figure)
    assert any("predicted by vjm" in text and "(simulated)" in text for text in texts_of(figure))


def test_a_model_without_joint_springs_borrows_those_of_a_vjm_and_says_so(data):
    model = sb.make_model("knn").fit(data)
    alone = sb.figure("robot", model=model)
    assert "vjm" in alone.caption and "knn" in alone.caption
    (arm,) = alone.paint.args
    (predicted,) = model.predict(arm.q[None], arm.wrench[None])
    np.testing.assert_allclose(arm.deflection, predicted)
    assert arm.compliance.shape == (6,) and (arm.compliance > 0.0).all()


def test_results_show_the_data_set_that_measured_results_are_of(tmp_path):
    """Measured data come first, whatever the name."""
    made = MadeResults(tmp_path)
    made.add("vjm", [0.1], "a", data=made_data(1))
    made.add("vjm", [0.1], "z-measured", data=made_data(2), kind="measured")
    picture = sb.figure("robot", tmp_path)
    assert picture.subtitle.startswith("z-measured (measured), pose P")


def test_what_does_not_belong_together_is_refused(data, tmp_path):
    model = sb.make_model("vjm")
    with pytest.raises(NotFittedError):
        sb.figure("robot", data, model=model)
    model.fit(data)
    moved_robot = replace(ROBOT, tcp=np.array([0.0, 0.0, 0.3]))
    with pytest.raises(ConfigError, match="TCP"):
        robot_picture(
            data.samples, moved_robot, "mine", "measured", model=model.fitted, model_name="vjm"
        )
    with pytest.raises(ConfigError, match="row"):
        sb.figure("robot", model=model, row=1)
    with pytest.raises(ConfigError, match="only the figure robot"):
        sb.figure("scores", tmp_path, row=1)


def test_a_models_plot_is_its_figure_and_needs_a_fit(data):
    model = sb.make_model("vjm").fit(data)
    pictures = model.plot(), sb.figure("robot", model=model)
    plotted, figure = (picture.paint.args[0] for picture in pictures)
    np.testing.assert_array_equal(plotted.q, figure.q)
    np.testing.assert_array_equal(plotted.deflection, figure.deflection)
    with pytest.raises(NotFittedError):
        sb.make_model("vjm").plot()
