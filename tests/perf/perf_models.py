"""The models beside kinematics and networks, each beside the obvious way of computing the same."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from helpers.perf_case import OURS, ours_or_peer
from helpers.quick_models import twin_data
from stiff_models.networks.encoded_model import Scaler, encode
from stiff_models.physics.multi_segment_vjm import search_breakpoints
from stiff_models.regressors.gaussian_process import Covariance, GaussianProcess, log_likelihood
from stiff_models.regressors.gp_springs import GpSprings, Hyperparameters
from stiff_models.regressors.spring_process import SpringLoads, likelihood_slopes
from stiff_protocols.contract.types import FloatArray

SCIKIT_LEARN = "scikit-learn"
AUTOGRAD = "torch, reverse differentiation"
BRUTE_FORCE = "every trial on all samples"

Rows = tuple[FloatArray, FloatArray]


def gp_rows(n: int) -> Rows:
    """Standardised rows of the twin, some of them moved a little to make more."""
    data, rng = twin_data(), np.random.default_rng(0)
    which = np.arange(n) % len(data.samples)
    features = encode(data.robot, data.samples.q, data.samples.wrench, "sincos")[which]
    inputs = Scaler.of(features).apply(features) + 0.3 * rng.normal(size=features.shape)
    outputs = data.samples.deflection[which, 0]
    return inputs, Scaler.of(outputs[:, None]).apply(outputs[:, None])[:, 0]


COVARIANCE = Covariance("matern", 1.3, np.linspace(3.0, 6.0, 18), 0.02, jitter=1e-10)


def scikit_learns(inputs: FloatArray, outputs: FloatArray) -> GaussianProcessRegressor:
    kernel = ConstantKernel(COVARIANCE.variance) * Matern(COVARIANCE.lengths, nu=2.5)
    kernel += WhiteKernel(COVARIANCE.noise)
    return GaussianProcessRegressor(kernel, alpha=COVARIANCE.jitter, optimizer=None).fit(
        inputs, outputs
    )


@pytest.mark.parametrize("who", [OURS, SCIKIT_LEARN])
@pytest.mark.parametrize("n", [151, 1000])
def test_likelihood(benchmark, who, n):
    rows = gp_rows(n)
    theirs = scikit_learns(*rows)
    ways = {
        OURS: lambda: log_likelihood(COVARIANCE, *rows),
        SCIKIT_LEARN: lambda: theirs.log_marginal_likelihood(COVARIANCE.theta, eval_gradient=True),
    }
    for found, expected in zip(ways[OURS](), ways[SCIKIT_LEARN](), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    benchmark.group = f"GP likelihood and gradient, 18 length scales, {n:,} rows"
    ours_or_peer(benchmark, who, {SCIKIT_LEARN: 4.0})
    benchmark.pedantic(ways[who], rounds=5, iterations=10 if n < 1000 else 1, warmup_rounds=1)


@pytest.mark.benchmark(group="GP prediction of 10,000 rows, 151 training rows")
@pytest.mark.parametrize("who", [OURS, SCIKIT_LEARN])
def test_prediction(benchmark, who):
    rows, (elsewhere, _) = gp_rows(151), gp_rows(10_000)
    ways = {
        OURS: GaussianProcess.of(COVARIANCE, *rows).mean,
        SCIKIT_LEARN: scikit_learns(*rows).predict,
    }
    np.testing.assert_allclose(*(way(elsewhere) for way in ways.values()), atol=1e-9)
    ours_or_peer(benchmark, who, {SCIKIT_LEARN: 2.0}, work=10_000, unit="sample")
    benchmark.pedantic(ways[who], (elsewhere,), rounds=5, warmup_rounds=1)


def autograd_likelihood(
    hyper: Hyperparameters, loads: SpringLoads, deflection: FloatArray, theta: FloatArray
) -> tuple[float, FloatArray]:
    """The log-likelihood of springs with curves, its slopes by reverse differentiation."""
    value_of = dict(zip(hyper.priors, leaf := torch.tensor(theta, requires_grad=True), strict=True))
    move, loaded, unloaded, features, load = (
        torch.from_numpy(np.ascontiguousarray(part))
        for part in (loads.move, loads.loaded, loads.unloaded, loads.features, loads.load)
    )
    across, scale = torch.from_numpy(hyper.across), torch.from_numpy(hyper.scale)[:, None]
    size = torch.stack([value_of[f"own {joint}"] for joint in hyper.joint.tolist()])
    size = torch.exp(2.0 * (size + across * value_of["across"]))[:, None, None]
    bend = torch.exp(2.0 * torch.where(across, value_of["bend across"], value_of["bend own"]))

    def curve(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        t, u = first / scale, second / scale
        apart = 3.0**0.5 * (t[:, :, None] - u[:, None]).abs() / torch.exp(value_of["length"])
        lost = torch.atan(t / torch.exp(value_of["width"]))[:, :, None]
        lost = lost * torch.atan(u / torch.exp(value_of["width"]))[:, None]
        lost = torch.exp(2.0 * value_of["lost"]) * ~across[:, None, None] * lost
        bent = bend[:, None, None] * (1.0 + apart) * torch.exp(-apart)
        return t[:, :, None] * u[:, None] + bent + lost

    again = 2.0 * torch.atan((loaded - unloaded) / scale / torch.exp(value_of["width"]) / 2.0)
    again = again * torch.exp(value_of["lost again"]) * ~across[:, None]
    turned = curve(loaded, loaded) + curve(unloaded, unloaded)
    turned = turned - curve(loaded, unloaded) - curve(unloaded, loaded)
    turned = size * scale[:, :, None] ** 2 * (turned + again[:, :, None] * again[:, None])
    matrix = torch.einsum("san,snm,sbm->anbm", move, turned, move)
    n_pose = hyper.n_pose_features
    lengths = torch.cat([value_of["pose"].repeat(n_pose), value_of["load"].repeat(6)])
    apart = 5.0**0.5 * (torch.cdist(*[features * torch.exp(-lengths)] * 2) + 1e-12)
    rest = (1.0 + apart + apart**2 / 3.0) * torch.exp(-apart) * (load @ load.T)
    rest = torch.exp(2.0 * value_of["remainder"]) * rest
    matrix = matrix + torch.eye(3)[:, None, :, None] * rest[None, :, None, :]
    n = 3 * len(load)
    matrix = matrix.reshape(n, n) + torch.exp(2.0 * value_of["noise"]) * torch.eye(n)
    outputs = torch.from_numpy(deflection.ravel())
    value = torch.distributions.MultivariateNormal(torch.zeros(n), matrix).log_prob(outputs)
    value.backward()
    return value.item(), leaf.grad.numpy()


@pytest.mark.benchmark(group="likelihood and gradient of 18 springs with curves, 120 samples")
@pytest.mark.parametrize("who", [OURS, AUTOGRAD])
def test_springs_with_curves(benchmark, who):
    data = twin_data()
    train = data.samples.take(np.arange(120))
    model = GpSprings(search_rows=10).fit(train, robot=data.robot)
    loads, deflection = model.process_.loads, train.deflection.T
    hyper = model._hyperparameters(train, data.robot, loads)

    def ours(theta: FloatArray) -> tuple[float, FloatArray]:
        covariance = hyper.covariance(theta)
        slopes = likelihood_slopes(covariance, loads, deflection)
        return slopes.value, hyper.slopes(covariance, slopes)

    default = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        ways = {OURS: ours, AUTOGRAD: partial(autograd_likelihood, hyper, loads, deflection)}
        for found, expected in zip(*(way(model.theta_) for way in ways.values()), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-3)
        ours_or_peer(benchmark, who, {AUTOGRAD: 2.0})
        benchmark.pedantic(ways[who], (model.theta_,), rounds=5, iterations=3, warmup_rounds=1)
    finally:
        torch.set_default_dtype(default)


def brute_force(finest: FloatArray, target: FloatArray, start: np.ndarray) -> np.ndarray:
    """The same search with each trial's least squares on all samples."""
    n_joints, n_candidates = finest.shape[2], finest.shape[3] - 1

    def residual(chosen):
        columns = [
            part.sum(axis=-1)
            for joint, row in enumerate(chosen)
            for part in np.split(finest[:, :, joint], row + 1, axis=-1)
        ]
        matrix = np.stack(columns, axis=-1).reshape(-1, len(columns))
        return nnls(matrix / np.linalg.norm(matrix, axis=0), target.reshape(-1))[1]

    chosen, best, before = start, residual(start), np.inf
    while best < before:
        before = best
        for joint, candidate in itertools.product(range(n_joints), range(n_candidates)):
            trial = chosen.copy()
            trial[joint, 0] = candidate
            error = residual(trial)
            if error < best * (1.0 - 1e-9):
                best, chosen = error, trial
    return chosen


@pytest.mark.benchmark(group="multi-segment breakpoint search, 6 joints, 3,000 samples")
@pytest.mark.parametrize("who", [OURS, BRUTE_FORCE])
def test_search(benchmark, who):
    """Deflection by segments of six springs that are four times as soft below one candidate."""
    rng, n, n_candidates = np.random.default_rng(0), 3000, 9
    finest = rng.normal(size=(n, 3, 6, 1)) * rng.uniform(0.2, 1.0, size=(n, 1, 6, n_candidates + 1))
    knees = rng.integers(1, n_candidates - 1, size=(6, 1))
    soft = np.where(np.arange(n_candidates + 1) <= knees, 4.0, 1.0)
    target = np.einsum("nkis,is->nk", finest, soft)
    target += 0.1 * rng.normal(size=target.shape)
    case = finest, target, np.full((6, 1), n_candidates // 2)
    way = search_breakpoints if who == OURS else brute_force
    np.testing.assert_array_equal(way(*case), knees)
    ours_or_peer(benchmark, who, {BRUTE_FORCE: 10.0})
    benchmark.pedantic(way, case, rounds=3, warmup_rounds=1)
