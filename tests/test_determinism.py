"""The same cell on the same machine: the same bits, in any process, order and number of threads."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from helpers.quick_models import KEYS, fitted, twin_data
from stiff_bench.run.cell import compute_cell
from stiff_models.model_catalog import model_info

pytestmark = pytest.mark.xdist_group("processes")  # what they predict is kept

SEED = 5
TOLERANCE_M = 1e-12
"""Of a predicted deflection, where only the number of threads differs: a millionth of a nm. A solve
by LAPACK may divide its work by them, on a machine other than the one where all were the same."""
PRE_TRAINED, PRE_TRAINED_TOLERANCE_M = ("mlp-pretrained", "ft-mlp", "deep-ensemble"), 1e-7
"""Some processors divide a pre-training's products in single precision by the threads: 5e-9 m were
seen on an Intel Xeon of family 6, model 167; on others nothing."""
CONVOLUTION_TOLERANCE_M = 2e-5
"""oneDNN sums a convolution's gradients thread by thread, and a training amplifies that: after
these few steps, 0.003 mm was seen."""

WIDE = "ft-mlp at its full width"
WIDE_OPTIONS = {"pretrain_steps": 20, "epochs": 20}
"""The recipe's 380 nodes: the sizes at which libraries divide their work by the threads."""


def prediction(key: str) -> np.ndarray:
    """What a model, fitted anew with its quick options, predicts on all of the KR10 twin."""
    name, options = ("ft-mlp", WIDE_OPTIONS) if key == WIDE else (key, model_info(key).quick)
    samples = twin_data().samples
    return np.asarray(
        fitted(name, options, chosen=True, seed=SEED).predict(samples.q, samples.wrench)
    )


def usable() -> list[str]:
    return [WIDE, *(key for key in KEYS if not model_info(key).missing())]


def write_predictions(path: str, keys: list[str]) -> None:
    """Fit these models one after another and store what they predict."""
    np.savez(path, **{key: prediction(key) for key in keys})


REFERENCE, OTHER_ORDER, MORE_THREADS = ("0", 1, False), ("random", 1, True), ("0", 2, False)
"""Processes: PYTHONHASHSEED, number of threads, whether the models come in reverse order."""


@pytest.fixture(scope="module")
def of_process(tmp_path_factory):
    """A function that gives every model's predictions in a process of that kind, computed once."""

    @functools.cache
    def get(hash_seed: str, threads: int, reverse: bool) -> dict[str, np.ndarray]:
        path, keys = tmp_path_factory.mktemp("p") / "predictions.npz", usable()
        program = (
            f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
            f"from test_determinism import write_predictions\n"
            f"write_predictions({str(path)!r}, {keys[::-1] if reverse else keys!r})\n"
        )
        names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
        about = dict.fromkeys(names, str(threads))
        about |= {"PYTHONHASHSEED": hash_seed, "STIFFBENCH_CACHE": "off"}
        subprocess.run([sys.executable, "-c", program], env=os.environ | about, check=True)
        with np.load(path, allow_pickle=False) as found:
            return {key: found[key] for key in keys}

    return get


@pytest.mark.parametrize("models", [("vjm", "knn"), ("knn", "vjm")])
def test_a_cells_prediction_does_not_depend_on_the_cells_before(models, tasks_of):
    (alone,) = tasks_of(models=("vjm",), splits=1)
    expected = compute_cell(alone, "r")
    both = [compute_cell(task, "r") for task in tasks_of(models=models, splits=1)]
    (found,) = [result for result in both if result.cell.key == expected.cell.key]
    np.testing.assert_array_equal(found.prediction.predicted, expected.prediction.predicted)


@pytest.mark.slow
@pytest.mark.parametrize("other", [OTHER_ORDER, MORE_THREADS], ids=["other order", "two threads"])
@pytest.mark.parametrize("key", [WIDE, *KEYS])
def test_every_model_predicts_the_same_in_another_process_order_and_number_of_threads(
    key, other, of_process
):
    if key not in usable():
        pytest.skip(model_info(key).missing())
    tolerance = CONVOLUTION_TOLERANCE_M if key == "dt-cnn" else TOLERANCE_M
    tolerance = PRE_TRAINED_TOLERANCE_M if key in PRE_TRAINED else tolerance
    expected, found = of_process(*REFERENCE)[key], of_process(*other)[key]
    tolerance = tolerance if other == MORE_THREADS else 0.0
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance)
