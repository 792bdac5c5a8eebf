"""Check that exported files read back unchanged, or that none are written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import seven_joint_arm
from helpers.made_samples import samples_with
from stiff_datasets.measured import exported_files
from stiff_datasets.measured.card_text import exported_card
from stiff_datasets.measured.exported_files import export
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_datasets.robots.urdf_writer import robot_urdf
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.types import BenchmarkData


@pytest.fixture()
def data() -> BenchmarkData:
    """Return five samples of an arm of seven joints at random angles."""
    rng, robot = np.random.default_rng(1), seven_joint_arm()
    q = rng.uniform(-1.5, 1.5, size=(5, 7))
    samples = samples_with(q, rng.normal(0, 50.0, (5, 6)), rng.normal(0, 1e-3, (5, 3)))
    return BenchmarkData(samples, robot)


def exported(data: BenchmarkData, folder, earlier: str = ""):
    def card(words: str, sha256: str) -> str:
        rows = {"What": "Seven joints", "Read by": words, "sha256": sha256}
        return exported_card("seven", data, rows, "seven.csv", earlier)

    return export(data, folder, "seven", robot_urdf(data.robot), card)


def test_the_files_read_back_as_the_same_samples_and_robot(data, tmp_path):
    files = exported(data, tmp_path / "shared")
    csv, card, urdf, croissant, package = files.paths
    assert sorted((tmp_path / "shared").iterdir()) == sorted(files.paths)
    robot = read_robot(urdf, tcp=data.robot.tcp_on_flange.tolist())
    samples = read_samples(csv, robot)
    np.testing.assert_allclose(samples.q, data.samples.q, rtol=1e-15)
    for name in ("wrench", "deflection", "pose_id", "load_id", "group"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(data.samples, name))
    assert BenchmarkData(samples, robot).sha256 == files.sha256
    assert files.sha256 in card.read_text()
    assert files.n_rounded == np.count_nonzero(samples.q != data.samples.q)
    assert croissant.name == "seven.croissant.json" and package.name == "seven.datapackage.json"


def test_what_is_exported_again_reads_back_exactly(data, tmp_path):
    files = exported(data, tmp_path / "first")
    robot = read_robot(files.paths[2], tcp=data.robot.tcp_on_flange.tolist())
    read_data = BenchmarkData(read_samples(files.paths[0], robot), data.robot)
    assert exported(read_data, tmp_path / "second").n_rounded == 0
    first, second = (tmp_path / name / "seven.csv" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()


def test_the_instruments_noise_goes_into_the_card_and_comes_back(data, tmp_path):
    noisy = replace(data, samples=replace(data.samples, instrument_noise=1.7e-5))
    files = exported(noisy, tmp_path / "stated")
    assert read_samples(files.paths[0], data.robot).instrument_noise == 1.7e-5
    earlier = "Instrument noise: 0.017 mm per deflection"
    files = exported(noisy, tmp_path / "earlier", earlier)
    assert files.paths[1].read_text().lower().count("instrument noise") == 1
    assert read_samples(files.paths[0], data.robot).instrument_noise == 1.7e-5


@pytest.mark.parametrize("ending", [".csv", ".md", ".urdf", ".croissant.json", ".datapackage.json"])
def test_a_file_that_is_there_is_kept_and_no_other_is_written(data, tmp_path, ending):
    (tmp_path / f"seven{ending}").write_text("mine")
    with pytest.raises(StoreError, match=f"seven{ending}: exists"):
        exported(data, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"seven{ending}"]
    assert (tmp_path / f"seven{ending}").read_text() == "mine"


def test_data_that_no_file_may_hold_leave_nothing_behind(data, tmp_path):
    far = replace(data, samples=replace(data.samples, deflection=data.samples.deflection + 1.0))
    with pytest.raises(DataError, match=r"seven\.csv"):
        exported(far, tmp_path / "shared")
    assert not [*tmp_path.iterdir()]


def test_a_disk_that_fills_up_while_files_are_moved_leaves_nothing_behind(
    data, tmp_path, monkeypatch
):
    move = exported_files.shutil.move

    def full(source, target):
        if target.suffix == ".urdf":
            raise OSError(28, "No space left on device")
        return move(source, target)

    monkeypatch.setattr(exported_files.shutil, "move", full)
    with pytest.raises(StoreError, match="No space left"):
        exported(data, tmp_path / "shared")
    assert not [*tmp_path.iterdir()]


def test_the_earlier_card_is_below_without_links_to_files_that_are_not_there(data, tmp_path):
    earlier = "# Data card: old\n\nSee [the page](page.md) and [it](https://a.org).\n\n## Dates\n"
    text = exported(data, tmp_path, earlier).paths[1].read_text()
    assert "page.md" not in text and "[it](https://a.org)" in text
    assert [line for line in text.splitlines() if line.startswith("#")] == [
        "# Data card: seven",
        "## The data card of seven.csv",
        "### Dates",
    ]
