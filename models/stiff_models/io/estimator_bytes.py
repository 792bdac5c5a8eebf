"""Row numbers inside scikit-learn's compiled trees, which it follows without looking.

A file could hold a tree whose children or features are not there; following them would read memory
outside of the arrays or never end (scikit-learn's pull request 34558). In a tree that scikit-learn
grew, a child stands after its parent.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable
from typing import Any

import numpy as np
import skops.io
from sklearn.base import BaseEstimator
from sklearn.ensemble._hist_gradient_boosting.predictor import TreePredictor
from sklearn.neighbors import BallTree, KDTree
from sklearn.tree._tree import Tree

from stiff_protocols.contract.errors import DataError, ModelError
from stiff_protocols.contract.types import IntArray


def check_indices(estimator: BaseEstimator) -> None:
    """Check every compiled tree inside an estimator that was read from a file.

    Raises:
        DataError: a tree names a row or a feature that it does not have.
    """
    _visit(estimator, -1, set())


def _visit(value: Any, n_features: int, seen: set[int]) -> None:
    """Check `value` and what it holds; `n_features` is what its estimator checks input for."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, Tree):
        _check_decision_tree(value, n_features)
    elif isinstance(value, TreePredictor):
        _check_predictor(value, n_features)
    elif isinstance(value, KDTree | BallTree):
        _check_search_tree(value)
    else:
        own = getattr(value, "n_features_in_", n_features)
        # an estimator inside another one gets no more features than the outer one checks for
        n_features = own if n_features < 0 else min(own, n_features)
        for part in _parts(value):
            _visit(part, n_features, seen)


def _parts(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, np.ndarray):
        return value.ravel().tolist() if value.dtype == object else ()
    return vars(value).values() if hasattr(value, "__dict__") else ()


def _check_decision_tree(tree: Tree, n_features: int) -> None:
    inner = tree.children_left != -1  # -1: a leaf
    children = np.stack([tree.children_left, tree.children_right])
    _check_nodes(inner, children, tree.feature, n_features)


def _check_predictor(tree: TreePredictor, n_features: int) -> None:
    nodes = tree.nodes
    if nodes["is_categorical"].any():
        raise DataError("holds a tree with categories, which no model here grows")
    children = np.stack([nodes["left"], nodes["right"]]).astype(np.int64)
    _check_nodes(nodes["is_leaf"] == 0, children, nodes["feature_idx"], n_features)


def _check_nodes(
    inner: np.ndarray[Any, Any], children: IntArray, feature: IntArray, n_features: int
) -> None:
    """Check `children` (2, n_nodes) and `feature` (n_nodes,) of the nodes that are no leaves."""
    after = children[:, inner] > np.flatnonzero(inner)
    there = children[:, inner] < len(inner)
    known = (feature[inner] >= 0) & (feature[inner] < n_features)
    if len(inner) == 0 or not (after.all() and there.all() and known.all()):
        raise DataError("holds a decision tree whose nodes point outside of it")


def _check_search_tree(tree: KDTree | BallTree) -> None:
    data, rows, nodes, bounds = (np.asarray(array) for array in tree.get_arrays())
    _, _, _, _, _, n_levels, n_nodes, *_ = tree.__getstate__()
    ends = np.stack([nodes["idx_start"], nodes["idx_end"]])
    if not (
        0 < n_levels < 64  # two to the power of more would fill the memory
        and n_nodes == len(nodes) == bounds.shape[1] == 2**n_levels - 1
        and bounds.shape[2] == data.shape[1]
        and sorted(rows.tolist()) == list(range(len(data)))
        and ((ends >= 0) & (ends <= len(data))).all()
        and nodes["is_leaf"][n_nodes // 2 :].all()
    ):
        raise DataError("holds a neighbour tree whose nodes point outside of it")


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
