"""Whether an arm of six joints collides with itself: capsules along its links.

Four capsules: base column (base frame's origin to A1's), upper arm (A2 to A3), forearm (A4 to A5),
hand with tool (A5 to the TCP). Neighbours share a joint and always overlap there, so what is
checked is column against forearm, column against hand and upper arm against hand.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from stiff_datasets.robots.robot import ChainModel
from stiff_protocols.contract.types import FloatArray

COLUMN, UPPER_ARM, FOREARM, HAND = "base column", "upper arm", "forearm", "hand"
RADII = {COLUMN: 0.12, UPPER_ARM: 0.09, FOREARM: 0.08, HAND: 0.06}
"""m, for a KR10: about half the width of the widest housing of each; assumption."""
PAIRS = ((COLUMN, FOREARM), (COLUMN, HAND), (UPPER_ARM, HAND))


def self_clearance(chain: ChainModel, q: FloatArray) -> FloatArray:
    """Return (n,) the smallest gap between two capsules at (n, 6) `q` [rad], m.

    Below zero they overlap.
    """
    geometry = _capsules(chain)
    data, found = chain.model.createData(), geometry.createData()
    gaps = []
    for one in q:
        pin.computeDistances(chain.model, data, geometry, found, one)
        gaps.append(min(result.min_distance for result in found.distanceResults))
    return np.array(gaps)


def _capsules(chain: ChainModel) -> pin.GeometryModel:
    """Return the capsules, each fixed to the joint that moves it, and the pairs to check."""
    placements, here = chain.model.jointPlacements, np.zeros(3)
    geometry, numbers = pin.GeometryModel(), {}
    for name, joint, start, end in (
        (COLUMN, 0, here, placements[1].translation),
        (UPPER_ARM, 2, here, placements[3].translation),
        (FOREARM, 4, here, placements[5].translation),
        (HAND, 6, placements[6].actInv(here), chain.tcp),  # A6 moves its far end
    ):
        shape = coal.Capsule(RADII[name], float(np.linalg.norm(end - start)))
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start)
        placement = pin.SE3(turn.matrix(), (start + end) / 2.0)  # a capsule lies along its z
        numbers[name] = geometry.addGeometryObject(
            pin.GeometryObject(name, joint, placement, shape)
        )
    for first, second in PAIRS:
        geometry.addCollisionPair(pin.CollisionPair(numbers[first], numbers[second]))
    return geometry
