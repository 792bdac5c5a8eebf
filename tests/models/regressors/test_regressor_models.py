"""What regressors say of the samples."""

from __future__ import annotations

import warnings

import pytest
from sklearn.exceptions import ConvergenceWarning

from stiff_models.regressors.regressor_model import told_as_ours
from stiff_protocols.contract.errors import StiffBenchWarning


@pytest.mark.parametrize(
    ("text", "category", "kept", "told"),
    [
        ("lbfgs  failed\n\nYou might scale", ConvergenceWarning, False, "^lbfgs failed$"),
        ("y residual is constant", UserWarning, False, "^y residual is constant$"),
        ("overflow", RuntimeWarning, False, "^the regressor's arithmetic: overflow$"),
        ("odd", FutureWarning, True, "^odd$"),  # said of its code
    ],
)
def test_what_a_regressor_says_of_the_samples_becomes_our_warning(text, category, kept, told):
    expected = category if kept else StiffBenchWarning
    with pytest.warns(expected, match=told) as caught, told_as_ours():
        warnings.warn(text, category, stacklevel=1)
    assert caught[0].category is expected
