"""Does another frame or sign of the wrench explain measured deflections better than the file's?

A wrench that is expressed in the wrong frame, or is the reaction of the one that was asked for,
fits no model, and nothing in the file says why. So the same reference model is fitted to every
likely misreading of the wrench, and the residuals are compared.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stiff_protocols.contract.errors import ModelError, StiffBenchWarning
from stiff_protocols.contract.interfaces import StiffnessModel
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples

FEWER_SQUARES = 0.5
"""A better reading leaves less than this share of the squares that the wrench as given leaves."""
CLEARLY = 3.0
"""Standard errors by which it must be better, see `better_reading`."""
AS_GOOD = 1.1
"""Readings that leave at most so many times the best one's squares cannot be told from it."""
MOST_SAMPLES = 1000
"""So many samples are compared at most, spread evenly: a wrong frame shows in far fewer."""

_FLIPPED_TORQUE = np.repeat([1.0, -1.0], 3)  # (6,)


@dataclass(frozen=True, eq=False)
class Reading:
    """A way to read the wrench of a file.

    Attributes:
        name: what the file's wrench then is, in words.
        wrench: (n, 6) that wrench at the TCP, base frame.
        same: names of readings that give the same wrench on all of the samples.
    """

    name: str
    wrench: FloatArray
    same: tuple[str, ...] = ()


@dataclass(frozen=True)
class BetterReading:
    """A reading that explains the data clearly better than the wrench as given.

    Attributes:
        name: what the file's wrench then is, in words.
        ties: names of readings that explain the data about as well.
        rms: root mean square length of the residual, m.
        rms_as_given: the same of the wrench as given, m.
    """

    name: str
    ties: tuple[str, ...]
    rms: float
    rms_as_given: float


def better_reading(samples: Samples, robot: Robot, model: StiffnessModel) -> BetterReading | None:
    """Return the reading that explains the data much better than the file's; None: there is none.

    The best reading must leave less than half the sum of squares that the wrench as given leaves,
    and be better by more than three standard errors of the difference, summed by pose: the test
    of Q. Vuong (Econometrica 57, 1989) between models that do not contain each other and have
    equally many parameters, with poses for rows because the loads of a pose share their errors.
    Three instead of the usual two, since the best of more than a hundred readings is compared.

    Half the squares alone is deceived where there are next to no data. Of 720 draws of 5 to 40
    rows from three data sets, as they are and with 0.5, 2 and 1000 times their deflection in
    noise added, it gave 20 false alarms with 5 rows, one with 8 and none with more; both parts
    together gave 2, with 5 rows of pure noise. Of errors planted in the data as they are, half the
    squares alone found all, both parts all with 20 rows and 5 of 6 with 12.

    Args:
        samples: the data.
        robot: the robot that was measured.
        model: a reference model; it is fitted to every reading.

    Raises:
        ModelError: the model cannot be fitted to the wrench as given.
    """
    spread = np.linspace(0, len(samples) - 1, min(len(samples), MOST_SAMPLES))
    samples = samples.take(np.unique(spread.astype(np.int64)))
    given, *others = readings(samples, robot)
    as_given = squared_residuals(samples, robot, model, given.wrench)
    squares = np.stack([_squares_or_none(samples, robot, model, each.wrench) for each in others])
    total = squares.sum(axis=1)
    best, *ties = np.flatnonzero(total <= AS_GOOD * total.min())  # of these the likeliest first
    if not _much_better(squares[best], as_given, samples):
        return None
    return BetterReading(
        name=others[best].name,
        ties=(*others[best].same, *(others[i].name for i in ties)),
        rms=float(np.sqrt(squares[best].mean())),
        rms_as_given=float(np.sqrt(as_given.mean())),
    )


def squared_residuals(
    samples: Samples, robot: Robot, model: StiffnessModel, wrench: FloatArray
) -> FloatArray:
    """Return (n,) the squared length [m2] of each residual of the model fitted to `wrench`.

    Raises:
        ModelError: the model cannot be fitted.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # identifiability is reported apart
        predicted = model.fit(replace(samples, wrench=wrench), robot=robot).predict(
            samples.q, wrench
        )
    return np.asarray(((samples.deflection - predicted) ** 2).sum(axis=1))


def _squares_or_none(
    samples: Samples, robot: Robot, model: StiffnessModel, wrench: FloatArray
) -> FloatArray:
    try:
        return squared_residuals(samples, robot, model, wrench)
    except ModelError:  # explains nothing
        return np.full(len(samples), np.inf)


def _much_better(squares: FloatArray, as_given: FloatArray, samples: Samples) -> bool:
    if not squares.sum() < FEWER_SQUARES * as_given.sum():
        return False
    _, pose = np.unique(samples.pose_id, return_inverse=True)
    gain = np.bincount(pose, as_given - squares)  # (n_poses,)
    return len(gain) > 1 and bool(gain.sum() > CLEARLY * np.sqrt(len(gain)) * gain.std(ddof=1))


def readings(samples: Samples, robot: Robot) -> list[Reading]:
    """Return the wrench as given and every other reading of it, the likeliest first.

    The force may stand in axes that are any of the 48 signed permutations of the base's: 24
    rotations and 24 reflections R. The torque then is R t, as where columns of the file are
    swapped or flipped, or det(R) R t, the law of a torque between a left-handed and a right-handed
    frame. The wrench may also be expressed in the tool's frame, or its torque be taken about the
    flange. Readings that give the same wrench on all of these samples stand as one.
    """
    same: dict[bytes, list[Reading]] = {}
    for reading in _all_readings(samples, robot):
        key = (reading.wrench + 0.0).tobytes()  # minus zero is zero
        same.setdefault(key, []).append(reading)
    return [
        Reading(first.name, first.wrench, tuple(other.name for other in others))
        for first, *others in same.values()
    ]


def _all_readings(samples: Samples, robot: Robot) -> Iterator[Reading]:
    given = samples.wrench
    has_torque = bool(given[:, 3:].any())
    axes = [(matrix, _words(matrix)) for matrix in _signed_permutations()]
    for matrix, words in axes:
        yield Reading(f"the wrench{words}", _turned(given, matrix))
    about_flange = ", its torque taken about the flange (the last joint) instead of the TCP"
    tool = robot.forward(samples.q).rotation
    lever = tool @ robot.tcp  # (n, 3) last joint to TCP, base frame
    for matrix, words in axes:
        in_tool = _turned(given, tool @ matrix)
        yield Reading(f"the wrench expressed in the tool frame{words}", in_tool)
        if has_torque:
            moved = _moved(in_tool, lever)
            yield Reading(f"the wrench expressed in the tool frame{words}{about_flange}", moved)
    if not has_torque:
        return
    yield Reading(f"the wrench{about_flange}", _moved(given, lever))
    yield Reading("the wrench with the sign of its torque flipped", given * _FLIPPED_TORQUE)
    for matrix, words in axes:
        if np.linalg.det(matrix) < 0.0:
            name = f"the wrench in a left-handed frame{words}"
            yield Reading(name, _turned(given, matrix) * _FLIPPED_TORQUE)


def _signed_permutations() -> list[FloatArray]:
    """Return the 48 (3, 3) signed permutations: identity, flip of all, then the least change."""
    found = [
        np.diag(signs)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return sorted(found, key=lambda matrix: (abs(np.trace(matrix)) < 3.0, -np.trace(matrix)))


def _words(matrix: FloatArray) -> str:
    """Say in words what a signed permutation makes of the axes of a file."""
    diagonal, proper = np.diag(matrix), np.linalg.det(matrix) > 0.0
    if (diagonal == 1.0).all():
        return ""
    if (diagonal == -1.0).all():
        return " with its sign flipped (the reaction? or the deflection, unloaded minus loaded?)"
    if diagonal.all() and proper:
        axis = int(np.argmax(diagonal))
        return f" turned by 180 deg about {AXES[axis]}" + ("" if axis == 2 else " (z down?)")
    if diagonal.all():
        axis = int(np.argmin(diagonal))
        return f" with the sign of {AXES[axis]} flipped" + (" (z down?)" if axis == 2 else "")
    if proper and diagonal.sum() == 1.0:
        axis = int(np.argmax(diagonal))
        sine = matrix[(axis + 2) % 3, (axis + 1) % 3]
        return f" turned by {90 * sine:+.0f} deg about {AXES[axis]}"
    if not proper and (matrix >= 0.0).all():
        first, second = (name for name, kept in zip(AXES, diagonal, strict=True) if not kept)
        return f" with {first} and {second} swapped"
    sources = np.abs(matrix).argmax(axis=1)
    signs = ("-" if row.sum() < 0.0 else "" for row in matrix)
    read = ", ".join(sign + AXES[source] for sign, source in zip(signs, sources, strict=True))
    return f" with x, y, z read from its columns {read}"


def _turned(wrench: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return (n, 6) force and torque turned by (3, 3) or (n, 3, 3)."""
    return np.hstack(
        [(rotation @ part[:, :, None])[:, :, 0] for part in (wrench[:, :3], wrench[:, 3:])]
    )


def _moved(wrench: FloatArray, lever: FloatArray) -> FloatArray:
    """Return (n, 6) the wrench at the TCP of one at the flange; lever (n, 3): flange to TCP, m."""
    return np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(lever, wrench[:, :3])])
