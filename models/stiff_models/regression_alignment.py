"""Two distances between feature samples that were made for regression: RSD and DARE-GRAM.

Both compare subspaces, not distributions: adapting the scale of the features, as the other
distances do, harms a regression. They are defined on batches of equal length that have fewer rows
than features (36 in both papers): more rows than features span the whole space.

Singular vectors have no finite derivative where singular values meet; `smooth_svd` bounds it.
"""

from __future__ import annotations

from typing import Any

import torch

PAPER_ROWS = 36  # batch length of both papers
BASES_PENALTY = 0.1  # of RSD's bases mismatch, as published
EXPLAINED = 0.9  # share of the eigenvalues that DARE-GRAM's pseudo-inverse keeps, as published
ANGLE_WEIGHT, SCALE_WEIGHT = 0.05, 0.001  # of DARE-GRAM, as published (dSprites)
BROADENING = 1e-12  # of smooth_svd, relative to the largest squared singular value
RANK_TOLERANCE = 1e-10  # eigenvalues below this share of the largest are rounding


def rsd(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the representation subspace distance with its bases mismatch penalty.

    With the left singular vectors U_s, U_t of the transposed features and
    ``U_s^T U_t = P_s diag(cos theta) P_t^T``, it is ``sum sin theta_i + 0.1 | |P_s| - |P_t| |_F``.
    Chen et al., "Representation Subspace Distance for Domain Adaptation Regression", ICML 2021.

    Args:
        source: (n, d), n < d
        target: (n, d)
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
    Domain Adaptation Regression by Aligning Inversed Gram Matrices", CVPR 2023.

    Args:
        source: (n, d), n > 1
        target: (n, d)
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
    rank = max(int((spectrum > RANK_TOLERANCE * spectrum[0]).sum()), 1)
    return (vectors[:, :rank] / spectrum[:rank]) @ vectors[:, :rank].T


def _leading(spectrum: torch.Tensor) -> int:
    """Return the number of eigenvalues that one domain asks DARE-GRAM to keep."""
    spectrum = spectrum.cpu()  # on a GPU a cumulative sum is not deterministic
    share = spectrum.cumsum(0) / spectrum.sum()
    within = int((share <= max(EXPLAINED, float(share[min(1, len(share) - 1)]))).sum())
    return max(within - 1, 1)


def smooth_svd(matrix: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return U, S and V of ``matrix = U diag(S) V^T``, thin, with bounded derivatives.

    Args:
        matrix: (m, n), float64.
    """
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
