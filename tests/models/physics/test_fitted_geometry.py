"""Check that a fitted geometry finds the measured point and is reported as fitted."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from helpers.made_samples import samples_with
from helpers.quick_models import quick_model
from stiff_datasets.twin.experiment import TwinExperiment
from stiff_datasets.twin.robot_twin import random_poses
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import shipped_constants
from stiff_models.io.model_file import load
from stiff_models.model_catalog import SpringModel
from stiff_models.physics.fitted_geometry import Geometry, moved_wrench
from stiff_models.physics.full_vjm import FullVjm, spring_twists
from stiff_models.physics.multi_segment_vjm import MultiSegmentVjm
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.conformance.model_checks import check_model
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.stiffness_model import optional
from stiff_protocols.contract.types import PATH_GROUP, BenchmarkData
from stiff_protocols.splits.path_compensation import PathCompensation

STIFFNESS = np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
OFFSET = np.array([0.04, -0.03, -0.06])  # m, of the true point from the card's, last joint's frame
MODELS = (VirtualJointModel, FullVjm, MultiSegmentVjm)
OPTIONS = ({"tcp": "fit"}, {"tcp": "prior"}, {"lever": "fit"})

# segments that no torque reaches are not identifiable
pytestmark = pytest.mark.filterwarnings("ignore:joint stiffness not identifiable")


def measured_samples(robot, rng, *, lever=False, noise=0.0, n=60):
    """Return samples of linear springs, measured (or only loaded) `OFFSET` from the card's TCP."""
    q = rng.uniform(-1.5, 1.5, size=(n, 6))
    wrench = rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)
    if lever:
        at_tcp = moved_wrench(wrench, robot.forward(q).rotation @ OFFSET)
        deflection = robot.joint_deflection(1 / STIFFNESS, q, at_tcp)
    else:
        deflection = offset_robot(robot).joint_deflection(1 / STIFFNESS, q, wrench)
    return samples_with(q, wrench, deflection + noise * rng.normal(size=(n, 3)))


def offset_robot(robot, offset=OFFSET):
    return replace(robot, tcp=robot.tcp + offset)


@pytest.mark.parametrize("lever", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_the_point_of_exact_samples_is_found_and_new_poses_are_predicted(model, lever, kr10, rng):
    train, test = (measured_samples(kr10, rng, lever=lever) for _ in range(2))
    options = {"lever": "fit"} if lever else {"tcp": "fit"}
    fitted = model(**options).fit(train, robot=kr10)
    error = fitted.predict(test.q, test.wrench) - test.deflection
    assert np.abs(fitted.geometry_.point - kr10.tcp - OFFSET).max() < 1e-3
    assert np.abs(error).max() < 0.02 * np.abs(test.deflection).max()
    assert fitted.robot_ is kr10
    unfitted = model().fit(train, robot=kr10)
    assert np.abs(unfitted.predict(test.q, test.wrench) - test.deflection).max() > (
        3.0 * np.abs(error).max()
    )


@pytest.mark.parametrize("model", MODELS)
def test_a_prior_holds_the_point_the_nearer_the_narrower_it_is(model, kr10, rng):
    train = measured_samples(kr10, rng, noise=1e-4, n=20)
    distances = [
        np.linalg.norm(fitted.geometry_.point - kr10.tcp)
        for fitted in (
            model(tcp="prior", tcp_sigma_mm=sigma).fit(train, robot=kr10)
            for sigma in (0.1, 20.0, 1e4)
        )
    ]
    assert distances == sorted(distances) and distances[0] < 2e-3
    assert distances[-1] == pytest.approx(np.linalg.norm(OFFSET), rel=0.3)


@pytest.mark.slow
def test_the_interval_holds_the_point_in_nine_of_ten_measurements(kr10, rng):
    true_point = offset_robot(kr10).tcp_on_flange
    inside = []
    for _ in range(40):
        train = measured_samples(kr10, rng, noise=5e-5, n=20)
        low, high = VirtualJointModel(tcp="fit").fit(train, robot=kr10).geometry_.interval().T
        inside += [(low < true_point) & (true_point < high)]
    assert 0.8 < np.mean(inside) < 0.98


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_the_tcp_is_predicted_by_the_turn_of_the_tool_about_the_measured_point(options, kr10, rng):
    train = measured_samples(kr10, rng, lever="lever" in options, noise=1e-5)
    model = FullVjm(**options).fit(train, robot=kr10)
    test = measured_samples(kr10, rng)
    rotation = kr10.forward(test.q).rotation
    geometry: Geometry = model.geometry_
    to_card_tcp = rotation @ (
        kr10.tcp - geometry.point
    )  # from the fitted point to the TCP, base frame
    at_point = moved_wrench(test.wrench, to_card_tcp)  # the tool is loaded at its TCP
    twists = spring_twists(geometry.robot, test.q, 3)
    load = moved_wrench(at_point, rotation @ geometry.lever)
    spring_turn = np.einsum(
        "nks,ns->nk", twists, np.einsum("nks,nk->ns", twists, load) * model.compliance_
    )
    to_tcp = rotation @ (kr10.tcp - geometry.robot.tcp)
    expected = model.predict(test.q, at_point) + np.cross(spring_turn[:, 3:], to_tcp)
    np.testing.assert_allclose(model.predict_at_tcp(test.q, test.wrench), expected, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("key", get_args(SpringModel))
def test_a_spring_model_moves_the_tool_as_a_rigid_body(key):
    model = quick_model(key)
    robot, rng = model.robot_, np.random.default_rng(3)
    q, wrench = rng.uniform(-1.0, 1.0, (20, 6)), rng.normal(size=(20, 6)) * 20.0
    rotation = robot.forward(q).rotation

    def moved(lever):
        load = moved_wrench(wrench, rotation @ -lever)  # the same load, at another point
        return model.predict_at_point(q, load, robot.tcp + lever)

    first, second = np.array([0.1, -0.05, 0.2]), np.array([0.0, 0.15, -0.1])
    at_tcp = moved(np.zeros(3))
    np.testing.assert_allclose(at_tcp, optional(model, "predict_at_tcp")(q, wrench), atol=1e-15)
    summed = moved(first) + moved(second) - at_tcp
    np.testing.assert_allclose(moved(first + second), summed, atol=1e-12)
    assert np.abs(moved(first) - at_tcp).max() > 1e-6


@pytest.mark.parametrize(
    ("model", "options"),
    [
        (FullVjm, {"lever": "fit", "tcp": "fit"}),
        (MultiSegmentVjm, {"lever": "fit", "tcp": "prior"}),
    ],
)
def test_options_that_contradict_each_other_are_refused(model, options, kr10, rng):
    with pytest.raises(ConfigError, match=r"lever='fit'.*use tcp='given'"):
        model(**options).fit(measured_samples(kr10, rng), robot=kr10)
    with pytest.raises(ConfigError, match="use tcp='given'"):
        model(**options).check_params()


@pytest.mark.parametrize(
    ("model", "options"),
    [(FullVjm, {"tcp": "prior"}), (MultiSegmentVjm, {"lever": "fit"})],
    ids=str,
)
def test_models_with_a_fitted_geometry_keep_the_contract_and_are_saved(model, options, fanuc):
    checks = check_model(lambda: model(**options), fanuc, uses_validation=False, load=load)
    failures = [str(check) for check in checks if check.status == "failed"]
    assert not failures, "\n".join(failures)
    statuses = {check.name: check.status for check in checks}
    assert statuses["save and load give the same numbers"] == "passed"


@pytest.fixture(scope="module")
def offset_ur5():
    """Return a UR5 that was measured and pulled 30 mm from its card's TCP.

    Paths are for the tool at the TCP, whose true deflection is known.
    """
    constants = shipped_constants("ur5")
    x, y, z = constants.tcp_m
    measured = constants.model_copy(update={"tcp_m": (x, y, z + 0.03)})
    samples = TwinExperiment(measured, specimen=0, seed=0).samples(random_poses(constants, 151, 0))
    tool = DigitalTwin.in_world(constants, 0, "clean")
    data = BenchmarkData(samples, tool.description, under_load=tool.truth)
    return PathCompensation().prepared(data)


@pytest.mark.slow
def test_commands_are_for_the_tools_own_tcp_where_another_point_was_measured(offset_ur5):
    protocol, is_path = PathCompensation(), offset_ur5.samples.group == PATH_GROUP
    rows = np.flatnonzero(is_path)
    train = offset_ur5.samples.take(np.flatnonzero(~is_path))
    points = offset_ur5.samples.take(rows)

    def path_error(predict):
        commands = protocol.commanded(predict, offset_ur5.robot, points.q, points.wrench)
        remaining_error = points.deflection - protocol.scored(commands, commands, offset_ur5, rows)
        return np.linalg.norm(remaining_error, axis=1).mean()

    unfitted_model, fitted_model = (
        FullVjm(tcp=tcp).fit(train, robot=offset_ur5.robot) for tcp in ("given", "fit")
    )
    at_tcp = path_error(optional(fitted_model, "predict_at_tcp"))
    assert at_tcp < 0.8 * path_error(unfitted_model.predict)
    assert at_tcp < 0.8 * path_error(fitted_model.predict)  # the measured point's
