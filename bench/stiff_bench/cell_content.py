"""A cell's result as plain content, and back: the same in a file of its own and in a pack.

Numbers are in SI units at full precision.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from itertools import starmap
from typing import Any

import numpy as np

from stiff_protocols.cost import Cost
from stiff_protocols.record import Cell, CellResult, Presentation, ResultRecord
from stiff_protocols.types import FloatArray, IntArray, Interval, Prediction


def cell_content(result: CellResult) -> dict[str, Any]:
    """Return what is stored of a result, as JSON can hold it; its arrays as lists."""
    return {
        "cell": fields_of(result.cell),
        "shown": fields_of(result.shown),
        "run_id": result.run_id,
        "status": result.status,
        "records": result.records,
        "prediction": None if result.prediction is None else _plain(result.prediction),
        "cost": None if result.cost is None else fields_of(result.cost),
        # JSON has no infinity (a rigid joint) and no NaN (one that cannot be identified)
        "diagnostics": {
            name: value if math.isfinite(value) else str(value)
            for name, value in result.diagnostics.items()
        },
        "warnings": list(result.warnings),
        "failure": result.failure,
        "cause": result.cause,
        "log": list(result.log),
        "calibration_samples": result.calibration_samples,
        "n_train": result.n_train,
        "n_splits": result.n_splits,
        "chosen": dict(result.chosen),
        "curves": {name: _points(curve) for name, curve in result.curves.items()},
    }


def _points(curve: FloatArray) -> list[list[float | None]]:
    """Return a curve's points; a NaN, as where there are no validation rows, becomes a null."""
    return [[value if math.isfinite(value) else None for value in row] for row in curve.tolist()]


def fields_of(found: Any) -> dict[str, Any]:
    """Return a dataclass's fields as they are; `asdict` copies all that is in them."""
    return {item.name: getattr(found, item.name) for item in fields(found)}


def _plain(prediction: Prediction) -> dict[str, IntArray | FloatArray]:
    plain: dict[str, IntArray | FloatArray] = {
        "rows": prediction.rows,
        "predicted_m": prediction.predicted,
        "measured_m": prediction.measured,
    }
    if prediction.reference is not None:
        plain["reference_m"] = prediction.reference
    if prediction.interval is not None:  # its coverage is the cell's
        plain["lower_m"] = prediction.interval.lower
        plain["upper_m"] = prediction.interval.upper
    return plain


def cell_result(content: Mapping[str, Any]) -> CellResult:
    """Return the result that was stored; what an older stiffbench did not store has its default.

    Raises:
        KeyError, TypeError, AttributeError, ValueError, DataError: it is no result's content.
    """
    cell = Cell(**content["cell"])
    prediction = content["prediction"]
    shown = content["shown"]
    return CellResult(
        cell=cell,
        shown=Presentation(**{**shown, "caveats": tuple(shown["caveats"])}),
        run_id=content["run_id"],
        status=content["status"],
        records=tuple(starmap(ResultRecord, content["records"])),
        prediction=None if prediction is None else _prediction(prediction, cell.coverage),
        cost=None if content["cost"] is None else Cost(**content["cost"]),
        diagnostics={name: float(value) for name, value in content["diagnostics"].items()},
        warnings=tuple(content["warnings"]),
        failure=content["failure"],
        cause=content.get("cause", ""),
        log=tuple(content.get("log", ())),
        calibration_samples=content["calibration_samples"],
        n_splits=content.get("n_splits", 0),
        n_train=content.get("n_train", 0),  # unknown in results from before it was stored
        chosen=content.get("chosen", {}),
        curves={
            name: np.array(points, dtype=np.float64).reshape(-1, 3)
            for name, points in content.get("curves", {}).items()
        },
    )


def _prediction(content: Mapping[str, Any], coverage: float | None) -> Prediction:
    interval = None
    if coverage is not None and "lower_m" in content:
        interval = Interval(content["lower_m"], content["upper_m"], coverage)
    return Prediction(
        rows=np.array(content["rows"], dtype=np.int64),
        predicted=content["predicted_m"],
        measured=content["measured_m"],
        interval=interval,
        reference=content.get("reference_m"),
    )
