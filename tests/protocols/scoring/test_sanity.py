"""Check that predictions of wrong shape or unit are refused, and bad ones accepted."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_protocols.contract.errors import ModelError
from stiff_protocols.scoring.sanity import check_prediction, check_units


@pytest.fixture()
def measured(rng):
    return rng.normal(scale=1e-4, size=(40, 3))


def test_predictions_a_thousand_times_too_large_or_too_small_are_refused(rng, measured):
    with pytest.raises(ModelError, match=r"about 1000 times larger .* are these mm\?"):
        check_units(1000.0 * measured, measured)
    rough = measured + rng.normal(scale=5e-5, size=measured.shape)
    with pytest.raises(ModelError, match=r"times smaller .* expected m"):
        check_units(rough / 1000.0, measured)


def test_zero_small_and_bad_predictions_are_left_alone(rng, measured):
    for scale in (0.0, 1e-300, 1e-9, 1e-5, 0.02, 1.0, 50.0):
        check_units(scale * rng.permutation(measured), measured)
        check_units(scale * measured, measured)
    check_units(rng.normal(scale=1e-7, size=measured.shape), measured)  # explains nothing
    check_units(measured, np.zeros_like(measured))  # says nothing about units


@pytest.mark.parametrize(
    ("predicted", "part"),
    [
        (np.zeros((3, 4)), r"shape \(3, 4\)"),
        (np.zeros(4), r"expected \(4, 3\)"),
        (np.full((4, 3), np.inf), "12 values that are not finite"),
        (np.full((4, 3), "0"), "<U1 values"),
        (np.zeros((4, 3), dtype=complex), "complex128"),
        (np.zeros((4, 3), dtype=int), "int64"),
    ],
)
def test_what_is_no_prediction_is_refused(predicted, part):
    with pytest.raises(ModelError, match=part):
        check_prediction(predicted, 4)
    check_prediction(np.zeros((4, 3), dtype=np.float32), 4)
