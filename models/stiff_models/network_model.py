"""What all network families share: options, feature encoding, prediction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from annotated_types import Ge, Le
from sklearn.base import BaseEstimator

from stiff_models.features import AngleEncoding, Scaler, encode
from stiff_models.networks import Activation, Device, build_network, torch_device
from stiff_models.training import Rows
from stiff_protocols.errors import ModelError, NotFittedError
from stiff_protocols.types import FloatArray, Robot, Samples

Layers = Annotated[int, Ge(1), Le(20)]
Width = Annotated[int, Ge(1), Le(4096)]


@dataclass(kw_only=True, eq=False, repr=False)
class NetworkModel(BaseEstimator):  # type: ignore[misc]
    """Base of the network families; the options are the constructor's keywords.

    Attributes:
        layers: hidden layers.
        width: nodes a hidden layer.
        activation: of the hidden layers.
        angle_encoding: "sincos" (sine and cosine of each angle) or "raw" (the angle).
        device: where the network runs.
    """

    layers: Layers = 4
    width: Width = 380
    activation: Activation = "relu"
    angle_encoding: AngleEncoding = "sincos"
    device: Device = "auto"

    def check_params(self) -> None:
        """Check what a single option's type cannot.

        Raises:
            ConfigError: the device is not there.
        """
        torch_device(self.device)

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection, m, base frame.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: `q` has another number of joints than the robot fitted for.
        """
        if not hasattr(self, "network_"):
            raise NotFittedError(f"{type(self).__name__}: call fit before predict")
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != self.robot_.n_joints:
            raise ModelError(f"q has shape {q.shape}, expected (n, {self.robot_.n_joints})")
        return self._network_deflection(self.network_, q, wrench)

    def _network_deflection(
        self, network: torch.nn.Sequential, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        inputs = self._inputs(q, wrench)
        with torch.no_grad():
            outputs = [network(part) for part in torch.split(inputs, 8192)]
        standardised = torch.cat(outputs).cpu().numpy().astype(np.float64)
        return self.output_scaler_.undo(standardised)

    def _start(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray, seed: int
    ) -> None:
        """Take the statistics of the first training data and draw a new network."""
        self.robot_ = robot
        features = encode(robot, q, wrench, self.angle_encoding)
        self.input_scaler_ = Scaler.of(features)
        self.output_scaler_ = Scaler.of(deflection)
        self.network_ = build_network(
            features.shape[1],
            layers=self.layers,
            width=self.width,
            activation=self.activation,
            seed=seed,
        ).to(torch_device(self.device))

    def _inputs(self, q: FloatArray, wrench: FloatArray) -> torch.Tensor:
        features = self.input_scaler_.apply(encode(self.robot_, q, wrench, self.angle_encoding))
        return torch.as_tensor(features, dtype=torch.float32, device=torch_device(self.device))

    def _rows(self, q: FloatArray, wrench: FloatArray, deflection: FloatArray) -> Rows:
        """Return standardised rows on the device."""
        inputs = self._inputs(q, wrench)
        targets = self.output_scaler_.apply(deflection)
        return Rows(inputs, torch.as_tensor(targets, dtype=torch.float32, device=inputs.device))

    def _measured_rows(self, samples: Samples) -> Rows:
        return self._rows(samples.q, samples.wrench, samples.deflection)
