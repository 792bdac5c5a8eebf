"""Check predictions before they are scored, and warn of uninformative training rows.

A third-party model may predict mm. A table of its own would not show that, so it is an error.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiff_protocols.contract.errors import ModelError, warn
from stiff_protocols.contract.types import Deflection, FloatArray, Samples

FAR_OFF = 100.0
"""Factor between a predicted and the measured root mean square from which it is suspect."""
UNIT_FACTORS = (300.0, 3000.0)
"""Range of factors by a mistake between m and mm, for an imperfect model."""
OUT_OF_HAND = 1e5
"""Factor above which mm cannot be the cause."""
EXPLAINED = 0.5
"""Share of the measured squares that small predictions must explain once they are scaled up."""
FEWEST = 3
"""Training samples; with fewer, any difference may cause the deflection."""
FORCES = (1e-2, 1e5)
"""N; smaller forces do not bend a robot, and larger forces break it."""
ROWS_AGAIN = 16
"""Largest number of rows that are predicted twice."""
SAME_M, SAME_SHARE = 1e-7, 1e-4
"""m, and share of the largest prediction, by which rounding may change a prediction."""
DEFLECTIONS = (1e-7, 0.1)
"""m; instruments do not resolve smaller deflections, and larger values are not deflections."""


def check_prediction(predicted: FloatArray, n: int) -> None:
    """Raise ModelError unless `predicted` is (n, 3) finite floating-point numbers."""
    array = np.asarray(predicted)
    expectation = f"expected ({n}, 3) finite numbers"
    if predicted is None or array.dtype.kind != "f":
        what = "None" if predicted is None else f"{array.dtype} values"
        raise ModelError(f"predict returned {what}, {expectation}")
    if array.shape != (n, 3):
        raise ModelError(f"predict returned shape {array.shape}, {expectation}")
    if not np.isfinite(array).all():
        n_bad = int((~np.isfinite(array)).sum())
        raise ModelError(f"predict returned {n_bad} values that are not finite, {expectation}")


def check_rows_apart(
    predict: Deflection, q: FloatArray, wrench: FloatArray, predicted: FloatArray
) -> None:
    """Check that the prediction of a row depends neither on other rows nor on chance.

    At most half of the rows are predicted again, in reverse order.

    Args:
        predict: returns (n, 3) m.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m.
        predicted: (n, 3) m, of all rows together.

    Raises:
        ModelError: a prediction differs.
    """
    n_again = min(-(-len(q) // 2), ROWS_AGAIN)
    rows = np.linspace(len(q) - 1, 0, n_again).round().astype(np.int64)
    again = np.asarray(predict(q[rows], wrench[rows]))
    check_prediction(again, len(rows))
    far = float(np.abs(again - predicted[rows]).max(initial=0.0))
    if far > SAME_M + SAME_SHARE * float(np.abs(predicted).max(initial=0.0)):
        raise ModelError(
            f"{len(rows)} rows predicted again, in reverse order, differ by up to "
            f"{1e3 * far:.3g} mm: compute means, scales and random numbers in fit, not in predict"
        )


def check_units(predicted: FloatArray, measured: FloatArray) -> None:
    """Check that predictions of a model's training rows are not in mm or similar units.

    Small predictions are accepted (zero is a valid model) unless they become right when multiplied
    by about 1000. Both arrays are (n, 3) m.

    Raises:
        ModelError: they are off by about the factor between m and mm.
    """
    size, measured_size = _root_mean_square(predicted), _root_mean_square(measured)
    if size == 0.0 or measured_size == 0.0:
        return
    if size > FAR_OFF * measured_size:
        cause = (
            "expected m, are these mm?"
            if size < OUT_OF_HAND * measured_size
            else "has the model diverged (a learning rate too high), or is its unit another one?"
        )
        raise ModelError(
            f"predictions are about {_rough(size / measured_size)} times larger than the training "
            f"deflections: {cause}"
        )
    # both divided by their size first: the squares of tiny numbers would underflow
    unit, target = predicted / size, measured / measured_size
    aligned = float(np.mean(unit * target)) * measured_size / size  # the least-squares factor
    factor = float(np.clip(aligned, *UNIT_FACTORS))
    explained = 1.0 - float(np.mean((target - factor * (size / measured_size) * unit) ** 2))
    if size < measured_size / FAR_OFF and explained > EXPLAINED:
        raise ModelError(
            f"predictions are about {_rough(factor)} times smaller than the training deflections, "
            "and right when multiplied by that: expected m"
        )


def warn_of_rows(train: Samples) -> None:
    """Warn of effects that no model can learn from these training rows."""
    for finding in _findings(train):
        warn(finding)


def _findings(train: Samples) -> Iterator[str]:
    n = len(train)
    if n < FEWEST:
        yield f"training samples: {n}, too few to learn the effect of pose and load"
    elif not np.ptp(train.q, axis=0).any():
        yield f"all {n} training samples are of one pose: the effect of the pose cannot be learned"
    if not train.wrench.any():
        yield f"the wrench is zero in all {n} training samples: no stiffness can be learned"
    elif n >= FEWEST and not np.ptp(train.wrench, axis=0).any():
        yield f"all {n} training samples have one load: the effect of the load cannot be learned"
    if not train.deflection.any():
        yield f"the deflection is zero in all {n} training samples: there is nothing to learn"
    sizes = (
        ("forces", train.wrench[:, :3], "N", FORCES),
        ("deflections", train.deflection, "m", DEFLECTIONS),
    )
    for name, values, unit, (least, most) in sizes:
        size = _root_mean_square(values)
        if size and not least <= size <= most:
            yield (
                f"the training samples' {name} are of {size:.2g} {unit} (root mean square, "
                f"expected {least:g} to {most:g}): is the unit right?"
            )


def _rough(factor: float) -> str:
    """Return the factor with one digit, so that the splits of a run share a message."""
    return f"{float(f'{factor:.0e}'):g}"


def _root_mean_square(values: FloatArray) -> float:
    largest = float(np.abs(values).max(initial=0.0))
    return largest * float(np.sqrt(np.mean((values / largest) ** 2))) if largest else 0.0
