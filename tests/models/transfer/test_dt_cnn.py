"""Check `dt-cnn`: its presets, its layers, and the labels that each regime uses."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.made_samples import with_other_labels
from stiff_models.networks import network_model
from stiff_models.transfer.cnn import CellMaxPool, adapt_statistics, build_cnn
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
    robot, usual_train, _, _ = parts
    model = DtCnn(**(SMALL | options))
    return model.fit(usual_train if train is None else train, robot=robot, seed=5)


def predictions(model, parts):
    test = parts[3]
    return model.predict(test.q, test.wrench)


def kinds(network):
    return {type(module) for module in network.modules()}


def differing_names(first, second):
    """Return the names of weights and buffers in which two fitted models differ."""
    second_state = second.network_.state_dict()
    return {
        k for k, v in first.network_.state_dict().items() if not torch.equal(v, second_state[k])
    }


def test_the_udtl_preset_is_the_literal_network(parts):
    model = fit(parts, pretrain_steps=0, preset="udtl")
    only_udtl = {CellMaxPool, torch.nn.MaxPool1d, torch.nn.LayerNorm}
    assert only_udtl <= kinds(model.network_)
    assert {m.p for m in model.network_.modules() if isinstance(m, torch.nn.Dropout)} == {0.5}
    assert not model.input_scaler_.mean.any() and (model.input_scaler_.scale == 1.0).all()
    assert not kinds(fit(parts, pretrain_steps=0).network_) & only_udtl


@pytest.mark.slow
def test_adabn_changes_only_the_batch_statistics(parts):
    differing = differing_names(fit(parts, alignment="none"), fit(parts, alignment="adabn"))
    assert differing == {
        f"body.{number}.{name}"
        for number in (2, 5, 8, 11)
        for name in ("running_mean", "running_var", "num_batches_tracked")
    }


@pytest.mark.slow
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
    identified_options = {"alignment": alignment}  # the labels make the source's stiffnesses
    changed_prediction = predictions(
        fit(parts, with_other_labels(train), **identified_options), parts
    )
    assert (
        np.abs(changed_prediction - predictions(fit(parts, **identified_options), parts)).max() > 0
    )


@pytest.mark.slow
def test_fine_tuning_learns_every_weight_for_the_chosen_epochs_and_keeps_the_batch_statistics(
    parts,
):
    tuned, source = fit(parts, supervision="fine-tune"), fit(parts)
    assert differing_names(tuned, source) == {name for name, _ in tuned.network_.named_parameters()}
    train = parts[1]
    errors = [
        np.abs(model.predict(train.q, train.wrench) - train.deflection).mean()
        for model in (tuned, source)
    ]
    assert errors[0] < 0.9 * errors[1]
    assert (tuned.regime, source.regime) == ("", NO_TARGET_LABELS)
    assert tuned.best_params_["epochs"] == tuned.curves_["fine-tuning"][-1, 0] in (6, 12)


def network(n_inputs=12, pool="none", dropout=0.0, per_sample=False, seed=0):
    """Return a network in evaluation mode with batch statistics adapted to inputs."""
    net = build_cnn(n_inputs, pool=pool, dropout=dropout, per_sample=per_sample, seed=seed)
    adapt_statistics(net, inputs(64, n_inputs, seed=9))
    return net


def inputs(n=20, n_inputs=12, seed=1):
    return torch.randn(n, n_inputs, generator=torch.Generator().manual_seed(seed))


def swap_columns(values, first, second):
    order = list(range(values.shape[1]))
    order[first], order[second] = order[second], order[first]
    return values[:, order]


@pytest.mark.parametrize("length", [4, 6, 9, 13])
def test_cells_are_those_of_torchs_adaptive_pooling(length):
    values = torch.randn(3, 5, length, generator=torch.Generator().manual_seed(0))
    assert torch.equal(CellMaxPool(length)(values), torch.nn.AdaptiveMaxPool1d(4)(values))


@pytest.mark.parametrize(("n_inputs", "pool", "hidden"), [(18, "none", 2304), (18, "udtl", 512)])
def test_layers_are_those_of_udtl(n_inputs, pool, hidden):
    net = network(n_inputs, pool=pool)
    convolutions = [m for m in net.modules() if isinstance(m, torch.nn.Conv1d)]
    assert {m.kernel_size for m in convolutions} == {(1,)}
    channels = [(m.in_channels, m.out_channels) for m in convolutions]
    assert channels == [(1, 16), (16, 32), (32, 64), (64, 128)]
    linear = [(m.in_features, m.out_features) for m in net.modules() if hasattr(m, "in_features")]
    assert linear == [(hidden, 256), (256, 256), (256, 3)]
    assert len(net.norms()) == 4
    assert net(inputs(7, n_inputs)).shape == (7, 3)
    assert net.bottleneck(inputs(7, n_inputs)).shape == (7, 256)


@pytest.mark.parametrize(("n_inputs", "pair"), [(12, 0), (18, 4)])
def test_the_pooled_network_cannot_tell_apart_the_features_of_a_pair(n_inputs, pair):
    values = inputs(50, n_inputs)
    swapped_values = swap_columns(values, 2 * pair, 2 * pair + 1)
    net = network(n_inputs, pool="udtl")
    assert not torch.equal(values, swapped_values)
    assert torch.equal(net(values), net(swapped_values))  # exactly, q1 with q2 for example


def test_samples_are_normalised_on_their_own():
    values = torch.tensor([[1.0, 2.0, 3.0, 6.0], [5.0, 5.0, 5.0, 5.0]])
    expected = np.array([[-2.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 0.0]])
    expected[0] /= np.sqrt(14 / 4)
    normalise = build_cnn(4, pool="none", dropout=0.0, per_sample=True, seed=0).body[0]
    np.testing.assert_allclose(normalise(values), expected, rtol=1e-6)
    net = network(per_sample=True)
    np.testing.assert_allclose(
        net(inputs()).detach(), net(100.0 * inputs() + 7.0).detach(), atol=1e-4
    )


def test_adapted_statistics_are_those_of_the_inputs():
    net = build_cnn(6, pool="none", dropout=0.0, per_sample=False, seed=0)
    before = copy.deepcopy(net.state_dict())
    values = 3.0 + 2.0 * inputs(40, 6)
    adapt_statistics(net, values)
    # closed form for the first convolution: w x + b over rows and features
    weight, bias = (before[f"body.1.{name}"].double().numpy() for name in ("weight", "bias"))
    outputs = values.double().numpy().reshape(-1, 1) * weight[:, 0, 0] + bias  # (240, 16)
    np.testing.assert_allclose(net.norms()[0].running_mean, outputs.mean(0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(net.norms()[0].running_var, outputs.var(0, ddof=1), rtol=1e-4)
    assert not any(module.training for module in net.modules())
    assert {module.momentum for module in net.norms()} == {0.1}
