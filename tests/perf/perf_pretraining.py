"""Compare the throughput of pre-training on the source domain with peers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import pytest
import torch
from sklearn.neural_network import MLPRegressor

from helpers.perf_case import ours_or_peer
from helpers.quick_models import twin_data
from stiff_models.device import has_fast_bfloat16
from stiff_models.networks.fully_connected import build_network, linear_layers
from stiff_models.networks.training import Rows, TrainingPlan, train_network
from stiff_models.transfer.pretrained_mlp import PRETRAINING, MlpPretrained
from stiff_models.transfer.pretraining import divided

WIDTH, BATCH, STEPS = 380, 1024, 20
FAST = PRETRAINING["fast"]
TEXTBOOK = TrainingPlan(steps=STEPS, learning_rate=1e-3, loss="mse", optimizer="adam", batch=BATCH)
THROUGHPUT = "pre-training, 4 x 380, batches of 1,024"
PLAIN, SKLEARN = "plain eager torch", "scikit-learn's MLPRegressor"
SGEMM = ("sgemm, default route", "sgemm, medium route")


def new_network() -> torch.nn.Sequential:
    return build_network(18, layers=4, width=WIDTH, activation="relu", seed=0)


def gigaflop(n_rows: int) -> float:
    """Return the work of both passes over n rows: three products per weight."""
    weights = sum(layer.weight.numel() for layer in linear_layers(new_network()))
    return 1e-9 * 3 * 2 * weights * n_rows


@pytest.fixture(scope="module")
def source() -> Rows:
    """Return a scaled source; both loops train the same network on it."""
    data, model = twin_data(), MlpPretrained(device="cpu", preset="paper")
    origin = model._origin(data.samples, data.robot)
    domain = model._simulated(origin.samples, origin.robot, 0)
    learn, _ = divided(domain, 0)
    model._start(origin.robot, learn.q, learn.wrench, learn.deflection, 0)
    source = model._rows(learn.q, learn.wrench, learn.deflection)
    ours_, plain = new_network(), new_network()
    train(ours_, source, replace(TEXTBOOK, steps=5))
    for _ in zip(range(5), plain_steps(plain, source), strict=False):
        pass
    for our_weights, plain_weights in zip(ours_.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(our_weights, plain_weights, rtol=1e-3, atol=1e-4)
    return source


def train(network: torch.nn.Sequential, source: Rows, plan: TrainingPlan) -> None:
    train_network(network, source, plan, seed=0, phase="pre-train")


def plain_steps(network: torch.nn.Sequential, source: Rows) -> Iterator[None]:
    """Yield after each step of the textbook loop with default Adam."""
    optimizer = torch.optim.Adam(network.parameters())
    loss_of = torch.nn.MSELoss()
    generator = torch.Generator().manual_seed(0)
    n = len(source)
    while True:
        order = torch.randperm(n, generator=generator)
        for rows in order.split(BATCH)[: n // BATCH]:
            optimizer.zero_grad()
            loss_of(network(source.inputs[rows]), source.targets[rows]).backward()
            optimizer.step()
            yield


PLANS = {
    "stiffbench float32": TEXTBOOK,
    "stiffbench bfloat16": replace(TEXTBOOK, mixed_precision=True),
    "stiffbench recipe=fast": replace(FAST, steps=STEPS),  # Newton-Schulz is not counted as work
}
TARGETS = {
    "stiffbench float32": dict.fromkeys(SGEMM, 0.7),
    "stiffbench bfloat16": dict.fromkeys(SGEMM, 1.3) | {PLAIN: 3.0},
}


@pytest.mark.benchmark(group=THROUGHPUT)
@pytest.mark.parametrize("who", [*PLANS, PLAIN, SKLEARN])
def test_throughput(benchmark, source, who):
    if who in PLANS and PLANS[who].mixed_precision and not has_fast_bfloat16(torch.device("cpu")):
        pytest.skip("bfloat16: this processor has no products of it")
    if who == PLAIN:
        steps = plain_steps(new_network(), source)

        def way() -> object:
            return [next(steps) for _ in range(STEPS)]
    elif who == SKLEARN:
        regressor = MLPRegressor(hidden_layer_sizes=(WIDTH,) * 4, alpha=0.0, batch_size=BATCH)
        rows = source.inputs[: STEPS * BATCH], source.targets[: STEPS * BATCH]
        way = partial(regressor.partial_fit, *(part.numpy() for part in rows))
    else:
        way = partial(train, new_network(), source, PLANS[who])
    work = gigaflop(STEPS * BATCH)
    ours_or_peer(benchmark, who, TARGETS.get(who), work=work, unit="GFLOP")
    benchmark.pedantic(way, rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group=THROUGHPUT)
@pytest.mark.parametrize("route", SGEMM)
def test_matrix_product(benchmark, route):
    """Measure the machine's limit: the matrix product of one layer."""
    precision = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if "medium" in route else "highest")
    batch_matrix, layer_matrix = torch.randn(BATCH, WIDTH), torch.randn(WIDTH, WIDTH)
    ours_or_peer(benchmark, route, work=2e-9 * BATCH * WIDTH**2, unit="GFLOP")
    benchmark.pedantic(
        torch.mm, (batch_matrix, layer_matrix), rounds=20, iterations=20, warmup_rounds=1
    )
    torch.set_float32_matmul_precision(precision)
