"""Check that model files read back unchanged and that wrong files are refused."""

from __future__ import annotations

import copy
import io
import json
import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import torch
from sklearn.base import BaseEstimator
from sklearn.ensemble import (
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, Matern, WhiteKernel
from sklearn.linear_model import LinearRegression
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.preprocessing import FunctionTransformer

from helpers.model_files import archived, changed, members, npy_header, saved_model
from helpers.quick_models import quick_model, twin_data
from stiff_models import load
from stiff_models.io.model_file import TRUSTED, save
from stiff_models.networks.mlp import Mlp
from stiff_protocols.contract.errors import DataError, ModelError, NotFittedError, StoreError
from stiff_protocols.scoring.cross_validated import CrossValidatedError


class ThirdPartyRegressor(LinearRegression):
    """Stand for an estimator outside scikit-learn."""


@pytest.mark.slow
@pytest.mark.parametrize("key", ["gp", "vjm-gp", "deep-ensemble"])
def test_intervals_have_the_same_bits_after_a_round_trip(key, tmp_path):
    """Compare only intervals; the conformance suite compares every model's predictions."""
    model, samples = quick_model(key), twin_data().samples
    model.save(tmp_path / "model.stiff")
    loaded_model = load(tmp_path / "model.stiff")
    before, after = (
        m.predict_interval(samples.q, samples.wrench, 0.9) for m in (model, loaded_model)
    )
    np.testing.assert_array_equal([before.lower, before.upper], [after.lower, after.upper])
    assert type(loaded_model) is type(model) and vars(loaded_model).keys() == vars(model).keys()
    assert loaded_model.robot_.name == "kr10_r1100_2"


REGRESSORS = [
    RandomForestRegressor(n_estimators=3, random_state=0),
    MultiOutputRegressor(GradientBoostingRegressor(n_estimators=3)),
    MultiOutputRegressor(HistGradientBoostingRegressor(max_iter=3)),
    GaussianProcessRegressor(RBF() + Matern() * 2.0 + WhiteKernel(), optimizer=None),
    KNeighborsRegressor(algorithm="kd_tree"),
    KNeighborsRegressor(algorithm="ball_tree"),
    MLPRegressor(hidden_layer_sizes=(5,), n_iter_no_change=2, tol=10.0),
]


@pytest.mark.parametrize("regressor", REGRESSORS, ids=lambda regressor: type(regressor).__name__)
def test_a_trusted_regressor_predicts_the_same_bits_after_a_round_trip(regressor, rng):
    inputs = rng.normal(size=(120, 4))
    regressor.fit(inputs, inputs @ rng.normal(size=(4, 3)))
    import skops.io  # takes a second, which collecting the tests would pay

    loaded = skops.io.loads(skops.io.dumps(regressor), trusted=list(TRUSTED))
    np.testing.assert_array_equal(loaded.predict(inputs), regressor.predict(inputs))


FRESH = """
import sys, numpy as np
from stiff_models import load
loads = np.load('loads.npz')
np.save('out.npy', load('model.stiff').predict(loads['q'], loads['wrench']))
print([name for name in ('torch', 'sklearn', 'skops', 'pandas') if name in sys.modules])
"""


@pytest.mark.parametrize(
    ("key", "imported_packages"),
    [
        ("vjm-full", []),
        pytest.param("bayes-springs", [], marks=pytest.mark.slow),
        pytest.param("vjm-gp", [], marks=pytest.mark.slow),
        pytest.param("ft-mlp", ["torch"], marks=pytest.mark.slow),
    ],
)
def test_a_fresh_process_predicts_the_same_bits_and_imports_only_what_its_model_needs(
    key, imported_packages, tmp_path
):
    model, samples = quick_model(key), twin_data().samples
    model.save(tmp_path / "model.stiff")
    np.savez(tmp_path / "loads.npz", q=samples.q, wrench=samples.wrench)
    command = [sys.executable, "-W", "error", "-c", FRESH]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == str(imported_packages)
    np.testing.assert_array_equal(
        np.load(tmp_path / "out.npy"), model.predict(samples.q, samples.wrench)
    )


def test_a_spring_models_file_is_read_by_json_and_numpy_as_its_page_says(tmp_path):
    path, springs = saved_model(tmp_path, "vjm"), quick_model("vjm").springs_
    with zipfile.ZipFile(path) as archive:
        fitted = json.loads(archive.read("model.json"))["model"]["fitted"]
        fields = fitted["springs_"]["fields"]
        compliance = np.load(io.BytesIO(archive.read(fields["compliance"]["file"])))
    np.testing.assert_array_equal(compliance, springs.compliance)
    assert tuple(fields["units"]["items"]) == springs.units
    with np.load(path) as arrays:
        np.testing.assert_array_equal(arrays[fields["compliance"]["file"][:-4]], compliance)


def save_and_load(value, folder):
    holder = copy.copy(quick_model("zero"))
    holder.value_ = value
    holder.save(folder / "model.stiff")
    return load(folder / "model.stiff").value_


INFINITY = float("inf")


@pytest.mark.parametrize(
    "value",
    [
        {1: (INFINITY, [-INFINITY, {"a": (2,)}])},
        {"type": "array", "file": "x"},
        {"a/b": np.ones(1), "a": {"b": np.zeros(2), "../c": np.ones(3)}, "#2": [np.ones(4)]},
        [True, None, 10**30, -0.0, 5e-324, "\ud800 é", np.str_("text")],
        [np.float64("nan"), np.float32(0.1), np.int8(-3), np.bool_(False), np.complex64(1j)],
        [np.asfortranarray(np.eye(3)[:2]), np.array(7.0), np.empty((0, 3)), np.array(["é", ""])],
        [np.array([1 + 2j]), np.arange(3, dtype=">i2"), np.array(["2026-11-28"], "datetime64[s]")],
        [{1, 2}, b"bytes", slice(1, 2), np.ma.masked_array([1.0, 2.0], [True, False])],
        CrossValidatedError(0.1, 0.2, 0.3, 40, 5),
    ],
    ids=repr,
)
def test_values_of_every_kind_come_back_with_their_types(value, tmp_path):
    assert described(save_and_load(value, tmp_path)) == described(value)


def described(value):
    """Return a text of a value with its types, and with the bits of its arrays."""
    if isinstance(value, np.ndarray | np.generic) and type(value) is not np.str_:
        return f"{type(value)} {value.dtype} {value.shape} {value.tobytes()}"
    if isinstance(value, dict):
        return str([(key, described(part)) for key, part in value.items()])
    if isinstance(value, list | tuple):
        return f"{type(value)} {[described(part) for part in value]}"
    return repr(value) if type(value) is not np.str_ else repr(str(value))


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (object(), "builtins.object"),
        (np.array([object()]), "builtins.object"),
        (lambda: 0, "<lambda>"),
        (BaseEstimator, "sklearn.base.BaseEstimator"),
        (FunctionTransformer(func=os.getcwd), "posix.getcwd"),
        (ThirdPartyRegressor(), "ThirdPartyRegressor"),
        ([torch.nn.Linear(1, 1)], "value_/0 is a torch module"),
    ],
)
def test_what_no_file_can_hold_is_refused_by_its_types_name(value, name, tmp_path):
    with pytest.raises(ModelError, match="zero cannot be saved: ") as caught_error:
        save_and_load(value, tmp_path)
    assert name in str(caught_error.value)
    assert not list(tmp_path.iterdir())


def test_what_is_not_fitted_not_ours_or_has_no_folder_is_refused(tmp_path):
    third_party = ThirdPartyRegressor()
    third_party.robot_ = twin_data().robot
    for model, path, error, message in (
        (Mlp(), "model", NotFittedError, "call fit before save"),
        (
            third_party,
            "model",
            ModelError,
            r"ThirdPartyRegressor is not a stiffbench model.*own library",
        ),
        (quick_model("vjm"), "none/model", StoreError, "cannot be written"),
    ):
        with pytest.raises(error, match=message):
            save(model, tmp_path / path)


def test_a_network_of_another_machines_gpu_runs_on_what_is_here(tmp_path, monkeypatch):
    model = copy.copy(quick_model("mlp"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for device, expected in (("cpu", "cpu"), ("cuda", "auto")):
        model.device = device
        model.save(tmp_path / "model.stiff")
        assert load(tmp_path / "model.stiff").device == expected


def test_files_that_are_none_or_damaged_are_refused_in_one_line(tmp_path):
    path, copy_path = tmp_path / "model.stiff", tmp_path / "other.stiff"
    quick_model("mlp").save(path)
    valid = path.read_bytes()
    flipped_bytes = bytearray(valid)
    flipped_bytes[-5] ^= 1
    bomb = {"model.json": bytes(2**20)}
    for content, message in (
        (b"no model at all", "not a model file, or a corrupt file"),
        (b"", "not a model file, or a corrupt file"),
        (valid[:-100], "not a model file, or a corrupt file"),
        (valid[:50], "not a model file, or a corrupt file"),
        (bytes(flipped_bytes), ""),
        (archived({"weight.npy": bytes(3)}), "not a model file of stiffbench"),
        (archived({"schema.json": b"{}"}), "earlier stiffbench.*fit the model again"),
        (archived(bomb, zipfile.ZIP_DEFLATED), r"file of \d+ bytes unpacks to 1048576"),
    ):
        copy_path.write_bytes(content)
        with pytest.raises(DataError, match=rf"other\.stiff: .*{message}") as caught_error:
            load(copy_path)
        assert "\n" not in str(caught_error.value)
    with pytest.raises(DataError, match="No such file"):
        load(tmp_path / "none.stiff")
    with pytest.raises(DataError, match="Is a directory"):
        load(tmp_path)


def change_fitted(**nodes):
    return lambda content: content["model"]["fitted"].update(nodes)


def replace_attribute(kind, **parts):
    return change_fitted(a_={"type": kind} | parts)


def change_robot(**fields):
    return lambda content: content["model"]["fitted"]["robot_"]["fields"].update(fields)


LOWER = {"type": "array", "file": "model/fitted/robot_/fields/lower.npy"}
CHANGES = {
    "has format 3": lambda content: content.update(format=3),
    "unknown model 'vjn'": lambda content: content["model"].update({"class": "vjn"}),
    "KeyError: 'class'": lambda content: content["model"].pop("class"),
    "unknown model 'os:system'": replace_attribute("record", **{"class": "os:system"}, fields={}),
    "holds stiff_models.io.model_file:load,": replace_attribute(
        "record", **{"class": "stiff_models.io.model_file:load"}, fields={"path": "x"}
    ),
    "holds stiff_models.io.model_file:Path,": replace_attribute(
        "record", **{"class": "stiff_models.io.model_file:Path"}, fields={}
    ),
    "which is not a frozen dataclass": replace_attribute(
        "record", **{"class": "stiff_models.networks.mlp:Mlp"}, fields={}
    ),
    "which is not a stiffbench model": replace_attribute(
        "model", **{"class": "stiff_models.networks.encoded_model:Scaler"}, params={}, fitted={}
    ),
    "the type 'pickle'": replace_attribute("pickle", file="x"),
    "the type 'plugin'": replace_attribute("plugin", key="mine", code="", params={}, fitted={}),
    "the type 'array'": replace_attribute("array", file=["x"]),
    "has no member 'x.npy'": replace_attribute("array", file="x.npy"),
    "names it twice": change_robot(upper=LOWER),
    "which model.json does not name": change_robot(lower=[-3.0] * 6),
    "sets 'predict'": change_fitted(predict=0),
    "sets '__class__'": change_fitted(__class__=0),
    "sets 'robot'": lambda content: content["model"]["modules"].update(robot={}),
    "unexpected keyword argument 'colour'": lambda content: content["model"]["params"].update(
        colour=1
    ),
    "a model without its robot": lambda content: content["model"]["fitted"].update(
        robot_=[content["model"]["fitted"]["robot_"]]
    ),
    "lengths are in m": change_robot(tcp=[1e300, 0.0, 0.0]),
    "is not a rotation": change_robot(flange=[[0.0] * 4] * 4),
}


@pytest.mark.parametrize("message", CHANGES)
def test_a_crafted_file_builds_nothing_that_is_not_ours(message, tmp_path):
    with pytest.raises(DataError, match=r"model\.stiff: ") as caught_error:
        load(changed(saved_model(tmp_path, "vjm"), CHANGES[message]))
    assert message in str(caught_error.value)


@pytest.mark.parametrize(
    ("regressor", "name"),
    [
        (FunctionTransformer(func=os.getcwd), "posix.getcwd"),
        (ThirdPartyRegressor(), "test_model_file.ThirdPartyRegressor"),
    ],
)
def test_an_object_of_another_type_is_not_built(regressor, name, tmp_path):
    import skops.io

    path, data = saved_model(tmp_path, "vjm"), skops.io.dumps(regressor)
    changed(path, replace_attribute("skops", file="a.skops"), {"a.skops": data})
    with pytest.raises(DataError, match=rf"model\.stiff: .*{name}"):
        load(path)


TCP = "model/fitted/robot_/fields/tcp.npy"
ARRAYS = {
    "another shape": npy_header((4,), "<f8") + bytes(32),
    "more numbers than its shape": npy_header((2,), "<f8") + bytes(24),
    "fewer numbers than its shape": npy_header((3,), "<f8") + bytes(16),
    "terabytes": npy_header((2**40,), "<f8"),
    "endless texts of no letters": npy_header((2**60,), "<U0"),
    "objects": npy_header((3,), "|O") + bytes(24),
    "no array": b"{}",
}


@pytest.mark.parametrize("kind", ARRAYS)
def test_an_array_that_is_not_what_its_head_says_is_refused(kind, tmp_path):
    path = changed(saved_model(tmp_path, "vjm"), lambda content: None, {TCP: ARRAYS[kind]})
    with pytest.raises(DataError, match=r"model\.stiff: "):
        load(path)


@pytest.mark.parametrize(
    "name", ["/etc/x.npy", "../x.npy", "a/../../x.npy", "a\\x.npy", "C:/x", "x/"]
)
def test_a_members_name_that_leaves_the_archive_is_refused(name, tmp_path):
    change = replace_attribute("array", file=name)
    path = changed(saved_model(tmp_path, "vjm"), change, {name: npy_header((0,), "<f8")})
    with pytest.raises(DataError, match=r"model\.stiff: holds "):
        load(path)


def test_what_is_there_twice_is_refused(tmp_path):
    path = saved_model(tmp_path, "vjm")
    parts = members(path.read_bytes())
    twice = parts["model.json"].replace(b'"format": 6', b'"format": 6, "format": 6')
    path.write_bytes(archived(parts | {"model.json": twice}))
    with pytest.raises(DataError, match=r"model\.stiff: has a key twice.*format"):
        load(path)
    path.write_bytes(archived(parts))
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "a") as archive:
        archive.writestr(TCP, parts[TCP])
    with pytest.raises(DataError, match=r"model\.stiff: holds two members of one name"):
        load(path)


def test_a_bomb_in_an_object_of_scikit_learn_is_refused(tmp_path):
    path = saved_model(tmp_path, "knn")
    parts = members(path.read_bytes())
    (name,) = (name for name in parts if name.endswith(".skops"))
    bomb = archived({"schema.json": bytes(2**20)}, zipfile.ZIP_DEFLATED)
    path.write_bytes(archived(parts | {name: bomb}))
    with pytest.raises(DataError, match=r"model\.stiff: .* unpacks to 1048576"):
        load(path)


@pytest.mark.parametrize(("option", "value"), [("layers", 10**9), ("width", 0), ("width", "all")])
def test_a_network_that_no_user_could_ask_for_is_not_built(option, value, tmp_path):
    def change(content):
        content["model"]["params"][option] = value

    with pytest.raises(DataError, match=rf"model\.stiff: has the option {option} = "):
        load(changed(saved_model(tmp_path, "mlp"), change))
