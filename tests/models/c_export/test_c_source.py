"""Compare exported C with the models in Python: deflections, corrections, statuses, refusals."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from helpers.c_models import NEEDS_GCC, compiled
from helpers.made_robots import planar_arm, random_chain, seven_joint_arm, tree_urdf
from helpers.made_samples import samples_with
from helpers.quick_models import fitted, quick_model
from stiff_datasets.robots.shipped_robots import named_robot, shipped_robots
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_models.c_export.c_source import export_c
from stiff_models.model_catalog import MODELS, is_spring_model, model_info
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning
from stiff_protocols.contract.stiffness_model import optional
from stiff_protocols.paths import compensation
from stiff_protocols.paths.path import ToolPath

NANOMETRE, COMMAND_RAD = 1e-9, 1e-9
NETWORK_SHARE = 1e-6
"""Largest difference of a network, of the largest deflection: Python computes it in float32."""
MOST_BYTES = 256 * 1024
STATUSES = {
    -1: compensation.NOT_CONVERGED,
    -2: compensation.OUT_OF_REACH,
    -3: compensation.BEYOND_LIMITS,
}
PALLETIZER = """
    base turn revolute axis=y z=0.5
    turn upper revolute axis=y x=0.2 z=0.3
    upper elbow revolute axis=y z=0.9 mimic=to_upper multiplier=-1 offset=0.2
    elbow rail prismatic axis=x limits=-1..1
    rail tool0 fixed z=0.1
"""
SPRINGS = [
    ("vjm", {"tcp": "fit"}),
    ("vjm", {"lever": "fit"}),
    ("vjm-full", {"springs": 6, "solver": "ridge"}),
    ("vjm-multisegment", {"segments": 3}),
    ("vjm-multisegment", {"gravity": False}),
    ("fourier-springs", {}),
    ("curve-springs", {}),
    ("bayes-springs", {}),
    ("bayes-springs", {"tcp": "prior"}),
    ("bayes-springs", {"groups": "joints+bearing play+load curves+base", "lever": "fit"}),
]
"""Every family of springs, with the options that change its prediction."""
FIRST_OF_FAMILY = {key: options for key, options in reversed(SPRINGS)}


def made_model(key, options, robot, rng):
    """Return a model of made samples in which no part vanishes."""
    q = rng.uniform(-1.2, 1.2, (60, robot.n_joints))
    wrench = 50.0 * rng.normal(size=(60, 6))
    compliance = np.where(robot.turns, 1e-5, 1e-6) * rng.uniform(0.5, 2.0, robot.n_joints)
    deflection = robot.joint_deflection(compliance, q, wrench)
    deflection += 0.02 * deflection.std() * rng.normal(size=deflection.shape)
    model = model_info(key).load()(**options)
    with warnings.catch_warnings():  # of robots without masses, and of few samples
        warnings.simplefilter("ignore", StiffBenchWarning)
        model.fit(samples_with(q, wrench, deflection), robot=robot)
    if key == "bayes-springs":
        model.coefficients_ = 0.1 * rng.normal(size=model.coefficients_.shape)
        model.rig_ = replace(
            model.rig_,
            force_point=rng.normal(size=3),
            cross_talk=rng.normal(size=(6, 6)),
            weight_factor=rng.uniform(0.5, 2.0, robot.n_joints),
        )
    return model


def random_loads(robot, n, rng):
    """Return (n, n_joints) positions within two turns and the limits, and (n, 6) wrenches."""
    low, high = np.clip(robot.lower, -6.3, 6.3), np.clip(robot.upper, -6.3, 6.3)
    q = rng.uniform(low, high, (n, robot.n_joints))
    return q, rng.normal(size=(n, 6)) * np.repeat([300.0, 50.0], 3)


def python_correction(model, q, wrench):
    """Return Python's commands and the problems of the rows; the target is each pose itself."""
    poses = model.robot_.forward(q)
    path = ToolPath("made", poses.points[:, -1], poses.rotation, wrench)
    done = compensation.compensate(optional(model, "predict_at_tcp"), model.robot_, path, q)
    return done.q, done.problem, done.iterations


def assert_corrects_as_python(c, model, q, wrench):
    command, status = c.correct(q, wrench)
    expected, problem, iterations = python_correction(model, q, wrench)
    assert [STATUSES.get(int(number), "") for number in status] == problem.tolist()
    assert np.array_equal(status[status > 0], iterations[status > 0])
    assert np.abs(command - expected).max() <= COMMAND_RAD
    assert np.array_equal(command[status < 0], q[status < 0])


@pytest.fixture(scope="module")
def vjm_in_c(tmp_path_factory):
    return compiled(quick_model("vjm"), tmp_path_factory.mktemp("vjm"))


@NEEDS_GCC
def test_c_predicts_and_corrects_as_python(vjm_in_c, rng):
    model, c = quick_model("vjm"), vjm_in_c
    q, wrench = random_loads(model.robot_, 5000, rng)
    expected = model.predict(q, wrench)
    assert np.abs(c.deflection(q, wrench) - expected).max() <= NANOMETRE < expected.std()
    assert_corrects_as_python(c, model, q[:400], wrench[:400])


@NEEDS_GCC
def test_a_corrected_command_puts_the_loaded_tool_where_the_unloaded_one_was(vjm_in_c):
    model = quick_model("vjm")
    q = np.radians([[0.0, -60.0, 90.0, 10.0, 30.0, 0.0]])
    wrench = np.array([[50.0, 0.0, -200.0, 0.0, 5.0, 0.0]])
    command, status = vjm_in_c.correct(q, wrench)
    before, after = (model.robot_.forward(positions) for positions in (q, command))
    bent = model.predict(command, wrench)
    assert status[0] > 1 and np.linalg.norm(bent) > 1e-4
    assert np.linalg.norm(after.points[:, -1] + bent - before.points[:, -1]) < 2e-6
    assert np.abs(after.rotation - before.rotation).max() < 1e-7


@NEEDS_GCC
@pytest.mark.slow
@pytest.mark.parametrize(("key", "options"), SPRINGS)
def test_springs_of_100_000_random_samples_of_all_shipped_robots(key, options, tmp_path, rng):
    robots = [named_robot(name).robot() for name in shipped_robots()]
    if FIRST_OF_FAMILY[key] != options:  # other options: the first robot
        robots = robots[:1]
    elif key != "bayes-springs":  # whose expressions hold those of the other families
        robots = robots[::4]
    for number, robot in enumerate(robots):
        folder = tmp_path / str(number)
        folder.mkdir()
        model = made_model(key, options, robot, rng)
        c = compiled(model, folder, key)
        assert c.library.stat().st_size <= MOST_BYTES
        q, wrench = random_loads(robot, 100_000 // len(robots) + 1, rng)
        expected = model.predict(q, wrench)
        assert np.abs(c.deflection(q, wrench) - expected).max() <= NANOMETRE
        assert expected.std() > 1e3 * NANOMETRE
        assert_corrects_as_python(c, model, q[:30], wrench[:30])


@NEEDS_GCC
@pytest.mark.slow
@pytest.mark.parametrize(("key", "options"), FIRST_OF_FAMILY.items())
def test_springs_of_other_chains(key, options, tmp_path, rng):
    """Slides, mimic joints, seven joints, few joints, no limits, and a turned base."""
    path = tree_urdf(tmp_path / "palletizer.urdf", PALLETIZER)
    planar = planar_arm(2, (0.0, 1.0, 0.0), mass=2.0)
    kinds = ("prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute")
    masses = {"masses": np.full(6, 2.0), "gravity": np.array([3.0, -4.0, 8.0])}
    robots = [
        read_robot(path, tcp=(0.1, 0.2, 0.1)),
        replace(planar, lower=np.full(2, -np.inf), upper=np.full(2, np.inf)),
        replace(random_chain(rng, kinds), **masses),
        random_chain(rng, ("prismatic",) * 3),
        seven_joint_arm(),
    ]
    for number, robot in enumerate(robots):
        folder = tmp_path / str(number)
        folder.mkdir()
        model = made_model(key, options, robot, rng)
        c = compiled(model, folder, key)
        q, wrench = random_loads(robot, 500, rng)
        assert np.abs(c.deflection(q, wrench) - model.predict(q, wrench)).max() <= NANOMETRE
        if robot.n_joints <= 6:
            assert_corrects_as_python(c, model, q[:50], wrench[:50])
        else:  # Python refuses: a pose does not determine the joints
            command, status = c.correct(q, wrench)
            assert set(status.tolist()) == {-4} and np.array_equal(command, q)


@NEEDS_GCC
@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "options"),
    [
        ("mlp", {"epochs": 50, "training": "normal"}),
        ("mlp", {"angle_encoding": "raw", "activation": "tanh", "width": 40, "layers": 1}),
        ("mlp", {"activation": "sigmoid", "width": 40}),
        ("mlp", {"activation": "gelu", "width": 40}),
        ("mlp-pretrained", {"width": 40, "pretrain_steps": 20}),
        ("ft-mlp", {"width": 40, "pretrain_steps": 20, "epochs": 10, "anchor": "none"}),
    ],
)
def test_networks_of_random_samples_are_pythons_within_float32(key, options, tmp_path, rng):
    model = fitted(key, options)
    c = compiled(model, tmp_path, key)
    q, wrench = random_loads(model.robot_, 20_000 if model.width > 100 else 100_000, rng)
    expected = model.predict(q, wrench)
    error = np.abs(c.deflection(q, wrench) - expected).max()
    assert error <= NETWORK_SHARE * np.abs(expected).max()
    command, status = c.correct(q[:100], wrench[:100])
    in_python, problem, _ = python_correction(model, q[:100], wrench[:100])
    assert np.array_equal(status > 0, problem == "")
    assert np.abs(command - in_python).max() <= 1e-6


@NEEDS_GCC
def test_what_is_not_finite_is_never_a_number(tmp_path):
    c = compiled(quick_model("vjm-multisegment"), tmp_path)
    q, wrench = np.zeros((3, 6)), np.full((3, 6), 10.0)
    q[0, 2], wrench[1, 0], wrench[2, 5] = np.nan, np.nan, np.inf
    assert not np.isfinite(c.deflection(q, wrench)).all(axis=1).any()
    assert (c.correct(q, wrench)[1] < 0).all()


@NEEDS_GCC
def test_names_that_c_would_read_as_code_stay_in_the_comment(tmp_path):
    robot = replace(planar_arm(2, (0.0, 1.0, 0.0), mass=1.0), name="*/ x /* ??/\n\u00e9")
    q, wrench = np.array([[0.1, 0.2], [0.4, 0.9], [-0.3, 0.6]]), np.full((3, 6), 10.0)
    samples = samples_with(q, wrench, robot.joint_deflection(np.full(2, 1e-5), q, wrench))
    model = model_info("vjm").load()().fit(samples, robot=robot)
    assert np.isfinite(compiled(model, tmp_path).deflection(q, wrench)).all()


@pytest.mark.parametrize("key", ["mean", "knn", "gp", "residual-mlp", "deep-ensemble", "ft-mlp"])
def test_another_model_is_refused_by_name(key, tmp_path):
    model = object.__new__(model_info(key).load())
    model.robot_, model.teacher_ = quick_model("vjm").robot_, quick_model("vjm")
    with pytest.raises(ConfigError, match=f"{key} has no C form.*bayes-springs.*mlp"):
        export_c(model, tmp_path / "model.c", name=key, data="made")
    assert not [*tmp_path.iterdir()]


def test_every_family_of_springs_is_compared():
    families = {info.key for info in MODELS if is_spring_model(info.key)}
    assert {key for key, _ in SPRINGS} == families


def test_a_file_without_the_suffix_of_c_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"\.c"):
        export_c(quick_model("vjm"), tmp_path / "model.cpp", name="vjm", data="made")
