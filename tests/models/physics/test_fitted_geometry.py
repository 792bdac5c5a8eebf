"""Fitted geometry: the measured point is found where the springs are right, and told as fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_samples import samples_with
from stiff_datasets.twin.constants import shipped_constants, specimen_springs
from stiff_datasets.twin.robot_twin import random_poses
from stiff_datasets.twin.twin import DigitalTwin, TwinExperiment
from stiff_models.io.model_file import load
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


def measured(robot, rng, *, lever=False, noise=0.0, n=60):
    """Samples of linear joint springs, measured (or only loaded) `OFFSET` from the card's TCP."""
    q = rng.uniform(-1.5, 1.5, size=(n, 6))
    wrench = rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)
    if lever:
        at_tcp = moved_wrench(wrench, robot.forward(q).rotation @ OFFSET)
        deflection = robot.joint_deflection(1 / STIFFNESS, q, at_tcp)
    else:
        deflection = elsewhere(robot).joint_deflection(1 / STIFFNESS, q, wrench)
    return samples_with(q, wrench, deflection + noise * rng.normal(size=(n, 3)))


def elsewhere(robot, offset=OFFSET):
    return replace(robot, tcp=robot.tcp + offset)


@pytest.mark.parametrize("lever", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_the_point_of_exact_samples_is_found_and_new_poses_are_predicted(model, lever, kr10, rng):
    train, test = (measured(kr10, rng, lever=lever) for _ in range(2))
    options = {"lever": "fit"} if lever else {"tcp": "fit"}
    found = model(**options).fit(train, robot=kr10)
    error = found.predict(test.q, test.wrench) - test.deflection
    assert np.abs(found.geometry_.point - kr10.tcp - OFFSET).max() < 1e-3
    assert np.abs(error).max() < 0.02 * np.abs(test.deflection).max()
    assert found.robot_ is kr10
    given = model().fit(train, robot=kr10)
    assert np.abs(given.predict(test.q, test.wrench) - test.deflection).max() > (
        3.0 * np.abs(error).max()
    )


@pytest.mark.parametrize("model", MODELS)
def test_a_prior_holds_the_point_the_nearer_the_narrower_it_is(model, kr10, rng):
    train = measured(kr10, rng, noise=1e-4, n=20)
    distances = [
        np.linalg.norm(fitted.geometry_.point - kr10.tcp)
        for fitted in (
            model(tcp="prior", tcp_sigma_mm=sigma).fit(train, robot=kr10)
            for sigma in (0.1, 20.0, 1e4)
        )
    ]
    assert distances == sorted(distances) and distances[0] < 2e-3
    assert distances[-1] == pytest.approx(np.linalg.norm(OFFSET), rel=0.3)


def test_the_interval_holds_the_point_in_nine_of_ten_measurements(kr10, rng):
    true = elsewhere(kr10).tcp_on_flange
    inside = []
    for _ in range(40):
        train = measured(kr10, rng, noise=5e-5, n=20)
        low, high = VirtualJointModel(tcp="fit").fit(train, robot=kr10).geometry_.interval().T
        inside += [(low < true) & (true < high)]
    assert 0.8 < np.mean(inside) < 0.98


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_the_tcp_is_predicted_by_the_turn_of_the_tool_about_the_measured_point(options, kr10, rng):
    train = measured(kr10, rng, lever="lever" in options, noise=1e-5)
    model = FullVjm(**options).fit(train, robot=kr10)
    test = measured(kr10, rng)
    rotation = kr10.forward(test.q).rotation
    place: Geometry = model.geometry_
    back = rotation @ (kr10.tcp - place.point)  # from the fitted point to the TCP, base frame
    at_point = moved_wrench(test.wrench, back)  # the tool is loaded at its TCP
    twists = spring_twists(place.robot, test.q, 3)
    load = moved_wrench(at_point, rotation @ place.lever)
    turned = np.einsum(
        "nks,ns->nk", twists, np.einsum("nks,nk->ns", twists, load) * model.compliance_
    )
    to_tcp = rotation @ (kr10.tcp - place.robot.tcp)
    expected = model.predict(test.q, at_point) + np.cross(turned[:, 3:], to_tcp)
    np.testing.assert_allclose(model.predict_at_tcp(test.q, test.wrench), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "options"),
    [
        (FullVjm, {"lever": "fit", "tcp": "fit"}),
        (MultiSegmentVjm, {"lever": "fit", "tcp": "prior"}),
    ],
)
def test_options_that_contradict_each_other_are_refused(model, options, kr10, rng):
    with pytest.raises(ConfigError, match=r"lever='fit'.*use tcp='given'"):
        model(**options).fit(measured(kr10, rng), robot=kr10)
    with pytest.raises(ConfigError, match="use tcp='given'"):
        model(**options).check_params()


@pytest.mark.parametrize(
    ("model", "options"),
    [(FullVjm, {"tcp": "prior"}), (MultiSegmentVjm, {"lever": "fit"})],
    ids=str,
)
def test_models_with_a_fitted_geometry_keep_the_contract_and_are_saved(model, options, fanuc):
    checks = check_model(lambda: model(**options), fanuc, uses_validation=False, load=load)
    failed = [str(check) for check in checks if check.status == "failed"]
    assert not failed, "\n".join(failed)
    by_name = {check.name: check.status for check in checks}
    assert by_name["save and load give the same numbers"] == "passed"


@pytest.fixture(scope="module")
def falsified():
    """A UR5 that was measured and pulled 30 mm in front of its TCP; its card names the TCP.

    The TCP is the tool that paths are for: its true deflection is known.
    """
    constants = shipped_constants("ur5")
    robot, springs = constants.robot(), specimen_springs(constants, 0)
    experiment = TwinExperiment(constants, loads="omni", specimen=0, seed=0)
    experiment.twin = DigitalTwin(elsewhere(robot, np.array([0.0, 0.0, 0.03])), springs)
    samples = experiment.samples(random_poses(constants, 151, 0))
    of_tool = DigitalTwin(robot, springs).readings
    return PathCompensation().prepared(BenchmarkData(samples, robot, {}, of_tool))


def test_commands_are_for_the_tools_own_tcp_where_another_point_was_measured(falsified):
    protocol, is_path = PathCompensation(), falsified.samples.group == PATH_GROUP
    rows = np.flatnonzero(is_path)
    train = falsified.samples.take(np.flatnonzero(~is_path))
    points = falsified.samples.take(rows)

    def path_error(predict):
        commands = protocol.commanded(predict, falsified.robot, points.q, points.wrench)
        left = points.deflection - protocol.scored(commands, commands, falsified, rows)
        return np.linalg.norm(left, axis=1).mean()

    given, fitted = (FullVjm(tcp=tcp).fit(train, robot=falsified.robot) for tcp in ("given", "fit"))
    at_tcp = path_error(optional(fitted, "predict_at_tcp"))
    assert at_tcp < 0.8 * path_error(given.predict)
    assert at_tcp < 0.8 * path_error(fitted.predict)  # the measured point's
