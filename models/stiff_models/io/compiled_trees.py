"""Row numbers and shapes that scikit-learn's compiled code follows without looking.

skops checks types, not content: a file could hold a tree whose children or features are not there,
and following them would read memory outside of the arrays or never end (scikit-learn's pull request
34558). In a tree that scikit-learn grew, a child stands after its parent.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from sklearn.ensemble._hist_gradient_boosting.predictor import TreePredictor
from sklearn.neighbors import BallTree, KDTree
from sklearn.tree._tree import Tree

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import IntArray


def check_compiled_trees(content: object) -> None:
    """Raise DataError where a tree or neighbours' regressor names rows or features it has not."""
    _visit(content, -1, set())


def _visit(value: Any, n_features: int, seen: set[tuple[int, int]]) -> None:
    """Check `value` and what it holds; `n_features` is what its estimator checks input for."""
    own = getattr(value, "n_features_in_", n_features)
    # an estimator inside another one gets no more features than the outer one checks for
    n_features = own if n_features < 0 else min(own, n_features)
    if (id(value), n_features) in seen:
        return
    seen.add((id(value), n_features))
    if isinstance(value, Tree):
        if value.node_count != value.capacity:  # the arrays' length, whatever there is behind
            raise DataError("holds a decision tree of more or fewer nodes than it says")
        children = np.stack([value.children_left, value.children_right])
        _check_nodes(children[0] != -1, children, value.feature, n_features)  # -1: a leaf
    elif isinstance(value, TreePredictor):
        nodes = value.nodes
        if nodes["is_categorical"].any():
            raise DataError("holds a tree with categories, which no model here grows")
        children = np.stack([nodes["left"], nodes["right"]]).astype(np.int64)
        _check_nodes(nodes["is_leaf"] == 0, children, nodes["feature_idx"], n_features)
    elif isinstance(value, KDTree | BallTree):
        _check_search_tree(value)
    elif hasattr(value, "_fit_X"):  # neighbours: compiled code believes their shape
        rows = np.asarray(value._fit_X)
        if rows.ndim != 2 or len(rows) == 0 or rows.shape[1] != n_features:
            raise DataError(f"holds neighbours of shape {rows.shape}, expected (n, {n_features})")
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
