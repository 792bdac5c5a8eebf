"""A model under check: its rows, its fits (each computed once), and its side effects."""

from __future__ import annotations

import io
import random
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stiff_protocols.conformance.checks import Failed, remembered
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.stiffness_model import StiffnessModel, interface_fault
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Interval, Samples
from stiff_protocols.paths.inverse import evenly_spaced
from stiff_protocols.scoring.sanity import check_prediction

FEWEST_ROWS, MOST_ROWS = 10, 48
TRAIN_SHARE, VALIDATION_SHARE = 0.6, 0.2
SMALLEST = 1e-9  # m; far below what any instrument resolves
INFLATION = 1e3
"""Factor on labels whose effect must show in a model fitted to them."""
FROM_SEED = "draw all random numbers from `seed`: rng = np.random.default_rng(seed)"


class CheckedModel:
    """A model and its rows for the checks.

    Attributes:
        make: function that returns a new model.
        train, validation, test: disjoint samples of the robot. `test` has random deflections: a
            model that predicts them has read them here.
        measured: (n, 3) m, measured deflections of the test rows.
        other_samples: as many samples as `train`, mostly different.
        uses_validation: true if the model chooses an epoch.
        parts: name -> samples of fits. "stated" also have order, approach and readings after the
            load. "own" are the validation rows of the first fit. "loud" are
            the validation rows with deflections multiplied by `INFLATION`.
        save, load: functions that write and read a fitted model, or None.
        fit_faults: options that fits changed so far, or wrong return values.
        side_effects: effects of the model so far, other than fits and predictions.
    """

    def __init__(
        self,
        make: Callable[[], StiffnessModel],
        data: BenchmarkData,
        *,
        uses_validation: bool,
        save: Callable[[StiffnessModel, Path], None] | None,
        load: Callable[[Path], StiffnessModel] | None,
    ) -> None:
        """Divide the rows; DataError if there are too few."""
        if len(data.samples) < FEWEST_ROWS:
            raise DataError(
                f"{len(data.samples)} samples are too few to check a model; give {FEWEST_ROWS} "
                "or more"
            )
        self.make, self.save, self.load, self.robot = make, save, load, data.robot
        rows = np.random.default_rng(0).permutation(evenly_spaced(len(data.samples), MOST_ROWS))
        ends = np.cumsum([int(len(rows) * share) for share in (TRAIN_SHARE, VALIDATION_SHARE)])
        self.train, validation, test = map(data.samples.take, np.split(rows, ends))
        self.measured = test.deflection
        bait = np.random.default_rng(1).normal(size=self.measured.shape)
        self.test = replace(test, deflection=max(float(self.measured.std()), SMALLEST) * bait)
        self.other_samples = data.samples.take(rows[-len(self.train) :])
        self.uses_validation = uses_validation
        self.parts: dict[str, Any] = {
            **{
                "train": self.train,
                "other": self.other_samples,
                "stated": _stating_more(self.train),
                "none": None,
                "validation": validation,
            },
            **{"own": validation if uses_validation else None, "loud": inflated(validation)},
        }
        self.fit_faults: list[Failed] = []
        self.side_effects: list[Failed] = []

    @remembered
    def _made(self) -> StiffnessModel:
        made = self.make()
        if fault := interface_fault(made):
            raise Failed(
                f"{type(made).__name__} {fault}", "compare with the model that `bench new` writes"
            )
        absent = [name for name in ("get_params", "set_params") if not hasattr(made, name)]
        if absent:
            reason = f"{type(made).__name__} has no {' and no '.join(absent)}"
            raise Failed(reason, "inherit sklearn.base.BaseEstimator")
        return made

    def new(self) -> StiffnessModel:
        """Return a new model."""
        self._made()  # a constructor that raises is one failure
        return self.make()

    @remembered
    def fitted(self, train: str = "train", validation: str = "own") -> StiffnessModel:
        """Return a new model fitted to these `parts`; each fit is computed once."""
        model = self.new()
        self.fit(model, self.parts[train], self.parts[validation])
        return model

    @remembered
    def predicted(self, train: str = "train", validation: str = "own") -> FloatArray:
        """Return the (n, 3) prediction [m] of the test rows after a fit to these `parts`."""
        return self.predict_test(self.fitted(train, validation))

    def predicted_again(self) -> FloatArray:
        """Return the (n, 3) prediction [m] of a new model with the same fit as the first."""
        return self.predicted("train", "validation" if self.uses_validation else "none")

    def fit(
        self, model: StiffnessModel, train: Samples, validation: Samples | None, seed: int = 0
    ) -> None:
        """Fit a model."""
        before = _options(model)
        try:
            returned = self._watched(
                lambda: model.fit(train, robot=self.robot, validation=validation, seed=seed)
            )
        except ValueError as error:
            if "read-only" not in str(error):  # in NumPy's words for a write to a frozen array
                raise
            raise Failed(
                f"fit writes into the samples ({error})",
                "copy an array before you change it: q = train.q.copy()",
            ) from error
        if returned is not model:
            wrong = f"fit returned {type(returned).__name__}"
            self.fit_faults.append(Failed(wrong, "end fit with: return self"))
        after = _options(model)
        for name, value in before.items():
            if after.get(name) != value:
                wrong = f"fit changes {name} from {value} to {after.get(name, 'nothing')}"
                advice = "store a value derived from an option under another name that ends in _"
                self.fit_faults.append(Failed(wrong, advice))

    def predict_test(self, model: StiffnessModel) -> FloatArray:
        """Return the checked (n, 3) prediction [m] of the test rows."""
        return self.predict(model, self.test.q, self.test.wrench)

    def predict(self, model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the checked (n, 3) prediction [m]."""
        predicted = np.asarray(self.answer(model, q, wrench))
        check_prediction(predicted, len(q))
        return predicted

    def answer(self, model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> object:
        """Return the result of predict for writable copies.

        A change of the copies is a side effect.
        """
        before, given = {"q": q, "wrench": wrench}, {"q": q.copy(), "wrench": wrench.copy()}
        answer: object = self._watched(lambda: model.predict(*given.values()))  # as a run does
        if written := [name for name in before if not np.array_equal(given[name], before[name])]:
            effect = f"predict writes into {' and '.join(written)}"
            self.side_effects.append(Failed(effect, "copy an array before you change it"))
        return answer

    def interval(
        self, model: StiffnessModel, q: FloatArray, wrench: FloatArray, coverage: float
    ) -> Interval:
        """Return the model's interval for writable copies."""
        interval: Interval = self._watched(
            lambda: model.predict_interval(q.copy(), wrench.copy(), coverage)
        )
        return interval

    def _watched(self, work: Callable[[], Any]) -> Any:
        """Call `work` and record its output and changed global random states."""
        before, printed = _random_states(), io.StringIO()
        try:
            with redirect_stdout(printed), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # findings about the rows, not about the model
                return work()
        finally:
            if text := printed.getvalue().strip():
                effect = f"printed {text.splitlines()[0][:60]!r} and the like"
                advice = "use stiff_protocols.contract.progress.report or logging"
                self.side_effects.append(Failed(effect, advice))
            after = _random_states()
            if moved := [name for name, state in before.items() if after[name] != state]:
                effect = f"changes the global random state of {', '.join(moved)}"
                self.side_effects.append(Failed(effect, FROM_SEED))


def inflated(samples: Samples) -> Samples:
    """Return samples with deflections multiplied by `INFLATION`."""
    return replace(samples, deflection=INFLATION * samples.deflection)


def _stating_more(samples: Samples) -> Samples:
    """Return samples whose rows also have an order, an approach and a reading after the load."""
    return replace(
        samples,
        order=np.arange(float(len(samples))),
        approach=np.where(np.arange(samples.q.size).reshape(samples.q.shape) % 2, 1.0, -1.0),
        after=0.01 * samples.deflection,
    )


def _options(model: StiffnessModel) -> dict[str, str]:
    """Return the repr of each option."""
    return {name: repr(value) for name, value in model.get_params(deep=False).items()}


def _random_states() -> dict[str, object]:
    """Return the global random states by name; torch's only if it is imported."""
    kind, keys, *state_parts = np.random.get_state(legacy=True)  # noqa: NPY002
    states: dict[str, object] = {
        "numpy.random": (kind, np.asarray(keys).tobytes(), *state_parts),
        "random": random.getstate(),
    }
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "get_rng_state"):
        states["torch"] = torch.get_rng_state().numpy().tobytes()
    return states
