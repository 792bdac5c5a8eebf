"""Check `realmlp`, `tabm`, `tabpfn` and `tabicl` without their package and with a stand-in."""

from __future__ import annotations

import importlib.util
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.neighbors import KNeighborsRegressor

from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models import model_catalog as optional_packages
from stiff_models.regressors.tabular import RealMlp, TabIcl, TabPfn
from stiff_protocols.contract.errors import ConfigError, StoreError


def test_without_its_package_a_family_names_the_extra(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for package, extra, reason in (
        ("pytabkit", "tabular", optional_packages.missing_pytabkit()),
        ("tabpfn", "tabpfn", optional_packages.missing_tabpfn()),
        ("tabicl", "tabicl", optional_packages.missing_tabicl()),
    ):
        assert reason == f"needs the package {package}: pip install 'stiffbench[{extra}]'"
    data = Kr10Twin().load()
    for cls, package in ((TabPfn, "tabpfn"), (TabIcl, "tabicl")):
        with pytest.raises(ConfigError, match=f"{package}: needs the package {package}"):
            cls(device="cpu").fit(data.samples, robot=data.robot)


@pytest.mark.parametrize("key", ["tabpfn", "tabicl"])
def test_weights_that_are_not_there_are_named_and_never_fetched(key, tmp_path, monkeypatch):
    monkeypatch.setattr(optional_packages, "missing", lambda package: "")
    missing = getattr(optional_packages, f"missing_{key}")
    file = tmp_path / "weights.ckpt"
    assert f"{file} does not exist" in missing(str(file)) and f"{key}.model_path" in missing(
        str(file)
    )
    file.touch()
    assert missing(str(file)) == ""


class NearestRow(KNeighborsRegressor):
    """Stand for the package tabicl: a regressor of one output."""

    checkpoint_version = "tabicl-regressor.ckpt"

    def __init__(self, model_path=None, allow_auto_download=True, device=None, random_state=None):
        super().__init__(n_neighbors=1)
        self.model_path, self.allow_auto_download = model_path, allow_auto_download
        self.device, self.random_state = device, random_state

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = False
        return tags


@pytest.fixture
def fake_tabicl(monkeypatch):
    monkeypatch.setattr(optional_packages, "missing", lambda package: "")
    monkeypatch.setitem(sys.modules, "tabicl", SimpleNamespace(TabICLRegressor=NearestRow))


def test_tabicl_predicts_each_axis_with_the_weights_that_are_there(fake_tabicl, tmp_path, parts):
    robot, train, _, _ = parts
    weights = tmp_path / "weights.ckpt"
    weights.touch()
    model = TabIcl(model_path=str(weights), device="cpu").fit(train, robot=robot, seed=3)
    predicted = model.predict(train.q, train.wrench)
    np.testing.assert_allclose(predicted, train.deflection, atol=1e-12)
    for axis in model.regressor_.estimators_:
        assert (axis.model_path, axis.random_state) == (str(weights), 3)
        assert axis.device == "cpu" and not axis.allow_auto_download


@pytest.mark.parametrize("cached_name", [None, "weights.ckpt"])
def test_tabicls_own_weights_are_looked_for_only_in_its_cache(
    fake_tabicl, cached_name, tmp_path, monkeypatch
):
    (tmp_path / "weights.ckpt").touch()
    cached_path = None if cached_name is None else str(tmp_path / cached_name)
    hub = SimpleNamespace(try_to_load_from_cache=lambda repository, name: cached_path)
    monkeypatch.setitem(sys.modules, "huggingface_hub", hub)
    reason = optional_packages.missing_tabicl()
    assert (reason == "") is (cached_name is not None)
    assert cached_name or "tabicl-regressor.ckpt does not exist" in reason


@pytest.mark.parametrize("model", [RealMlp(), TabPfn(), TabIcl()])
def test_what_cannot_be_saved_says_so(model, tmp_path):
    with pytest.raises(StoreError, match="cannot be saved"):
        model.save(tmp_path / "model")
