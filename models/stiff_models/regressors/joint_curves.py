"""Curve, stiffnesses and lost motion of each joint, by a process over springs.

A curve belongs to a previously unloaded joint. SI: rad, N m, N, m.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtri

from stiff_models.physics.vjm import stiffness_unit
from stiff_models.regressors.spring_process import SpringProcess
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot
from stiff_protocols.springs.identification import (
    LARGEST_ERROR,
    LOST_MOTION,
    SPRING_CURVE,
    IdentifiedSprings,
    spring_key,
)

N_POINTS = 41  # of a curve, from the lowest torque to the highest
TINY_SLOPE = 1e-15  # rad/(N m) or m/N: no joint is so stiff
ARCMIN = math.pi / 180.0 / 60.0

LEAST_RANGE = 1e-9
"""Share of the robot's widest torque range; a joint with less is loaded by rounding only."""
LOST_MOTION_Z = float(ndtri(0.95))
"""A lost motion is found if its 90 % interval lies above zero."""

PLACES = ("no", "half", "full")
_ENDS = np.array([[0.0, 0.05], [0.45, 0.55], [0.95, 1.0]])
"""Shares of the full torque between which the slope at no, half and full torque is taken."""


def joint_curves(
    process: SpringProcess, robot: Robot, springs: IntArray, calibration: float
) -> tuple[dict[str, FloatArray], IdentifiedSprings, dict[str, float]]:
    """Return the curves of the joints' own springs, their stiffnesses and their lost motion.

    A curve, "spring A2", is (n, 3) torque [N m or N], turn [rad or m], and its standard deviation,
    from the lowest to the highest torque of weight and load in the training samples. Stiffnesses
    are at no, half and full torque, if they lie in this range: the slope over a twentieth of the
    largest torque, with its standard error. A joint without torque has neither. Lost motion is its
    width and the standard error, by name and unit; 0 without an error if none is found.

    Args:
        process: process of all springs.
        robot: robot of these joints.
        springs: (n_joints,) number of each joint's own spring.
        calibration: factor on standard deviations.
    """
    points: dict[str, FloatArray] = {}
    slopes, errors = np.zeros((2, robot.n_joints, len(PLACES)))
    inside = np.zeros((robot.n_joints, len(PLACES)), dtype=bool)
    lowest, highest = (ends[springs] for ends in process.loads.torque_range)
    least = LEAST_RANGE * float((highest - lowest).max())
    for joint in np.flatnonzero(highest - lowest > least).tolist():
        low, high = float(lowest[joint]), float(highest[joint])
        full = max(low, high, key=abs)
        ends = full * _ENDS
        torque = np.concatenate([np.linspace(low, high, N_POINTS), ends.ravel()])
        turn, covariance = process.curve(int(springs[joint]), torque)
        deviation = calibration * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        curve = np.stack([torque, turn, deviation], axis=1)
        points[f"{SPRING_CURVE}{robot.joint_names[joint]}"] = curve[:N_POINTS]
        steps = np.zeros((len(PLACES), len(torque)))
        for place, (start, end) in enumerate(ends):
            steps[place, N_POINTS + 2 * place : N_POINTS + 2 * place + 2] = np.array(
                [-1.0, 1.0]
            ) / (end - start)
        inside[joint] = ((ends >= low) & (ends <= high)).all(axis=1)
        slopes[joint] = steps @ turn
        variance = np.einsum("pi,ij,pj->p", steps, covariance, steps)
        errors[joint] = calibration * np.sqrt(np.maximum(variance, 0.0))
    straight = process.loads.effects(process.loads.loaded - process.loads.unloaded)[springs]
    stiffness = _identified(robot, inside, slopes, errors, straight)
    return points, stiffness, _lost_motion(process, robot, springs, calibration)


def _lost_motion(
    process: SpringProcess, robot: Robot, springs: IntArray, calibration: float
) -> dict[str, float]:
    numbers: dict[str, float] = {}
    widths, errors = process.lost_motion(springs)
    errors = calibration * errors
    is_lost_motion = process.is_lost_motion(springs) & (widths > LOST_MOTION_Z * errors)
    for joint, name in enumerate(robot.joint_names):
        unit, factor = ("arcmin", 1.0 / ARCMIN) if robot.turns[joint] else ("mm", 1e3)
        width_key = spring_key(LOST_MOTION, name, unit)
        numbers[width_key] = 0.0
        if is_lost_motion[joint]:
            numbers[width_key] = factor * float(widths[joint])
            error_key = spring_key(f"{LOST_MOTION} standard error", name, unit)
            numbers[error_key] = factor * float(errors[joint])
    return numbers


def _unit_rows(matrix: FloatArray) -> FloatArray:
    """Return the rows scaled to length 1, without rows of zeros."""
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    return np.asarray((matrix / np.where(size > 0.0, size, 1.0))[size[:, 0] > 0.0])


def _identified(
    robot: Robot, inside: BoolArray, slopes: FloatArray, errors: FloatArray, straight: FloatArray
) -> IdentifiedSprings:
    """Return (n_joints, 3) slopes and their standard errors [rad/(N m) or m/N] as stiffnesses.

    `inside` (n_joints, 3) chooses the slopes; `straight` (n_joints, n) is the training deflection
    by each joint at unit compliance.
    """
    names = np.array(
        [[f"{name} at {word} torque" for word in PLACES] for name in robot.joint_names]
    )
    units = np.array([[stiffness_unit(kind)] * len(PLACES) for kind in robot.joint_types])
    # a slope that may also be negative has the size of its error
    error = errors[inside]
    compliance = np.maximum(slopes[inside], np.maximum(0.3 * error, TINY_SLOPE))
    log_error = error / compliance
    is_known = log_error <= LARGEST_ERROR
    return IdentifiedSprings(
        compliance=compliance,
        is_identified=is_known,
        log_error=log_error,
        rank=int(is_known.sum()),
        condition=float(np.linalg.cond(_unit_rows(straight))),
        names=tuple(names[inside].tolist()),
        units=tuple(units[inside].tolist()),
    )
