"""Samples whose test deflections cannot be read before the last prediction."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from stiff_bench.plan.fits import FitTask
from stiff_bench.run.execution import compute_fit
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import FloatArray, IntArray, Samples

CALLS = ("fit", "predict", "predict_interval")


class Leak(BaseException):
    """A test deflection was read too early; no `except Exception` of a model can hide it."""


class Seal:
    """A seal that reading a test deflection breaks; no model may be called after that."""

    def __init__(self) -> None:
        self.n_running_calls = 0
        self.broken = False

    def look(self) -> None:
        if self.n_running_calls:
            raise Leak("a test deflection was read during fit or prediction")
        self.broken = True

    def guarded(self, cls: type, name: str) -> Callable[..., Any]:
        """Return a method of a model that must not be called when the seal is broken."""
        call = getattr(cls, name)

        @functools.wraps(call)
        def sealed_call(*args: Any, **options: Any) -> Any:
            if self.broken:
                raise Leak(f"a test deflection was read before {cls.__name__}.{name}")
            self.n_running_calls += 1
            try:
                return call(*args, **options)
            finally:
                self.n_running_calls -= 1

        return sealed_call


class SealedSamples(Samples):
    """The data of the engine; rows without test rows can be taken freely."""

    def __init__(self, truth: Samples, test: IntArray, seal: Seal) -> None:
        for field in fields(Samples):
            if field.name != "deflection":
                object.__setattr__(self, field.name, getattr(truth, field.name))
        for name, value in (("_truth", truth), ("_test", test), ("_seal", seal)):
            object.__setattr__(self, name, value)

    @property
    def deflection(self) -> FloatArray:
        self._seal.look()
        return self._truth.deflection

    def take(self, rows: IntArray) -> Samples:
        if np.isin(rows, self._test).any():
            self._seal.look()
        return self._truth.take(rows)


def with_other_test_deflections(task: FitTask) -> FitTask:
    """Return the same cell with test deflections 7 m larger on every axis."""
    samples = task.data.samples
    deflection = samples.deflection.copy()
    deflection[task.split.test] += 7.0
    return replace(task, data=replace(task.data, samples=replace(samples, deflection=deflection)))


def computed_under_seal(task: FitTask) -> FitResult:
    """Compute a cell of the engine.

    Raises:
        Leak: a test deflection was read during a call, or before the last call, of the model,
            of its copy for intervals, or of the reference.
    """
    seal = Seal()
    samples = SealedSamples(task.data.samples, task.split.test, seal)
    classes = {task.model.cls, model_info(REFERENCE_MODEL).load()}
    with pytest.MonkeyPatch.context() as patch:
        for cls in classes:
            for name in CALLS:
                if offers(cls, name):
                    patch.setattr(cls, name, seal.guarded(cls, name))
        result = compute_fit(replace(task, data=replace(task.data, samples=samples)), "r")
    # otherwise nothing was scored, or other rows were scored
    assert result.status == "ok" and seal.broken, result.failure
    return result
