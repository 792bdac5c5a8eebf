"""`realmlp`, `tabm` and `tabpfn`: what they say without their package, what they do with it."""

from __future__ import annotations

import importlib.util

import pytest

from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.regressors import optional_packages
from stiff_models.regressors.tabular import RealMlp, TabPfn
from stiff_protocols.contract.errors import ConfigError, StoreError


def test_without_pytabkit_its_families_name_the_extra(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    reason = optional_packages.missing_pytabkit()
    assert reason == "needs the package pytabkit: pip install 'stiffbench[tabular]'"


def test_without_tabpfn_its_family_names_the_extra(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    reason = "needs the package tabpfn: pip install 'stiffbench[tabpfn]'"
    assert optional_packages.missing_tabpfn() == reason
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
