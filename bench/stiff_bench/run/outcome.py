"""The outcome of a fit as text, in which it comes from the process of a model.

Reading it runs no code of that process, whatever the text is: it is JSON.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import orjson

from stiff_bench.run.fit import FitOutcome, FitTask, Fitted, short, unrepeated
from stiff_bench.store.cell_rows import storable
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.record import Cost
from stiff_protocols.contract.types import FloatArray, Interval

_ARRAYS = ("predicted", "of_training", "commands", "at_commands")
_BASE_BYTES, _BYTES_A_ROW = 2**24, 2**10
_FAULTS = (AttributeError, DataError, KeyError, OverflowError, TypeError, ValueError)
"""Errors that a text without an outcome can raise."""


def most_bytes(task: FitTask) -> int:
    """Return how long the text of a fit can become."""
    return _BASE_BYTES + _BYTES_A_ROW * len(task.q)


def outcome_text(outcome: FitOutcome) -> bytes:
    """Return an outcome as JSON."""
    content: dict[str, Any] = {
        "failure": storable(outcome.failure),
        "cause": storable(outcome.cause),
        "warnings": [storable(message) for message in outcome.warnings],
    }
    if (fitted := outcome.fitted) is not None:
        interval = fitted.interval
        content["fitted"] = {
            **{name: _plain(getattr(fitted, name)) for name in _ARRAYS},
            "cost": list(fitted.cost),
            "interval": interval
            and [_plain(interval.lower), _plain(interval.upper), interval.coverage],
            "calibration_samples": fitted.calibration_samples,
            # JSON has no infinity (a rigid joint) and no NaN (one that cannot be identified)
            "diagnostics": {
                storable(name): value if math.isfinite(value) else str(value)
                for name, value in fitted.diagnostics.items()
            },
            "chosen": {storable(k): storable(v) for k, v in fitted.chosen.items()},
            "curves": {storable(name): _plain(curve) for name, curve in fitted.curves.items()},
        }
    return orjson.dumps(content)


def _plain(array: FloatArray | None) -> Any:
    return None if array is None else np.asarray(array, dtype=np.float64).tolist()


def read_outcome(text: bytes) -> FitOutcome:
    """Return the outcome that a text holds; its shapes are seen to when it is scored.

    Raises:
        DataError: it holds none.
    """
    try:
        content = orjson.loads(text)
        fitted = None if content.get("fitted") is None else _fitted(content["fitted"])
        failure, cause = (short(_text(content[name])) for name in ("failure", "cause"))
        warned = unrepeated(_text(message) for message in content["warnings"])
        if fitted is None and not failure:
            raise DataError("neither predictions nor a failure")
    except _FAULTS as error:
        raise DataError(f"its process sent no outcome of a fit: {short(str(error))}") from error
    return FitOutcome(fitted, failure, cause, warned)


def _fitted(content: Mapping[str, Any]) -> Fitted:
    *seconds, memory = content["cost"]
    fit_s, predict_s, latency_s, throughput = map(float, seconds)
    interval, chosen = content["interval"], content["chosen"]
    arrays = {name: _array(content[name]) for name in _ARRAYS}
    predicted, of_training = arrays.pop("predicted"), arrays.pop("of_training")
    if predicted is None or of_training is None:
        raise DataError("no predictions")
    return Fitted(
        predicted,
        of_training,
        Cost(fit_s, predict_s, latency_s, throughput, None if memory is None else int(memory)),
        interval=interval and Interval(interval[0], interval[1], float(interval[2])),
        calibration_samples=int(content["calibration_samples"]),
        diagnostics={name: float(value) for name, value in content["diagnostics"].items()},
        chosen={name: _text(value) for name, value in chosen.items()},
        curves={
            name: np.array(points, dtype=np.float64).reshape(-1, 3)
            for name, points in content["curves"].items()
        },
        **arrays,
    )


def _array(content: Any) -> FloatArray | None:
    return None if content is None else np.array(content, dtype=np.float64)


def _text(content: Any) -> str:
    if not isinstance(content, str):
        raise DataError(f"a text is a {type(content).__name__}")
    return content
