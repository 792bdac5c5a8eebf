"""Turn and stiffness of each joint by the torque on it, from the coefficients of `bayes-springs`.

A curve belongs to a joint that was not loaded before, at the mean of its compliance over its own
angle: lines, lost motion and load curves. SI: rad, N m, N, m.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiff_models.physics.vjm import stiffness_unit
from stiff_models.regressors.arm_loads import OWN_AXIS, ArmLoads, Sizes
from stiff_models.regressors.spring_groups import Group, JointLines, LoadCurves, LostMotion
from stiff_protocols.contract.types import FloatArray, Robot
from stiff_protocols.springs.identification import (
    LARGEST_ERROR,
    SPRING_CURVE,
    IdentifiedSprings,
)

N_POINTS = 41
"""Points of a curve, from the lowest torque to the highest."""
LEAST_RANGE = 1e-9
"""Share of the widest range of torques; a joint with less is loaded by rounding only."""
TINY_SLOPE = 1e-15
"""rad/(N m) or m/N: no joint is so stiff."""
PLACES = {"no": (0.0, 0.05), "half": (0.45, 0.55), "full": (0.95, 1.0)}
"""Torques of printed stiffnesses -> shares of the largest torque between which a slope is taken."""


def joint_curves(
    robot: Robot,
    loads: ArmLoads,
    sizes: Sizes,
    groups: Sequence[Group],
    coefficients: FloatArray,
    root: FloatArray,
) -> tuple[dict[str, FloatArray], IdentifiedSprings]:
    """Return the curves of the joints, and their stiffnesses at no, half and full torque.

    A curve, "spring A2", is (n, 3) torque [N m or N], turn [rad or m], and its standard deviation,
    inside the torques of weight and load on the training samples. A joint without torque has none.

    Args:
        robot: the robot.
        loads: training loads.
        sizes: units of the coefficients.
        groups: groups that predictions have.
        coefficients: (p,) of these groups, in their order.
        root: (p, k) matrix whose product with its transpose is their covariance.
    """
    torque = np.concatenate([loads.weight, loads.weight + loads.load])[:, 1:, OWN_AXIS]
    ends = np.stack([torque.min(axis=0), torque.max(axis=0)], axis=1)
    widest = float(np.ptp(ends, axis=1).max())
    curves: dict[str, FloatArray] = {}
    slopes, errors, names, units = [], [], [], []
    for joint, (low, high) in enumerate(ends.tolist()):
        if high - low <= LEAST_RANGE * widest:
            continue
        full = max(low, high, key=abs)
        steps = full * np.array([*PLACES.values()])
        at = np.linspace(low, high, N_POINTS)
        torques = np.concatenate([at, steps.ravel()])
        columns, of_steps = np.split(_turns(loads, sizes, groups, joint, torques), [N_POINTS])
        deviation = np.linalg.norm(columns @ root, axis=1)
        name = robot.joint_names[joint]
        curves[f"{SPRING_CURVE}{name}"] = np.stack([at, columns @ coefficients, deviation], axis=1)
        rises = np.diff(of_steps.reshape(*steps.shape, -1), axis=1)[:, 0] / np.diff(steps)
        for place, ends_of_step, slope in zip(PLACES, steps, rises, strict=True):
            if not ((ends_of_step >= low) & (ends_of_step <= high)).all():
                continue
            slopes.append(float(slope @ coefficients))
            errors.append(float(np.linalg.norm(slope @ root)))
            names.append(f"{name} at {place} torque")
            units.append(stiffness_unit(robot.joint_types[joint]))
    error = np.array(errors)
    # a slope that may also be negative has the size of its error
    compliance = np.maximum(np.array(slopes), np.maximum(0.3 * error, TINY_SLOPE))
    log_error = error / compliance
    is_known = (log_error <= LARGEST_ERROR) & (compliance > TINY_SLOPE)
    straight = loads.move[:, :, 1:, OWN_AXIS] * loads.load[:, None, 1:, OWN_AXIS]
    matrix = straight.reshape(-1, robot.n_joints)
    size = np.linalg.norm(matrix, axis=0)
    return curves, IdentifiedSprings(
        compliance=compliance,
        is_identified=is_known,
        log_error=log_error,
        rank=int(is_known.sum()),
        condition=float(np.linalg.cond(matrix[:, size > 0.0] / size[size > 0.0])),
        names=tuple(names),
        units=tuple(units),
    )


def _turns(
    loads: ArmLoads, sizes: Sizes, groups: Sequence[Group], joint: int, torque: FloatArray
) -> FloatArray:
    """Return the (n, p) turns of a joint by each coefficient under (n,) torques from rest."""
    n, shape = len(torque), loads.load.shape[1:]
    twist, load = np.zeros((n, 6, *shape)), np.zeros((n, *shape))
    twist[:, 0, joint + 1, OWN_AXIS], load[:, joint + 1, OWN_AXIS] = 1.0, torque
    none, still = np.zeros((n, 6)), np.zeros((n, shape[0] - 1))
    unloaded = ArmLoads(
        still, none, none, np.zeros((n, 3, 3)), twist, load, np.zeros_like(load), loads.turns
    )
    parts = []
    for group in groups:
        columns = group.columns(unloaded, sizes)[:, 0]
        bends = isinstance(group, JointLines | LostMotion | LoadCurves)
        parts.append(columns if bends else np.zeros_like(columns))
    return np.concatenate(parts, axis=1)
