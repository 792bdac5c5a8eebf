"""Promised remaining error of corrected paths, against the simulated robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb

LOADS = ["fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"]


def promised_and_found(
    model_name: str, data: sb.Dataset, folder: Path, coverage: float | None = None
) -> tuple[float, float]:
    """Return the mean expected error, m, and the mean distance of the twin from the path, m.

    With a coverage, the expected error is the half width of the interval.
    """
    model = sb.make_model(model_name).fit(data)
    path = folder / "path.csv"
    assert "0 of 41 points are beyond" in sb.example_path(path, points=41, model=model)
    corrected = sb.compensate_path(model, path, folder / "new.csv", coverage=coverage)
    wrench = pd.read_csv(path)[LOADS].to_numpy()
    commands = corrected.compensation.q
    true_deflection = data.data.under_load(commands, wrench)
    stands = data.robot.tcp_position(commands) + true_deflection
    found_error = np.linalg.norm(stands - corrected.compensation.target, axis=1)
    promised = corrected.expected_error if coverage is None else corrected.half_width
    return float(promised.mean()), float(found_error.mean())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model_name", "coverage", "specimen"),
    # a robot with the Gaussian process takes as long as ten without
    [*(("vjm", None, number) for number in range(5)), ("vjm-gp", 0.9, 0)],
)
def test_the_twin_is_as_near_to_the_path_as_promised(model_name, coverage, specimen, tmp_path):
    data = sb.load_dataset("kr10-twin", specimen=specimen)
    promised, found_error = promised_and_found(model_name, data, tmp_path, coverage)
    assert 0.0 < found_error <= promised
