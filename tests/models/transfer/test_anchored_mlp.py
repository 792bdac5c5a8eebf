"""Check anchored transfer: before fine-tuning a network predicts what its teacher predicts."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch

from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.model_catalog import SpringModel
from stiff_models.networks.onnx_export import physics_module
from stiff_models.physics.full_vjm import FullVjm
from stiff_models.physics.multi_segment_vjm import MultiSegmentVjm
from stiff_models.physics.vjm import VirtualJointModel, fitted_physics
from stiff_models.transfer.deep_ensemble import DeepEnsemble
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.pretrained_mlp import (
    TEACHERS,
    MlpPretrained,
    chosen_teacher,
)
from stiff_models.transfer.source_model import NO_TARGET_LABELS
from stiff_protocols.contract.record import TEACHER_EPOCHS

pytestmark = [
    pytest.mark.usefixtures("small_source"),
    pytest.mark.filterwarnings("ignore::stiff_protocols.contract.errors.StiffBenchWarning"),
]
SMALL = {"width": 8, "pretrain_steps": 5, "device": "cpu"}


def predict(model, samples):
    return model.predict(samples.q, samples.wrench)


def errors(model, samples):
    return np.linalg.norm(predict(model, samples) - samples.deflection, axis=1)


@pytest.mark.parametrize(
    ("anchor", "cls", "options"),
    [
        ("vjm", FtMlp, {"epochs": 0}),
        *(
            pytest.param(anchor, FtMlp, {"epochs": 0}, marks=pytest.mark.slow)
            for anchor in get_args(SpringModel)
            if anchor != "vjm"
        ),
        ("vjm-full", MlpPretrained, {}),
        ("vjm-multisegment", DeepEnsemble, {"epochs": 0, "members": 2}),
    ],
)
def test_without_fine_tuning_an_anchored_network_is_its_teacher_exactly(
    anchor, cls, options, parts
):
    robot, train, _, test = parts
    model = cls(**SMALL, **options, anchor=anchor).fit(train, robot=robot, seed=3)
    teacher = fitted_physics(anchor, train, robot)
    np.testing.assert_array_equal(predict(model, test), predict(teacher, test))
    assert model.diagnostics_[TEACHER_EPOCHS] == 0.0


@pytest.mark.parametrize("teacher", TEACHERS)
def test_the_teacher_is_chosen_that_predicts_left_out_poses_best(teacher, parts, rng):
    robot, train, _, _ = parts
    truth = fitted_physics(teacher, train, robot)
    noise = rng.normal(scale=2e-6, size=train.deflection.shape)
    samples = replace(train, deflection=predict(truth, train) + noise)
    if teacher == "vjm":  # the other teachers contain it, except for their priors
        assert chosen_teacher(samples.take(np.arange(3)), robot, 0) in TEACHERS
    else:
        assert chosen_teacher(samples, robot, 0) == teacher


@pytest.mark.slow
def test_the_chosen_teacher_is_reported_and_an_ensembles_members_have_the_first_ones(parts):
    robot, train, _, _ = parts
    teacher = chosen_teacher(train, robot, 3)
    single = FtMlp(**SMALL, epochs=10, training="normal").fit(train, robot=robot, seed=3)
    assert single.best_params_ == {"anchor": teacher}
    assert single.diagnostics_[TEACHER_EPOCHS] == 10.0
    ensemble = DeepEnsemble(**SMALL, epochs=10, members=2).fit(train, robot=robot, seed=3)
    assert ensemble.best_params_ == {"anchor": teacher, "epochs": ensemble.members_[1].epochs}
    assert ensemble.members_[1].anchor == teacher


@pytest.mark.parametrize(
    ("options", "anchored"),
    [
        ({}, True),
        ({"anchor": "none"}, False),
        ({"preset": "paper"}, False),
        ({"recipe": "paper"}, False),
        ({"preset": "paper", "anchor": "teacher"}, True),
    ],
)
def test_the_papers_method_has_no_anchor(options, anchored):
    assert FtMlp(**options).is_anchored is anchored
    assert DeepEnsemble(**options).is_anchored is anchored
    assert not MlpPretrained().is_anchored


def test_the_labels_that_identify_a_teacher_are_declared():
    model = MlpPretrained(anchor="vjm")
    model.use_source(Kr10Twin(specimen=1).load())
    assert model.regime == NO_TARGET_LABELS
    assert FtMlp().regime == ""


def test_a_fold_has_a_teacher_that_never_saw_the_poses_left_out(parts, monkeypatch):
    robot, train, _, _ = parts
    learn, held_out = np.arange(60), np.arange(60, 90)
    fold_errors = []

    def record_errors(samples, lengths, errors_of, seed):
        fold_errors.append(errors_of(learn, held_out))
        return 0

    monkeypatch.setattr("stiff_models.networks.network_model.chosen_epochs", record_errors)
    FtMlp(**SMALL, epochs=10, anchor="vjm-full").fit(train, robot=robot, seed=2)
    teacher = fitted_physics("vjm-full", train.take(learn), robot)
    np.testing.assert_allclose(fold_errors[0][0], errors(teacher, train.take(held_out)), atol=2e-9)
    assert (fold_errors[0][1] != fold_errors[0][0]).any()


PHYSICS = (
    VirtualJointModel(),
    FullVjm(springs=6, solver="ridge"),
    MultiSegmentVjm(segments=3),
    MultiSegmentVjm(gravity=False),
)


@pytest.mark.parametrize("slide", [False, True])
@pytest.mark.parametrize("model", PHYSICS, ids=str)
def test_a_physical_model_predicts_the_same_in_torch(model, slide, parts):
    robot, train, _, test = parts
    if slide:
        robot = replace(robot, joint_types=("prismatic", *robot.joint_types[1:]))
    model.fit(train, robot=robot)
    module = physics_module(model)
    torch_prediction = module(torch.tensor(test.q), torch.tensor(test.wrench)).numpy()
    np.testing.assert_allclose(torch_prediction, predict(model, test), atol=1e-12)
