"""Hazards: faulty or unusual samples, as laboratories and converters produce them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from helpers.made_robots import random_chain
from helpers.made_samples import samples_with
from stiff_protocols.contract.types import FloatArray, JointType, Robot, Samples


@dataclass(frozen=True, eq=False)
class Case:
    """Samples for a fit and for its predictions."""

    robot: Robot
    train: Samples
    validation: Samples | None
    test: Samples


Hazard = Callable[[Case], Case]


def in_all_parts(change: Callable[[Samples], Samples]) -> Hazard:
    """Return a hazard that changes training, validation and test samples alike."""

    def changed(case: Case) -> Case:
        validation = None if case.validation is None else change(case.validation)
        return Case(case.robot, change(case.train), validation, change(case.test))

    return changed


def wrist_singular(samples: Samples) -> Samples:
    """Set A5 to zero, so that A4 and A6 turn about one line."""
    q = samples.q.copy()
    q[:, 4] = 0.0
    return replace(samples, q=q)


def _as_the_first(*names: str) -> Hazard:
    """Return a hazard that gives every row the values of the first training row."""

    def changed(case: Case) -> Case:
        first = {name: getattr(case.train, name)[:1] for name in names}
        return in_all_parts(
            lambda s: replace(s, **{n: np.repeat(row, len(s), axis=0) for n, row in first.items()})
        )(case)

    return changed


def _few(n_train: int, n_validation: int | None) -> Hazard:
    def changed(case: Case) -> Case:
        assert case.validation is not None
        held_out = None if n_validation is None else case.validation.take(np.arange(n_validation))
        return Case(case.robot, case.train.take(np.arange(n_train)), held_out, case.test)

    return changed


def _times(name: str, factor: float | FloatArray) -> Hazard:
    return in_all_parts(lambda s: replace(s, **{name: getattr(s, name) * factor}))


def _contradicted(samples: Samples) -> Samples:
    repeated = samples.take(np.repeat(np.arange(len(samples)), 3))
    sign = np.tile([1.0, -1.0, 1.0], len(samples))
    return replace(repeated, deflection=repeated.deflection * sign[:, None])


def _float32(samples: Samples) -> Samples:
    """Return samples in single precision, in columns, read-only."""
    arrays = {name: getattr(samples, name) for name in ("q", "wrench", "deflection")}
    made = {name: np.asfortranarray(array, dtype=np.float32) for name, array in arrays.items()}
    for array in made.values():
        array.flags.writeable = False
    return replace(samples, **made)


def _robot_of(kinds: tuple[JointType, ...]) -> Hazard:
    def changed(case: Case) -> Case:
        rng = np.random.default_rng(0)
        robot = random_chain(rng, kinds)

        def drawn(n: int) -> Samples:
            q = rng.uniform(-1.0, 1.0, (n, len(kinds)))
            wrench = rng.normal(size=(n, 6)) * 50.0
            deflection = robot.joint_deflection(np.full(len(kinds), 1e-5), q, wrench)
            return samples_with(q, wrench, deflection)

        return Case(robot, drawn(30), drawn(10), drawn(20))

    return changed


HAZARDS: dict[str, Hazard] = {
    "wrist singular": in_all_parts(wrist_singular),
    "1 row": _few(1, None),
    "1 row, 1 validation": _few(1, 1),
    "2 rows": _few(2, None),
    "5 rows": _few(5, 2),
    "one pose": _as_the_first("q", "pose_id"),
    "one load": _as_the_first("wrench"),
    "no load": _times("wrench", 0.0),
    "force only along z": _times("wrench", np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])),
    "no deflection": _times("deflection", 0.0),
    "deflection only along z": _times("deflection", np.array([0.0, 0.0, 1.0])),
    "wrenches of wrong sign": _times("wrench", -1.0),
    "loads x 1e6": _times("wrench", 1e6),
    "loads x 1e-6": _times("wrench", 1e-6),
    "deflections x 1e6": _times("deflection", 1e6),
    "rows contradict": in_all_parts(_contradicted),
    "float32": in_all_parts(_float32),
    "slides and turns": _robot_of(("prismatic", "revolute", "revolute", "prismatic")),
    "slides only": _robot_of(("prismatic",) * 3),
    "7 joints": _robot_of(("revolute",) * 7),
}
