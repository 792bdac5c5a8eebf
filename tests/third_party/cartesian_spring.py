"""Provide a model with one Cartesian compliance: deflection = C wrench, C (3, 6)."""

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from stiff_protocols.contract.plugin import ModelInfo


class CartesianSpring(BaseEstimator):
    """Fit the compliance of the hand by least squares.

    Attributes:
        torques: true if torques move the TCP too, false if only forces do.
    """

    def __init__(self, *, torques: bool = True):
        self.torques = torques

    def fit(self, train, *, robot, validation=None, seed=0):
        self.n_joints_ = robot.n_joints
        self.compliance_ = np.linalg.lstsq(self._loads(train.wrench), train.deflection)[0]
        return self

    def predict(self, q, wrench):
        check_is_fitted(self)
        if q.shape[1] != self.n_joints_:
            raise ValueError(f"{q.shape[1]} joint angles, fitted to {self.n_joints_}")
        return self._loads(wrench) @ self.compliance_

    def _loads(self, wrench):
        return wrench if self.torques else wrench[:, :3]


MODELS = [
    ModelInfo(
        key="cartesian-spring",
        target="cartesian_spring:CartesianSpring",
        summary="one Cartesian compliance for every pose",
    )
]
TAKEN = [
    ModelInfo(key="vjm", target="cartesian_spring:CartesianSpring", summary="a key that is ours"),
    ModelInfo(
        key="force-spring", target="cartesian_spring:CartesianSpring", summary="next to a taken key"
    ),
]
