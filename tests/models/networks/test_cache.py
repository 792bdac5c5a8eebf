"""The cache of trainings: what its key holds, and what it survives."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import joblib
import numpy as np
import pytest
import torch

from stiff_models.networks import cache
from stiff_models.networks.arithmetic import Arithmetic
from stiff_models.networks.cache import cache_info, clear_cache
from stiff_models.transfer import pretraining
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.mlp_pretrained import MlpPretrained
from stiff_protocols.contract.errors import StiffBenchWarning

pytestmark = pytest.mark.usefixtures("small_source")

NEITHER = Arithmetic("highest", bfloat16=False)
SMALL = {"width": 8, "pretrain_steps": 10, "device": "cpu", "source_poses": "data"}
SMALL |= {"anchor": "none"}


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def fit(twin, seed=1, **options):
    train = twin.samples.take(np.arange(100))
    model = FtMlp(**SMALL | {"epochs": 3} | options)
    return model.fit(train, robot=twin.robot, seed=seed)


def test_variants_of_fine_tuning_pre_train_once_and_so_does_the_pretrained_model(twin, trainings):
    for freeze in ("layers:1,2", "full", "head"):
        fit(twin, freeze=freeze)
    MlpPretrained(**SMALL).fit(twin.samples.take(np.arange(100)), robot=twin.robot, seed=1)
    assert trainings == ["pre-train"]
    assert cache_info().entries == 1 and cache_info().size_bytes > 0


def test_the_source_error_is_measured_once_and_kept_with_the_training(twin, monkeypatch):
    first = fit(twin).source_errors_
    monkeypatch.delattr(pretraining, "some_of")
    np.testing.assert_array_equal(fit(twin, freeze="full").source_errors_, first)
    assert first.shape == (7,) and (first > 0).all()


def test_other_training_samples_are_another_training(twin, trainings):
    fit(twin)
    scale = np.where(np.arange(151) < 100, 1.0, 7.0)[:, None]
    moved = replace(twin.samples, deflection=twin.samples.deflection * scale)
    FtMlp(**SMALL, epochs=3).fit(moved.take(np.arange(101)), robot=twin.robot, seed=1)
    assert len(trainings) == 2


class Wavy(torch.nn.Sequential):
    """A stranger's network."""


class Strange(MlpPretrained):
    """A plugin's model."""

    def _new_network(self, n_inputs, seed, n_outputs=3):
        return Wavy(*super()._new_network(n_inputs, seed, n_outputs))


def test_a_strangers_code_is_part_of_the_key(twin, monkeypatch, tmp_path, trainings):
    train = twin.samples.take(np.arange(100))
    source = tmp_path / "plugin.py"
    monkeypatch.setattr(sys.modules[Wavy.__module__], "__file__", str(source))
    for text, trained in (("a", 1), ("a", 1), ("bb", 2)):
        source.write_text(text)
        Strange(**SMALL).fit(train, robot=twin.robot, seed=1)
        assert len(trainings) == trained


def test_our_own_files_are_no_part_of_the_key(twin, monkeypatch, trainings):
    def read(path):
        raise AssertionError(path)

    monkeypatch.setattr("stiff_protocols.contract.source_code.file_code", read)
    fit(twin)
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
    twin, monkeypatch, trainings, name, value
):
    monkeypatch.setattr(cache, "arithmetic", lambda device, mixed_precision: NEITHER)
    fit(twin)
    monkeypatch.setattr(cache, name, value)
    fit(twin)
    assert len(trainings) == 2


def test_a_full_disk_is_a_warning_and_no_failure(twin, monkeypatch, trainings):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    expected = fit(twin).predict(twin.samples.q, twin.samples.wrench)
    clear_cache()
    monkeypatch.setattr(joblib.memory.MemorizedFunc, "_check_previous_func_code", full)
    with pytest.warns(StiffBenchWarning, match="No space left"):
        model = fit(twin)
    np.testing.assert_array_equal(model.predict(twin.samples.q, twin.samples.wrench), expected)
    assert len(trainings) == 2


def test_a_folder_where_everybody_may_write_is_not_used(twin, empty_cache):
    empty_cache.mkdir()
    empty_cache.chmod(0o777)
    with pytest.warns(StiffBenchWarning, match="others may write"):
        fit(twin)
    assert not [*empty_cache.iterdir()]


def test_no_steps_are_not_kept(twin):
    train = twin.samples.take(np.arange(100))
    MlpPretrained(**SMALL | {"pretrain_steps": 0}).fit(train, robot=twin.robot)
    assert cache_info().entries == 0


def test_switched_off_it_keeps_nothing(twin, trainings, monkeypatch, empty_cache):
    monkeypatch.setenv("STIFFBENCH_CACHE", "off")
    fit(twin)
    fit(twin)
    assert len(trainings) == 2 and not empty_cache.exists()
    assert cache_info().folder is None


def test_a_damaged_entry_is_trained_again(twin, trainings, empty_cache):
    first = fit(twin).predict(twin.samples.q, twin.samples.wrench)
    (stored,) = empty_cache.rglob("output.pkl")
    stored.write_bytes(stored.read_bytes()[:100])
    again = fit(twin).predict(twin.samples.q, twin.samples.wrench)
    np.testing.assert_array_equal(first, again)
    assert len(trainings) == 2


PROGRAM = """
import time, numpy as np
from stiff_models.networks.cache import Trained, remembered
from stiff_models.networks.training import Curve
for number in range(20):
    def compute():
        time.sleep(0.01)
        print("computed")
        curve = Curve(np.ones((1, 3)), 1, 0.0)
        return Trained({"a": np.full(10_000, number)}, curve, 0.0, np.ones(3))
    assert (remembered(str(number), compute).weights["a"] == number).all()
"""


@pytest.mark.slow
def test_processes_that_use_it_at_once_harm_nothing_and_a_later_one_computes_nothing():
    words = [sys.executable, "-c", PROGRAM]
    at_once = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=60)[0] for process in at_once]
    assert [process.returncode for process in at_once] == [0, 0]
    assert "".join(said).count("computed") >= 20
    for number in range(20):
        found = cache.remembered(str(number), lambda: pytest.fail("computed again"))
        assert (found.weights["a"] == number).all()
    assert cache_info().entries == 20
