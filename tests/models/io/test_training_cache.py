"""Check the keys of the cache of trainings, and how it handles broken entries."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from types import SimpleNamespace

import joblib
import numpy as np
import pytest
import torch

from stiff_models.device import Arithmetic
from stiff_models.io.cache_folder import cache_folder
from stiff_models.transfer import pretraining
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.pretrained_mlp import MlpPretrained
from stiff_protocols.contract.errors import StiffBenchWarning

pytestmark = pytest.mark.usefixtures("small_source")

SMALL = {"width": 8, "pretrain_steps": 10, "device": "cpu", "anchor": "none"}


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def fit(twin, cls=FtMlp, n_rows=100, seed=1, **options):
    samples = twin.samples.take(np.arange(n_rows))
    options = SMALL | ({"epochs": 3} if cls is FtMlp else {}) | options
    return cls(**options).fit(samples, robot=twin.robot, seed=seed)


@pytest.mark.slow
def test_variants_of_fine_tuning_pre_train_once_and_so_does_the_pretrained_model(
    twin, trainings, monkeypatch
):
    first = fit(twin).source_errors_
    monkeypatch.delattr(pretraining, "some_of")  # errors on the source are kept with the training
    for freeze in ("full", "head"):
        np.testing.assert_array_equal(fit(twin, freeze=freeze).source_errors_, first)
    fit(twin, MlpPretrained)
    assert trainings == ["pre-train"] and (first > 0).all()


def test_other_training_samples_are_another_training(twin, trainings):
    fit(twin)
    moved = replace(twin.samples, deflection=7.0 * twin.samples.deflection)
    fit(replace(twin, samples=moved))
    assert len(trainings) == 2


class Wavy(torch.nn.Sequential):
    """Stand for a third-party network."""


class ThirdParty(MlpPretrained):
    """Stand for a plugin's model."""

    def _new_network(self, n_inputs, seed, n_outputs=3):
        return Wavy(*super()._new_network(n_inputs, seed, n_outputs))


def test_third_party_code_is_part_of_the_key(twin, monkeypatch, tmp_path, trainings):
    source = tmp_path / "plugin.py"
    monkeypatch.setattr(sys.modules[Wavy.__module__], "__file__", str(source))
    for text, n_trainings in (("a", 1), ("a", 1), ("bb", 2)):
        source.write_text(text)
        fit(twin, ThirdParty)
        assert len(trainings) == n_trainings


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PRETRAINING_VERSION", pretraining.PRETRAINING_VERSION + 1),
        ("arithmetic", lambda device, mixed_precision: Arithmetic("highest", mixed_precision)),
        ("arithmetic", lambda device, mixed_precision: Arithmetic("medium", False)),
        ("platform", SimpleNamespace(machine=lambda: "another")),
    ],
)
def test_another_version_or_machines_rounding_is_another_training(
    twin, monkeypatch, trainings, name, value
):
    neither = Arithmetic("highest", bfloat16=False)
    monkeypatch.setattr(pretraining, "arithmetic", lambda device, mixed_precision: neither)
    fit(twin)
    monkeypatch.setattr(pretraining, name, value)
    fit(twin)
    assert len(trainings) == 2


def test_a_full_disk_is_a_warning_and_no_failure(twin, monkeypatch, trainings):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    expected = fit(twin).predict(twin.samples.q, twin.samples.wrench)
    shutil.rmtree(cache_folder())
    monkeypatch.setattr(joblib.memory.MemorizedFunc, "_check_previous_func_code", full)
    with pytest.warns(StiffBenchWarning, match="No space left"):
        model = fit(twin)
    np.testing.assert_array_equal(model.predict(twin.samples.q, twin.samples.wrench), expected)
    assert len(trainings) == 2


def test_no_steps_are_not_kept_and_switched_off_nothing_is(
    twin, trainings, monkeypatch, empty_cache
):
    fit(twin, MlpPretrained, pretrain_steps=0)
    assert not empty_cache.exists()
    monkeypatch.setenv("STIFFBENCH_CACHE", "off")
    fit(twin)
    fit(twin)
    assert trainings[-2:] == ["pre-train"] * 2 and not empty_cache.exists()


def test_a_damaged_entry_is_trained_again(twin, trainings, empty_cache):
    before = fit(twin).predict(twin.samples.q, twin.samples.wrench)
    (entry,) = empty_cache.rglob("output.pkl")
    entry.write_bytes(entry.read_bytes()[:100])
    after = fit(twin).predict(twin.samples.q, twin.samples.wrench)
    np.testing.assert_array_equal(before, after)
    assert len(trainings) == 2
