"""Model files: what is read back, and what is refused."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import skops.io
import torch
from safetensors import safe_open
from safetensors.numpy import save_file
from sklearn.base import BaseEstimator
from sklearn.preprocessing import FunctionTransformer

from quick_models import KEYS, quick_model, twin_data
from stiff_models import load
from stiff_models.base import FittedModel
from stiff_models.io.saved import save
from stiff_models.io.state_codec import pack, unpack
from stiff_models.networks.mlp import Mlp
from stiff_protocols.contract.errors import (
    DataError,
    ModelError,
    NotFittedError,
    NotSavable,
    StoreError,
)

NOT_SAVABLE = ("realmlp", "tabm", "tabpfn")


@pytest.mark.parametrize("key", KEYS)
def test_every_built_in_predicts_the_same_bits_after_a_round_trip(key, tmp_path):
    model, samples = quick_model(key), twin_data().samples
    path = tmp_path / "model.stiff"
    if key in NOT_SAVABLE:
        with pytest.raises(NotSavable) as refused:
            model.save(path)
        pytest.skip(str(refused.value))
    model.save(path)
    loaded = load(path)
    assert type(loaded) is type(model)
    np.testing.assert_array_equal(
        loaded.predict(samples.q, samples.wrench), model.predict(samples.q, samples.wrench)
    )
    if hasattr(model, "predict_interval"):
        ours, theirs = (m.predict_interval(samples.q, samples.wrench, 0.9) for m in (model, loaded))
        np.testing.assert_array_equal([ours.lower, ours.upper], [theirs.lower, theirs.upper])
    assert vars(loaded).keys() == vars(model).keys()
    assert loaded.robot_.name == "kr10_r1100_2"


@pytest.mark.slow
def test_a_fresh_process_predicts_the_same_bits_and_imports_nothing_heavy_before(tmp_path):
    model, samples = quick_model("ft-mlp"), twin_data().samples
    model.save(tmp_path / "model.stiff")
    np.savez(tmp_path / "loads.npz", q=samples.q, wrench=samples.wrench)
    program = (
        "import sys, numpy as np\n"
        "from stiff_models import load\n"
        "assert not {'torch', 'sklearn', 'skops'} & sys.modules.keys()\n"
        "loads = np.load('loads.npz')\n"
        "np.save('out.npy', load('model.stiff').predict(loads['q'], loads['wrench']))\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", program], cwd=tmp_path, check=True)
    np.testing.assert_array_equal(
        np.load(tmp_path / "out.npy"), model.predict(samples.q, samples.wrench)
    )


class Holder(FittedModel):
    """Holds whatever a test puts in."""

    def _predict(self, q, wrench):
        return np.zeros((len(q), 3))


def there_and_back(value):
    holder = Holder()
    holder.value_ = value
    node, arrays = pack(holder, lambda cls: "holder")
    text = json.dumps(node, allow_nan=False)
    return unpack(json.loads(text), arrays, lambda key: Holder).value_


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        7,
        -0.0,
        0.1,
        "text",
        np.float32(0.1),
        np.int64(3),
        np.bool_(True),
        np.array([np.nan, np.inf, -0.0]),
        np.array(["A1", "Gelenk ü"]),
        np.array([], dtype=np.int16),
        np.array([[True, False]]),
        np.array([1 + 2j]),
        np.array(5.0),
    ],
)
def test_plain_values_come_back_as_they_were(value):
    back = there_and_back(value)
    assert type(back) is type(value)
    np.testing.assert_array_equal(back, value)
    assert np.asarray(back).dtype == np.asarray(value).dtype
    assert np.asarray(back).tobytes() == np.asarray(value).tobytes()


def test_numbers_that_json_has_not_and_nested_containers_come_back(rng):
    back = there_and_back({1: (float("inf"), [float("-inf"), {"a": (2,)}])})
    assert back == {1: (float("inf"), [float("-inf"), {"a": (2,)}])}
    assert np.isnan(there_and_back(float("nan")))


def test_arrays_keep_their_order_in_memory(rng):
    back = there_and_back(rng.normal(size=(4, 3)).T)
    assert back.flags.f_contiguous and not back.flags.c_contiguous


@pytest.mark.parametrize("value", [object(), np.array([object()]), {1}, lambda: 0, BaseEstimator])
def test_what_no_file_can_hold_is_refused_by_its_attributes_name(value):
    with pytest.raises(ModelError, match=r"Holder\.value_"):
        there_and_back(value)


def test_an_unfitted_model_is_refused(tmp_path):
    with pytest.raises(NotFittedError):
        save(Mlp(), tmp_path / "model.stiff")


def test_a_strangers_model_is_refused(tmp_path):
    model = Holder()
    model.robot_ = twin_data().robot
    with pytest.raises(ModelError, match=r"Holder is no model that stiffbench ships.*own means"):
        save(model, tmp_path / "model.stiff")


def test_a_network_of_another_machines_gpu_runs_on_what_is_here(tmp_path, monkeypatch):
    model = copy.copy(quick_model("mlp"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for device, loaded in (("cpu", "cpu"), ("cuda", "auto")):
        model.device = device
        model.save(tmp_path / "model.stiff")
        assert load(tmp_path / "model.stiff").device == loaded


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(StoreError, match="cannot be written"):
        quick_model("vjm").save(tmp_path / "none" / "model.stiff")


def test_files_that_are_none_or_damaged_are_refused_in_one_line(tmp_path):
    path, other = tmp_path / "model.stiff", tmp_path / "other.stiff"
    quick_model("mlp").save(path)
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[-5] ^= 1
    contents = {
        "text": b"no model at all",
        "empty": b"",
        "cut": whole[:-100],
        "cut head": whole[:50],
        "flipped": bytes(flipped),
    }
    for name, content in contents.items():
        other.write_bytes(content)
        with pytest.raises(DataError, match=r"other\.stiff: ") as refused:
            load(other)
        assert "\n" not in str(refused.value), name
    with pytest.raises(DataError, match="No such file"):
        load(tmp_path / "none.stiff")
    with pytest.raises(DataError, match="Is a directory"):
        load(tmp_path)


def test_a_safetensors_file_of_somebody_else_is_refused(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_file({"weight": np.zeros(3)}, path)
    with pytest.raises(DataError, match="no model file of stiffbench's"):
        load(path)


@pytest.fixture()
def tampered(tmp_path):
    """A function that saves a model, changes the head of its file, and returns the file."""

    def make(change, key="vjm", extra=None):
        path = tmp_path / "model.stiff"
        quick_model(key).save(path)
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata()
            arrays = {name: file.get_tensor(name) for name in file.keys()}
        arrays |= extra or {}
        head = json.loads(metadata["stiffbench_model"])
        change(head)
        text = json.dumps(head)
        digest = hashlib.sha256(text.encode())
        for name in sorted(arrays):
            digest.update(name.encode() + arrays[name].tobytes())
        save_file(arrays, path, metadata={"stiffbench_model": text, "sha256": digest.hexdigest()})
        return path

    return make


def fitted(**nodes):
    return lambda head: head["model"]["fitted"].update(nodes)


CHANGES = {
    "has format 2": lambda head: head.update(format=2),
    "unknown model 'vjn'": lambda head: head["model"].update(key="vjn"),
    "names no model": lambda head: head["model"].pop("key"),
    "of os:system,": fitted(a_={"type": "record", "class": "os:system", "fields": {}}),
    "of posix:system,": fitted(a_={"type": "model", "class": "posix:system"}),
    "of stiff_models.io.saved:load,": fitted(
        a_={"type": "record", "class": "stiff_models.io.saved:load", "fields": {"path": "x"}}
    ),
    "of stiff_models.io.saved:Path,": fitted(
        a_={"type": "record", "class": "stiff_models.io.saved:Path", "fields": {}}
    ),
    "which is no frozen dataclass": fitted(
        a_={"type": "record", "class": "stiff_models.networks.mlp:Mlp", "fields": {}}
    ),
    "which is no model": fitted(
        a_={
            "type": "model",
            "class": "stiff_models.networks.features:Scaler",
            "params": {},
            "fitted": {},
        }
    ),
    "sets 'predict'": fitted(predict=0),
    "sets '__class__'": fitted(__class__=0),
    "array of object": fitted(
        a_={"type": "array", "data": "0", "dtype": "|O", "shape": [1]},
    ),
    "KeyError": lambda head: head["model"].pop("params"),
    "unexpected keyword argument 'colour'": lambda head: head["model"]["params"].update(colour=1),
}


@pytest.mark.parametrize("message", CHANGES)
def test_a_crafted_file_builds_nothing_that_is_not_ours(message, tampered):
    with pytest.raises(DataError, match=r"model\.stiff: ") as refused:
        load(tampered(CHANGES[message]))
    assert message in str(refused.value)


def test_a_crafted_scikit_learn_part_is_refused_by_its_types_name(tampered):
    data = np.frombuffer(skops.io.dumps(FunctionTransformer(func=os.system)), dtype=np.uint8)
    node = {"type": "estimator", "data": "x", "dtype": "|u1", "shape": [len(data)]}
    with pytest.raises(DataError, match=r"holds posix\.system, which is not loaded"):
        load(tampered(fitted(a_=node), extra={"x": data}))


@pytest.mark.parametrize(("option", "value"), [("layers", 10**9), ("width", 0), ("width", "all")])
def test_a_network_that_no_user_could_ask_for_is_not_built(option, value, tampered):
    def change(head):
        head["model"]["params"][option] = value

    with pytest.raises(DataError, match=rf"model\.stiff: has the option {option} = "):
        load(tampered(change, key="mlp"))
