"""Samples of a test's own making."""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.types import FloatArray, Samples


def samples_with(q: FloatArray, wrench: FloatArray, deflection: FloatArray) -> Samples:
    """One load at each pose."""
    n = len(q)
    return Samples(
        q=q,
        wrench=wrench,
        deflection=deflection,
        pose_id=np.arange(n).astype(str),
        load_id=np.full(n, "1"),
        group=np.full(n, "all"),
    )
