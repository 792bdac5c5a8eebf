"""Check twin data sets that are streamed to files."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pandas as pd
import pytest

from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.robots.shipped_robots import shipped_robot
from stiff_datasets.twin import simulate as module
from stiff_datasets.twin.experiment import TwinExperiment
from stiff_datasets.twin.robot_twin import TwinData
from stiff_datasets.twin.simulate import simulate
from stiff_datasets.twin.twin_file import shipped_constants
from stiff_protocols.contract.errors import ConfigError, StoreError

CONSTANTS = shipped_constants("kr10_r1100_2")


def omni(loads_per_pose=1, seed=0):
    return TwinExperiment(
        CONSTANTS, loads="omni", specimen=0, seed=seed, loads_per_pose=loads_per_pose
    )


@pytest.mark.slow
def test_what_is_written_is_valid_measured_data_of_the_twin_in_either_format(tmp_path, kr10):
    read_back = []
    for path in (tmp_path / "s.csv", tmp_path / "s.parquet"):
        simulate(path, omni(loads_per_pose=3, seed=1), 301)
        read_back.append(read_samples(path, kr10))
    samples, parquet_samples = read_back
    for item in fields(samples):
        np.testing.assert_array_equal(
            getattr(samples, item.name), getattr(parquet_samples, item.name)
        )
    assert len(samples) == 301 and len(set(samples.pose_id)) == 101
    error = samples.deflection - omni().twin.truth(samples.q, samples.wrench)
    assert error.std() == pytest.approx(np.sqrt(2) * 1e-5, rel=0.1)


def test_blocks_have_poses_loads_and_noise_of_their_own(tmp_path, kr10, monkeypatch):
    monkeypatch.setattr(module, "BLOCK", 40)
    simulate(tmp_path / "s.csv", omni(loads_per_pose=2), 100)
    samples = read_samples(tmp_path / "s.csv", kr10)
    assert len(np.unique(samples.q, axis=0)) == 50 == len(set(samples.pose_id))
    assert len(np.unique(samples.wrench, axis=0)) == 100


def test_an_unknown_ending_and_a_folder_that_is_not_there_are_refused(tmp_path):
    with pytest.raises(
        ConfigError, match=r"s\.xls: unsupported extension \.xls \(use \.csv or \.parquet\)"
    ):
        simulate(tmp_path / "s.xls", omni(), 10)
    with pytest.raises(StoreError, match=r"absent/s\.csv: cannot be written: the folder .*absent"):
        simulate(tmp_path / "absent" / "s.csv", omni(), 10)


@pytest.mark.slow
def test_all_columns_of_a_world_are_its_samples_with_approach_and_the_reading_after(tmp_path):
    experiment = TwinData(world="friction").experiment(shipped_constants("ur5"), loads_per_pose=2)
    simulate(tmp_path / "s.csv", experiment, 30)
    simulate(tmp_path / "all.csv", experiment, 30, all_columns=True)
    table, every = (pd.read_csv(tmp_path / name) for name in ("s.csv", "all.csv"))
    pd.testing.assert_frame_equal(table, every[table.columns])
    extra = every.drop(columns=[*table.columns])
    assert [*extra] == [
        "order",
        *(f"approach_q{i}" for i in range(1, 7)),
        *(f"after_d{a}_mm" for a in "xyz"),
    ]
    assert set(extra["approach_q2"]) == {-1.0, 1.0}
    robot = shipped_robot("ur5", tcp=(0.0, 0.06, 0.08))
    stated = read_samples(tmp_path / "all.csv", robot)
    assert stated.order.tolist() == [*range(1, 31)]
    np.testing.assert_array_equal(stated.approach[:, 1], extra["approach_q2"])
    assert len(read_samples(tmp_path / "s.csv", shipped_robot("ur5", tcp=(0.0, 0.06, 0.08)))) == 30
