"""What a split must be before a model is fitted to it, whoever wrote the protocol."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot, Samples, Split


def named(split: Split) -> str:
    """Return condition and number of a split for people."""
    return " | ".join(filter(None, (split.condition, f"split {split.index}")))


def fault_of_rows(split: Split, n_samples: int) -> str:
    """Return what is wrong with the row numbers of a split; "" for nothing.

    Negative numbers would count rows from the end, and pass for rows that they are not.
    """
    parts = {
        **{"training": split.train, "validation": split.validation, "test": split.test},
        "also reported": split.also_reported,
    }
    for name, rows in parts.items():
        array = np.asarray(rows)
        if not isinstance(rows, np.ndarray) or array.ndim != 1 or array.dtype.kind not in "iu":
            return f"has {name} rows that are no one-dimensional integer array"
        if name in ("training", "test") and not len(array):
            return f"has no {name} rows"
        if len(array) and (array.min() < 0 or array.max() >= n_samples):
            return f"has {name} rows outside 0..{n_samples - 1}"
        if len(np.unique(array)) < len(array):
            return f"has {name} rows that occur twice"
    twice = np.intersect1d(split.test, split.also_reported)
    return f"has {len(twice)} test rows among the also reported ones" if len(twice) else ""


def leak_of(split: Split, *, selects_on_test: bool, reports_training: bool = False) -> str:
    """Return how rows of a split are learned from and tested; "" where none is.

    Args:
        split: to look at.
        selects_on_test: the protocol says that the validation rows are test rows.
        reports_training: the protocol says that rows beside the test rows are reported.
    """
    learned = np.intersect1d(split.train, np.concatenate([split.validation, split.test]))
    if len(learned):
        return f"trains on {len(learned)} rows of its other parts"
    chosen_on = np.intersect1d(split.validation, split.test)
    if len(chosen_on) and not selects_on_test:
        return (
            f"has {len(chosen_on)} test rows that choose an epoch, and the protocol does not "
            "declare selects_on_test"
        )
    if len(split.also_reported) and not reports_training:
        return (
            f"reports {len(split.also_reported)} rows that are no test rows, and the protocol does "
            "not declare reports_training"
        )
    return ""


def fault_of_sensor_errors(split: Split) -> str:
    """Return what is wrong with a split's sensor errors; "" for nothing."""
    if split.wrench_error is None:
        return ""
    error = np.asarray(split.wrench_error)
    n_rows = len(split.reported)
    if error.shape != (n_rows, 6) or not np.isfinite(error).all():
        return (
            f"has sensor errors of shape {error.shape} for {n_rows} test rows, or some "
            "that are not finite"
        )
    return ""


def fault_of_numbers(numbers: Iterable[tuple[str, int]]) -> str:
    """Return which of these conditions' splits are not numbered 0, 1, 2, ...; "" for none."""
    indices: dict[str, list[int]] = {}
    for condition, index in numbers:
        indices.setdefault(condition, []).append(index)
    for condition, found in indices.items():
        if sorted(found) != list(range(len(found))):
            return f"condition {condition!r} has splits of index {found}"
    return ""


def first_fault(
    splits: Iterable[Split],
    n_samples: int,
    *,
    selects_on_test: bool,
    reports_training: bool = False,
) -> str:
    """Return the first fault of a protocol's splits; "" where there is none.

    The splits are looked at once, one by one.
    """
    numbers = []
    for split in splits:
        fault = (
            fault_of_rows(split, n_samples)
            or leak_of(split, selects_on_test=selects_on_test, reports_training=reports_training)
            or fault_of_sensor_errors(split)
        )
        if fault:
            return f"{named(split)} {fault}"
        numbers.append((split.condition, split.index))
    return fault_of_numbers(numbers) if numbers else "made no split of these samples"


def check_source(word: str, source: BenchmarkData, dataset: str, target: BenchmarkData) -> None:
    """Check that a source fits a target and holds none of its samples.

    All samples of the source, which `word` names, identify the VJM that makes the source domain;
    on the target, `dataset`, models are fine-tuned and tested.

    Raises:
        ConfigError: the joints are others, or samples are the target's.
    """
    if source.robot.joint_types != target.robot.joint_types:
        raise ConfigError(
            f"source {word!r}: robot {source.robot.name!r} has {_joints(source.robot)}, robot "
            f"{target.robot.name!r} of {dataset!r} has {_joints(target.robot)} (valid: a robot "
            "with the same joints, base to tip)"
        )
    held = {row.tobytes() for row in _numbers(source.samples)}
    common = sum(row.tobytes() in held for row in _numbers(target.samples))
    if common:
        raise ConfigError(
            f"source {word!r} holds {common} of the {len(target.samples)} samples of its target "
            f"{dataset!r}, whose test part no source may hold (valid: samples of another robot or "
            "another specimen)"
        )


def _joints(robot: Robot) -> str:
    types = robot.joint_types
    of = types[0] if len(set(types)) == 1 else ", ".join(types)
    return f"{robot.n_joints} joints ({of})"


def _numbers(samples: Samples) -> FloatArray:
    """Return (n, .) poses, loads and deflections; adding 0.0 makes -0.0 and 0.0 one number."""
    return np.hstack([samples.q, samples.wrench, samples.deflection]) + 0.0
