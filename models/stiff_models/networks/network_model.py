"""What all network families share: options, feature encoding, prediction."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from annotated_types import Ge, Le

from stiff_models.base import FittedModel
from stiff_models.device import RunsOnDevice, torch_device
from stiff_models.networks.cache import Trained, remembered, training_digest
from stiff_models.networks.features import AngleEncoding, Scaler, encode
from stiff_models.networks.network import Activation, ChosenActivation, build_network
from stiff_models.networks.torch_parts import EncodedNetwork
from stiff_models.networks.training import Objective, Rows, train_network
from stiff_models.networks.training_plan import Trainable, TrainingPlan
from stiff_protocols.contract.types import FloatArray, Robot, Samples

Layers = Annotated[int, Ge(1), Le(20)]
Width = Annotated[int, Ge(1), Le(4096)]

PREDICTED_AT_ONCE = 1024  # rows: what the layers pass on stays in the processor's cache


@dataclass(kw_only=True, eq=False, repr=False)
class EncodedNetworkModel(RunsOnDevice, FittedModel):
    """Base of the families with one network on encoded, standardised samples.

    Attributes:
        angle_encoding: "sincos" (sine and cosine of each angle) or "raw" (the angle).
    """

    angle_encoding: AngleEncoding = "sincos"

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        inputs = self._inputs(q, wrench)
        with torch.no_grad():
            outputs = [self.network_(part) for part in torch.split(inputs, PREDICTED_AT_ONCE)]
        return self.output_scaler_.undo(torch.cat(outputs).cpu().double().numpy())

    def _start(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray, seed: int
    ) -> None:
        """Take the statistics of the first training data and draw a new network."""
        self.robot_ = robot
        self.input_scaler_ = Scaler.of(encode(robot, q, wrench, self.angle_encoding))
        self.output_scaler_ = Scaler.of_deflection(deflection)
        self.network_ = self._new_network(seed).to(torch_device(self.device)).eval()

    @abstractmethod
    def _new_network(self, seed: int) -> torch.nn.Module:
        """Return an untrained network; the scalers say how many inputs it has."""

    def _torch_module(self) -> torch.nn.Module:
        """The fitted prediction as a module, for export; see `onnx_export`."""
        return EncodedNetwork(
            self.robot_,
            self.network_,
            angle_encoding=self.angle_encoding,
            input_scaler=self.input_scaler_,
            output_scaler=self.output_scaler_,
        )

    def _empty_module(self, name: str) -> torch.nn.Module:
        return self._new_network(seed=0)

    def _train_remembered(
        self,
        rows: Rows,
        plan: TrainingPlan,
        seed: int,
        phase: str,
        *,
        trainable: Trainable | None = None,
        objective: Objective | None = None,
        judge: Callable[[], FloatArray] = lambda: np.empty(0),
        extra: Iterable[torch.Tensor] = (),
        about: str = "",
    ) -> Trained:
        """Train the network in place, or put in the weights of the same training done before.

        `judge` measures the trained network once: the outcome is kept with the weights. `extra`
        (tensors) and `about` say what `objective` and `judge` are made of; the other arguments are
        those of `train_network`.
        """

        def compute() -> Trained:
            start = time.perf_counter()
            curve = train_network(
                self.network_,
                rows,
                plan,
                seed=seed,
                phase=phase,
                trainable=trainable,
                objective=objective,
            )
            weights = {
                name: tensor.cpu().numpy() for name, tensor in self.network_.state_dict().items()
            }
            seconds = time.perf_counter() - start
            return Trained(weights, curve, seconds, judge())

        if plan.steps == 0:
            return compute()
        actors = [thing for thing in (self, objective) if thing is not None]
        digest = training_digest(
            self.network_, rows, plan, seed, actors=actors, extra=extra, about=about
        )
        trained = remembered(digest, compute)
        self.network_.load_state_dict(
            {name: torch.from_numpy(array.copy()) for name, array in trained.weights.items()}
        )
        return trained

    def _inputs(self, q: FloatArray, wrench: FloatArray) -> torch.Tensor:
        """Return what the network is given for each sample, (n, n_inputs) on the device."""
        features = self.input_scaler_.apply(encode(self.robot_, q, wrench, self.angle_encoding))
        return torch.as_tensor(features, dtype=torch.float32, device=torch_device(self.device))

    def _rows(self, q: FloatArray, wrench: FloatArray, deflection: FloatArray) -> Rows:
        inputs = self._inputs(q, wrench)
        targets = self.output_scaler_.apply(deflection)
        return Rows(inputs, torch.as_tensor(targets, dtype=torch.float32, device=inputs.device))

    def _measured_rows(self, samples: Samples) -> Rows:
        return self._rows(samples.q, samples.wrench, samples.deflection)


@dataclass(kw_only=True, eq=False, repr=False)
class NetworkModel(EncodedNetworkModel):
    """Base of the families with the fully connected network.

    Attributes:
        layers: hidden layers.
        width: nodes per hidden layer.
        activation: of the hidden layers; "auto" is "relu", unless the recipe has another.
    """

    layers: Layers = 4
    width: Width = 380
    activation: ChosenActivation = "auto"

    @property
    def hidden_activation(self) -> Activation:
        """The activation that the network gets."""
        return "relu" if self.activation == "auto" else self.activation

    def _new_network(self, seed: int) -> torch.nn.Module:
        return build_network(
            len(self.input_scaler_.mean),
            layers=self.layers,
            width=self.width,
            activation=self.hidden_activation,
            seed=seed,
        )
