"""Fits of a search: to parts of the training side, scored on the others, and to all of it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import fields

import numpy as np

from stiff_protocols.contract import ChoosesEpoch, StiffnessModel
from stiff_protocols.sanity import check_prediction
from stiff_protocols.types import Robot, Samples, Split


def inner_error(
    make: Callable[[], StiffnessModel],
    rows: Samples,
    parts: Sequence[Split],
    *,
    robot: Robot,
    validates: bool,
    seed: int,
) -> float:
    """Return the mean Euclidean error over the rows of all test parts, m.

    Args:
        make: returns a new model.
        rows: the training side.
        parts: of `rows`.
        robot: that was measured.
        validates: the parts' validation rows may choose the epoch; else they are training rows.
        seed: of every fit.

    Raises:
        ModelError: what the model returns is no prediction; what a fit raises passes through.
    """
    distances = []
    for part in parts:
        model = make()
        train, validation = rows.take(part.train), rows.take(part.validation)
        test = rows.take(part.test)
        with warnings.catch_warnings():  # those of the last fit are the ones to read
            warnings.simplefilter("ignore")
            if validates:
                fit_to(model, train, validation, robot=robot, seed=seed)
            else:
                fit_to(model, together(train, validation), None, robot=robot, seed=seed)
            predicted = np.asarray(model.predict(test.q, test.wrench))
        check_prediction(predicted, len(test))
        distances.append(np.linalg.norm(predicted - test.deflection, axis=1))
    return float(np.concatenate(distances).mean())


def fit_to(
    model: StiffnessModel,
    train: Samples,
    validation: Samples | None,
    *,
    robot: Robot,
    seed: int,
) -> None:
    """Fit; a model that chooses no epoch learns from the validation rows instead."""
    if validation is not None and not (len(validation) and chooses_epoch(model)):
        train, validation = together(train, validation), None
    model.fit(train, robot=robot, validation=validation, seed=seed)


def chooses_epoch(model: StiffnessModel) -> bool:
    """Return whether a model that is given validation rows chooses its epoch by them."""
    return model.chooses_epoch() if isinstance(model, ChoosesEpoch) else True


def together(first: Samples, second: Samples) -> Samples:
    """Return the rows of both."""
    return Samples(
        **{
            item.name: np.concatenate([getattr(first, item.name), getattr(second, item.name)])
            for item in fields(Samples)
        }
    )
