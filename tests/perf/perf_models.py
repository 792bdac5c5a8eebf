"""The models beside kinematics and networks, each beside the obvious way of computing the same."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import nnls
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from perf_case import ours, peer
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.networks.features import Scaler, encode
from stiff_models.physics.congruence import LoadedRobot
from stiff_models.physics.multi_segment_vjm import search_breakpoints
from stiff_models.regressors.gaussian_process import Covariance, GaussianProcess, log_likelihood
from stiff_protocols.contract.types import FloatArray

SCIKIT_LEARN = "scikit-learn"
LIKELIHOOD = "GP likelihood and gradient, 18 length scales, {} rows"
PREDICTION = "GP prediction of 10,000 rows, 151 training rows"
SEARCH = "multi-segment breakpoint search, 6 joints, 3,000 samples"
BUCKLING = "buckling check of 10,000 loaded samples"
BRUTE_FORCE = "every trial on all samples"

Rows = tuple[FloatArray, FloatArray]


def gp_rows(n: int) -> Rows:
    """Standardised rows of the twin, some of them moved a little to make more."""
    data, rng = Kr10Twin().load(), np.random.default_rng(0)
    which = np.arange(n) % len(data.samples)
    features = encode(data.robot, data.samples.q, data.samples.wrench, "sincos")[which]
    inputs = Scaler.of(features).apply(features) + 0.3 * rng.normal(size=features.shape)
    outputs = data.samples.deflection[which, 0]
    return inputs, Scaler.of(outputs[:, None]).apply(outputs[:, None])[:, 0]


def our_covariance() -> Covariance:
    return Covariance("matern", 1.3, np.linspace(3.0, 6.0, 18), 0.02, jitter=1e-10)


def scikit_learns(inputs: FloatArray, outputs: FloatArray) -> GaussianProcessRegressor:
    own = our_covariance()
    kernel = ConstantKernel(own.variance) * Matern(own.lengths, nu=2.5) + WhiteKernel(own.noise)
    return GaussianProcessRegressor(kernel, alpha=own.jitter, optimizer=None).fit(inputs, outputs)


@pytest.fixture(scope="module", params=[151, 1000])
def likelihoods(request):
    """Ours and scikit-learn's, as functions without arguments that give the same."""
    rows = gp_rows(request.param)
    process, covariance = scikit_learns(*rows), our_covariance()

    def theirs():
        return process.log_marginal_likelihood(covariance.theta, eval_gradient=True)

    def own():
        return log_likelihood(covariance, *rows)

    for found, expected in zip(own(), theirs(), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    return request.param, own, theirs


def test_our_likelihood(benchmark, likelihoods):
    n, own, _ = likelihoods
    benchmark.group = LIKELIHOOD.format(f"{n:,}")
    ours(benchmark, at_least={SCIKIT_LEARN: 4.0})
    benchmark.pedantic(own, rounds=5, iterations=10 if n < 1000 else 1, warmup_rounds=1)


def test_scikit_learns_likelihood(benchmark, likelihoods):
    n, _, theirs = likelihoods
    benchmark.group = LIKELIHOOD.format(f"{n:,}")
    peer(benchmark, SCIKIT_LEARN)
    benchmark.pedantic(theirs, rounds=5, iterations=10 if n < 1000 else 1, warmup_rounds=1)


@pytest.fixture(scope="module")
def processes():
    rows, (elsewhere, _) = gp_rows(151), gp_rows(10_000)
    own, theirs = GaussianProcess.of(our_covariance(), *rows), scikit_learns(*rows)
    np.testing.assert_allclose(own.mean(elsewhere), theirs.predict(elsewhere), atol=1e-9)
    return own, theirs, elsewhere


@pytest.mark.benchmark(group=PREDICTION)
def test_our_prediction(benchmark, processes):
    own, _, elsewhere = processes
    ours(benchmark, at_least={SCIKIT_LEARN: 2.0}, work=10_000, unit="sample")
    benchmark.pedantic(own.mean, (elsewhere,), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group=PREDICTION)
def test_scikit_learns_prediction(benchmark, processes):
    _, theirs, elsewhere = processes
    peer(benchmark, SCIKIT_LEARN, work=10_000, unit="sample")
    benchmark.pedantic(theirs.predict, (elsewhere,), rounds=5, warmup_rounds=1)


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


@pytest.fixture(scope="module")
def springs():
    """Deflection by segments of six springs that are four times as soft below one candidate."""
    rng, n, n_candidates = np.random.default_rng(0), 3000, 9
    finest = rng.normal(size=(n, 3, 6, 1)) * rng.uniform(0.2, 1.0, size=(n, 1, 6, n_candidates + 1))
    knees = rng.integers(1, n_candidates - 1, size=(6, 1))
    soft = np.where(np.arange(n_candidates + 1) <= knees, 4.0, 1.0)
    target = np.einsum("nkis,is->nk", finest, soft)
    target += 0.1 * rng.normal(size=target.shape)
    case = finest, target, np.full((6, 1), n_candidates // 2)
    np.testing.assert_array_equal(search_breakpoints(*case), knees)
    np.testing.assert_array_equal(brute_force(*case), knees)
    return case


@pytest.mark.benchmark(group=SEARCH)
def test_our_search(benchmark, springs):
    ours(benchmark, at_least={BRUTE_FORCE: 10.0})
    benchmark.pedantic(search_breakpoints, springs, rounds=3, warmup_rounds=1)


@pytest.mark.benchmark(group=SEARCH)
def test_a_brute_force_search(benchmark, springs):
    peer(benchmark, BRUTE_FORCE)
    benchmark.pedantic(brute_force, springs, rounds=3, warmup_rounds=1)


@pytest.fixture(scope="module")
def loaded():
    data, rng = Kr10Twin().load(), np.random.default_rng(0)
    q = rng.uniform(data.robot.lower, data.robot.upper, size=(10_000, 6))
    wrench = data.samples.wrench[np.arange(10_000) % len(data.samples)]
    case = LoadedRobot.of(data.robot, q, wrench)
    for compliance in (np.full(6, 1e-4), np.full(6, 1e-2)):  # the second lets some buckle
        np.testing.assert_array_equal(
            case.beyond_buckling(compliance), all_eigenvalues(case, compliance)
        )
    return case, np.full(6, 1e-4)


def all_eigenvalues(case: LoadedRobot, compliance: FloatArray) -> np.ndarray:
    root = np.sqrt(compliance)
    scaled = root[:, None] * case.congruence * root
    symmetric = (scaled + scaled.transpose(0, 2, 1)) / 2
    return np.flatnonzero(np.linalg.eigvalsh(symmetric)[:, -1] >= 1.0)


@pytest.mark.benchmark(group=BUCKLING)
def test_our_buckling_check(benchmark, loaded):
    case, compliance = loaded
    ours(benchmark, at_least={"eigenvalues of all": 3.0}, work=10_000, unit="sample")
    benchmark.pedantic(case.beyond_buckling, (compliance,), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group=BUCKLING)
def test_eigenvalues_of_all(benchmark, loaded):
    peer(benchmark, "eigenvalues of all", work=10_000, unit="sample")
    benchmark.pedantic(all_eigenvalues, loaded, rounds=5, warmup_rounds=1)
