"""Check that exported files read back unchanged, or that none are written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbench as sb
from helpers.made_robots import seven_joint_arm
from helpers.made_samples import samples_with
from stiff_bench.api import data_files
from stiff_datasets.measured.data_card import new_card
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.types import BenchmarkData

ENDINGS = [".croissant.json", ".csv", ".datapackage.json", ".md", ".urdf"]


@pytest.fixture()
def dataset() -> sb.Dataset:
    """Return five samples of an arm of seven joints at random angles."""
    rng, robot = np.random.default_rng(1), seven_joint_arm()
    q = rng.uniform(-1.5, 1.5, size=(5, 7))
    samples = samples_with(q, rng.normal(0, 50.0, (5, 6)), rng.normal(0, 1e-3, (5, 3)))
    return sb.Dataset.from_samples(replace(samples, instrument_noise=1.7e-5), robot, name="seven")


def read_back(folder, robot) -> BenchmarkData:
    robot = read_robot(folder / "seven.urdf", tcp=robot.tcp_on_flange.tolist())
    return BenchmarkData(read_samples(folder / "seven.csv", robot), robot)


def test_the_files_read_back_as_the_same_samples_and_robot_and_exactly_the_second_time(
    dataset, tmp_path
):
    given = dataset.samples
    printed = str(dataset.export(tmp_path / "first"))
    names = sorted(path.name for path in (tmp_path / "first").iterdir())
    assert names == [f"seven{ending}" for ending in ENDINGS]
    data = read_back(tmp_path / "first", dataset.robot)
    np.testing.assert_allclose(data.samples.q, given.q, rtol=1e-15)
    for name in ("wrench", "deflection", "pose_id", "load_id", "group", "instrument_noise"):
        np.testing.assert_array_equal(getattr(data.samples, name), getattr(given, name))
    assert data.sha256 in printed and data.sha256 in (tmp_path / "first/seven.md").read_text()
    n_rounded = np.count_nonzero(data.samples.q != given.q)
    assert n_rounded and f"{n_rounded} of 35 joint positions differ" in printed
    again = sb.Dataset.from_samples(data.samples, dataset.robot, name="seven")
    again.export(tmp_path / "second")
    first, second = (tmp_path / name / "seven.csv" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_that_is_there_is_kept_and_no_other_is_written(dataset, tmp_path, ending):
    (tmp_path / f"seven{ending}").write_text("mine")
    with pytest.raises(StoreError, match=f"seven{ending}: exists"):
        dataset.export(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"seven{ending}"]
    assert (tmp_path / f"seven{ending}").read_text() == "mine"


def test_data_that_no_file_may_hold_leave_nothing_behind(dataset, tmp_path):
    far = replace(dataset.samples, deflection=dataset.samples.deflection + 1.0)
    with pytest.raises(DataError, match=r"seven\.csv"):
        sb.Dataset.from_samples(far, dataset.robot, name="seven").export(tmp_path / "shared")
    assert not [*tmp_path.iterdir()]


def test_a_disk_that_fills_up_while_files_are_moved_leaves_nothing_behind(
    dataset, tmp_path, monkeypatch
):
    move = data_files.shutil.move

    def full(source, target):
        if target.suffix == ".urdf":
            raise OSError(28, "No space left on device")
        return move(source, target)

    monkeypatch.setattr(data_files.shutil, "move", full)
    with pytest.raises(StoreError, match="No space left"):
        dataset.export(tmp_path / "shared")
    assert not [*tmp_path.iterdir()]


def test_the_earlier_card_is_below_without_its_noise_again_and_links_to_files_that_are_not_there(
    dataset,
):
    links = "See [the page](page.md) and [it](https://a.org)."
    earlier = f"\n# Data card: old\n\n{links}\n\n## Dates\nInstrument noise: 0.017 mm a reading\n"
    text = new_card("seven", dataset.data, {}, "seven.csv", earlier)
    assert "page.md" not in text and "[it](https://a.org)" in text
    assert text.lower().count("instrument noise") == 1
    assert [line for line in text.splitlines() if line.startswith("#")] == [
        "# Data card: seven",
        "## The data card of seven.csv",
        "### Dates",
    ]
