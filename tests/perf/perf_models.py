"""Compare Gaussian processes with scikit-learn's on the same rows."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from helpers.perf_case import OURS, ours_or_peer
from helpers.quick_models import twin_data
from stiff_models.networks.encoded_model import Scaler, encode
from stiff_models.regressors.gaussian_process import Covariance, GaussianProcess, log_likelihood
from stiff_protocols.contract.types import FloatArray

SCIKIT_LEARN = "scikit-learn"

Rows = tuple[FloatArray, FloatArray]


def gp_rows(n: int) -> Rows:
    """Return n standardised rows of the twin; repeated rows are moved a little."""
    data, rng = twin_data(), np.random.default_rng(0)
    which = np.arange(n) % len(data.samples)
    features = encode(data.robot, data.samples.q, data.samples.wrench, "sincos")[which]
    inputs = Scaler.of(features).apply(features) + 0.3 * rng.normal(size=features.shape)
    outputs = data.samples.deflection[which, 0]
    return inputs, Scaler.of(outputs[:, None]).apply(outputs[:, None])[:, 0]


COVARIANCE = Covariance("matern", 1.3, np.linspace(3.0, 6.0, 18), 0.02, jitter=1e-10)


def scikit_learn_process(inputs: FloatArray, outputs: FloatArray) -> GaussianProcessRegressor:
    kernel = ConstantKernel(COVARIANCE.variance) * Matern(COVARIANCE.lengths, nu=2.5)
    kernel += WhiteKernel(COVARIANCE.noise)
    return GaussianProcessRegressor(kernel, alpha=COVARIANCE.jitter, optimizer=None).fit(
        inputs, outputs
    )


@pytest.mark.parametrize("who", [OURS, SCIKIT_LEARN])
@pytest.mark.parametrize("n", [151, 1000])
def test_likelihood(benchmark, who, n):
    rows = gp_rows(n)
    peer = scikit_learn_process(*rows)
    ways = {
        OURS: lambda: log_likelihood(COVARIANCE, *rows),
        SCIKIT_LEARN: lambda: peer.log_marginal_likelihood(COVARIANCE.theta, eval_gradient=True),
    }
    for value, expected in zip(ways[OURS](), ways[SCIKIT_LEARN](), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9)
    benchmark.group = f"GP likelihood and gradient, 18 length scales, {n:,} rows"
    ours_or_peer(benchmark, who, {SCIKIT_LEARN: 4.0})
    benchmark.pedantic(ways[who], rounds=5, iterations=10 if n < 1000 else 1, warmup_rounds=1)


@pytest.mark.benchmark(group="GP prediction of 10,000 rows, 151 training rows")
@pytest.mark.parametrize("who", [OURS, SCIKIT_LEARN])
def test_prediction(benchmark, who):
    rows, (new_inputs, _) = gp_rows(151), gp_rows(10_000)
    ways = {
        OURS: GaussianProcess.of(COVARIANCE, *rows).mean,
        SCIKIT_LEARN: scikit_learn_process(*rows).predict,
    }
    np.testing.assert_allclose(*(way(new_inputs) for way in ways.values()), atol=1e-9)
    ours_or_peer(benchmark, who, {SCIKIT_LEARN: 2.0}, work=10_000, unit="sample")
    benchmark.pedantic(ways[who], (new_inputs,), rounds=5, warmup_rounds=1)
