"""Samples whose test deflections cannot be read before every prediction is made."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.cell import compute_cell
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import FloatArray, IntArray, Samples

CALLS = ("fit", "predict", "predict_interval")


class Leak(BaseException):
    """A test deflection was read too early; no `except Exception` of a model can hide it."""


class Seal:
    """Is broken by the first look at a test deflection; no model may be asked any more then."""

    def __init__(self) -> None:
        self.asking = 0
        self.broken = False

    def look(self) -> None:
        if self.asking:
            raise Leak("a test deflection was read during fit or prediction")
        self.broken = True

    def guarded(self, cls: type, name: str) -> Callable[..., Any]:
        """The same method of a model, which must not be called when the seal is broken."""
        call = getattr(cls, name)

        @functools.wraps(call)
        def asked(*args: Any, **options: Any) -> Any:
            if self.broken:
                raise Leak(f"a test deflection was read before {cls.__name__}.{name}")
            self.asking += 1
            try:
                return call(*args, **options)
            finally:
                self.asking -= 1

        return asked


class SealedSamples(Samples):
    """All of the data, as the engine holds them; what is taken without test rows is free."""

    def __init__(self, truth: Samples, test: IntArray, seal: Seal) -> None:
        for each in fields(Samples):
            if each.name != "deflection":
                object.__setattr__(self, each.name, getattr(truth, each.name))
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


def with_other_test_deflections(task: CellTask) -> CellTask:
    """The same cell, whose test poses were measured 7 m away on every axis."""
    samples = task.data.samples
    deflection = samples.deflection.copy()
    deflection[task.split.test] += 7.0
    return replace(task, data=replace(task.data, samples=replace(samples, deflection=deflection)))


def computed_under_seal(task: CellTask) -> CellResult:
    """Compute a cell of the engine.

    Raises:
        Leak: a test deflection was read during a fit or a prediction, or before the last one: the
            model's, its copy's for intervals, or the reference's.
    """
    seal = Seal()
    samples = SealedSamples(task.data.samples, task.split.test, seal)
    classes = {task.model.cls, model_info(REFERENCE_MODEL).load()}
    with pytest.MonkeyPatch.context() as patch:
        for cls in classes:
            for name in CALLS:
                if offers(cls, name):
                    patch.setattr(cls, name, seal.guarded(cls, name))
        result = compute_cell(replace(task, data=replace(task.data, samples=samples)), "r")
    # else nothing was scored, or it was scored on something else
    assert result.status == "ok" and seal.broken, result.failure
    return result
