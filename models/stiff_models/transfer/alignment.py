"""Distances of source and target features, and the objective of `dt-cnn` that uses them.

`source` is (n_s, d) and `target` (n_t, d) features, unless stated otherwise.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal

import torch

from stiff_models.networks.training import HUBER_DELTA, Loss, loss_function
from stiff_models.transfer.cnn import WIDTH, Cnn

DISCRIMINATOR_WIDTH = 1024
DISCRIMINATOR_DROPOUT = 0.5


def reverse_gradient(values: torch.Tensor, strength: float) -> torch.Tensor:
    """Return `values`, whose backward gradient is multiplied by -`strength`."""
    passed = values.view_as(values)
    if passed.requires_grad:
        passed.register_hook(lambda grad: -strength * grad)  # type: ignore[no-untyped-call]
    return passed


def build_discriminator(n_features: int, *, seed: int) -> torch.nn.Sequential:
    """Return the n_features-1024-1024-1 network of UDTL; its output is a logit, source positive.

    Weights are drawn from `seed`. Torch's global random state is not changed.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        layers: list[torch.nn.Module] = []
        for n_inputs in (n_features, DISCRIMINATOR_WIDTH):
            layers += [torch.nn.Linear(n_inputs, DISCRIMINATOR_WIDTH), torch.nn.ReLU()]
            layers.append(torch.nn.Dropout(DISCRIMINATOR_DROPOUT))
        return torch.nn.Sequential(*layers, torch.nn.Linear(DISCRIMINATOR_WIDTH, 1))


def domain_loss(
    discriminator: torch.nn.Module,
    source: torch.Tensor,
    target: torch.Tensor,
    *,
    strength: float,
) -> torch.Tensor:
    """Return the discriminator's binary cross-entropy, each domain with half of the weight.

    ``-(mean log D(s) + mean log(1 - D(t))) / 2`` with D the probability of the source; `strength`
    is the factor of the features' reversed gradient.
    """
    logits = discriminator(reverse_gradient(torch.cat([source, target]), strength))
    softplus = torch.nn.functional.softplus
    of_source, of_target = logits[: len(source)], logits[len(source) :]
    return (softplus(-of_source).mean() + softplus(of_target).mean()) / 2.0


KERNEL_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Bandwidths of MK-MMD's five kernels as multiples of the mean squared distance."""


def mk_mmd(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the squared multi-kernel maximum mean discrepancy.

    ``mean k(s, s') + mean k(t, t') - 2 mean k(s, t)`` over all pairs, with
    ``k(x, y) = sum_u exp(-|x - y|^2 / (b 2^u))``, u = -2..2, and b the mean squared distance of two
    different rows of both samples together, which carries no gradient. Long et al., "Learning
    Transferable Features with Deep Adaptation Networks", ICML 2015, in the form of UDTL.
    """
    values = torch.cat([source, target])
    values = values - values.detach().mean(0)  # the same distances with smaller rounding errors
    n, n_source = len(values), len(source)
    size = values.square().sum(1)
    distance = (size[:, None] + size[None, :] - 2.0 * values @ values.T).clamp_min(0.0)
    bandwidth = distance.detach().sum() / (n * (n - 1))
    bandwidth = bandwidth.clamp_min(torch.finfo(values.dtype).eps)  # rows that are all the same
    kernels = [torch.exp(-distance / (bandwidth * factor)) for factor in KERNEL_FACTORS]
    kernel = torch.stack(kernels).sum(0)
    within_source = kernel[:n_source, :n_source].mean()
    within_target = kernel[n_source:, n_source:].mean()
    return within_source + within_target - 2.0 * kernel[:n_source, n_source:].mean()


def coral(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return ``|C_s - C_t|_F^2 / (4 d^2)`` of the features' covariances, with 1/(n-1).

    Sun and Saenko, "Deep CORAL", ECCV Workshops 2016. (UDTL's variant works on the logits and
    omits 1/(n-1).) Both domains need two rows.
    """
    difference = _covariance(source) - _covariance(target)
    return difference.square().sum() / (4 * source.shape[1] ** 2)


def _covariance(values: torch.Tensor) -> torch.Tensor:
    centred = values - values.mean(0)
    return centred.T @ centred / (len(values) - 1)


Alignment = Literal["none", "adabn", "mk-mmd", "coral", "dann"]

SOURCE_ONLY = 1 / 6  # share of the training before alignment starts: UDTL's epoch 50 of 300


def uses_target(alignment: Alignment) -> bool:
    """Return whether the training uses inputs of the target ("adabn" uses them afterwards)."""
    return alignment not in ("none", "adabn")


def ramp(progress: float) -> float:
    """Return lambda, the weight of the alignment: ``2 / (1 + exp(-10 p)) - 1``.

    p goes from 0 to 1 over the part of the training (`progress` 0..1) after `SOURCE_ONLY`; before
    it lambda is 0. Ganin et al. 2016; in the form of UDTL.
    """
    aligned = max(0.0, (progress - SOURCE_ONLY) / (1.0 - SOURCE_ONLY))
    return 2.0 / (1.0 + math.exp(-10.0 * aligned)) - 1.0


class TargetObjective(ABC):
    """Base of the objectives that use inputs of the target, (n, n_inputs).

    Attributes:
        made_of: tensors of the objective, a part of the training's cache key.
        about: settings as text, another part of the cache key.
    """

    made_of: Sequence[torch.Tensor]
    about: str

    def __init__(self, target: torch.Tensor, *, seed: int) -> None:
        """Store the target inputs; `seed` determines their batches."""
        self.target = target
        self.generator = torch.Generator().manual_seed(seed)

    def parameters(self) -> list[torch.nn.Parameter]:
        """Return trainable parameters in addition to the network's."""
        return []

    @abstractmethod
    def __call__(
        self, progress: float, inputs: torch.Tensor, targets: torch.Tensor
    ) -> torch.Tensor:
        """Return the loss of a source batch (n, n_inputs) with its (n, 3) standardised outputs."""

    def _target_rows(self, n: int) -> torch.Tensor:
        """Draw the numbers of `n` rows of the target, or of all if there are fewer."""
        chosen = torch.randperm(len(self.target), generator=self.generator)[:n]
        return chosen.to(self.target.device)


class AlignedObjective(TargetObjective):
    """Loss of the source batch + weight * lambda * distance.

    A step passes the source batch and as many target rows (or all, if there are fewer) through the
    network at once. Both domains share the batch statistics, as in UDTL. The Huber loss is divided
    by its width, so that it tends to the absolute error. "dann" applies lambda to the reversed
    gradient; its discriminator always learns at full weight.
    """

    def __init__(
        self,
        network: Cnn,
        target: torch.Tensor,
        *,
        alignment: Alignment,
        weight: float,
        loss: Loss,
        seed: int,
    ) -> None:
        """Store the parts; `seed` determines the target's batches and the discriminator."""
        super().__init__(target, seed=seed)
        self.network, self.alignment, self.weight = network, alignment, weight
        self.made_of, self.about = (target,), f"{alignment} {weight!r}"
        self.loss = loss_function(loss)
        self.unit = HUBER_DELTA if loss == "huber" else 1.0
        self.discriminator = (
            build_discriminator(WIDTH, seed=seed).to(target.device) if alignment == "dann" else None
        )

    def parameters(self) -> list[torch.nn.Parameter]:
        """Return the discriminator's parameters."""
        return [] if self.discriminator is None else list(self.discriminator.parameters())

    def __call__(
        self, progress: float, inputs: torch.Tensor, targets: torch.Tensor
    ) -> torch.Tensor:
        """Return the loss of a source batch (n, n_inputs) with its (n, 3) standardised outputs."""
        if progress < SOURCE_ONLY:
            return self.loss(self.network(inputs).float(), targets) / self.unit
        n = len(inputs)
        inputs_of_both = torch.cat([inputs, self.target[self._target_rows(n)]])
        features = self.network.bottleneck(inputs_of_both)
        outputs = self.network.head(features).float()
        loss = self.loss(outputs[:n], targets) / self.unit
        # distances subtract near equals: never in low precision
        with torch.autocast(inputs.device.type, enabled=False):
            distance = self._distance(features[:n].float(), features[n:].float(), ramp(progress))
        return loss + self.weight * distance

    def _distance(
        self, source: torch.Tensor, target: torch.Tensor, strength: float
    ) -> torch.Tensor:
        """Return the distance of both domains' features, times `strength`."""
        if self.discriminator is not None:
            return domain_loss(self.discriminator, source, target, strength=strength)
        return strength * (mk_mmd if self.alignment == "mk-mmd" else coral)(source, target)
