"""Whether another robot's or specimen's samples can be the source of a target's models."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from stiff_protocols.errors import ConfigError
from stiff_protocols.types import BenchmarkData, FloatArray, Robot, Samples, Split


def check_source(word: str, source: BenchmarkData, dataset: str, target: BenchmarkData) -> None:
    """See that a source fits a target and holds none of its samples.

    Args:
        word: names the source.
        source: whose VJM makes the source domain, identified on all of its samples.
        dataset: names the target.
        target: what models are fine-tuned and tested on.

    Raises:
        ConfigError: the joints are others, or samples are the target's: these are tested.
    """
    if source.robot.joint_types != target.robot.joint_types:
        raise ConfigError(
            f"source {word!r}: robot {source.robot.name!r} has {_joints(source.robot)}, robot "
            f"{target.robot.name!r} of {dataset!r} has {_joints(target.robot)} (valid: a robot "
            "with the same joints, base to tip)"
        )
    common = _common(source.samples, target.samples)
    if common:
        raise ConfigError(
            f"source {word!r} holds {common} of the {len(target.samples)} samples of its target "
            f"{dataset!r}, whose test part no source may hold (valid: samples of another robot or "
            "another specimen)"
        )


def check_named(splits: Sequence[Split], sources: Collection[str], protocol: str) -> None:
    """See that a protocol's splits name no source that it did not announce.

    Raises:
        ConfigError: one does.
    """
    unknown = {split.source for split in splits} - {"", *sources}
    if unknown:
        raise ConfigError(
            f"protocol {protocol!r}: a split's source is {min(unknown)!r}, which its "
            f"source_datasets does not return (valid: {', '.join(sources) or 'none'})"
        )


def _joints(robot: Robot) -> str:
    types = robot.joint_types
    of = types[0] if len(set(types)) == 1 else ", ".join(types)
    return f"{robot.n_joints} joints ({of})"


def _common(source: Samples, target: Samples) -> int:
    """Return how many of the target's samples the source holds: same pose, load and deflection."""
    held = {row.tobytes() for row in _numbers(source)}
    return sum(row.tobytes() in held for row in _numbers(target))


def _numbers(samples: Samples) -> FloatArray:
    # adding 0.0 makes -0.0 and 0.0 one number
    return np.hstack([samples.q, samples.wrench, samples.deflection]) + 0.0
