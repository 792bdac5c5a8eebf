"""Check that loading results, data, robots and models runs no code from them."""

from __future__ import annotations

import io
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from helpers.made_results import ROBOT, MadeResults, made_data
from helpers.model_files import archived, members, saved_model
from stiff_bench.store.database import (
    FILE,
    data_content,
    read_manifests,
    read_results,
    stored_data,
)
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_models import load
from stiff_models.io.cache_folder import usable_folder
from stiff_protocols.contract.errors import DataError, StoreError

ROOT = Path(__file__).parents[1]
URDF = ROOT / "datasets" / "stiff_datasets" / "robots" / "kr10_r1100_2.urdf"
SECRET = "the content of a private file"


class Bomb:
    """Write a file when a pickle of this object is read."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.write_text, (self.mark, "run")


@pytest.fixture()
def mark(tmp_path):
    """Return a file that no test may create."""
    path = tmp_path / "somebody's code was run"
    yield path
    assert not path.exists()


@pytest.fixture()
def bomb(mark):
    return pickle.dumps(Bomb(mark))


def test_the_bomb_of_these_tests_goes_off(tmp_path):
    pickle.loads(pickle.dumps(Bomb(tmp_path / "mark")))
    assert (tmp_path / "mark").read_text() == "run"


# Model files


def torch_zip(content: bytes) -> bytes:
    return archived({"archive/data.pkl": content, "archive/version": b"3\n"})


@pytest.mark.parametrize("wrap", [bytes, torch_zip], ids=["pickle", "torch's zip"])
def test_a_model_file_that_is_a_pickle_is_refused_unread(wrap, bomb, tmp_path):
    path = tmp_path / "model.stiff"
    path.write_bytes(wrap(bomb))
    with pytest.raises(DataError, match="not a model file"):
        load(path)


def objects_array(mark: Path) -> bytes:
    """Return a .npy file of an array of objects, which NumPy pickles."""
    file = io.BytesIO()
    np.save(file, np.array([Bomb(mark)]), allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize("kind", [".npy", ".skops"])
@pytest.mark.parametrize("wrap", [pickle.dumps, lambda bomb: objects_array(bomb.mark)])
def test_a_pickle_within_a_model_file_is_refused_unread(kind, wrap, tmp_path, mark):
    path = saved_model(tmp_path, "knn")
    parts = members(path.read_bytes())
    name = next(name for name in parts if name.endswith(kind))
    path.write_bytes(archived(parts | {name: wrap(Bomb(mark))}))
    with pytest.raises(DataError, match=r"model\.stiff: "):
        load(path)


# Data


def stored_with(**arrays) -> bytes:
    """Return the stored content of a data set with some arrays replaced."""
    file = io.BytesIO()
    with np.load(io.BytesIO(data_content(made_data()))) as stored:
        np.savez(file, **(dict(stored) | arrays), allow_pickle=True)
    return file.getvalue()


def test_a_pickle_in_the_samples_of_a_results_folder_is_refused_unread(mark):
    assert stored_data(stored_with()).robot.name == ROBOT.name
    with pytest.raises(DataError, match="allow_pickle=False"):
        stored_data(stored_with(q=np.array([Bomb(mark)])))


def test_a_pickle_that_calls_itself_a_table_is_refused(tmp_path, bomb, mark):
    for name in ("data.csv", "data.parquet"):
        (tmp_path / name).write_bytes(bomb)
        with pytest.raises(DataError):
            read_samples(tmp_path / name, ROBOT)


# Robots

ENTITIES = "".join(f'<!ENTITY a{i + 1} "{f"&a{i};" * 10}">' for i in range(12))
DOCTYPES = {
    "external file": '<!DOCTYPE robot [<!ENTITY x SYSTEM "file://{secret}">]>',
    "external page": '<!DOCTYPE robot [<!ENTITY x SYSTEM "http://127.0.0.1:9/">]>',
    "parameter": '<!DOCTYPE robot [<!ENTITY % p SYSTEM "file://{secret}"> %p; <!ENTITY x "1">]>',
    "laughs": f'<!DOCTYPE robot [<!ENTITY a0 "ha">{ENTITIES}<!ENTITY x "&a12;">]>',
}


@pytest.fixture()
def secret(tmp_path):
    path = tmp_path / "secret"
    path.write_text(SECRET)
    return path


@pytest.mark.parametrize("kind", DOCTYPES)
def test_a_urdf_reads_no_other_file_and_does_not_grow(kind, tmp_path, secret):
    _, _, robot_text = URDF.read_text().partition("<robot ")
    path, doctype = tmp_path / "robot.urdf", DOCTYPES[kind].replace("{secret}", str(secret))
    for name, note in (("&x;", ""), ("r", "<note>&x;</note>")):
        path.write_text(f'{doctype}<robot name="{name}">{note}{robot_text.partition(">")[2]}')
        try:
            robot = read_robot(path)
        except DataError as refused:
            assert SECRET not in str(refused) and len(str(refused)) < 1000
        else:
            assert SECRET not in repr(robot) and len(robot.name) < 100


# Results folders


@pytest.fixture()
def folder(tmp_path):
    """Return a small folder of results."""
    made_results = MadeResults(tmp_path / "results")
    made_results.add_run("run-1", made_results.add("vjm", [0.1, 0.2]))
    return made_results.folder


def test_a_results_file_that_links_elsewhere_is_none_and_is_not_quoted(folder, secret):
    (folder / FILE).unlink()
    (folder / FILE).symlink_to(secret)
    for read in (read_results, read_manifests):
        with pytest.raises(StoreError, match="corrupt") as caught_error:
            read(folder)
        assert SECRET not in str(caught_error.value)


# The cache, which holds pickles


def test_a_cache_that_others_may_write_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path / "cache"))
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o775)
    with pytest.raises(StoreError, match="may write there"):
        usable_folder()


def test_a_new_cache_is_the_users_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("STIFFBENCH_CACHE", str(tmp_path / "cache"))
    before = os.umask(0)
    try:
        usable_folder()
    finally:
        os.umask(before)
    assert (tmp_path / "cache").stat().st_mode & 0o777 == 0o700
