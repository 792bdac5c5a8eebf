"""`adann-2r`: adversarial domain adaptation with two regressors on a common feature extractor.

After maximum classifier discrepancy (Saito, Watanabe, Ushiku and Harada, "Maximum Classifier
Discrepancy for Unsupervised Domain Adaptation", CVPR 2018) with regressors for the classifiers, as
in Xia et al., "Adversarial Bi-Regressor Network for Domain Adaptive Regression", IJCAI 2022. Both
regressors learn the simulated source domain. On inputs of the target they are free and move apart,
as far as the source allows. The extractor learns features of such inputs on which they agree.
Differences here: the division of the base network; one step instead of three in turn (the extractor
gets the reversed gradient); and the schedule of the weight, as in `dt-cnn`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, cast

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.networks.network_model import NetworkModel
from stiff_models.networks.training import HUBER_DELTA, Loss, Rows, TrainingPlan, loss_function
from stiff_models.transfer.alignment import TargetObjective, ramp, reverse_gradient
from stiff_models.transfer.pretrained_mlp import PRETRAINING
from stiff_models.transfer.pretraining import PretrainedModel
from stiff_protocols.contract.types import Robot, Samples

REGRESSORS_SHARE = 0.05
"""The regressors' share of the disagreement's weight. Unlike class probabilities, outputs are
unbounded, and regressors with the extractor's weight diverge."""

# in more steps, with labels, it overfits the few measured samples
FAST = replace(PRETRAINING["fast"], steps=150)


class TwoRegressors(torch.nn.Module):
    """A feature extractor and two regressors of its features; the output is their mean.

    The two networks have the same shape and share the first half of their hidden layers (the larger
    half for an odd number).
    """

    def __init__(
        self, first_network: torch.nn.Sequential, second_network: torch.nn.Sequential
    ) -> None:
        """Use the first half of `first_network` as the common half."""
        super().__init__()
        n_hidden = len(first_network) // 2  # pairs of layer and activation, then the outputs
        common = 2 * ((n_hidden + 1) // 2)
        self.extractor = torch.nn.Sequential(*list(first_network)[:common])
        self.first = torch.nn.Sequential(*list(first_network)[common:])
        self.second = torch.nn.Sequential(*list(second_network)[common:])

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the (n, 3) outputs of (n, n_inputs) inputs."""
        features = self.extractor(inputs)
        outputs: torch.Tensor = (self.first(features) + self.second(features)) / 2.0
        return outputs

    def disagreement(self, features: torch.Tensor) -> torch.Tensor:
        """Return the mean absolute difference of both regressors on (n, width) features."""
        difference: torch.Tensor = self.first(features) - self.second(features)
        return difference.abs().mean()


class AdversarialObjective(TargetObjective):
    """Both regressors' loss - weight * lambda * disagreement.

    The loss covers the source batch and, with `labels`, measured rows. The Huber loss is divided by
    its width, as in `AlignedObjective`. The disagreement is computed on as many target rows as the
    batch has, or on all. Its gradient is reversed on the way to the extractor: the regressors
    increase the disagreement, and the extractor decreases it. lambda is `ramp`.
    """

    def __init__(
        self,
        network: TwoRegressors,
        target: torch.Tensor,
        labels: torch.Tensor | None,
        *,
        weight: float,
        seed: int,
    ) -> None:
        """Store the parts; `target` is (n, n_inputs), `labels` (n, 3) standardised or None."""
        super().__init__(target, seed=seed)
        self.network, self.labels, self.weight = network, labels, weight
        self.made_of = (target,) if labels is None else (target, labels)
        self.about = f"adversarial {weight!r}"
        self.loss = loss_function("huber")

    def __call__(
        self, progress: float, inputs: torch.Tensor, targets: torch.Tensor
    ) -> torch.Tensor:
        """Return the loss of a source batch (n, n_inputs) with its (n, 3) standardised outputs."""
        loss = self._learned(self.network.extractor(inputs), targets)
        chosen = self._target_rows(len(inputs))
        # the difference of two regressors would be lost in low precision
        with torch.autocast(inputs.device.type, enabled=False):
            features = self.network.extractor(self.target[chosen])
            if self.labels is not None:
                loss = loss + self._learned(features, self.labels[chosen])
            disagreement = self.network.disagreement(
                reverse_gradient(features, 1.0 / REGRESSORS_SHARE)
            )
            return loss - REGRESSORS_SHARE * self.weight * ramp(progress) * disagreement

    def _learned(self, features: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        network = self.network
        outputs = (network.first(features).float(), network.second(features).float())
        return (self.loss(outputs[0], targets) + self.loss(outputs[1], targets)) / HUBER_DELTA


@dataclass(kw_only=True, eq=False, repr=False)
class Adann2R(PretrainedModel, NetworkModel):
    """Two regressors, adversarially trained, in two regimes that cannot be compared.

    With `supervision="none"` the training labels still identify the joint stiffnesses of the
    source, as with `dt-cnn`. The first half of the hidden layers is the extractor; each regressor
    has its own second half.

    Attributes:
        adversarial_weight: weight of the disagreement on target inputs against the loss on
            standardised outputs; 0: both regressors learn only the source.
        supervision: "none" (no measured deflection trains the network) or "labels" (both regressors
            also learn the measured training samples, with the weight of the source).
    """

    adversarial_weight: Annotated[float, Ge(0.0)] = 0.3
    supervision: Literal["none", "labels"] = "none"

    @property
    def regime(self) -> str:
        """Regime of the training; "" if measured deflections train the network."""
        return self._unlabelled() if self.supervision == "none" else ""

    @property
    def shares_pretraining(self) -> bool:
        """False: the training uses the inputs of the training part."""
        return False

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        super()._fit(train, robot, validation, seed)
        disagreement_mm = 1000.0 * self._disagreement(self._measured_rows(train))
        self.diagnostics_["disagreement on the target [mm]"] = disagreement_mm

    def _objective(self, train: Samples, loss: Loss, seed: int) -> AdversarialObjective:
        measured = self._measured_rows(train)
        labels = measured.targets if self.supervision == "labels" else None
        return AdversarialObjective(
            self._two(), measured.inputs, labels, weight=self.adversarial_weight, seed=seed
        )

    def _disagreement(self, rows: Rows) -> float:
        """Return the mean absolute difference of both regressors on rows, m, all axes together."""
        network = self._two()
        with torch.no_grad():
            features = network.extractor(rows.inputs)
            difference = network.first(features) - network.second(features)
        scale = self.output_scaler_.scale
        return float(np.mean(np.abs(difference.cpu().double().numpy()) * scale))

    def _two(self) -> TwoRegressors:
        return cast(TwoRegressors, self.network_)

    def _new_network(self, n_inputs: int, seed: int, n_outputs: int = 3) -> torch.nn.Module:
        second_seed = int(np.random.default_rng(seed).integers(2**31))
        first_network, second_network = (
            NetworkModel._new_network(self, n_inputs, network_seed, n_outputs)
            for network_seed in (seed, second_seed)
        )
        return TwoRegressors(
            cast(torch.nn.Sequential, first_network), cast(torch.nn.Sequential, second_network)
        )

    def _recipe_plan(self) -> TrainingPlan:
        return FAST
