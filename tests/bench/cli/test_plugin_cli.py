"""`bench check` and `bench new model`: what they print, write and refuse."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from sklearn.base import BaseEstimator

from helpers.command_line import bench_here
from stiff_bench.model_tools.plugins import checklist, new_model
from stiff_bench.plan.registry import build_registry
from stiff_models.io.training_cache import VARIABLE
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, StoreError
from stiff_protocols.contract.plugin import ModelInfo

BAD = """
import numpy as np
from sklearn.base import BaseEstimator
from stiff_protocols.contract.plugin import ModelInfo

class Bad(BaseEstimator):
    def __init__(self, *, shape: int = 3):
        self.shape = shape
    def fit(self, train, *, robot, validation=None, seed=0):
        self.mean_ = train.deflection.mean(axis=0)
        return self
    def predict(self, q, wrench):
        return 1000 * np.tile(self.mean_, (len(q), 1))[:, : self.shape]

MODELS = [ModelInfo(key="bad", target=Bad, summary="mm")]
"""


@pytest.mark.slow
def test_a_new_model_passes_its_own_test_and_the_suite_and_can_be_run_as_it_stands(tmp_path):
    made = bench_here("new", "model", "My-Spring", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my_spring.py", "test_my_spring.py"]
    head, first, *others = made.stdout.splitlines()
    for part in ("my_spring.py", "test_my_spring.py", "key is my-spring"):
        assert part in head
    assert first == "  python -m pytest test_my_spring.py"
    tested = subprocess.run(
        [sys.executable, *first.split()[1:], "-W", "error", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert "2 passed" in tested.stdout, tested.stdout
    for line in others:  # the commands, as they are printed
        done = bench_here(*line.split()[1:], cwd=tmp_path)
        assert done.returncode == 0, done.stderr + done.stdout
        assert "my-spring" in done.stdout


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("2nd", "'2nd' is no name for a model"),
        ("_x", "a letter first"),
        ("my model", "'my model' is no name"),
        ("../up", "is no name"),
        ("class", "no Python keyword"),
        ("federnüß", "is no name"),
        ("vjm", "key 'vjm' is taken by stiffbench"),
        ("FT-MLP", "key 'ft-mlp' is taken by stiffbench"),
        ("numpy", "Python already has a module 'numpy'"),
    ],
)
def test_a_name_that_cannot_serve_is_refused_and_nothing_is_written(tmp_path, name, message):
    with pytest.raises(ConfigError, match=message):
        new_model(name, tmp_path, build_registry())
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_exists_is_left_as_it_is_and_no_other_is_written(tmp_path):
    test = tmp_path / "test_spring.py"
    test.write_text("mine")
    with pytest.raises(StoreError, match=r"test_spring\.py: exists, and nothing is written"):
        new_model("spring", tmp_path, build_registry())
    assert [path.name for path in tmp_path.iterdir()] == ["test_spring.py"]
    assert test.read_text() == "mine"


def test_when_the_second_file_cannot_be_put_in_place_the_first_is_taken_away(tmp_path, monkeypatch):
    put = Path.replace

    def refuse(self, target):
        if not target.name.startswith("test_"):
            raise OSError(28, "No space left on device")
        return put(self, target)

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(StoreError, match="No space left"):
        new_model("spring", tmp_path, build_registry())
    assert list(tmp_path.iterdir()) == []


@pytest.fixture()
def bad(tmp_path):
    path = tmp_path / "bad.py"
    path.write_text(BAD)
    return path


def test_a_bad_plugin_is_told_what_failed_why_and_how_to_mend_it_with_status_1(bad, tmp_path):
    done = bench_here("check", "bad", "--plugin", str(bad), cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "bad (default options) on fanuc-r2000ic (default options)"
    assert "✓ the constructor takes keywords and only stores them" in lines
    (metres,) = (i for i, line in enumerate(lines) if "numbers in metres" in line)
    assert "mm?" in lines[metres]
    assert lines[metres + 1].startswith("    to fix it: ")
    assert "3 failed" in lines[-1]
    assert list(tmp_path.iterdir()) == [bad]


class Listens(BaseEstimator):
    """A model that says whether trainings are remembered while it is fitted."""

    def fit(self, train, **_):
        raise RuntimeError(f"cache {os.environ[VARIABLE]}")


SAVED = """
import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted
from stiff_protocols.contract.plugin import ModelInfo

class Mean(BaseEstimator):
    def __init__(self, *, held: str = "numbers"):
        self.held = held
    def fit(self, train, *, robot, validation=None, seed=0):
        self.mean_, self.n_joints_ = train.deflection.mean(axis=0), robot.n_joints
        if self.held == "code":
            self.rule_ = lambda q: q
        return self
    def predict(self, q, wrench):
        check_is_fitted(self)
        if q.shape[1] != self.n_joints_:
            raise ValueError("another robot")
        return np.tile(self.mean_, (len(q), 1))

MODELS = [ModelInfo(key="saved", target=Mean, summary="mean")]
"""


@pytest.mark.parametrize(("held", "mark"), [("numbers", "✓"), ("code", "\N{EN DASH}")])
def test_a_check_saves_a_plugins_model_as_fit_does(tmp_path, held, mark):
    (tmp_path / "saved.py").write_text(SAVED)
    own = ("--plugin", "saved.py", "--set", f"saved.held={held}")
    checked = bench_here("check", "saved", *own, cwd=tmp_path)
    (line,) = (one for one in checked.stdout.splitlines() if "save and load" in one)
    assert checked.returncode == 0 and line.startswith(mark) and "no save" not in line
    fit = ("fit", "--model", "saved", "--dataset", "fanuc-r2000ic", "--output", "m.stiff")
    assert (bench_here(*fit, *own, cwd=tmp_path).returncode == 0) == (held == "numbers")
    assert ("bench fit" in line) == (held == "code")


def test_a_check_trains_anew_and_leaves_the_cache_as_it_was(monkeypatch):
    monkeypatch.setenv(VARIABLE, "somewhere")
    registry = build_registry()
    registry.add([ModelInfo(key="listens", target=Listens, summary="")], "test")
    assert "raised RuntimeError: cache off" in repr(
        checklist("listens", "fanuc-r2000ic", (), registry)
    )
    assert os.environ[VARIABLE] == "somewhere"


def test_a_shipped_model_a_data_set_and_a_protocol_pass():
    registry = build_registry()
    for key, first in (
        ("vjm", "vjm (default options) on fanuc-r2000ic (default options)"),
        ("fanuc-r2000ic", "fanuc-r2000ic (default options)"),
        ("holdout", "holdout (default options) on fanuc-r2000ic (default options)"),
    ):
        checked = checklist(key, "fanuc-r2000ic", (), registry)
        assert checked.kept, checked
        assert checked.where == first


class NeedsFile(BaseEstimator):
    """Can be used once an option names a file."""

    def __init__(self, *, file: str = ""):
        self.file = file

    def missing(self):
        return "" if self.file else "no file of weights"


def why() -> str:
    return "no weights"


def test_what_cannot_be_used_here_or_not_with_its_options_says_why():
    registry = build_registry()
    extra = ModelInfo(key="extra", target=dict, summary="", missing_because=f"{__name__}:why")
    needs = ModelInfo(key="needs-file", target=NeedsFile, summary="")
    registry.add([extra, needs], "test")
    for key, reason in (("extra", "no weights"), ("needs-file", "no file of weights")):
        with pytest.raises(StiffBenchError, match=f"'{key}' cannot be checked here: {reason}"):
            checklist(key, "fanuc-r2000ic", (), registry)
    checked = checklist("needs-file", "fanuc-r2000ic", ("needs-file.file=w.ckpt",), registry)
    assert "needs-file (file=w.ckpt) on fanuc-r2000ic" in checked.where
