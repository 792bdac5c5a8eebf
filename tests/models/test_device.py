"""Check devices of networks: routes of matrix products, and GPU settings without a GPU."""

from __future__ import annotations

import contextlib
import os

import pytest
import torch

from stiff_models import device
from stiff_models.device import (
    Arithmetic,
    arithmetic,
    has_fast_bfloat16,
    medium_is_float32,
    torch_device,
)
from stiff_models.networks.fully_connected import build_network
from stiff_models.networks.training import Rows, _Run
from stiff_models.transfer.cnn import build_cnn
from stiff_models.transfer.dt_cnn import FAST
from stiff_models.transfer.ft_mlp import FINE_TUNING
from stiff_models.transfer.pretrained_mlp import PRETRAINING

CPU = torch.device("cpu")
ELSEWHERE = torch.device("meta")  # holds no numbers, but refuses tensors of other devices


@pytest.fixture(autouse=True)
def cleared_processor_checks():
    checks = (medium_is_float32, has_fast_bfloat16)
    for check in checks:
        check.cache_clear()
    yield
    for check in checks:
        check.cache_clear()


def test_the_check_passes_float32_and_fails_bfloat16():
    assert device._relative_error(torch.float32, CPU) <= device.FLOAT32_ERROR
    assert device._relative_error(torch.bfloat16, CPU) > 100 * device.FLOAT32_ERROR


@pytest.mark.parametrize(
    ("error", "seconds", "expected"),
    [
        (0.0, lambda dtype: dtype.itemsize, Arithmetic("medium", bfloat16=True)),
        (0.0, lambda dtype: 1.0 / dtype.itemsize, Arithmetic("medium", bfloat16=False)),
        (1.0, lambda dtype: dtype.itemsize, Arithmetic("highest", bfloat16=False)),
    ],
)
def test_a_route_is_taken_where_it_is_accurate_and_fast(monkeypatch, error, seconds, expected):
    monkeypatch.setattr(device, "_relative_error", lambda dtype, target_device: error)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: True)
    monkeypatch.setattr(device, "_seconds", seconds)
    assert arithmetic(CPU, mixed_precision=True) == expected
    assert not arithmetic(CPU, mixed_precision=False).bfloat16


def test_routes_and_modes_are_put_back_after_a_training():
    before = torch.get_float32_matmul_precision()
    with pytest.raises(ZeroDivisionError), Arithmetic("medium", bfloat16=False).in_force():
        assert torch.get_float32_matmul_precision() == "medium"
        raise ZeroDivisionError
    assert torch.get_float32_matmul_precision() == before
    with arithmetic(torch.device("cuda"), mixed_precision=False).in_force():
        assert torch.are_deterministic_algorithms_enabled()
    assert not torch.are_deterministic_algorithms_enabled()


@pytest.mark.parametrize("bfloat16", [False, True])
@pytest.mark.parametrize("plan", [PRETRAINING["fast"], FINE_TUNING["paper"], FAST])
def test_a_step_of_training_stays_on_the_device_of_its_rows(plan, bfloat16, monkeypatch):
    adam = torch.optim.Adam
    monkeypatch.setattr(
        torch.optim, "Adam", lambda groups, *, fused, **options: adam(groups, **options)
    )
    monkeypatch.setattr(_Run, "_autocast", lambda self, low: contextlib.nullcontext())
    network = build_network(18, layers=4, width=16, activation="gelu", seed=0)
    if plan is FAST:
        network = build_cnn(18, pool="none", dropout=0.1, per_sample=False, seed=0)
    network = network.to(ELSEWHERE)
    rows = Rows(*(torch.zeros(1500, size, device=ELSEWHERE) for size in (18, 3)))
    run = _Run(network, rows, plan, [*network.parameters()], None, 0, None, bfloat16)
    assert [run.step(step).device for step in range(2)] == [ELSEWHERE] * 2


def test_a_gpus_matrix_products_are_told_to_repeat_themselves(monkeypatch):
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", "")  # so that it is put back afterwards
    monkeypatch.delenv("CUBLAS_WORKSPACE_CONFIG")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert torch_device("cpu") == torch.device("cpu")
    assert "CUBLAS_WORKSPACE_CONFIG" not in os.environ
    assert torch_device("auto") == torch_device("cuda") == torch.device("cuda")
    assert os.environ["CUBLAS_WORKSPACE_CONFIG"] == ":4096:8"
