"""A model fitted to a whole data set, as `bench fit` does: nothing is kept back for a test."""

from __future__ import annotations

from typing import Any

import numpy as np

from stiff_bench.plan.cells import uses_validation
from stiff_bench.plan.options import Choice
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.interfaces import ChecksRobot
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import Robot, Samples
from stiff_protocols.splits.generators import inner_validation

VALIDATION_FRACTION = 0.2
"""Of the poses, where a model chooses its epoch; as the protocols' default."""


def whole_fit(
    choice: Choice[ModelInfo], samples: Samples, robot: Robot, *, seed: int = 0
) -> tuple[Any, str]:
    """Return a new fitted model, and how its number of epochs was chosen ("": there is no choice).

    Raises:
        ConfigError: the model cannot be used here, or not for this robot.
        ModelError: the samples cannot be fitted.
    """
    if why := choice.missing():
        raise ConfigError(f"{choice.name!r} cannot be used here: {why}")
    model = choice.make()
    if isinstance(model, ChecksRobot):
        model.check_robot(robot)
    train, validation, note = samples, None, ""
    if uses_validation(choice.info, model):
        split = inner_validation(samples, np.arange(len(samples)), VALIDATION_FRACTION, seed)
        if len(split.validation):
            train, validation = samples.take(split.train), samples.take(split.validation)
            note = (
                f"{len(validation)} samples of {len(set(validation.pose_id))} poses chose the "
                f"number of epochs; {len(train)} samples were learned from"
            )
        else:
            note = "one pose gives no rows to choose the epoch by: the last one was kept"
    model.fit(train, robot=robot, validation=validation, seed=seed)
    for name, value in (("robot_", robot), ("training_range_", TrainingRange.of(train))):
        if not hasattr(model, name):  # a plugin's model need not have them
            setattr(model, name, value)
    return model, note
