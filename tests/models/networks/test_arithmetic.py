"""Routes of matrix products: checked before they are taken, and put back afterwards."""

from __future__ import annotations

import pytest
import torch

from stiff_models.networks import arithmetic as module
from stiff_models.networks.arithmetic import (
    Arithmetic,
    arithmetic,
    has_fast_bfloat16,
    medium_is_float32,
)
from stiff_models.networks.network import build_network
from stiff_models.networks.training import Rows, train_network
from stiff_models.networks.training_plan import TrainingPlan

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def checked_anew():
    for check in (medium_is_float32, has_fast_bfloat16):
        check.cache_clear()
    yield
    for check in (medium_is_float32, has_fast_bfloat16):
        check.cache_clear()


def test_the_check_passes_float32_and_fails_bfloat16():
    assert module._relative_error(torch.float32, CPU) <= module.FLOAT32_ERROR
    assert module._relative_error(torch.bfloat16, CPU) > 100 * module.FLOAT32_ERROR


@pytest.mark.parametrize("error", [0.0, 1.0])
def test_a_route_that_is_less_accurate_than_its_name_is_not_taken(monkeypatch, error):
    monkeypatch.setattr(module, "_relative_error", lambda dtype, device: error)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: True)
    monkeypatch.setattr(module, "_seconds", lambda dtype: dtype.itemsize)
    accurate = error == 0.0
    assert arithmetic(CPU, mixed_precision=True) == Arithmetic(
        "medium" if accurate else "highest", bfloat16=accurate
    )
    assert not arithmetic(CPU, mixed_precision=False).bfloat16


def test_bfloat16_is_not_taken_where_it_is_slower(monkeypatch):
    monkeypatch.setattr(module, "_relative_error", lambda dtype, device: 0.0)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: True)
    monkeypatch.setattr(module, "_seconds", lambda dtype: 1.0 / dtype.itemsize)
    assert not module.has_fast_bfloat16(CPU)


def test_a_training_leaves_everybody_elses_route_as_it_was(monkeypatch):
    seen = []
    forward = torch.nn.Identity()
    forward.register_forward_hook(lambda *_: seen.append(torch.get_float32_matmul_precision()))
    net = torch.nn.Sequential(
        forward, build_network(2, layers=1, width=4, activation="relu", seed=0)
    )
    rows = Rows(torch.ones(3, 2), torch.ones(3, 3))
    plan = TrainingPlan(steps=2, learning_rate=1e-3, loss="mae", optimizer="adam")
    before = torch.get_float32_matmul_precision()
    train_network(net, rows, plan, seed=0, phase="t")
    assert set(seen) == {arithmetic(CPU, mixed_precision=False).float32_route}
    assert torch.get_float32_matmul_precision() == before
    with pytest.raises(ZeroDivisionError), Arithmetic("medium", bfloat16=False).in_force():
        raise ZeroDivisionError
    assert torch.get_float32_matmul_precision() == before
