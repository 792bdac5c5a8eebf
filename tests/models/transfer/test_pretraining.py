"""Check pre-training: its sum over joints, and the options that change it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from stiff_models.physics.vjm import VirtualJointModel, identify_joints
from stiff_models.transfer.dt_cnn import DtCnn
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.pretrained_mlp import MlpPretrained
from stiff_models.transfer.pretraining import power_of_four
from stiff_protocols.splits.random_splits import LeaveOneOut

SMALL = {"pretrain_steps": 20, "device": "cpu"}


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch, small_source):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path / "cache"))


def predict(model, samples):
    return model.predict(samples.q, samples.wrench)


def with_compliance(robot, samples, factors):
    """Return the samples of a robot whose joints' compliances are multiplied by factors."""
    joints = identify_joints(robot, samples)
    vjm = VirtualJointModel().fit(samples, robot=robot)
    vjm.springs_ = replace(joints, compliance=joints.compliance * factors)
    return replace(samples, deflection=predict(vjm, samples))


@pytest.mark.slow
@pytest.mark.parametrize("cls", [MlpPretrained, DtCnn])
def test_predictions_are_linear_in_the_identified_compliances(cls, twin, trainings):
    samples = with_compliance(twin.robot, twin.samples, np.ones(6))
    joints = identify_joints(twin.robot, samples).compliance
    bounds = power_of_four(joints) / joints  # within a factor of two, one reference serves all
    options = SMALL | ({} if cls is DtCnn else {"width": 16})
    factors = [np.ones(6), bounds, 0.5 * (1 + bounds)]
    first, second, between = (
        predict(
            cls(**options).fit(
                with_compliance(twin.robot, samples, factor), robot=twin.robot, seed=seed
            ),
            samples,
        )
        for seed, factor in enumerate(factors)
    )
    assert trainings == ["pre-train"]  # neither compliances nor the seed of the fit take part
    size = np.abs(first).max()
    assert np.abs(first - second).max() > 0.05 * size
    np.testing.assert_allclose(between, (first + second) / 2, atol=1e-5 * size)


def test_leave_one_out_needs_few_pre_trainings(twin, trainings):
    for split in LeaveOneOut().splits(twin.samples, n_splits=None, seed=0):
        train = twin.samples.take(np.sort(np.concatenate([split.train, split.validation])))
        MlpPretrained(**SMALL, width=8).fit(train, robot=twin.robot)
        if split.index == 8:
            break
    assert len(trainings) <= 2


@pytest.mark.slow
def test_what_makes_another_pre_training(twin, trainings):
    """Options of fine-tuning do not: see the tests of the cache."""
    changes = [
        {"activation": "tanh"},
        {"pretrain_steps": 21},
        {"pretrain_seed": 1},
        {"preset": "paper"},
        {"recipe": "paper"},
        {"source_teacher": "vjm-multisegment"},
    ]
    for number, options in enumerate([{}, *changes], start=1):
        all_options = SMALL | {"width": 8, "epochs": 0} | options
        FtMlp(**all_options).fit(twin.samples, robot=twin.robot)
        assert trainings.count("pre-train") == number, options


@pytest.mark.slow
def test_the_source_is_learned_quickly_also_at_a_factor_of_two_off(twin, monkeypatch):
    """All 2,000 steps reach 3.5 um in minutes; 60 steps reach 76 um, 150 steps 17 um."""
    monkeypatch.setattr("stiff_models.transfer.source_domain.POSE_BUDGET", 21_280)
    joints = identify_joints(twin.robot, twin.samples).compliance
    samples = with_compliance(twin.robot, twin.samples, 2.0 * power_of_four(joints) / joints)
    model = MlpPretrained(device="cpu", pretrain_steps=150).fit(samples, robot=twin.robot)
    size = np.sqrt((model.output_scaler_.scale**2).mean())
    assert model.source_errors_[:3].mean() <= 0.025e-3 * max(1.0, size / 0.5e-3)
    assert isinstance(model.network_[-1], torch.nn.Linear)
    assert model.network_[-1].out_features == 3


@pytest.mark.slow
def test_no_result_depends_on_the_robots_name(twin):
    first, second = (
        FtMlp(**SMALL, width=8, epochs=30).fit(
            twin.samples, robot=replace(twin.robot, name=name), seed=1
        )
        for name in (twin.robot.name, "another")
    )
    np.testing.assert_array_equal(predict(first, twin.samples), predict(second, twin.samples))
