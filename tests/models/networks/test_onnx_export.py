"""Networks as ONNX files, run by onnxruntime."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from helpers.made_samples import samples_with
from helpers.quick_models import KEYS, quick_model, twin_data
from stiff_models.networks.mlp import Mlp
from stiff_models.networks.onnx_export import export_onnx
from stiff_models.transfer.compliance_net import ComplianceNet
from stiff_protocols.contract.errors import ConfigError

onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")


pytestmark = pytest.mark.xdist_group("onnx")  # an import of seconds, in one process
LONG = (
    *("mlp", "mlp-pretrained", "ft-mlp", "deep-ensemble", "residual-mlp"),
    *("compliance-net", "dt-cnn", "adann-2r"),
)
"""Networks: an export takes seconds."""


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=[pytest.mark.slow] * (key in LONG)) for key in KEYS]
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
        (ours,) = session.run(["deflection"], {"q": samples.q[:n], "wrench": samples.wrench[:n]})
        assert ours.shape == (n, 3) and ours.dtype == np.float64
        assert np.abs(ours - predicted[:n]).max() <= 1e-6
    meta = session.get_modelmeta().custom_metadata_map
    assert meta["robot"] == model.robot_.name and "rad" in meta["units"]


@pytest.mark.slow
@pytest.mark.parametrize("family", [Mlp, ComplianceNet])
def test_a_robot_with_a_slide_and_raw_angles_is_exported_whole(family, tmp_path, rng):
    kr10 = twin_data().robot
    robot = replace(kr10, joint_types=("prismatic", *kr10.joint_types[1:]))
    q, wrench = rng.uniform(-1.0, 1.0, size=(40, 6)), rng.normal(scale=50.0, size=(40, 6))
    compliance = np.array([1e-6, 2e-6, 2e-6, 4e-6, 4e-6, 4e-6])  # m/N, then rad/(N m)
    deflection = robot.joint_deflection(compliance, q, wrench)
    model = family(width=16, epochs=200, angle_encoding="raw", device="cpu")
    model.fit(samples_with(q, wrench, deflection), robot=robot)
    export_onnx(model, tmp_path / "net.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "net.onnx")
    predicted = model.predict(q, wrench)
    assert predicted.std() > 0.1 * deflection.std()
    for n in (1, 40):
        (ours,) = session.run(None, {"q": q[:n], "wrench": wrench[:n]})
        assert ours.shape == (n, 3)
        assert np.abs(ours - predicted[:n]).max() <= 1e-5 * np.abs(predicted).max()


def test_a_missing_package_is_named_with_the_extra_that_brings_it(tmp_path, monkeypatch):
    model = quick_model("mlp")
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "onnxscript" else find(name)
    )
    with pytest.raises(ConfigError, match=r"onnxscript.*stiffbench\[onnx\]"):
        export_onnx(model, tmp_path / "net.onnx")
