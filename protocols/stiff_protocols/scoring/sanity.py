"""What a prediction must be before it is scored, and what training rows cannot teach any model.

A stranger's model may predict mm. Nobody sees that in a table of its own, so it is an error.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiff_protocols.contract.errors import ModelError, warn
from stiff_protocols.contract.types import FloatArray, Samples

FAR_OFF = 100.0
"""A root mean square so many times the measured one, or so small a part of it, is suspect."""
UNIT_FACTORS = (300.0, 3000.0)
"""Factors that a mistake between m and mm leaves, for a model that is not perfect either."""
OUT_OF_HAND = 1e5
"""So many times too large, and mm are not to blame."""
EXPLAINED = 0.5
"""Share of the measured squares that small predictions must explain once they are scaled up."""
FEWEST = 3
"""Training samples; in fewer, whatever differs may be what the deflection comes from."""
FORCES = (1e-2, 1e5)
"""N; forces that are smaller bend no robot, and larger ones break it."""
DEFLECTIONS = (1e-7, 0.1)
"""m; what is smaller no instrument resolves on a robot, and what is larger is none."""


def check_prediction(predicted: FloatArray, n: int) -> None:
    """Raise ModelError unless `predicted` is (n, 3) finite real numbers."""
    array = np.asarray(predicted)
    wanted = f"expected ({n}, 3) finite numbers"
    if predicted is None or array.dtype.kind not in "fiu":
        what = "None" if predicted is None else f"{array.dtype} values"
        raise ModelError(f"predict returned {what}, {wanted}")
    if array.shape != (n, 3):
        raise ModelError(f"predict returned shape {array.shape}, {wanted}")
    if not np.isfinite(array).all():
        n_bad = int((~np.isfinite(array)).sum())
        raise ModelError(f"predict returned {n_bad} values that are not finite, {wanted}")


def check_units(predicted: FloatArray, measured: FloatArray) -> None:
    """See that predictions of the rows a model was fitted to are not in mm or the like.

    Predictions that are merely small are left alone (zero is a legitimate model) unless they
    become right when multiplied by about 1000. Both arrays are (n, 3) m.

    Raises:
        ModelError: they are off by about the factor between m and mm.
    """
    size, wanted = _root_mean_square(predicted), _root_mean_square(measured)
    if size == 0.0 or wanted == 0.0:
        return
    if size > FAR_OFF * wanted:
        cause = (
            "expected m, are these mm?"
            if size < OUT_OF_HAND * wanted
            else "has the model diverged (a learning rate too high), or is its unit another one?"
        )
        raise ModelError(
            f"predictions are about {_rough(size / wanted)} times larger than the training "
            f"deflections: {cause}"
        )
    # both divided by their size first: the squares of tiny numbers would underflow
    unit, target = predicted / size, measured / wanted
    aligned = float(np.mean(unit * target)) * wanted / size  # the least-squares factor
    factor = float(np.clip(aligned, *UNIT_FACTORS))
    explained = 1.0 - float(np.mean((target - factor * (size / wanted) * unit) ** 2))
    if size < wanted / FAR_OFF and explained > EXPLAINED:
        raise ModelError(
            f"predictions are about {_rough(factor)} times smaller than the training deflections, "
            "and right when multiplied by that: expected m"
        )


def warn_of_rows(train: Samples) -> None:
    """Warn of what these training rows cannot teach a model, whichever it is."""
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
    """Return one digit of it: the splits of a run then share one message."""
    return f"{float(f'{factor:.0e}'):g}"


def _root_mean_square(values: FloatArray) -> float:
    largest = float(np.abs(values).max(initial=0.0))
    return largest * float(np.sqrt(np.mean((values / largest) ** 2))) if largest else 0.0
