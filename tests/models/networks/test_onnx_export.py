"""Check networks exported as ONNX files by running them in onnxruntime."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import torch

from helpers.quick_models import KEYS, quick_model, twin_data
from stiff_models.networks.onnx_export import export_onnx
from stiff_protocols.contract.errors import ConfigError

onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")


pytestmark = pytest.mark.xdist_group("onnx")  # an import of seconds, in one process
LONG = ("mlp", "mlp-pretrained", "ft-mlp", "residual-mlp", "compliance-net", "dt-cnn", "adann-2r")
"""Networks whose export takes seconds."""
ENSEMBLE = "deep-ensemble"  # takes many times as long; only the mean is new


@pytest.mark.parametrize(
    "key",
    [
        pytest.param(key, marks=[pytest.mark.slow] * (key in LONG))
        for key in KEYS
        if key != ENSEMBLE
    ],
)
def test_onnxruntime_predicts_what_the_model_does(key, tmp_path, capfd):
    model, samples = quick_model(key), twin_data().samples
    path = tmp_path / "net.onnx"
    try:
        export_onnx(model, path)
    except ConfigError as error:  # no network
        assert "cannot be written as ONNX" in str(error)
        assert not hasattr(model, "network_") and not path.exists()
        return
    assert capfd.readouterr() == ("", "")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    predicted = model.predict(samples.q, samples.wrench)
    for n in (len(samples), 1):
        (outputs,) = session.run(["deflection"], {"q": samples.q[:n], "wrench": samples.wrench[:n]})
        assert outputs.shape == (n, 3) and outputs.dtype == np.float64
        assert np.abs(outputs - predicted[:n]).max() <= 1e-6
    meta = session.get_modelmeta().custom_metadata_map
    assert meta["robot"] == model.robot_.name and "rad" in meta["units"]


@pytest.mark.slow
def test_an_ensemble_is_the_mean_of_its_members_in_torch():
    model, samples = quick_model(ENSEMBLE), twin_data().samples
    module = model._torch_module()
    with torch.no_grad():
        outputs = module(torch.tensor(samples.q), torch.tensor(samples.wrench)).numpy()
    np.testing.assert_allclose(outputs, model.predict(samples.q, samples.wrench), atol=1e-6)


@pytest.mark.slow
def test_a_missing_package_is_named_with_the_extra_that_brings_it(tmp_path, monkeypatch):
    model = quick_model("mlp")
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "onnxscript" else find(name)
    )
    with pytest.raises(ConfigError, match=r"onnxscript.*stiffbench\[onnx\]"):
        export_onnx(model, tmp_path / "net.onnx")
