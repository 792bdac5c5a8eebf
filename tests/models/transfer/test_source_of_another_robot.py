"""Check source domains of another robot: its VJM, kinematics and poses."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from sklearn.base import clone

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.twin.robot_twin import Ur5Twin
from stiff_models import load
from stiff_models.model_catalog import MODELS, SpringModel, model_info
from stiff_models.physics.vjm import VirtualJointModel, fitted_physics
from stiff_models.transfer import pretraining
from stiff_models.transfer.compliance_net import ComplianceNet
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.pretrained_mlp import MlpPretrained
from stiff_models.transfer.pretraining import power_of_four
from stiff_models.transfer.source_domain import joint_ranges
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import BenchmarkData

pytestmark = pytest.mark.usefixtures("small_source")

TINY = {"width": 8, "pretrain_steps": 3, "device": "cpu"}
TAKE_A_SOURCE = (
    *("mlp-pretrained", "ft-mlp", "dt-cnn", "adann-2r"),
    *("compliance-net", "deep-ensemble"),
)


@pytest.fixture(scope="module")
def target() -> BenchmarkData:
    return FanucR2000iC().load()


@pytest.fixture(scope="module")
def ur5() -> BenchmarkData:
    return Ur5Twin().load()


def fit_with_source(model, target, source, **fit):
    model.use_source(source)
    return model.fit(target.samples, robot=target.robot, **fit)


def predict(model, data):
    return model.predict(data.samples.q, data.samples.wrench)


def vjm_of(data):
    return VirtualJointModel().fit(data.samples, robot=data.robot)


def test_every_family_with_a_source_domain_takes_another_robots_and_no_other_does():
    usable = [info for info in MODELS if not info.missing()]
    takers = [info.key for info in usable if offers(info.load(), "use_source")]
    assert sorted(takers) == sorted(TAKE_A_SOURCE)


@pytest.mark.parametrize(
    ("key", "options"),
    [
        ("mlp-pretrained", {}),
        *(("mlp-pretrained", {"source_teacher": key}) for key in get_args(SpringModel)[1:-1]),
        pytest.param("mlp-pretrained", {"source_teacher": "bayes-springs"}, marks=pytest.mark.slow),
        pytest.param("ft-mlp", {"preset": "paper"}, marks=pytest.mark.slow),
        ("compliance-net", {"epochs": 0}),
        ("dt-cnn", {"alignment": "mk-mmd"}),
        ("adann-2r", {}),
    ],
)
def test_simulated_deflections_are_those_of_the_source_robots_physics(
    key, options, target, ur5, monkeypatch
):
    domains = []

    def record_domain(domain, seed):
        domains.append(domain)
        return divided(domain, seed)

    divided = pretraining.divided
    monkeypatch.setattr(pretraining, "divided", record_domain)
    options = {"pretrain_steps": 0} | ({} if key == "dt-cnn" else {"width": 8}) | options
    model = fit_with_source(model_info(key).load()(**options, device="cpu"), target, ur5)
    (domain,) = domains
    q, wrench = domain.q[::50], domain.wrench[::50]
    if "preset" not in options:
        lower, upper = joint_ranges(ur5.robot, ur5.samples.q)
        assert (q >= lower).all() and (q <= upper).all()
    physics = fitted_physics(options.get("source_teacher", "vjm"), ur5.samples, ur5.robot)
    if model.shares_pretraining:  # each spring at its reference compliance
        compliance = physics.springs_.compliance
        rows = ur5.robot.jacobian(q)
        torque = np.einsum("nij,ni->nj", rows, wrench)
        expected = rows[:, :3] * (torque * power_of_four(compliance))[:, None, :]
        np.testing.assert_allclose(domain.parts[::50], expected, rtol=1e-9, atol=1e-15)
    else:
        expected = physics.predict(q, wrench)
        np.testing.assert_allclose(domain.deflection[::50], expected, rtol=1e-9, atol=1e-15)
    assert model.robot_ is target.robot


def test_fine_tuning_begins_with_the_other_robots_network_and_learns_the_targets_labels(
    target, ur5
):
    before = predict(fit_with_source(MlpPretrained(**TINY), target, ur5), target)
    options = TINY | {"anchor": "none"}
    untuned = predict(fit_with_source(FtMlp(**options, epochs=0), target, ur5), target)
    tuned = predict(
        fit_with_source(FtMlp(**options, freeze="full", epochs=30), target, ur5), target
    )
    np.testing.assert_array_equal(untuned, before)
    errors = [
        np.abs(prediction - target.samples.deflection).mean() for prediction in (before, tuned)
    ]
    assert errors[1] < errors[0]


def test_a_compliance_network_begins_with_the_other_robots_springs_in_the_targets_kinematics(
    target, ur5
):
    model = fit_with_source(ComplianceNet(width=8, epochs=0, device="cpu"), target, ur5)
    springs = vjm_of(ur5).springs_
    assert np.isfinite(springs.stiffness).all()
    rows = target.robot.jacobian(target.samples.q)
    joint = np.einsum("nij,ni->nj", rows, target.samples.wrench) * springs.compliance
    expected = np.einsum("nij,nj->ni", rows[:, :3], joint)
    np.testing.assert_allclose(predict(model, target), expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("key", TAKE_A_SOURCE)
def test_a_copy_keeps_the_source_and_a_new_model_has_none(key, ur5):
    model = model_info(key).load()()
    model.use_source(ur5)
    copy = clone(clone(model))
    assert copy is not model and copy._source is ur5
    assert copy.get_params() == model.get_params() and "_source" not in copy.get_params()
    assert type(model)()._source is None


@pytest.mark.slow
def test_a_saved_model_needs_its_source_no_more(target, ur5, tmp_path):
    model = fit_with_source(FtMlp(**TINY, epochs=2), target, ur5)
    model.save(tmp_path / "m")
    loaded = load(tmp_path / "m")
    np.testing.assert_array_equal(predict(loaded, target), predict(model, target))
    assert loaded.robot_.name == target.robot.name and loaded._source is None
