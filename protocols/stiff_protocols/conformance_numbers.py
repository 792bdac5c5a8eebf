"""How two predictions are compared by the conformance suite."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiff_protocols.checklist import Failed
from stiff_protocols.types import FloatArray, Samples

ROUNDING = 1e-5
"""Share of the largest prediction by which single precision may change with the batch size."""
SMALLEST = 1e-9  # m; far below what any instrument resolves
NOTHING_TO_SAY = ""


def same(what: str, first: FloatArray, second: FloatArray) -> None:
    """See that two predictions are equal to the bit.

    Raises:
        Failed: they are not.
    """
    if not np.array_equal(first, second):
        far = float(np.abs(first - second).max())
        raise Failed(f"{what} differs by up to {1e3 * far:.3g} mm")


def see_no_neighbours(
    what: str,
    together: FloatArray,
    predict: Callable[[FloatArray, FloatArray], FloatArray],
    rows: Samples,
) -> None:
    """Predict rows one by one and in reverse order: a row must not see the others.

    Args:
        what: name of what is predicted.
        together: (n, k) m, predicted from all rows at once.
        predict: returns (m, k) m for (m, n_joints) q and (m, 6) wrench.
        rows: the n rows.

    Raises:
        Failed: a row's prediction depends on the others.
    """
    q, wrench = rows.q, rows.wrench
    alone = np.concatenate([predict(q[i : i + 1], wrench[i : i + 1]) for i in range(len(q))])
    backwards = predict(q[::-1], wrench[::-1])[::-1]
    for how, other in (("alone", alone), ("in reverse order", backwards)):
        far = float(np.abs(other - together).max())
        if far > SMALLEST + ROUNDING * float(np.abs(together).max()):
            raise Failed(f"{what} predicted {how} differs by up to {1e3 * far:.3g} mm")
