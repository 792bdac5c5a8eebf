"""Check optional methods of any object with fit and predict."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_protocols.contract.stiffness_model import StiffnessModel, offers, optional
from stiff_protocols.contract.types import Interval

ZERO = np.zeros((2, 3))


class Bare:
    def predict(self, q, wrench):
        return ZERO


class Heir(StiffnessModel):
    predict = Bare.predict


class Rich(Heir):
    def predict_interval(self, q, wrench, coverage):
        return Interval(ZERO, ZERO, coverage)

    def chooses_epoch(self):
        return False


@pytest.mark.parametrize("model", [Bare(), Heir()])
def test_a_model_without_an_optional_method_has_the_default(model):
    assert not offers(model, "predict_interval") and not offers(type(model), "covariance")
    assert optional(model, "chooses_epoch")() and optional(model, "missing")() == ""
    assert optional(model, "predict_at_tcp")(ZERO, ZERO) is ZERO


def test_a_models_own_method_is_used():
    for model in (Rich, Rich()):
        assert offers(model, "predict_interval") and not offers(model, "use_source")
    assert optional(Rich(), "chooses_epoch")() is False
