"""The shipped constants are those of the record, and give the figures that it states."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stiff_datasets.twin.calibrate import (
    FIGURE_SEEDS,
    figures_text,
    line_figures,
    main,
    misfit,
    paper_figures,
    vjm_figures,
)
from stiff_datasets.twin.constants import read_constants, shipped_constants
from stiff_datasets.twin.kr10_twin import CONSTANTS, Kr10Twin
from stiff_models.physics.vjm import VirtualJointModel

RECORD = Path(__file__).parents[3] / "results" / "calibration" / "kr10_r1100_2.json"


@pytest.fixture(scope="module")
def record():
    return json.loads(RECORD.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def specimens():
    return [line_figures(shipped_constants(CONSTANTS), specimen=number) for number in range(10)]


def test_the_shipped_constants_are_those_that_were_found(record):
    shipped = shipped_constants(CONSTANTS).model_dump(mode="json")
    for name in ("name", "urdf", "tcp_m", "payload_kg", "hook_m", "joint"):
        assert shipped[name] == record["constants"][name]


def test_the_shipped_constants_give_the_figures_of_the_record_and_of_the_card(record, specimens):
    assert len(FIGURE_SEEDS) == 10 and len(record["specimens"]) == 10
    for found, stated in zip(specimens, record["specimens"], strict=True):
        for name in ("mae", "stde", "me"):
            np.testing.assert_allclose(
                getattr(found, name) * 1000, stated[f"{name}_mm"], atol=0.00011
            )
        np.testing.assert_allclose(found.stiffness, stated["stiffness_Nm_per_rad"], rtol=1e-4)
    assert np.abs(specimens[0].stiffness / paper_figures().stiffness - 1).max() < 0.25
    card = (files("stiff_datasets") / "data" / "kr10_twin.md").read_text(encoding="utf-8")
    assert figures_text(specimens, paper_figures()) in card


def test_the_papers_figures_are_those_of_its_tables_2_and_3():
    paper = paper_figures()
    np.testing.assert_allclose(paper.mae * 1000, [0.074, 0.066, 0.062])
    np.testing.assert_allclose(paper.stde * 1000, [0.108, 0.076, 0.075])
    np.testing.assert_allclose(paper.me * 1000, [0.628, 0.435, 0.581])
    np.testing.assert_allclose(paper.stiffness, [50900, 63360, 50340, 2270, 8890, 1390])


def test_the_misfit_is_nothing_for_the_paper_itself_and_grows_either_way():
    paper = paper_figures()
    assert misfit(paper, paper) == 0.0
    for factor in (0.9, 1.1):
        other = paper._replace(mae=paper.mae * factor)
        assert misfit(other, paper) == pytest.approx(3 * np.log(factor) ** 2)


def test_the_figures_are_those_of_the_vjm_on_the_samples_it_was_identified_on():
    data = Kr10Twin().load()
    found = vjm_figures(shipped_constants(CONSTANTS).chain(), data.samples)
    model = VirtualJointModel().fit(data.samples, robot=data.robot)
    error = np.abs(model.predict(data.samples.q, data.samples.wrench) - data.samples.deflection)
    np.testing.assert_allclose(found.mae, error.mean(axis=0))
    np.testing.assert_allclose(found.stde, error.std(axis=0))
    np.testing.assert_allclose(found.me, error.max(axis=0))
    np.testing.assert_allclose(found.stiffness, model.joints_.stiffness)


def test_a_folder_that_cannot_be_made_is_one_line_before_the_work(tmp_path):
    (tmp_path / "file").touch()
    done = CliRunner().invoke(main, ["--output", str(tmp_path / "file" / "c")])
    assert done.exit_code == 1 and "cannot be made" in done.output


@pytest.mark.slow
def test_a_short_calibration_writes_constants_record_and_figures(tmp_path):
    words = [sys.executable, "-m", "stiff_datasets.twin.calibrate", "--generations", "1"]
    done = subprocess.run(
        [*words, "--output", tmp_path / "c"], capture_output=True, text=True, check=True
    )
    assert "| X MAE [mm]" in done.stdout and "calibrate 1/1" in done.stderr
    record = json.loads((tmp_path / "c" / "kr10_r1100_2.json").read_text())
    assert record["command"] == "python -m stiff_datasets.twin.calibrate --generations 1 --seed 0"
    assert len(record["specimens"]) == 10 and len(record["steps"]) == 1
    found = read_constants(tmp_path / "c" / "kr10_r1100_2.toml")
    assert found.model_dump(mode="json") == record["constants"]
