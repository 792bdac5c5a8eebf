"""Check splits of any protocol before a model is fitted to them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import numpy as np

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot, Split

DECIMALS = 9
"""Of sines and cosines, and of m: a file in degrees rounds angles by 1e-15."""


def named(split: Split) -> str:
    """Return condition and number of a split as readable text."""
    return " | ".join(filter(None, (split.condition, f"split {split.index}")))


def first_fault(
    splits: Iterable[Split],
    n_samples: int,
    *,
    selects_on_test: bool,
    reports_training: bool = False,
) -> str:
    """Return the first fault of a protocol's splits; "" if there is none.

    Args:
        splits: splits, read once.
        n_samples: number of samples that they divide.
        selects_on_test: the protocol declares that the validation rows are test rows.
        reports_training: the protocol declares that it also reports other rows than test rows.
    """
    numbers: dict[str, list[int]] = {}
    for split in splits:
        faults = itertools.chain(
            _faults_of_rows(split, n_samples), _leaks(split, selects_on_test, reports_training)
        )
        if fault := next(faults, ""):
            return f"{named(split)} {fault}"
        numbers.setdefault(split.condition, []).append(split.index)
    for condition, indices in numbers.items():
        if sorted(indices) != list(range(len(indices))):
            return f"condition {condition!r} has splits of index {indices}"
    return "" if numbers else "made no split of these samples"


def _faults_of_rows(split: Split, n_samples: int) -> Iterator[str]:
    """Yield faults of a split's row numbers and of its sensor errors.

    Negative numbers would count rows from the end.
    """
    parts = {
        **{"training": split.train, "validation": split.validation, "test": split.test},
        "also reported": split.also_reported,
    }
    for name, rows in parts.items():
        if not isinstance(rows, np.ndarray) or rows.ndim != 1 or rows.dtype.kind not in "iu":
            yield f"has {name} rows that are not a one-dimensional integer array"
        if name in ("training", "test") and not len(rows):
            yield f"has no {name} rows"
        if len(rows) and (rows.min() < 0 or rows.max() >= n_samples):
            yield f"has {name} rows outside 0..{n_samples - 1}"
        if len(np.unique(rows)) < len(rows):
            yield f"has {name} rows that occur twice"
    if len(twice := np.intersect1d(split.test, split.also_reported)):
        yield f"has {len(twice)} test rows among the also reported ones"
    error, error_shape = split.wrench_error, (len(split.reported), 6)
    if error is not None and (np.shape(error) != error_shape or not np.isfinite(error).all()):
        yield (
            f"has sensor errors of shape {np.shape(error)} for {error_shape[0]} test rows, or some "
            "that are not finite"
        )


def _leaks(split: Split, selects_on_test: bool, reports_training: bool) -> Iterator[str]:
    """Yield leaks: rows for training and test that the protocol does not declare."""
    learned = np.intersect1d(split.train, np.concatenate([split.validation, split.test]))
    if len(learned):
        yield f"trains on {len(learned)} rows of its other parts"
    chosen_on = np.intersect1d(split.validation, split.test)
    if len(chosen_on) and not selects_on_test:
        yield (
            f"has {len(chosen_on)} test rows that choose an epoch, and the protocol does not "
            "declare selects_on_test"
        )
    if len(split.also_reported) and not reports_training:
        yield (
            f"reports {len(split.also_reported)} rows that are not test rows, and the protocol "
            "does not declare reports_training"
        )


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
    held = {row.tobytes() for row in _numbers(source)}
    common = sum(row.tobytes() in held for row in _numbers(target))
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


def pose_numbers(q: FloatArray, robot: Robot) -> FloatArray:
    """Return (n, .) numbers of poses `q` (n, n_joints), rad or m, the same for whole turns."""
    angles, slides = q[:, robot.turns], q[:, ~robot.turns]
    poses = np.hstack([np.sin(angles), np.cos(angles), slides])
    return np.asarray(poses.round(DECIMALS) + 0.0)  # -0.0 is 0.0


def _numbers(data: BenchmarkData) -> FloatArray:
    """Return (n, .) poses, loads and deflections."""
    samples = data.samples
    loads = np.hstack([samples.wrench, samples.deflection]) + 0.0
    return np.hstack([pose_numbers(samples.q, data.robot), loads])
