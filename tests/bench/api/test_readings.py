"""Check a run, a fit and a score on readings along directions, as a user does them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbench as sb
from stiff_datasets.twin.kr10_twin import Kr10TwinOmni
from stiff_protocols.contract.errors import ConfigError

pytestmark = pytest.mark.filterwarnings("ignore::stiff_protocols.contract.errors.StiffBenchWarning")


@pytest.fixture(scope="module")
def gauge():
    """Return a data set with one number a row, along z and y in turn."""
    data = Kr10TwinOmni().load()
    samples = data.samples.take(np.arange(0, 150, 3))
    directions = np.eye(3)[2 - np.arange(len(samples)) % 2][:, None]
    moved = samples.deflection * directions[:, 0]
    samples = replace(samples, deflection=moved, directions=directions)
    return sb.Dataset.from_samples(samples, data.robot)


def test_a_run_on_readings_is_scored_along_them(gauge, tmp_path):
    sb.evaluate("vjm", gauge, splits=2, output=tmp_path)
    frame = sb.open_results(tmp_path).frame()  # as stored
    assert frame["reading_mm"].to_numpy() == pytest.approx(frame["norm_mm"].to_numpy())
    assert "mae_x_mm" not in frame
    model = sb.make_model("vjm").fit(gauge)
    scores = model.score(gauge).set_index("metric")["value"]
    assert scores["reading"] == pytest.approx(scores["norm"])
    assert "mae" not in scores
    assert model.cross_validated_error.mean < 5e-4


def test_a_model_of_vectors_is_refused_before_it_is_fitted(gauge):
    with pytest.raises(ConfigError, match="bayes-springs"):
        sb.make_model("mean").fit(gauge)
