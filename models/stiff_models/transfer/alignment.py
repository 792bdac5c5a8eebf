"""Distances of source and target features, and the objective of `dt-cnn` that is made of them.

RSD and DARE-GRAM were made for regression: they compare subspaces, not distributions, as adapting
the scale of the features harms a regression. They are defined on batches of equal length that have
fewer rows than features (36 in both papers): more rows than features span the whole space.
Singular vectors have no finite derivative where singular values meet; `smooth_svd` bounds it.

`source` is (n_s, d) and `target` (n_t, d) features, unless a function says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import torch

from stiff_models.networks.training import Objective
from stiff_models.networks.training_plan import HUBER_DELTA, Loss, loss_function
from stiff_models.transfer.cnn import WIDTH, Cnn

DISCRIMINATOR_WIDTH = 1024
DISCRIMINATOR_DROPOUT = 0.5


class _Reversal(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, strength: float) -> torch.Tensor:
        ctx.strength = strength
        return values.view_as(values)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        return -ctx.strength * gradient, None


def reverse_gradient(values: torch.Tensor, strength: float) -> torch.Tensor:
    """Return `values`; on the way back their gradient is multiplied by -`strength`."""
    reversed_: torch.Tensor = _Reversal.apply(values, strength)  # type: ignore[no-untyped-call]
    return reversed_


def build_discriminator(n_features: int, *, seed: int) -> torch.nn.Sequential:
    """Return the n_features-1024-1024-1 network of UDTL; its output is a logit, source positive.

    Weights are drawn from `seed`; torch's own random state is left as it was.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return torch.nn.Sequential(
            *_discriminator_layer(n_features),
            *_discriminator_layer(DISCRIMINATOR_WIDTH),
            torch.nn.Linear(DISCRIMINATOR_WIDTH, 1),
        )


def _discriminator_layer(n_inputs: int) -> list[torch.nn.Module]:
    layer, dropout = torch.nn.Linear(n_inputs, DISCRIMINATOR_WIDTH), DISCRIMINATOR_DROPOUT
    return [layer, torch.nn.ReLU(), torch.nn.Dropout(dropout)]


def domain_loss(
    discriminator: torch.nn.Module,
    source: torch.Tensor,
    target: torch.Tensor,
    *,
    strength: float,
) -> torch.Tensor:
    """Return the discriminator's binary cross-entropy, each domain with half of the weight.

    ``-(mean log D(s) + mean log(1 - D(t))) / 2`` with D the probability of the source; `strength`
    is of the reversed gradient that reaches the features.
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
    return _mean_discrepancy(_kernel(source, target, KERNEL_FACTORS), len(source))


def jmmd(source: Sequence[torch.Tensor], target: Sequence[torch.Tensor]) -> torch.Tensor:
    """Return the squared joint maximum mean discrepancy of bottleneck features and outputs.

    `mk_mmd` with the product of one kernel a layer: the five Gaussian kernels on the features and
    one, with the mean squared distance as its bandwidth, on the (n, m) outputs. Long et al., "Deep
    Transfer Learning with Joint Adaptation Networks", ICML 2017. (UDTL fixes the bandwidth of the
    last kernel at 1.68, which fits class probabilities alone.)
    """
    features = _kernel(source[0], target[0], KERNEL_FACTORS)
    outputs = _kernel(source[1], target[1], (1.0,))
    return _mean_discrepancy(features * outputs, len(source[0]))


def coral(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return ``|C_s - C_t|_F^2 / (4 d^2)`` of the features' covariances, with 1/(n-1).

    Sun and Saenko, "Deep CORAL", ECCV Workshops 2016. (UDTL's own variant works on the logits and
    leaves out 1/(n-1).) Both domains need two rows.
    """
    difference = _covariance(source) - _covariance(target)
    return difference.square().sum() / (4 * source.shape[1] ** 2)


def _covariance(values: torch.Tensor) -> torch.Tensor:
    centred = values - values.mean(0)
    return centred.T @ centred / (len(values) - 1)


def _kernel(source: torch.Tensor, target: torch.Tensor, factors: Sequence[float]) -> torch.Tensor:
    """Return the (n, n) sum of Gaussian kernels over the rows of both samples, n = n_s + n_t."""
    values = torch.cat([source, target])
    values = values - values.detach().mean(0)  # distances stay; their rounding errors shrink
    n = len(values)
    size = values.square().sum(1)
    distance = (size[:, None] + size[None, :] - 2.0 * values @ values.T).clamp_min(0.0)
    bandwidth = distance.detach().sum() / (n * (n - 1))
    bandwidth = bandwidth.clamp_min(torch.finfo(values.dtype).eps)  # rows that are all the same
    return torch.stack([torch.exp(-distance / (bandwidth * factor)) for factor in factors]).sum(0)


def _mean_discrepancy(kernel: torch.Tensor, n_source: int) -> torch.Tensor:
    within_source = kernel[:n_source, :n_source].mean()
    within_target = kernel[n_source:, n_source:].mean()
    return within_source + within_target - 2.0 * kernel[:n_source, n_source:].mean()


PAPER_ROWS = 36  # batch length of both papers
BASES_PENALTY = 0.1  # of RSD's bases mismatch, as published
EXPLAINED = 0.9  # share of the eigenvalues that DARE-GRAM's pseudo-inverse keeps, as published
ANGLE_WEIGHT, SCALE_WEIGHT = 0.05, 0.001  # of DARE-GRAM, as published (dSprites)
BROADENING = 1e-12  # of smooth_svd, relative to the largest squared singular value
EIGENVALUE_TOLERANCE = 1e-10  # eigenvalues below this share of the largest are rounding


def rsd(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the representation subspace distance with its bases mismatch penalty.

    With the left singular vectors U_s, U_t of the transposed features (n < d rows in both) and
    ``U_s^T U_t = P_s diag(cos theta) P_t^T``, it is ``sum sin theta_i + 0.1 | |P_s| - |P_t| |_F``.
    Chen et al., "Representation Subspace Distance for Domain Adaptation Regression", ICML 2021.
    """
    bases = [smooth_svd(values.double().T)[0] for values in (source, target)]  # (d, n)
    left, cosine, right = smooth_svd(bases[0].T @ bases[1])
    # below 1e-14 a squared sine is rounding, and its root would have no finite slope
    sine = (1.0 - cosine.square()).clamp_min(1e-14).sqrt()
    mismatch = (left.abs() - right.abs()).square().sum().clamp_min(1e-14).sqrt()
    return (sine.sum() + BASES_PENALTY * mismatch).to(source.dtype)


def dare_gram(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the distance of the inverse Gram matrices in angle and of the spectra in scale.

    With Z = [1, features], G = Z^T Z of size d + 1, its eigenvalues l_1 >= l_2 >= ..., and G^+ the
    pseudo-inverse of its first k of them, it is
    ``0.05 mean_j (1 - cos(G_s^+[:, j], G_t^+[:, j])) + 0.001 |l_s[:k] - l_t[:k]| / k``.
    k is the larger one of both domains' numbers of leading eigenvalues with a share of at most 0.9,
    less one as in the published code, and at least 1. Nejjar et al., "DARE-GRAM: Unsupervised
    Domain Adaptation Regression by Aligning Inversed Gram Matrices", CVPR 2023. Both domains have n
    rows.
    """
    spectra, axes = [], []
    for values in (source.double(), target.double()):
        ones = torch.ones_like(values[:, :1])
        _, singular, right = smooth_svd(torch.cat([ones, values], 1))
        spectra.append(singular.square())
        axes.append(right)  # (d + 1, min(n, d + 1))
    kept = max(_leading(spectrum.detach()) for spectrum in spectra)
    inverses = [
        _inverse(vectors[:, :kept], spectrum[:kept])
        for vectors, spectrum in zip(axes, spectra, strict=True)
    ]
    cosine = torch.nn.functional.cosine_similarity(inverses[0], inverses[1], dim=0, eps=1e-6)
    scale = (spectra[0][:kept] - spectra[1][:kept]).square().sum().clamp_min(1e-14).sqrt() / kept
    angle = (1.0 - cosine).abs().mean()
    return (ANGLE_WEIGHT * angle + SCALE_WEIGHT * scale).to(source.dtype)


def _inverse(vectors: torch.Tensor, spectrum: torch.Tensor) -> torch.Tensor:
    """Return ``V diag(1/l) V^T`` over the eigenvalues that are not zero."""
    rank = max(int((spectrum > EIGENVALUE_TOLERANCE * spectrum[0]).sum()), 1)
    return (vectors[:, :rank] / spectrum[:rank]) @ vectors[:, :rank].T


def _leading(spectrum: torch.Tensor) -> int:
    """Return the number of eigenvalues that one domain asks DARE-GRAM to keep."""
    spectrum = spectrum.cpu()  # on a GPU a cumulative sum is not deterministic
    share = spectrum.cumsum(0) / spectrum.sum()
    within = int((share <= max(EXPLAINED, float(share[min(1, len(share) - 1)]))).sum())
    return max(within - 1, 1)


def smooth_svd(matrix: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return U, S and V of a float64 ``matrix = U diag(S) V^T``, thin, with bounded derivatives."""
    left, singular, right = _SmoothSvd.apply(matrix)  # type: ignore[no-untyped-call]
    return left, singular, right


class _SmoothSvd(torch.autograd.Function):
    """Singular value decomposition whose derivative has ``x / (x^2 + eps)`` in place of ``1/x``.

    The broadening of Liao et al., "Differentiable Programming Tensor Networks", PRX 2019, in the
    derivative of Townsend, "Differentiating the Singular Value Decomposition", 2016.
    """

    @staticmethod
    def forward(ctx: Any, matrix: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        left, singular, right_t = torch.linalg.svd(matrix, full_matrices=False)
        right = right_t.mT
        ctx.save_for_backward(left, singular, right)
        return left, singular, right

    @staticmethod
    def backward(
        ctx: Any, to_left: torch.Tensor, to_singular: torch.Tensor, to_right: torch.Tensor
    ) -> torch.Tensor:
        left, singular, right = ctx.saved_tensors
        squares = singular.square()
        tiny = torch.finfo(squares.dtype).tiny  # a matrix of zeros has the derivative zero
        broadening = (BROADENING * squares[0]).clamp_min(tiny)
        gap = squares[None, :] - squares[:, None]
        rotation = gap / (gap.square() + broadening.square()).clamp_min(tiny)
        inverse = singular / (squares + broadening)
        of_left, of_right = left.T @ to_left, right.T @ to_right
        core = (rotation * (of_left - of_left.T)) * singular[None, :]
        core = core + singular[:, None] * (rotation * (of_right - of_right.T))
        result = left @ (core + torch.diag(to_singular)) @ right.T
        result = result + (to_left - left @ of_left) * inverse @ right.T
        outside = (to_right - right @ of_right).T
        gradient: torch.Tensor = result + left @ (inverse[:, None] * outside)
        return gradient


Alignment = Literal["none", "adabn", "mk-mmd", "jmmd", "coral", "dann", "rsd", "dare-gram"]

DISTANCES = {"mk-mmd": mk_mmd, "coral": coral, "rsd": rsd, "dare-gram": dare_gram}
"""Those of the features alone."""

SOURCE_ONLY = 1 / 6  # share of the training before alignment starts: UDTL's epoch 50 of 300
RSD_TRADE_OFF = 1e-3  # published weight of the representation subspace distance


def uses_target(alignment: Alignment) -> bool:
    """Return whether the training itself sees inputs of the target ("adabn" does after it)."""
    return alignment not in ("none", "adabn")


def ramp(progress: float) -> float:
    """Return lambda, the weight of the alignment: ``2 / (1 + exp(-10 p)) - 1``.

    p goes from 0 to 1 over the part of the training (`progress` 0..1) that follows `SOURCE_ONLY`;
    before it lambda is 0. Ganin et al. 2016; in the form of UDTL.
    """
    aligned = max(0.0, (progress - SOURCE_ONLY) / (1.0 - SOURCE_ONLY))
    return 2.0 / (1.0 + math.exp(-10.0 * aligned)) - 1.0


class TargetObjective(Objective):
    """Base of the objectives that see inputs of the target, (n, n_inputs)."""

    def __init__(self, target: torch.Tensor, *, seed: int) -> None:
        """Store them; `seed` is of their batches."""
        self.target = target
        self.generator = torch.Generator().manual_seed(seed)

    def _target_rows(self, n: int) -> torch.Tensor:
        """Draw the numbers of `n` rows of the target, or of all where there are fewer."""
        chosen = torch.randperm(len(self.target), generator=self.generator)[:n]
        return chosen.to(self.target.device)


class AlignedObjective(TargetObjective):
    """Loss of the source batch + weight * lambda * distance.

    A step takes the source batch and as many target rows, or all of them where there are fewer,
    in one pass through the network: both domains share the batch statistics, as in UDTL. The loss
    is on standardised outputs; the Huber loss is divided by its width, so that it tends to the
    absolute error and not to one fiftieth of it, and the weight compares like with like. "dann"
    carries lambda in the reversed gradient, and its discriminator always learns at full weight.
    "rsd" and "dare-gram" see the first 36 rows of each domain, their papers' batch length.
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
        """Store the parts; `seed` is of the target's batches and of a discriminator."""
        super().__init__(target, seed=seed)
        self.network, self.alignment, self.weight = network, alignment, weight
        self.made_of, self.about = (target,), f"{alignment} {weight!r}"
        self.loss = loss_function(loss)
        self.unit = HUBER_DELTA if loss == "huber" else 1.0
        self.discriminator = (
            build_discriminator(WIDTH, seed=seed).to(target.device) if alignment == "dann" else None
        )

    def parameters(self) -> list[torch.nn.Parameter]:
        """Return those of the discriminator."""
        return [] if self.discriminator is None else list(self.discriminator.parameters())

    def __call__(
        self, progress: float, inputs: torch.Tensor, targets: torch.Tensor
    ) -> torch.Tensor:
        """Return the loss of a source batch (n, n_inputs) with its (n, 3) standardised outputs."""
        if progress < SOURCE_ONLY:
            return self.loss(self.network(inputs).float(), targets) / self.unit
        n = len(inputs)
        both = torch.cat([inputs, self.target[self._target_rows(n)]])
        features = self.network.bottleneck(both)
        outputs = self.network.head(features).float()
        loss = self.loss(outputs[:n], targets) / self.unit
        # distances subtract near equals: never in low precision
        with torch.autocast(inputs.device.type, enabled=False):
            distance = self._distance(features.float(), outputs, n, ramp(progress))
        return loss + self.weight * distance

    def _distance(
        self, features: torch.Tensor, outputs: torch.Tensor, n: int, strength: float
    ) -> torch.Tensor:
        """Return the distance of the first n rows from the rest, times `strength`."""
        source, target = features[:n], features[n:]
        if self.discriminator is not None:
            return domain_loss(self.discriminator, source, target, strength=strength)
        if self.alignment == "jmmd":
            return strength * jmmd((source, outputs[:n]), (target, outputs[n:]))
        if self.alignment == "rsd":
            strength *= RSD_TRADE_OFF
        if self.alignment in ("rsd", "dare-gram"):
            rows = min(len(source), len(target), PAPER_ROWS)
            source, target = source[:rows], target[:rows]
        return strength * DISTANCES[self.alignment](source, target)
