"""What can be seen of the code for a GPU without one."""

import contextlib
import os

import pytest
import torch

from stiff_models.device import torch_device
from stiff_models.networks.arithmetic import arithmetic
from stiff_models.networks.network import build_network
from stiff_models.networks.training import Rows, _Run
from stiff_models.transfer.cnn import build_cnn
from stiff_models.transfer.dt_cnn import FAST
from stiff_models.transfer.ft_mlp import FINE_TUNING
from stiff_models.transfer.pretrained_mlp import PRETRAINING

ELSEWHERE = torch.device("meta")  # holds no numbers, but refuses tensors of other devices


def mlp(activation="relu"):
    return build_network(18, layers=4, width=16, activation=activation, seed=0)


@pytest.fixture()
def elsewhere_as_on_a_gpu(monkeypatch):
    """Let the device without numbers do what a GPU can: fused optimizers, autocast."""
    adam = torch.optim.Adam
    monkeypatch.setattr(
        torch.optim, "Adam", lambda groups, *, fused, **words: adam(groups, **words)
    )
    monkeypatch.setattr(_Run, "_autocast", lambda self, low: contextlib.nullcontext())


@pytest.mark.parametrize("bfloat16", [False, True])
@pytest.mark.parametrize(
    ("network", "plan"),
    [
        (mlp(), PRETRAINING["fast"]),
        (mlp("gelu"), PRETRAINING["best"]),
        (mlp(), FINE_TUNING["fast"]),
        (mlp(), FINE_TUNING["paper"]),
        (build_cnn(18, pool="none", dropout=0.1, per_sample=False, seed=0), FAST),
    ],
    ids=["pre-train", "best", "fine-tune", "paper", "dt-cnn"],
)
@pytest.mark.usefixtures("elsewhere_as_on_a_gpu")
def test_a_step_of_training_stays_on_the_device_of_its_rows(network, plan, bfloat16):
    network = network.to(ELSEWHERE)
    rows = Rows(*(torch.zeros(1500, size, device=ELSEWHERE) for size in (18, 3)))
    run = _Run(network, rows, plan, [*network.parameters()], None, 0, None, bfloat16)
    assert [run.step(step).device for step in range(2)] == [ELSEWHERE] * 2


@pytest.mark.usefixtures("elsewhere_as_on_a_gpu")
def test_a_step_with_rows_of_another_device_than_the_network_fails():
    rows = Rows(torch.zeros(4, 18), torch.zeros(4, 3))
    network = mlp().to(ELSEWHERE)
    trainable = [*network.parameters()]
    with pytest.raises((RuntimeError, NotImplementedError)):
        _Run(network, rows, FINE_TUNING["fast"], trainable, None, 0, None, False).step(0)


def test_a_training_on_a_gpu_repeats_itself_and_leaves_torchs_mode_as_it_was():
    with arithmetic(torch.device("cuda"), mixed_precision=False).in_force():
        assert torch.are_deterministic_algorithms_enabled()
    assert not torch.are_deterministic_algorithms_enabled()
    with arithmetic(torch.device("cpu"), mixed_precision=False).in_force():
        assert not torch.are_deterministic_algorithms_enabled()


def test_a_gpus_matrix_products_are_told_to_repeat_themselves(monkeypatch):
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", "")  # so that it is put back afterwards
    monkeypatch.delenv("CUBLAS_WORKSPACE_CONFIG")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert torch_device("cpu") == torch.device("cpu")
    assert "CUBLAS_WORKSPACE_CONFIG" not in os.environ
    assert torch_device("auto") == torch_device("cuda") == torch.device("cuda")
    assert os.environ["CUBLAS_WORKSPACE_CONFIG"] == ":4096:8"
