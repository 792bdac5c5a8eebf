"""Samples of a test's own making."""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.types import FloatArray, Samples, TextArray


def samples_with(
    q: FloatArray, wrench: FloatArray, deflection: FloatArray, **names: TextArray
) -> Samples:
    """One load at each pose, all of one group, where no names say otherwise."""
    n = len(q)
    usual = {
        "pose_id": np.arange(n).astype(str),
        "load_id": np.full(n, "1"),
        "group": np.full(n, "all"),
    }
    return Samples(q=q, wrench=wrench, deflection=deflection, **(usual | names))
