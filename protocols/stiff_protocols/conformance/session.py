"""One model under the conformance suite: its rows, its fits (each made once), what it did aside."""

from __future__ import annotations

import io
import random
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from stiff_protocols.conformance.checklist import Failed, StageFailed
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Interval, Samples
from stiff_protocols.paths.inverse import evenly_spaced
from stiff_protocols.scoring.sanity import check_prediction

FEWEST_ROWS, MOST_ROWS = 10, 48
TRAIN_SHARE, VALIDATION_SHARE = 0.6, 0.2
SMALLEST = 1e-9  # m; far below what any instrument resolves
LOUD = 1e3
"""Factor on labels that are to show in whatever was fitted to them."""
OURS = ("stiff_bench", "stiff_datasets", "stiff_models", "stiff_protocols", "stiffbench")
"""Packages whose functions no model may replace."""
READ_ONLY = "read-only"  # in NumPy's words for a write to a frozen array

Value = TypeVar("Value")


class Session:
    """A model and the rows it is checked on; each fit is made once, when it is first needed.

    Where a model cannot be made, fitted or asked, every property raises StageFailed.

    Attributes:
        make: returns a new model.
        train, validation, test: disjoint samples of the robot; those of `test` have deflections
            that follow from nothing, so that whoever predicts them has found them here.
        measured: (n, 3) m, the deflections that the test rows have.
        other: as many samples as `train`, most of them others.
        uses_validation: the model is one that chooses an epoch.
        save: writes a fitted model, or None.
        load: reads a saved model, or None.
        printed: what the model wrote to standard output so far.
        disturbed: names of the global random states that it changed.
        overwritten: names of arrays given to `predict` that it changed.
        returned_by_fit: what the first fit returned.
        options_before_fit: the `options` of the model before its first fit.
    """

    returned_by_fit: object
    options_before_fit: dict[str, str]

    def __init__(
        self,
        make: Callable[[], StiffnessModel],
        data: BenchmarkData,
        *,
        uses_validation: bool,
        save: Callable[[StiffnessModel, Path], None] | None,
        load: Callable[[Path], StiffnessModel] | None,
    ) -> None:
        """Divide the rows; DataError where there are too few."""
        if len(data.samples) < FEWEST_ROWS:
            raise DataError(
                f"{len(data.samples)} samples are too few to check a model with "
                f"(valid: {FEWEST_ROWS} or more)"
            )
        self.make, self.save, self.load, self.robot = make, save, load, data.robot
        self.uses_validation = uses_validation
        rows = np.random.default_rng(0).permutation(evenly_spaced(len(data.samples), MOST_ROWS))
        n_train, n_validation = (
            int(len(rows) * share) for share in (TRAIN_SHARE, VALIDATION_SHARE)
        )
        self.train = data.samples.take(rows[:n_train])
        self.validation = data.samples.take(rows[n_train : n_train + n_validation])
        test = data.samples.take(rows[n_train + n_validation :])
        self.measured = test.deflection
        bait = np.random.default_rng(1).normal(size=self.measured.shape)
        self.test = replace(test, deflection=max(float(self.measured.std()), SMALLEST) * bait)
        self.other = data.samples.take(rows[-n_train:])
        self.printed = ""
        self.disturbed: set[str] = set()
        self.overwritten: set[str] = set()
        self._ours = _our_functions()
        self._outcomes: dict[str, Any] = {}

    def new(self) -> StiffnessModel:
        """Return a new model."""
        self._once("the constructor", self.make)
        return self.make()

    @property
    def fitted(self) -> StiffnessModel:
        """The model after its first fit, on `train`."""
        return self._once("fit", self._first_fit)

    @property
    def prediction(self) -> FloatArray:
        """The (n, 3) prediction [m] of the test rows after the first fit."""
        return self._once("predict", lambda: self.predict_test(self.fitted))

    @property
    def prediction_elsewhere(self) -> FloatArray:
        """The (n, 3) prediction [m] of the test rows by `fitted_elsewhere`, before a refit."""
        stage = "predict after the fit to other rows"
        return self._once(stage, lambda: self.predict_test(self.fitted_elsewhere))

    def prediction_again(self, *, with_validation: bool) -> FloatArray:
        """The (n, 3) prediction [m] of a new model fitted to the same rows with the same seed."""
        validation = self.validation if with_validation else None
        stage = f"the second fit {'with' if with_validation else 'without'} validation rows"
        return self._once(stage, lambda: self.predict_test(self._new(self.train, validation)))

    @property
    def fitted_elsewhere(self) -> StiffnessModel:
        """A model fitted to `other` without validation rows."""
        return self._once("the fit to other rows", lambda: self._new(self.other, None))

    @property
    def fitted_beside_loud_validation(self) -> StiffnessModel:
        """A model fitted to `other` with validation deflections that are `LOUD` times too large."""
        stage = "the fit with large validation deflections"
        return self._once(stage, lambda: self._new(self.other, _loud(self.validation)))

    @property
    def fitted_to_loud_rows(self) -> StiffnessModel:
        """A model fitted to `LOUD` times too large deflections, with a seed of its own."""
        rows, validation = _loud(self.other), self._own_validation
        return self._once("the fit to large deflections", lambda: self._new(rows, validation, 1))

    def prediction_after_refit(self) -> FloatArray:
        """The (n, 3) prediction [m] of `fitted_elsewhere` fitted once more, as the first was."""
        _ = self.prediction_elsewhere
        self._fit(self.fitted_elsewhere, self.train, self._own_validation)
        return self.predict_test(self.fitted_elsewhere)

    def restored(self) -> list[str]:
        """Return our functions and classes that the model put others in the place of.

        They are put back.
        """
        names = []
        for (module, name), ours in self._ours.items():
            if vars(sys.modules[module]).get(name) is not ours:
                names.append(f"{module}.{name}")
                setattr(sys.modules[module], name, ours)
        return names

    def predict_test(self, model: StiffnessModel) -> FloatArray:
        """Return the checked (n, 3) prediction [m] of the test rows."""
        return self.predict_checked(model, self.test.q, self.test.wrench)

    def predict_checked(
        self, model: StiffnessModel, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return the checked (n, 3) prediction [m]; see `predict`."""
        predicted = self.predict(model, q, wrench)
        check_prediction(predicted, len(q))
        return predicted

    def predict(self, model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return what the model predicts from writable copies, and note what it does to them."""
        given = {"q": q.copy(), "wrench": wrench.copy()}
        predicted = np.asarray(self._watched(lambda: model.predict(**given)))
        before = {"q": q, "wrench": wrench}
        self.overwritten |= {n for n in before if not np.array_equal(given[n], before[n])}
        return predicted

    def interval(
        self, model: StiffnessModel, q: FloatArray, wrench: FloatArray, coverage: float
    ) -> Interval:
        """Return what the model says of writable copies."""
        given = q.copy(), wrench.copy()
        return self._watched(lambda: model.predict_interval(*given, coverage))

    @property
    def _own_validation(self) -> Samples | None:
        return self.validation if self.uses_validation else None

    def _first_fit(self) -> StiffnessModel:
        model = self.new()
        self.options_before_fit = options(model)
        self.returned_by_fit = self._fit(model, self.train, self._own_validation)
        return model

    def _new(self, train: Samples, validation: Samples | None, seed: int = 0) -> StiffnessModel:
        model = self.new()
        self._fit(model, train, validation, seed)
        return model

    def _fit(
        self, model: StiffnessModel, train: Samples, validation: Samples | None, seed: int = 0
    ) -> object:
        try:
            return self._watched(
                lambda: model.fit(train, robot=self.robot, validation=validation, seed=seed)
            )
        except ValueError as error:
            if READ_ONLY not in str(error):
                raise
            raise Failed(
                f"fit writes into the samples it was given ({error})",
                "copy an array before you change it: q = train.q.copy()",
            ) from error

    def _once(self, stage: str, work: Callable[[], Value]) -> Value:
        """Return what `work` gave when the stage was first needed; a failure stays one."""
        if stage not in self._outcomes:
            try:
                self._outcomes[stage] = work()
            except StageFailed as failure:
                self._outcomes[stage] = failure
            except (Exception, SystemExit) as error:
                self._outcomes[stage] = StageFailed(stage, error)
        outcome = self._outcomes[stage]
        if isinstance(outcome, StageFailed):
            raise outcome
        done: Value = outcome
        return done

    def _watched(self, work: Callable[[], Value]) -> Value:
        """Do `work` and note what it prints and which global random states it moves."""
        before, printed = _random_states(), io.StringIO()
        try:
            with redirect_stdout(printed), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # findings about the rows, not about the model
                return work()
        finally:
            self.printed += printed.getvalue()
            after = _random_states()
            self.disturbed |= {name for name, state in before.items() if after[name] != state}


def _loud(samples: Samples) -> Samples:
    return replace(samples, deflection=LOUD * samples.deflection)


def options(model: StiffnessModel) -> dict[str, str]:
    """Return the repr of each option."""
    return {name: repr(value) for name, value in model.get_params(deep=False).items()}


def _our_functions() -> dict[tuple[str, str], object]:
    """Return the functions and classes that our modules use, by module and name."""
    return {
        (module, name): value
        for module, content in list(sys.modules.items())
        if module.partition(".")[0] in OURS
        for name, value in list(vars(content).items())
        if callable(value)
    }


def _random_states() -> dict[str, object]:
    """Return the global random states by name; torch's only where somebody imported it."""
    kind, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002
    states: dict[str, object] = {
        "numpy.random": (kind, np.asarray(keys).tobytes(), *rest),
        "random": random.getstate(),
    }
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "get_rng_state"):
        states["torch"] = torch.get_rng_state().numpy().tobytes()
    return states
