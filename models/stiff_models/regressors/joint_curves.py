"""Curve, stiffnesses and lost motion of each joint, by a process over springs.

A curve belongs to a previously unloaded joint. SI: rad, N m, N, m.
"""

from __future__ import annotations

import math

import numpy as np

from stiff_models.physics.vjm import stiffness_unit
from stiff_models.regressors.spring_process import SpringProcess
from stiff_protocols.contract.types import FloatArray, IntArray, Robot
from stiff_protocols.springs.identification import (
    LARGEST_ERROR,
    SPRING_CURVE,
    IdentifiedSprings,
    spring_key,
)

N_POINTS = 41  # from full torque on one side to full torque on the other
TINY_SLOPE = 1e-15  # rad/(N m) or m/N: no joint is so stiff
ARCMIN = math.pi / 180.0 / 60.0

PLACES = ("no", "half", "full")
_STEPS = np.zeros((len(PLACES), N_POINTS))
"""Weights of a curve's points: their sum over the step is the slope at no, half, full torque."""
_middle, _half, _full = N_POINTS // 2, 3 * N_POINTS // 4, N_POINTS - 1
_STEPS[0, [_middle, _middle + 1]] = -1.0, 1.0
_STEPS[1, [_half - 1, _half + 1]] = -0.5, 0.5
_STEPS[2, [_full - 1, _full]] = -1.0, 1.0


def joint_curves(
    process: SpringProcess, robot: Robot, springs: IntArray, calibration: float
) -> tuple[dict[str, FloatArray], IdentifiedSprings, dict[str, float]]:
    """Return the curves of the joints' own springs, their stiffnesses and their lost motion.

    A curve, "spring A2", is (n, 3) torque [N m or N], turn [rad or m], and its standard deviation.
    Stiffnesses are at no, half and full torque: the slope over a twentieth of the largest torque of
    weight and load in the training samples, with its standard error. Lost motion is its full
    width and the standard error, by name and unit.

    Args:
        process: process of all springs.
        robot: robot of these joints.
        springs: (n_joints,) number of each joint's own spring.
        calibration: factor on standard deviations.
    """
    points: dict[str, FloatArray] = {}
    slopes, errors = np.empty((2, robot.n_joints, len(PLACES)))
    for joint, spring in enumerate(springs.tolist()):
        loaded = process.loads.loaded[spring]
        full = float(loaded[np.abs(loaded).argmax()]) or float(process.covariance.scale[spring])
        torque = np.linspace(-full, full, N_POINTS)
        turn, covariance = process.curve(spring, torque)
        deviation = calibration * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        curve = np.stack([torque, turn, deviation], axis=1)
        points[f"{SPRING_CURVE}{robot.joint_names[joint]}"] = curve[np.argsort(torque)]
        steps = _STEPS / (torque[1] - torque[0])
        slopes[joint] = steps @ turn
        variance = np.einsum("pi,ij,pj->p", steps, covariance, steps)
        errors[joint] = calibration * np.sqrt(np.maximum(variance, 0.0))
    straight = process.loads.effects(process.loads.loaded - process.loads.unloaded)[springs]
    stiffness = _identified(robot, slopes, errors, straight)
    return points, stiffness, _lost_motion(process, robot, springs, calibration)


def _lost_motion(
    process: SpringProcess, robot: Robot, springs: IntArray, calibration: float
) -> dict[str, float]:
    numbers: dict[str, float] = {}
    for name, turns, width, error in zip(
        robot.joint_names, robot.turns, *process.lost_motion(springs), strict=True
    ):
        unit, factor = ("arcmin", 1.0 / ARCMIN) if turns else ("mm", 1e3)
        numbers[spring_key("lost motion", name, unit)] = factor * float(width)
        key = spring_key("lost motion standard error", name, unit)
        numbers[key] = factor * calibration * float(error)
    return numbers


def _unit_rows(matrix: FloatArray) -> FloatArray:
    """Return the rows scaled to length 1, without rows of zeros."""
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    return np.asarray((matrix / np.where(size > 0.0, size, 1.0))[size[:, 0] > 0.0])


def _identified(
    robot: Robot, slopes: FloatArray, errors: FloatArray, straight: FloatArray
) -> IdentifiedSprings:
    """Return (n_joints, 3) slopes and their standard errors [rad/(N m) or m/N] as stiffnesses.

    `straight` (n_joints, n) is the training deflection by each joint at unit compliance.
    """
    names = [f"{name} at {word} torque" for name in robot.joint_names for word in PLACES]
    units = [stiffness_unit(kind) for kind in robot.joint_types for _ in PLACES]
    # a slope that may also be negative has the size of its error
    least = np.maximum(0.3 * errors, TINY_SLOPE)
    compliance, error = np.maximum(slopes, least).ravel(), errors.ravel()
    log_error = error / compliance
    is_known = log_error <= LARGEST_ERROR
    return IdentifiedSprings(
        compliance=compliance,
        is_identified=is_known,
        log_error=log_error,
        rank=int(is_known.sum()),
        condition=float(np.linalg.cond(_unit_rows(straight))),
        names=tuple(names),
        units=tuple(units),
    )
