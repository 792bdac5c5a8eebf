"""Search for the torques at which a multi-segment spring changes its slope."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from stiff_protocols.types import FloatArray, IntArray

MAX_SWEEPS = 20
WORTH = 1e-9  # relative fall of the residual that a breakpoint is moved for: more than rounding


def search_breakpoints(finest: FloatArray, target: FloatArray, start: IntArray) -> IntArray:
    """Return the candidates that leave the least residual, moving one breakpoint at a time.

    A segment is a sum of the finest ones, so the samples are compressed once (QR) and a trial
    costs the same however many samples there are.

    Args:
        finest: (n, 3, n_joints, n_candidates + 1) deflection [m] by each of the segments between
            neighbouring candidates at unit slope.
        target: (n, 3) measured deflection, m.
        start: (n_joints, n_breakpoints) candidates' numbers to start from, increasing.

    Returns:
        (n_joints, n_breakpoints) candidates' numbers, increasing.
    """
    _, _, n_joints, n_finest = finest.shape
    rows = finest.reshape(-1, n_joints * n_finest)
    # the target beside them: the last column is what slopes can explain of it, and what they cannot
    beside = np.column_stack([rows, target.reshape(-1)])
    compressed = np.asarray(np.linalg.qr(beside, mode="r"))  # numpy's own types lack this mode
    triangle, seen = compressed[:, :-1], compressed[:, -1]
    # where each joint's segments begin in the columns: the first at the joint's own first one
    own, nothing = n_finest * np.arange(n_joints)[:, None], np.zeros(n_joints, dtype=np.int64)

    def residual(chosen: IntArray) -> float:
        first = own + np.column_stack([nothing, chosen + 1])
        coarse = np.add.reduceat(triangle, first.ravel(), axis=1)
        size = np.linalg.norm(coarse, axis=0)
        size[size == 0.0] = 1.0  # no sample's torque lies in the segment
        return float(nnls(coarse / size, seen)[1])

    chosen, best = start, residual(start)
    for _ in range(MAX_SWEEPS):
        before = best
        for joint, number in np.ndindex(start.shape):
            for trial in _moves(chosen, joint, number, n_finest - 1):
                error = residual(trial)
                if error < best * (1.0 - WORTH):
                    best, chosen = error, trial
        if best == before:
            break
    return chosen


def _moves(chosen: IntArray, joint: int, number: int, n_candidates: int) -> list[IntArray]:
    """Return the choices that one breakpoint's move between its neighbours gives."""
    around = [-1, *chosen[joint], n_candidates]
    moves = []
    for candidate in range(around[number] + 1, around[number + 2]):
        trial = chosen.copy()
        trial[joint, number] = candidate
        moves.append(trial)
    return moves
