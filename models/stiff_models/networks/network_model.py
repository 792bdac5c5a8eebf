"""Base classes of all network families: options, prediction and number of epochs.

The number of epochs is chosen by cross-validation inside the training samples.
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np
import torch
from annotated_types import Ge, Le

from stiff_models.device import RunsOnDevice, torch_device
from stiff_models.networks.encoded_model import EncodedModel, Scaler
from stiff_models.networks.fully_connected import Activation, ChosenActivation, build_network
from stiff_models.networks.onnx_export import EncodedNetwork
from stiff_models.networks.training import Curve, Rows, TrainingPlan, Visits, train_network
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples

Layers = Annotated[int, Ge(1), Le(20)]
Width = Annotated[int, Ge(1), Le(4096)]

Selection = Literal["cv", "best", "normal"]
"""Choice of the number of epochs: by cross-validation, by the validation rows, or fixed."""

LENGTHS = (0, 10, 30, 100, 400)
"""Numbers of epochs to choose from."""
FOLDS = 5

HeldOutErrors = Callable[[IntArray, IntArray], FloatArray]
"""Trains on the first rows; returns (n_lengths, n) errors of the second rows by length."""


def lengths_up_to(longest: int) -> tuple[int, ...]:
    """Return the numbers of epochs to choose from, up to the longest training."""
    return (*(length for length in LENGTHS if length < longest), longest)


def chosen_epochs(
    samples: Samples, lengths: tuple[int, ...], errors_of: HeldOutErrors, seed: int
) -> int:
    """Return the fewest epochs whose error is at most a standard error above the least.

    The error is the mean over the poses, in `FOLDS`-fold cross-validation by pose. The standard
    error belongs to the difference from the best length, pose by pose (the one-standard-error rule
    of Breiman et al. 1984, on paired differences). A single pose cannot be divided and gets the
    longest training.
    """
    poses, pose_of_row = np.unique(samples.pose_id, return_inverse=True)
    if len(poses) < 2:
        return lengths[-1]
    fold_of_pose = np.random.default_rng(seed).permutation(len(poses)) % FOLDS
    fold_of_row = fold_of_pose[pose_of_row]
    errors = np.empty((len(lengths), len(samples)))
    for fold in np.unique(fold_of_pose):
        held_out = fold_of_row == fold
        errors[:, held_out] = errors_of(np.flatnonzero(~held_out), np.flatnonzero(held_out))
    rows_a_pose = np.bincount(pose_of_row)
    of_poses = np.stack([np.bincount(pose_of_row, row) / rows_a_pose for row in errors])
    best = of_poses[of_poses.mean(axis=1).argmin()]
    for length, error in zip(lengths, of_poses, strict=True):
        more = error - best
        if more.mean() <= more.std(ddof=1) / np.sqrt(len(poses)):
            return length
    return lengths[-1]  # not reached: the best is within


@dataclass(kw_only=True, eq=False, repr=False)
class ChoosesEpochs:
    """Mixin of the families that learn from measured samples for a number of epochs.

    Attributes:
        training: "cv" chooses the number of epochs (0, 10, 30, 100, 400, or the longest) by
            cross-validation and trains on all rows. "best" keeps the best epoch on the validation
            rows, "normal" the last epoch.
    """

    training: Selection = "cv"

    def chooses_epoch(self) -> bool:
        """Return whether validation rows choose the epoch."""
        return self.training == "best"


PREDICTED_AT_ONCE = 1024  # rows: the layers' outputs stay in the processor's cache


@dataclass(kw_only=True, eq=False, repr=False)
class EncodedNetworkModel(RunsOnDevice, EncodedModel):
    """Base of the families with a network on encoded, standardised samples."""

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return self._predicted_by(self.network_, q, wrench)

    def _predicted_by(
        self, network: torch.nn.Module, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return the (n, 3) deflection, m, that a network of this model's shape predicts."""
        return self.output_scaler_.undo(self._outputs(network, q, wrench))

    def _outputs(self, network: torch.nn.Module, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return a network's (n, n_outputs) outputs."""
        inputs = self._inputs(q, wrench)
        with torch.no_grad():
            outputs = [network(part) for part in torch.split(inputs, PREDICTED_AT_ONCE)]
        return np.asarray(torch.cat(outputs).cpu().double().numpy())

    def _start(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray, seed: int
    ) -> None:
        """Store the statistics of the first training data and draw a new network."""
        self.robot_ = robot
        self._take_statistics(robot, q, wrench, deflection)
        network = self._new_network(len(self.input_scaler_.mean), seed)
        self.network_ = network.to(torch_device(self.device)).eval()

    @abstractmethod
    def _new_network(self, n_inputs: int, seed: int, n_outputs: int = 3) -> torch.nn.Module:
        """Return an untrained network; its output layer comes last in its `state_dict`."""

    def _torch_module(self) -> torch.nn.Module:
        """Return the fitted prediction as a module, for export; see `onnx_export`."""
        return self._encoded(self.network_, self.output_scaler_)

    def _encoded(self, network: torch.nn.Module, output_scaler: Scaler) -> EncodedNetwork:
        scaler = self.input_scaler_
        return EncodedNetwork(self.robot_, network, self.angle_encoding, scaler, output_scaler)

    def _empty_module(self, name: str) -> torch.nn.Module:
        return self._new_network(len(self.input_scaler_.mean), seed=0)

    def _learn_measured(
        self,
        train: Samples,
        validation: Samples | None,
        plan: TrainingPlan,
        seed: int,
        training: Selection,
    ) -> list[Curve]:
        """Train the network in place on measured samples and return each stage's curve."""
        rows, held_out = self._measured_rows(train), None
        if validation is not None and training == "best":
            held_out = self._measured_rows(validation)
            plan = replace(plan, keep_best=True)
        if training == "cv":
            plan = self._cross_validated(train, rows, plan, seed)
        return self._learn(self.network_, rows, plan, seed, validation=held_out)

    def _learn(
        self,
        network: torch.nn.Module,
        rows: Rows,
        plan: TrainingPlan,
        seed: int,
        *,
        validation: Rows | None = None,
        visits: Visits = MappingProxyType({}),
    ) -> list[Curve]:
        """Train a network in place on measured rows and return each stage's curve."""
        curve = train_network(
            network, rows, plan, seed=seed, phase="train", validation=validation, visits=visits
        )
        return [curve]

    def _n_stages(self) -> int:
        """Return the number of stages of `_learn`."""
        return 1

    def _cross_validated(
        self, samples: Samples, rows: Rows, plan: TrainingPlan, seed: int
    ) -> TrainingPlan:
        """Return the plan with the cross-validated number of epochs, at most its own.

        `rows` belong to `samples`. The initial weights come from all rows, which matters for the
        shorter trainings.
        """
        lengths = lengths_up_to(plan.steps)
        scale = torch.as_tensor(self.output_scaler_.scale, dtype=torch.float32).to(rows.inputs)

        def errors_of(learn: IntArray, held_out: IntArray) -> FloatArray:
            learned, tested = self._rows_of_fold(samples, rows, learn, held_out)
            errors = {}

            def look(network: torch.nn.Module, length: int) -> None:
                error = (network(tested.inputs) - tested.targets) * scale
                errors[length] = error.norm(dim=1).cpu().double().numpy()

            if plan.schedule == "constant" and self._n_stages() == 1:
                # a short training is the beginning of a long one
                network = copy.deepcopy(self.network_)
                visits = {length: partial(look, network, length) for length in lengths}
                self._learn(network, learned, plan, seed, visits=visits)
            else:
                for length in lengths:
                    network = copy.deepcopy(self.network_)
                    self._learn(network, learned, replace(plan, steps=length), seed)
                    with torch.no_grad():
                        look(network, length)
            return np.stack([errors[length] for length in lengths])

        epochs = chosen_epochs(samples, lengths, errors_of, seed)
        self.best_params_ = {**getattr(self, "best_params_", {}), "epochs": epochs}
        return replace(plan, steps=epochs)

    def _rows_of_fold(
        self, samples: Samples, rows: Rows, learn: IntArray, held_out: IntArray
    ) -> tuple[Rows, Rows]:
        """Return the training rows and the left-out rows of a cross-validation fold."""
        return rows.take(learn), rows.take(held_out)

    def _inputs(self, q: FloatArray, wrench: FloatArray) -> torch.Tensor:
        """Return the network's (n, n_inputs) inputs on the device."""
        features = self._features(self.robot_, q, wrench)
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
        activation: activation of the hidden layers. "auto" is "relu", or "sharp-gelu" for a network
            that is pre-trained on simulated deflections.
    """

    layers: Layers = 4
    width: Width = 380
    activation: ChosenActivation = "auto"

    @property
    def hidden_activation(self) -> Activation:
        """The network's activation."""
        return "relu" if self.activation == "auto" else self.activation

    def _new_network(self, n_inputs: int, seed: int, n_outputs: int = 3) -> torch.nn.Module:
        return build_network(
            n_inputs,
            layers=self.layers,
            width=self.width,
            activation=self.hidden_activation,
            seed=seed,
            n_outputs=n_outputs,
        )
