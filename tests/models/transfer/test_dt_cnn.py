"""`dt-cnn` as a model: its presets, what it learns from in each regime, and that it learns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.made_samples import with_other_labels
from stiff_models.networks import network_model
from stiff_models.transfer.cnn import CellMaxPool
from stiff_models.transfer.dt_cnn import FAST, FINE_TUNING, DtCnn
from stiff_models.transfer.source_model import NO_TARGET_LABELS

SMALL = {"device": "cpu", "source_poses": "sobol", "pretrain_steps": 8}


@pytest.fixture(autouse=True)
def short_training(small_source, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", "off")
    monkeypatch.setattr("stiff_models.transfer.dt_cnn.FAST", replace(FAST, batch=32))
    monkeypatch.setattr(network_model, "LENGTHS", (0, 6))
    monkeypatch.setattr("stiff_models.transfer.dt_cnn.FINE_TUNING", replace(FINE_TUNING, steps=12))


def fit(parts, train=None, **options):
    robot, own, _, _ = parts
    model = DtCnn(**(SMALL | options))
    return model.fit(own if train is None else train, robot=robot, seed=5)


def predictions(model, parts):
    test = parts[3]
    return model.predict(test.q, test.wrench)


def kinds(network):
    return {type(module) for module in network.modules()}


def changed(first, second):
    """Names of the weights and buffers in which two fitted models differ."""
    other = second.network_.state_dict()
    return {k for k, v in first.network_.state_dict().items() if not torch.equal(v, other[k])}


def test_the_udtl_preset_is_the_literal_network(parts):
    model = fit(parts, pretrain_steps=0, preset="udtl")
    assert {CellMaxPool, torch.nn.MaxPool1d, torch.nn.LayerNorm} <= kinds(model.network_)
    assert {m.p for m in model.network_.modules() if isinstance(m, torch.nn.Dropout)} == {0.5}
    assert not model.input_scaler_.mean.any() and (model.input_scaler_.scale == 1.0).all()
    unpooled = fit(parts, pretrain_steps=0, preset="udtl", pool="none")
    assert not kinds(unpooled.network_) & {CellMaxPool, torch.nn.MaxPool1d}


def test_adabn_changes_only_the_batch_statistics(parts):
    differing = changed(fit(parts, alignment="none"), fit(parts, alignment="adabn"))
    assert differing == {
        f"body.{number}.{name}"
        for number in (2, 5, 8, 11)
        for name in ("running_mean", "running_var", "num_batches_tracked")
    }


@pytest.mark.filterwarnings("ignore:joint stiffness not identifiable")  # of labels made up
@pytest.mark.parametrize("alignment", ["mk-mmd", "adabn"])
def test_unsupervised_labels_of_the_target_change_nothing_but_the_source(parts, alignment):
    train = parts[1]
    options = {
        "alignment": alignment,
        "source_stiffness": "nominal",
        "nominal_stiffness": "5e4,6e4,5e4,2e3,9e3,1e3",
    }
    model = fit(parts, **options)
    np.testing.assert_array_equal(
        predictions(fit(parts, with_other_labels(train), **options), parts),
        predictions(model, parts),
    )
    identified = {"alignment": alignment}  # the labels make the source's stiffnesses
    moved = predictions(fit(parts, with_other_labels(train), **identified), parts)
    assert np.abs(moved - predictions(fit(parts, **identified), parts)).max() > 0


@pytest.mark.slow
def test_fine_tuning_learns_every_weight_for_the_chosen_epochs_and_keeps_the_batch_statistics(
    parts,
):
    tuned, source = fit(parts, supervision="fine-tune"), fit(parts)
    assert changed(tuned, source) == {name for name, _ in tuned.network_.named_parameters()}
    train = parts[1]
    errors = [
        np.abs(model.predict(train.q, train.wrench) - train.deflection).mean()
        for model in (tuned, source)
    ]
    assert errors[0] < 0.9 * errors[1]
    assert (tuned.regime, source.regime) == ("", NO_TARGET_LABELS)
    assert tuned.best_params_["epochs"] == tuned.curves_["fine-tuning"][-1, 0] in (6, 12)
