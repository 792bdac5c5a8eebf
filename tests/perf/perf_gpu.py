"""Compare networks on a GPU and on the processor; skip without a GPU."""

from __future__ import annotations

import pytest
import torch

from helpers.perf_case import ours_or_peer
from helpers.quick_models import twin_data
from stiff_models.io.cache_folder import OFF, VARIABLE
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.pretrained_mlp import MlpPretrained
from stiff_protocols.splits.random_splits import Holdout

STEPS, SPLITS = 300, 64

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here"),
    pytest.mark.slow,
    pytest.mark.parametrize("device", ["cuda", "cpu"]),
]


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.setenv(VARIABLE, OFF)


def report_speed(benchmark, device, work, unit):
    gpu = f"stiffbench on {torch.cuda.get_device_name()}"
    name = gpu if device == "cuda" else "processor, one thread"
    ours_or_peer(benchmark, name, work=work, unit=unit)


@pytest.mark.benchmark(group=f"GPU: pre-training, {STEPS} steps of recipe=fast")
def test_pretraining(benchmark, device):
    data, model = twin_data(), MlpPretrained(device=device, pretrain_steps=STEPS)
    report_speed(benchmark, device, STEPS, "step")
    arguments = (data.samples,), {"robot": data.robot, "seed": 0}
    benchmark.pedantic(model.fit, *arguments, rounds=2, warmup_rounds=1)


@pytest.mark.benchmark(group=f"GPU: fine-tuning, {SPLITS} splits of recipe=fast")
def test_sweep(benchmark, device):
    data, model = twin_data(), FtMlp(device=device, pretrain_steps=0)

    def sweep():
        for split in Holdout().splits(data.samples, n_splits=SPLITS, seed=0):
            train, validation = (data.samples.take(r) for r in (split.train, split.validation))
            model.fit(train, robot=data.robot, validation=validation, seed=0)

    report_speed(benchmark, device, SPLITS, "split")
    benchmark.pedantic(sweep, rounds=1, warmup_rounds=1 if device == "cuda" else 0)
