"""The curves of a training: stored thinned, refused where they are none, read back with NaN."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from run_requests import planned
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.run.cell import CURVE_POINTS, compute_cell
from stiff_bench.store.database import ResultStore, read_results


def computed(curves):
    """The result of a cell whose model has these curves."""
    model = SimpleNamespace(
        curves_=curves, fit=lambda *_, **__: None, predict=lambda q, _: np.zeros((len(q), 3))
    )
    task = next(cell_tasks(planned(models=("zero",))))
    made = SimpleNamespace(make=lambda: model, missing=lambda: "")
    return compute_cell(replace(task, model=made), "run-1")


def curve(n_points):
    """Steps from 0, a falling loss, no validation loss."""
    steps = np.arange(n_points)
    return np.column_stack([steps, 1.0 / (1 + steps), np.full(n_points, np.nan)])


def test_a_long_curve_is_thinned_to_points_of_its_own_with_both_ends():
    whole = curve(12_345)
    found = computed({"training": whole}).curves["training"]
    assert found.shape == (CURVE_POINTS, 3)
    np.testing.assert_array_equal(found[[0, -1]], whole[[0, -1]])
    np.testing.assert_array_equal(found, whole[found[:, 0].astype(int)])
    assert np.diff(found[:, 0]).min() >= 62 and np.diff(found[:, 0]).max() <= 63


@pytest.mark.parametrize(
    "wrong", [np.zeros((5, 2)), np.zeros(3), "none", [[1, 2, 3], [1]], None, np.zeros((2, 3, 3))]
)
def test_what_is_no_curve_fails_the_cell_and_is_named(wrong):
    result = computed({"fine-tuning": wrong})
    assert (result.status, result.cause) == ("failed", "ModelError")
    assert result.failure.startswith("curves_['fine-tuning'] is no (n, 3) array")


def test_curves_come_back_from_the_store_with_their_nan_as_they_were(tmp_path):
    given = {
        "pre-training": curve(3),
        "long enough": curve(CURVE_POINTS),
        "no points": np.empty((0, 3)),
    }
    result = computed(given)
    ResultStore(tmp_path).write_cell(result)
    (read,) = read_results(tmp_path)
    assert list(read.curves) == list(given)
    for name, points in given.items():
        np.testing.assert_array_equal(read.curves[name], points)
