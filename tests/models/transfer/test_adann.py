"""Check two regressors against one extractor, the method of `adann-2r`."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from helpers.domain_rows import INPUTS, OF_TARGET, TARGETS
from helpers.made_samples import with_other_labels
from stiff_models.networks.fully_connected import build_network
from stiff_models.networks.training import HUBER_DELTA
from stiff_models.transfer.adann import (
    REGRESSORS_SHARE,
    Adann2R,
    AdversarialObjective,
    TwoRegressors,
)
from stiff_models.transfer.alignment import SOURCE_ONLY, ramp
from stiff_models.transfer.source_model import NO_TARGET_LABELS

SMALL = {"device": "cpu", "source_poses": "sobol", "width": 16, "pretrain_steps": 8}

NOMINAL = {"source_stiffness": "nominal", "nominal_stiffness": "5e4,6e4,5e4,2e3,9e3,1e3"}


def two_regressors(layers=4, width=8, seed=0):
    networks = (
        build_network(7, layers=layers, width=width, activation="relu", seed=network_seed)
        for network_seed in (seed, seed + 1)
    )
    return TwoRegressors(*networks)


def objective(network, labels=None, weight=2.0, target=OF_TARGET):
    return AdversarialObjective(network, target, labels, weight=weight, seed=3)


def gradients(network, loss):
    parameters = dict(network.named_parameters())
    slopes = torch.autograd.grad(loss, list(parameters.values()), allow_unused=True)
    return dict(zip(parameters, slopes, strict=True))


def test_before_a_sixth_of_the_training_both_regressors_learn_the_source_alone():
    network = two_regressors()
    loss = objective(network)(SOURCE_ONLY, INPUTS, TARGETS)
    features = network.extractor(INPUTS)
    huber = torch.nn.HuberLoss(delta=HUBER_DELTA)
    expected = sum(
        huber(regressor(features), TARGETS) / HUBER_DELTA
        for regressor in (network.first, network.second)
    )
    torch.testing.assert_close(loss, expected)


def test_regressors_are_driven_apart_on_the_target_and_the_extractor_against_them():
    network, weight, progress = two_regressors(), 2.0, 0.6
    total_loss = objective(network, weight=weight)(progress, INPUTS, TARGETS)
    source_loss = objective(network, weight=0.0)(progress, INPUTS, TARGETS)
    disagreement = network.disagreement(network.extractor(OF_TARGET))
    strength = weight * ramp(progress)
    torch.testing.assert_close(total_loss, source_loss - REGRESSORS_SHARE * strength * disagreement)
    total_slopes, source_slopes = gradients(network, total_loss), gradients(network, source_loss)
    for name, slope in gradients(network, disagreement).items():
        factor = strength if name.startswith("extractor") else -REGRESSORS_SHARE * strength
        torch.testing.assert_close(
            total_slopes[name] - source_slopes[name], factor * slope, rtol=1e-4, atol=1e-6
        )


@pytest.fixture()
def quick(small_source, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", "off")


def fit(parts, train=None, **options):
    robot, usual_train, _, _ = parts
    model = Adann2R(**(SMALL | options))
    return model.fit(usual_train if train is None else train, robot=robot, seed=5)


def predictions(model, parts):
    return model.predict(parts[3].q, parts[3].wrench)


@pytest.mark.filterwarnings("ignore:joint stiffness not identifiable")  # of labels made up
@pytest.mark.usefixtures("quick")
def test_unsupervised_labels_of_the_target_change_nothing_but_the_source(parts):
    train = parts[1]
    for supervision, labels_used in (("none", False), ("labels", True)):
        options = {"supervision": supervision, **NOMINAL}
        model = fit(parts, **options)
        changed = predictions(fit(parts, with_other_labels(train), **options), parts)
        assert (np.abs(changed - predictions(model, parts)).max() > 0.0) == labels_used
        assert model.regime == ("" if labels_used else NO_TARGET_LABELS)
    changed_prediction = predictions(fit(parts, with_other_labels(train)), parts)
    assert np.abs(changed_prediction - predictions(fit(parts), parts)).max() > 0.0


@pytest.mark.usefixtures("small_source")
def test_a_kept_training_is_taken_for_no_other_weight_or_label(parts, tmp_path, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path))
    train = parts[1]
    options = {**NOMINAL, "supervision": "labels"}
    first = fit(parts, **options)
    np.testing.assert_array_equal(
        predictions(fit(parts, **options), parts), predictions(first, parts)
    )
    other_models = [
        fit(parts, **options, adversarial_weight=2.0),
        fit(parts, **options | {"supervision": "none"}),
        fit(parts, with_other_labels(train), **options),
    ]
    for model in other_models:
        assert np.abs(predictions(model, parts) - predictions(first, parts)).max() > 0.0
