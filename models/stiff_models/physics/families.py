"""The virtual joint models by name: what others build on."""

from __future__ import annotations

from typing import Any, Literal

from stiff_models.base import FittedModel
from stiff_models.physics.full_vjm import FullVjm
from stiff_models.physics.multi_segment_vjm import MultiSegmentVjm
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.types import Robot, Samples

Physics = Literal["vjm", "vjm-multisegment", "vjm-full"]

_FAMILIES: dict[Physics, Any] = {
    "vjm": VirtualJointModel,
    "vjm-multisegment": MultiSegmentVjm,
    "vjm-full": FullVjm,
}


def fitted_physics(name: Physics, samples: Samples, robot: Robot) -> FittedModel:
    """Return the model with its default options, identified on the samples; errors as of `fit`."""
    fitted: FittedModel = _FAMILIES[name]().fit(samples, robot=robot)
    return fitted
