"""The cache of trainings: what its key holds, and what it survives."""

from __future__ import annotations

import sys
from dataclasses import replace

import joblib
import numpy as np
import pytest
import torch

from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.networks import cache, network_model
from stiff_models.networks.arithmetic import Arithmetic
from stiff_models.networks.cache import cache_info, clear_cache
from stiff_models.transfer import mlp_pretrained
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.mlp_pretrained import MlpPretrained
from stiff_protocols.contract.errors import StiffBenchWarning

pytestmark = pytest.mark.usefixtures("small_source")

NEITHER = Arithmetic("highest", bfloat16=False)
SMALL = {"width": 8, "pretrain_steps": 10, "device": "cpu", "source_poses": "data"}


@pytest.fixture(scope="module")
def data():
    return Kr10Twin().load()


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture()
def trainings(monkeypatch):
    """Counts what is really trained."""
    done = []
    real = network_model.train_network

    def counted(*args, **options):
        done.append(options["phase"])
        return real(*args, **options)

    monkeypatch.setattr(network_model, "train_network", counted)
    return done


def fit(data, seed=1, **options):
    train = data.samples.take(np.arange(100))
    return FtMlp(**SMALL, epochs=3, **options).fit(train, robot=data.robot, seed=seed)


def test_variants_of_fine_tuning_pre_train_once_and_so_does_the_pretrained_model(data, trainings):
    for freeze in ("layers:1,2", "full", "head", "bias", "l2sp"):
        fit(data, freeze=freeze)
    MlpPretrained(**SMALL).fit(data.samples.take(np.arange(100)), robot=data.robot, seed=1)
    assert trainings == ["pre-train"]
    assert cache_info().entries == 1 and cache_info().size_bytes > 0


def test_the_source_error_is_measured_once_and_kept_with_the_training(data, monkeypatch):
    first = fit(data).source_errors_
    monkeypatch.delattr(mlp_pretrained, "source_errors")
    np.testing.assert_array_equal(fit(data, freeze="full").source_errors_, first)
    assert first.shape == (7,) and (first > 0).all()


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 2},
        {"width": 9},
        {"activation": "tanh"},
        {"recipe": "paper"},
        {"pretrain_steps": 11},
    ],
)
def test_another_seed_network_or_plan_is_another_training(data, trainings, change, monkeypatch):
    fit(data)
    seed = change.get("seed", 1)
    options = {k: v for k, v in change.items() if k != "seed"}
    train = data.samples.take(np.arange(100))
    FtMlp(**SMALL | {"epochs": 3} | options).fit(train, robot=data.robot, seed=seed)
    assert len(trainings) == 2


def test_other_training_samples_are_another_training_and_test_samples_are_no_part_of_the_key(
    data, trainings
):
    fit(data)
    scale = np.where(np.arange(151) < 100, 1.0, 7.0)[:, None]
    moved = replace(data.samples, deflection=data.samples.deflection * scale)
    train = moved.take(np.arange(100))  # rows 100.. are the test part
    FtMlp(**SMALL, epochs=3).fit(train, robot=data.robot, seed=1)
    assert len(trainings) == 1
    FtMlp(**SMALL, epochs=3).fit(moved.take(np.arange(101)), robot=data.robot, seed=1)
    assert len(trainings) == 2


class Wavy(torch.nn.Sequential):
    """A stranger's network."""


class Strange(MlpPretrained):
    """A plugin's model."""

    def _new_network(self, seed):
        return Wavy(*super()._new_network(seed))


def test_a_strangers_code_is_part_of_the_key(data, monkeypatch, tmp_path, trainings):
    train = data.samples.take(np.arange(100))
    source = tmp_path / "plugin.py"
    monkeypatch.setattr(sys.modules[Wavy.__module__], "__file__", str(source))
    for text, trained in (("a", 1), ("a", 1), ("bb", 2)):
        source.write_text(text)
        Strange(**SMALL).fit(train, robot=data.robot, seed=1)
        assert len(trainings) == trained


def test_our_own_files_are_no_part_of_the_key(data, monkeypatch, trainings):
    def read(path):
        raise AssertionError(path)

    monkeypatch.setattr("stiff_protocols.contract.source_code.file_code", read)
    fit(data)
    assert len(trainings) == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PRETRAINING_VERSION", cache.PRETRAINING_VERSION + 1),
        ("arithmetic", lambda device, mixed_precision: Arithmetic("highest", mixed_precision)),
        ("arithmetic", lambda device, mixed_precision: Arithmetic("medium", False)),
        ("_machine", lambda device: "GPU"),
    ],
)
def test_another_version_or_machines_rounding_is_another_training(
    data, monkeypatch, trainings, name, value
):
    monkeypatch.setattr(cache, "arithmetic", lambda device, mixed_precision: NEITHER)
    fit(data)
    monkeypatch.setattr(cache, name, value)
    fit(data)
    assert len(trainings) == 2


def test_a_full_disk_is_a_warning_and_no_failure(data, monkeypatch, trainings):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    expected = fit(data).predict(data.samples.q, data.samples.wrench)
    clear_cache()
    monkeypatch.setattr(joblib.memory.MemorizedFunc, "_check_previous_func_code", full)
    with pytest.warns(StiffBenchWarning, match="No space left"):
        model = fit(data)
    np.testing.assert_array_equal(model.predict(data.samples.q, data.samples.wrench), expected)
    assert len(trainings) == 2


def test_a_folder_where_everybody_may_write_is_not_used(data, empty_cache):
    empty_cache.mkdir()
    empty_cache.chmod(0o777)
    with pytest.warns(StiffBenchWarning, match="others may write"):
        fit(data)
    assert not [*empty_cache.iterdir()]


def test_no_steps_are_not_kept(data):
    train = data.samples.take(np.arange(100))
    MlpPretrained(**SMALL | {"pretrain_steps": 0}).fit(train, robot=data.robot)
    assert cache_info().entries == 0


def test_clearing_the_cache_empties_it(data, trainings, empty_cache):
    fit(data)
    assert clear_cache().entries == 1
    assert cache_info().entries == 0
    fit(data)
    assert len(trainings) == 2


def test_switched_off_it_keeps_nothing(data, trainings, monkeypatch, empty_cache):
    monkeypatch.setenv("STIFFBENCH_CACHE", "off")
    fit(data)
    fit(data)
    assert len(trainings) == 2 and not empty_cache.exists()
    assert cache_info().folder is None


def test_a_damaged_entry_is_trained_again(data, trainings, empty_cache):
    first = fit(data).predict(data.samples.q, data.samples.wrench)
    (stored,) = empty_cache.rglob("output.pkl")
    stored.write_bytes(stored.read_bytes()[:100])
    again = fit(data).predict(data.samples.q, data.samples.wrench)
    np.testing.assert_array_equal(first, again)
    assert len(trainings) == 2
