"""Fits as a store holds them; this module imports little more than the store."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from stiff_protocols.contract.record import (
    Cost,
    Fit,
    FitResult,
    Presentation,
    RunManifest,
)
from stiff_protocols.contract.types import Prediction

PRESENTATION = Presentation("m@a=2", "d", "p", "simulated", "stiffness", caveats=("beware",))
FIT = Fit("m", {"a": 1, "b": 2.5}, "d", {}, "00", "p", {}, 0, "11", 0)
MANIFEST = RunManifest("r", "bench run", "2026-01-01", "finished", {"numpy": "2"}, ("k",))


def result(**changes) -> FitResult:
    numbers = np.array([[1 / 3, 2e-17, -0.1]])
    made = FitResult(
        *(FIT, PRESENTATION, "r", "ok"),
        Prediction(np.array([4]), numbers, numbers * 7, None, numbers / 3),
        Cost(1.5, 0.1, 1e-5, 1e5, None),
        diagnostics={"k1": math.nan, "k2": math.inf, "k3": 0.1},
        warnings=("careful",),
    )
    return replace(made, **changes)


def failure(**changes) -> FitResult:
    nothing = {"prediction": None, "cost": None}
    return result(**({"status": "failed", "failure": "it broke", **nothing} | changes))
