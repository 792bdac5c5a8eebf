"""Check that model files read back unchanged and that wrong files are refused."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import skops.io
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

from helpers.model_files import archived, changed, saved_model
from helpers.quick_models import quick_model, twin_data
from stiff_models import load
from stiff_models.io.model_file import TRUSTED, save
from stiff_models.networks.mlp import Mlp
from stiff_protocols.contract.errors import DataError, ModelError, NotFittedError, StoreError


class ThirdPartyRegressor(LinearRegression):
    """Stand for an estimator outside scikit-learn."""


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
    loaded = skops.io.loads(skops.io.dumps(regressor), trusted=list(TRUSTED))
    np.testing.assert_array_equal(loaded.predict(inputs), regressor.predict(inputs))


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


def save_and_load(value, folder):
    holder = copy.copy(quick_model("zero"))
    holder.value_ = value
    holder.save(folder / "model.stiff")
    return load(folder / "model.stiff").value_


def test_numbers_that_json_has_not_and_nested_containers_come_back(tmp_path):
    nested = {1: (float("inf"), [float("-inf"), {"a": (2,)}])}
    assert save_and_load(nested, tmp_path) == nested
    assert np.isnan(save_and_load(float("nan"), tmp_path))


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (object(), "builtins.object"),
        (np.array([object()]), "builtins.object"),
        (lambda: 0, "<lambda>"),
        (BaseEstimator, "sklearn.base.BaseEstimator"),
        (FunctionTransformer(func=os.getcwd), "posix.getcwd"),
        (ThirdPartyRegressor(), "ThirdPartyRegressor"),
    ],
)
def test_what_no_file_can_hold_is_refused_by_its_types_name(value, name, tmp_path):
    with pytest.raises(ModelError, match="zero cannot be saved: it holds ") as caught_error:
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
    bomb = {"schema.json": bytes(2**20)}
    for content, message in (
        (b"no model at all", "not a model file, or a corrupt file"),
        (b"", "not a model file, or a corrupt file"),
        (valid[:-100], "not a model file, or a corrupt file"),
        (valid[:50], "not a model file, or a corrupt file"),
        (bytes(flipped_bytes), ""),
        (archived({"weight.npy": bytes(3)}), "not a model file of stiffbench"),
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


def replace_attribute(kind, name, **parts):
    return change_fitted(a_={"stiffbench": kind, "class": name} | parts)


CHANGES = {
    "has format 3": lambda content: content.update(format=3),
    "unknown model 'vjn'": lambda content: content["model"].update({"class": "vjn"}),
    "KeyError: 'class'": lambda content: content["model"].pop("class"),
    "unknown model 'os:system'": replace_attribute("record", "os:system", fields={}),
    "holds stiff_models.io.model_file:load,": replace_attribute(
        "record", "stiff_models.io.model_file:load", fields={"path": "x"}
    ),
    "holds stiff_models.io.model_file:Path,": replace_attribute(
        "record", "stiff_models.io.model_file:Path", fields={}
    ),
    "which is not a frozen dataclass": replace_attribute(
        "record", "stiff_models.networks.mlp:Mlp", fields={}
    ),
    "which is not a stiffbench model": replace_attribute(
        "model", "stiff_models.networks.encoded_model:Scaler", params={}, fitted={}
    ),
    "sets 'predict'": change_fitted(predict=0),
    "sets '__class__'": change_fitted(__class__=0),
    "unexpected keyword argument 'colour'": lambda content: content["model"]["params"].update(
        colour=1
    ),
    "a model without its robot": change_fitted(robot_="kr10"),
    "lengths are in m": lambda content: content["model"]["fitted"]["robot_"]["fields"].update(
        tcp=np.array([1e300, 0.0, 0.0])
    ),
    "is not a rotation": lambda content: content["model"]["fitted"]["robot_"]["fields"].update(
        flange=np.zeros((4, 4))
    ),
    "posix.getcwd": change_fitted(a_=FunctionTransformer(func=os.getcwd)),
    "test_model_file.ThirdPartyRegressor": change_fitted(a_=ThirdPartyRegressor()),
}


@pytest.mark.parametrize("message", CHANGES)
def test_a_crafted_file_builds_nothing_that_is_not_ours(message, tmp_path):
    with pytest.raises(DataError, match=r"model\.stiff: ") as caught_error:
        load(changed(saved_model(tmp_path, "vjm"), CHANGES[message]))
    assert message in str(caught_error.value)


@pytest.mark.parametrize(("option", "value"), [("layers", 10**9), ("width", 0), ("width", "all")])
def test_a_network_that_no_user_could_ask_for_is_not_built(option, value, tmp_path):
    def change(content):
        content["model"]["params"][option] = value

    with pytest.raises(DataError, match=rf"model\.stiff: has the option {option} = "):
        load(changed(saved_model(tmp_path, "mlp"), change))
