"""Check that results have the same bits in any process, order and number of threads."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from helpers.quick_models import KEYS, fitted, twin_data
from stiff_bench.run.execution import compute_fit
from stiff_models.model_catalog import model_info

pytestmark = pytest.mark.xdist_group("processes")  # what they predict is kept

SEED = 5
TOLERANCE_M = 1e-12
"""Tolerance of a predicted deflection if only the number of threads differs: a millionth of a nm.
LAPACK may divide a solve by the threads on some machines."""
PRE_TRAINED, PRE_TRAINED_TOLERANCE_M = ("mlp-pretrained", "ft-mlp", "deep-ensemble"), 1e-7
"""Some processors divide a pre-training's products in single precision by the threads. An Intel
Xeon of family 6, model 167 gave differences of 5e-9 m; others gave none."""
SEARCHED, SEARCHED_TOLERANCE_M = ("bayes-springs",), 1e-9
"""A search for scales amplifies a rounding difference of the threads; seen: 5e-11 m."""
CONVOLUTION_TOLERANCE_M = 2e-5
"""oneDNN sums a convolution's gradients per thread, and a training amplifies the differences to
0.003 mm after these few steps."""

WIDE = "ft-mlp at its full width"
VARIANTS: dict[str, tuple[str, dict[str, object]]] = {
    WIDE: ("ft-mlp", {"pretrain_steps": 5, "epochs": 4}),
    "gp, default recipe": ("gp", {}),
    "vjm-gp, default recipe": ("vjm-gp", {}),
}
"""Other options than the quick ones: the recipe's 380 nodes, for which libraries divide their work
by the threads, and searches for hyperparameters from all starts."""


def prediction(key: str) -> np.ndarray:
    """Fit a model with its quick options, or a variant, and predict the KR10 twin's samples."""
    name, options = VARIANTS[key] if key in VARIANTS else (key, model_info(key).quick)
    samples = twin_data().samples
    return np.asarray(
        fitted(name, options, chosen=True, seed=SEED).predict(samples.q, samples.wrench)
    )


def usable_models() -> list[str]:
    return [*VARIANTS, *(key for key in KEYS if not model_info(key).missing())]


def write_predictions(path: str, keys: list[str]) -> None:
    """Fit these models one after another and store their predictions."""
    np.savez(path, **{key: prediction(key) for key in keys})


REFERENCE, OTHER_ORDER, MORE_THREADS = ("0", 1, False), ("random", 1, True), ("0", 2, False)
"""Processes: PYTHONHASHSEED, number of threads, whether the models come in reverse order."""


@pytest.fixture(scope="module")
def process_predictions(tmp_path_factory):
    """Return a cached function that predicts with every model in another process."""

    @functools.cache
    def get(hash_seed: str, threads: int, reverse: bool) -> dict[str, np.ndarray]:
        path, keys = tmp_path_factory.mktemp("p") / "predictions.npz", usable_models()
        program = (
            f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
            f"from test_determinism import write_predictions\n"
            f"write_predictions({str(path)!r}, {keys[::-1] if reverse else keys!r})\n"
        )
        names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        settings = dict.fromkeys(names, str(threads))
        settings |= {"PYTHONHASHSEED": hash_seed, "STIFFBENCH_CACHE": "off"}
        subprocess.run([sys.executable, "-c", program], env=os.environ | settings, check=True)
        with np.load(path, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in keys}

    return get


@pytest.mark.parametrize("models", [("vjm", "knn"), ("knn", "vjm")])
def test_a_cells_prediction_does_not_depend_on_the_cells_before(models, tasks_of):
    (single_task,) = tasks_of(models=("vjm",), splits=1)
    expected = compute_fit(single_task, "r")
    results = [compute_fit(task, "r") for task in tasks_of(models=models, splits=1)]
    (last_result,) = [result for result in results if result.fit.key == expected.fit.key]
    np.testing.assert_array_equal(last_result.prediction.predicted, expected.prediction.predicted)


@pytest.mark.slow
@pytest.mark.parametrize("process", [OTHER_ORDER, MORE_THREADS], ids=["other order", "two threads"])
@pytest.mark.parametrize("key", [*VARIANTS, *KEYS])
def test_every_model_predicts_the_same_in_another_process_order_and_number_of_threads(
    key, process, process_predictions
):
    if key not in usable_models():
        pytest.skip(model_info(key).missing())
    tolerance = CONVOLUTION_TOLERANCE_M if key == "dt-cnn" else TOLERANCE_M
    tolerance = PRE_TRAINED_TOLERANCE_M if key in PRE_TRAINED else tolerance
    tolerance = SEARCHED_TOLERANCE_M if key in SEARCHED else tolerance
    expected, actual = process_predictions(*REFERENCE)[key], process_predictions(*process)[key]
    tolerance = tolerance if process == MORE_THREADS else 0.0
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance)
