"""Check the errors that networks report, as in Tables 6 to 9, against NumPy."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.transfer import pretraining
from stiff_models.transfer.ft_mlp import FtMlp

SMALL = {"layers": 2, "width": 8, "device": "cpu", "pretrain_steps": 3, "epochs": 2}
MM = 1000.0


@pytest.fixture(scope="module", params=["fast", "paper"])  # shared by training parts, and not
def fitted(parts, request):
    """Return a small network, its samples, and the source's training and test parts."""
    robot, train, held_out, _ = parts
    parts_of_source = []

    def record_parts(domain, seed):
        parts_of_source.append(divided(domain, seed))
        return parts_of_source[-1]

    divided = pretraining.divided
    model = FtMlp(**SMALL, preset="paper", recipe=request.param, training="normal")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STIFFBENCH_CACHE", "off")
        patch.setattr(pretraining, "divided", record_parts)
        model.fit(train, robot=robot, validation=held_out, seed=5)
    ((learn, test),) = parts_of_source
    return model, train, learn, test


def test_the_source_is_divided_into_70_and_30_per_cent_that_share_no_sample(fitted):
    _, _, learn, test = fitted
    assert (len(learn), len(test)) == (74_480, 31_920)
    rows = np.hstack([np.vstack([learn.q, test.q]), np.vstack([learn.wrench, test.wrench])])
    assert len(np.unique(rows, axis=0)) == 106_400


def test_errors_on_the_source_are_those_of_the_network_before_fine_tuning_in_mm(fitted):
    model, train, learn, test = fitted
    before = copy.copy(model)
    before.network_ = model.source_network_
    vjm = VirtualJointModel().fit(train, robot=model.robot_)
    training_errors, test_errors = (
        np.abs(before.predict(part.q, part.wrench) - vjm.predict(part.q, part.wrench)) * MM
        for part in pretraining.some_of(learn, test)
    )
    expected = {
        "source training MAE [mm]": training_errors.mean(),
        "source training STDE [mm]": np.std(training_errors),
        "source test MAE [mm]": test_errors.mean(),
        "source test STDE [mm]": np.std(test_errors),
    } | {f"source test MAE {axis} [mm]": test_errors[:, i].mean() for i, axis in enumerate("XYZ")}
    reported = {name: model.diagnostics_[name] for name in expected}
    assert reported == pytest.approx(expected, rel=1e-4)
    after = np.abs(model.predict(test.q, test.wrench) - test.deflection) * MM
    assert after.mean() != pytest.approx(expected["source test MAE [mm]"], rel=1e-6)


def test_training_errors_are_over_all_axes_and_samples_together_in_mm(fitted):
    model, train, _, _ = fitted
    errors = np.abs(model.predict(train.q, train.wrench) - train.deflection) * MM
    assert model.diagnostics_["training MAE [mm]"] == pytest.approx(errors.mean())
    assert model.diagnostics_["training STDE [mm]"] == pytest.approx(np.std(errors))
