"""`mlp`, `mlp-pretrained` and `ft-mlp` as models, on small networks."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stiff_models.networks.features import Scaler, encode
from stiff_models.networks.mlp import Mlp
from stiff_models.networks.network import linear_layers
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.mlp_pretrained import MlpPretrained
from stiff_protocols.contract.errors import ConfigError, ModelError, NotFittedError

pytestmark = pytest.mark.usefixtures("small_source")

SMALL = {"layers": 4, "width": 16, "device": "cpu"}
SMALL_SOURCE = SMALL | {"pretrain_steps": 30, "source_poses": "sobol"}
STRATEGIES = [
    "layers:1,2",
    "layers:3",
    "layers:4,out",
    "full",
    "head",
    "first:2",
    "last:2",
    "gradual",
    "discriminative",
    "l2sp",
    "lp-ft",
    "bias",
]


def fit(model, parts, seed=5, validation=True):
    robot, train, held_out, _ = parts
    return model.fit(train, robot=robot, validation=held_out if validation else None, seed=seed)


def state(network):
    return {name: value.numpy().copy() for name, value in network.state_dict().items()}


def test_the_default_network_is_4_x_380_relu_on_18_features(parts):
    model = fit(Mlp(epochs=0, device="cpu"), parts)
    sizes = [(layer.in_features, layer.out_features) for layer in linear_layers(model.network_)]
    assert sizes == [(18, 380), (380, 380), (380, 380), (380, 380), (380, 3)]
    assert sum(isinstance(module, torch.nn.ReLU) for module in model.network_) == 4


def test_raw_angles_give_12_features(parts):
    robot, train, _, _ = parts
    assert encode(robot, train.q, train.wrench, "raw").shape[1] == 12
    assert encode(robot, train.q, train.wrench, "sincos").shape[1] == 18


def test_an_angle_and_the_same_angle_a_turn_later_are_one_input(parts):
    _, _, _, test = parts
    model = fit(Mlp(**SMALL, epochs=2), parts)
    np.testing.assert_allclose(
        model.predict(test.q + 2 * np.pi, test.wrench),
        model.predict(test.q, test.wrench),
        atol=1e-8,
    )


def test_a_constant_feature_is_not_divided_by_zero():
    values = np.stack([np.full(5, 3.0), np.arange(5.0)], axis=1)
    scaler = Scaler.of(values)
    assert np.isfinite(scaler.apply(values)).all()
    np.testing.assert_allclose(scaler.undo(scaler.apply(values)), values)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Mlp(**SMALL, epochs=20),
        lambda: MlpPretrained(**SMALL_SOURCE),
        lambda: FtMlp(**SMALL_SOURCE, epochs=10),
    ],
)
def test_the_same_seed_gives_the_same_predictions_and_another_seed_others(make, parts):
    _, _, _, test = parts
    first, again, other = (
        fit(make(), parts, seed=seed).predict(test.q, test.wrench) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert first.shape == (len(test), 3) and first.dtype == np.float64
    assert np.abs(first - other).max() > 0


def test_zero_epochs_of_fine_tuning_equal_the_pretrained_network(parts):
    _, _, _, test = parts
    tuned = fit(FtMlp(**SMALL_SOURCE, epochs=0), parts)
    source = fit(MlpPretrained(**SMALL_SOURCE), parts)
    np.testing.assert_array_equal(
        tuned.predict(test.q, test.wrench), source.predict(test.q, test.wrench)
    )


@pytest.mark.parametrize("freeze", STRATEGIES)
def test_every_strategy_moves_its_own_parameters_and_no_others(freeze, parts):
    model = fit(
        FtMlp(**SMALL_SOURCE, epochs=60, unfreeze_every=5, freeze=freeze, training="normal"), parts
    )
    before, after = state(model.source_network_), state(model.network_)
    changed = {name for name in before if not np.array_equal(before[name], after[name])}
    free = {
        "layers:1,2": {0, 2},
        "layers:3": {4},
        "layers:4,out": {6, 8},
        "head": {8},
        "first:2": {0, 2},
        "last:2": {6, 8},
    }.get(freeze, {0, 2, 4, 6, 8})
    kinds = ("bias",) if freeze == "bias" else ("weight", "bias")
    assert changed == {f"{layer}.{kind}" for layer in free for kind in kinds}


def test_l2sp_with_an_infinite_alpha_returns_the_source_weights(parts):
    model = fit(FtMlp(**SMALL_SOURCE, epochs=20, freeze="l2sp", l2sp_alpha=1e30), parts)
    before, after = state(model.source_network_), state(model.network_)
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_fine_tuning_brings_the_source_network_nearer_to_the_measurements(parts):
    _, train, _, _ = parts
    model = fit(FtMlp(**SMALL_SOURCE, epochs=200, freeze="full"), parts)
    tuned = np.abs(model.predict(train.q, train.wrench) - train.deflection).mean()
    model.network_ = model.source_network_
    assert tuned < 0.8 * np.abs(model.predict(train.q, train.wrench) - train.deflection).mean()


def test_without_validation_rows_the_last_epoch_is_kept(parts):
    model = fit(FtMlp(**SMALL_SOURCE, epochs=15, training="best"), parts, validation=False)
    assert model.fine_tuning_[-1].best_step == 15


def test_fine_tuning_keeps_the_statistics_of_the_source(parts):
    tuned, source = (
        fit(m, parts) for m in (FtMlp(**SMALL_SOURCE, epochs=5), MlpPretrained(**SMALL_SOURCE))
    )
    np.testing.assert_array_equal(tuned.input_scaler_.mean, source.input_scaler_.mean)
    np.testing.assert_array_equal(tuned.output_scaler_.scale, source.output_scaler_.scale)


@pytest.mark.parametrize("make", [Mlp, MlpPretrained, FtMlp])
def test_predict_before_fit_is_refused(make):
    with pytest.raises(NotFittedError):
        make().predict(np.zeros((1, 6)), np.zeros((1, 6)))


def test_joint_angles_of_another_robot_are_refused(parts):
    model = fit(Mlp(**SMALL, epochs=1), parts)
    with pytest.raises(ModelError, match=r"\(1, 7\), expected \(n, 6\)"):
        model.predict(np.zeros((1, 7)), np.zeros((1, 6)))


def test_a_strategy_that_does_not_fit_the_network_is_refused_before_any_work():
    with pytest.raises(ConfigError, match="'5' is no layer"):
        FtMlp(freeze="layers:5").check_params()


def test_constructors_only_store_and_get_params_gives_everything_back():
    model = FtMlp(freeze="full", epochs=7)
    params = model.get_params()
    assert params["freeze"] == "full" and params["epochs"] == 7 and params["width"] == 380
    assert FtMlp(**params).get_params() == params


def test_the_papers_schedule_is_the_papers():
    from stiff_models.transfer.ft_mlp import FINE_TUNING
    from stiff_models.transfer.mlp_pretrained import PRETRAINING

    tuning = FINE_TUNING["paper"]
    assert (tuning.learning_rate, tuning.steps, tuning.loss) == (0.03, 50_000, "mae")
    assert (PRETRAINING["paper"].steps, PRETRAINING["paper"].loss) == (100_000, "mse")


def test_the_best_recipe_has_gelu_unless_the_option_says_otherwise():
    for options, expected in (
        ({}, "relu"),
        ({"recipe": "best"}, "gelu"),
        ({"recipe": "best", "activation": "relu"}, "relu"),
        ({"activation": "tanh"}, "tanh"),
        ({"recipe": "paper"}, "relu"),
    ):
        assert FtMlp(**options).hidden_activation == expected
    assert Mlp().hidden_activation == "relu"


def test_fine_tuning_in_bfloat16_is_close_to_float32_and_is_asked_for(parts):
    exact = fit(FtMlp(**SMALL_SOURCE, epochs=20), parts).fine_tuning_[0]
    low = fit(FtMlp(**SMALL_SOURCE, epochs=20, precision="bfloat16"), parts).fine_tuning_[0]
    assert FtMlp().precision == "float32"
    assert low.best_loss == pytest.approx(exact.best_loss, rel=0.02)


@pytest.mark.slow
def test_the_fast_recipe_predicts_the_full_source_to_5_micrometres(parts):
    model = fit(MlpPretrained(device="cpu"), parts)
    assert model.diagnostics_["source samples"] == 106_400
    assert model.source_errors_[:3].mean() * 1000 <= 0.005
