"""Networks on a GPU beside the same on the processor; not measured where there is no GPU."""

from __future__ import annotations

import pytest
import torch

from perf_case import ours, peer
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.io.cache_folder import OFF, VARIABLE
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.mlp_pretrained import MlpPretrained
from stiff_protocols.splits.random_splits import Holdout

STEPS, SPLITS = 300, 64
PROCESSOR = "processor, one thread"

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def data():
    return Kr10Twin().load()


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.setenv(VARIABLE, OFF)


def about(benchmark, device, work, unit):
    if device == "cuda":
        name = f"stiffbench on {torch.cuda.get_device_name()}"
        ours(benchmark, name, work=work, unit=unit)
    else:
        peer(benchmark, PROCESSOR, work=work, unit=unit)


@pytest.mark.benchmark(group=f"GPU: pre-training, {STEPS} steps of recipe=fast")
@pytest.mark.parametrize("device", ["cuda", "cpu"])
def test_pretraining(benchmark, data, device):
    model = MlpPretrained(device=device, pretrain_steps=STEPS)
    about(benchmark, device, STEPS, "step")
    benchmark.pedantic(
        model.fit, (data.samples,), {"robot": data.robot, "seed": 0}, rounds=2, warmup_rounds=1
    )


@pytest.mark.benchmark(group=f"GPU: fine-tuning, {SPLITS} splits of recipe=fast")
@pytest.mark.parametrize("device", ["cuda", "cpu"])
def test_sweep(benchmark, data, device):
    splits = list(Holdout().splits(data.samples, n_splits=SPLITS, seed=0))
    model = FtMlp(device=device, pretrain_steps=0)

    def sweep():
        for split in splits:
            train, validation = (data.samples.take(r) for r in (split.train, split.validation))
            model.fit(train, robot=data.robot, validation=validation, seed=0)

    about(benchmark, device, SPLITS, "split")
    benchmark.pedantic(sweep, rounds=1, warmup_rounds=1 if device == "cuda" else 0)
