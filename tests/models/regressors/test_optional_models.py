"""`realmlp`, `tabm` and `tabpfn`: what they say without their package, what they do with it."""

from __future__ import annotations

import importlib.util

import pytest

from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.regressors import optional_packages
from stiff_models.regressors.tabular import RealMlp, TabPfn
from stiff_protocols.contract.errors import ConfigError, StoreError


def test_without_its_package_a_family_names_the_extra(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for package, extra, reason in (
        ("pytabkit", "tabular", optional_packages.missing_pytabkit()),
        ("tabpfn", "tabpfn", optional_packages.missing_tabpfn()),
    ):
        assert reason == f"needs the package {package}: pip install 'stiffbench[{extra}]'"
    data = Kr10Twin().load()
    with pytest.raises(ConfigError, match="needs the package tabpfn"):
        TabPfn(device="cpu").fit(data.samples, robot=data.robot)


def test_weights_that_are_not_there_are_named_and_never_fetched(tmp_path, monkeypatch):
    monkeypatch.setattr(optional_packages, "missing", lambda package: "")
    file = tmp_path / "weights.ckpt"
    assert f"{file} is not there" in optional_packages.missing_tabpfn(str(file))
    file.touch()
    assert optional_packages.missing_tabpfn(str(file)) == ""


@pytest.mark.parametrize("model", [RealMlp(), TabPfn()])
def test_what_cannot_be_saved_says_so(model, tmp_path):
    with pytest.raises(StoreError, match="cannot be saved"):
        model.save(tmp_path / "model")
