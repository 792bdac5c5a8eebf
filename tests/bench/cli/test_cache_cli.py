"""`bench cache` says what is kept, and empties it."""

from __future__ import annotations

import os
import subprocess

import numpy as np
import pytest
from click.testing import CliRunner

from helpers.command_line import BENCH
from stiff_bench.cli.main import bench
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.transfer.pretrained_mlp import MlpPretrained

pytestmark = pytest.mark.usefixtures("small_source")


@pytest.fixture()
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def said(*words: str) -> str:
    done = CliRunner().invoke(bench, ["cache", *words])
    assert done.exit_code == 0, done.output
    return done.output.strip()


def test_info_counts_the_trainings_and_clear_deletes_them(folder):
    assert said("info") == f"0 trainings, 0.0 MiB, in {folder}"
    data = Kr10Twin().load()
    train = data.samples.take(np.arange(60))
    MlpPretrained(width=8, pretrain_steps=2, source_poses="data").fit(train, robot=data.robot)
    assert said("info").startswith("1 training, 0.")
    assert said("clear").startswith("deleted: 1 training, 0.")
    assert said("info") == f"0 trainings, 0.0 MiB, in {folder}"


def test_switched_off_it_says_so(monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", "off")
    assert said("info") == "the cache is switched off (STIFFBENCH_CACHE=off)"
    assert said("clear").startswith("nothing to delete: the cache is switched off")


@pytest.mark.slow
def test_a_reader_that_has_left_is_no_failure(folder):
    read, write = os.pipe()
    os.close(read)
    command = [BENCH, "cache", "info"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, timeout=120, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")
