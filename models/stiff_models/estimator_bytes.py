"""scikit-learn estimators as bytes, by skops: read back only if every type inside is known.

skops trusts scikit-learn's public estimators, numpy and scipy. What regressors need beyond is
listed here by name. Of some of these skops says that a crafted file could name rows that are not
there; `tree_checks` looks at those before anything is predicted.
"""

from __future__ import annotations

import io
import zipfile

import skops.io
from sklearn.base import BaseEstimator

from stiff_models.tree_checks import check_indices
from stiff_protocols.errors import DataError, ModelError

_KERNELS = (
    "CompoundKernel",
    "ConstantKernel",
    "DotProduct",
    "ExpSineSquared",
    "Exponentiation",
    "Matern",
    "Product",
    "RBF",
    "RationalQuadratic",
    "Sum",
    "WhiteKernel",
)
ALLOWED = frozenset(
    {
        *(f"sklearn.gaussian_process.kernels.{name}" for name in _KERNELS),
        "sklearn.tree._tree.Tree",
        "sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",
        "sklearn.neighbors._kd_tree.KDTree",
        "sklearn.neighbors._ball_tree.BallTree",
        "sklearn.metrics._dist_metrics.EuclideanDistance64",
        "sklearn.metrics._dist_metrics.ManhattanDistance64",
        "sklearn.metrics._dist_metrics.MinkowskiDistance64",
        "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
        "sklearn.neural_network._stochastic_optimizers.SGDOptimizer",
        "sklearn._loss.loss.HalfTweedieLoss",
        "sklearn._loss.loss.HalfTweedieLossIdentity",
    }
)
"""Types that are read beside those that skops trusts."""


def estimator_to_bytes(estimator: BaseEstimator) -> bytes:
    """Return a fitted estimator as skops writes it.

    Raises:
        ModelError: it holds an object that could not be read again.
    """
    try:
        data = bytes(skops.io.dumps(estimator))
        unknown = _unknown_types(data)
    except Exception as error:  # whatever a stranger's object does when it is taken apart
        raise ModelError(f"{type(estimator).__name__} cannot be saved: {error}") from error
    if unknown:
        raise ModelError(
            f"{type(estimator).__name__} cannot be saved: it holds {', '.join(unknown)} (valid: "
            "objects of scikit-learn, numpy and scipy)"
        )
    return data


def estimator_from_bytes(data: bytes) -> BaseEstimator:
    """Return the estimator.

    Raises:
        DataError: the bytes are damaged, or name a type that is not known to be harmless.
    """
    try:
        _refuse_bomb(data)
        unknown = _unknown_types(data)
        if unknown:
            raise DataError(
                f"holds {', '.join(unknown)}, which is not loaded (valid: types of scikit-learn, "
                "numpy and scipy that are known to be harmless)"
            )
        estimator = skops.io.loads(data, trusted=sorted(ALLOWED))
    except DataError:
        raise
    except Exception as error:  # a crafted archive can raise anything
        raise DataError(f"a scikit-learn part cannot be read: {error}") from error
    if not isinstance(estimator, BaseEstimator):
        raise DataError(f"holds a {type(estimator).__name__} where an estimator belongs")
    check_indices(estimator)
    return estimator


def _refuse_bomb(data: bytes) -> None:
    """See that an archive unpacks to no more than it takes: `dumps` compresses nothing."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > len(data):
        raise DataError(f"a scikit-learn part of {len(data)} bytes unpacks to {size}")


def _unknown_types(data: bytes) -> list[str]:
    return [name for name in skops.io.get_untrusted_types(data=data) if name not in ALLOWED]
