"""Files are written under --output, in the cache and in stiffbench's own home, and nowhere else.

And Python files that lie in the working directory are not run.
"""

from __future__ import annotations

import itertools
import os
import shlex
import shutil
from pathlib import Path

import pytest

from helpers.command_line import LEAVES, bench
from helpers.made_results import MadeResults

ROOT = Path(__file__).parents[1]
DATA = ROOT / "datasets" / "stiff_datasets" / "data"
SKIPPED = {"PYTHONDONTWRITEBYTECODE", "MPLCONFIGDIR", "STIFFBENCH_HOME"}


LIE_ABOUT = (
    "conftest sitecustomize usercustomize my_model test_my_model numpy torch click signal pickle "
    "multiprocessing stiff_bench stiff_models stiff_plugins matplotlibrc stiff_bench/__init__"
)


class Place:
    """A user's whole world: home, working directory, temporary files, cache, output.

    The working directory is full of Python files, which leave the file `ran` when they run.
    """

    def __init__(self, top: Path) -> None:
        self.top = top
        for name in ("home", "work", "tmp", "cache", "out"):
            (top / name).mkdir()
        (top / "cache").chmod(0o700)
        made = MadeResults(top / "results")
        made.add_run("run-1", [*made.add("vjm", [0.1, 0.2]), *made.add("mlp", [0.3, 0.1])])
        (top / "work" / "stiff_bench").mkdir()
        leave_a_mark = f"open({str(top / 'ran')!r}, 'a').write(__file__)"
        for name in LIE_ABOUT.split():
            (top / "work" / f"{name}.py").write_text(f"{leave_a_mark}\nMODELS = []\n")
        (top / "work" / "x.pth").write_text(f"import os; {leave_a_mark}\n")
        about = {"HOME": "home", "TMPDIR": "tmp", "STIFFBENCH_CACHE": "cache"}
        self.environment = {
            name: value
            for name, value in os.environ.items()
            if name not in SKIPPED and not name.startswith("XDG_")
        } | {name: str(top / folder) for name, folder in about.items()}

    def bench(self, words: str):
        return bench(*shlex.split(words), cwd=self.top / "work", env=self.environment)

    def files(self) -> set[str]:
        """All that is there, but for cache and output."""
        paths = {path.relative_to(self.top) for path in self.top.rglob("*")}
        return {path.as_posix() for path in paths if path.parts[0] not in ("cache", "out")}


@pytest.fixture()
def place(tmp_path):
    return Place(tmp_path)


SIMULATE = "data simulate --samples 60 --output ../out/some.csv"
FIT = "fit --model mlp@width=8@epochs=2 --dataset kr10-twin --output ../out/m.stiff"
LEADERBOARD = ("leaderboard --results ../results",)
WRITE_BELOW_OUTPUT = (
    ("run --model vjm --model mlp-pretrained@pretrain_steps=3 --splits 1 --output ../out",),
    ("run --model knn --model mlp@epochs=2 --splits 1 --output ../out --jobs 2",),
    ("list models", "show vjm", "compare vjm mlp --results ../results"),
    ("check vjm",),
    ("data info kr10-twin --output ../out",),
    ("data plan --poses 5 --candidates 50 --output ../out/plan.csv",),
    ("data simulate --samples 100 --output ../out/some.parquet",),
    ("new model mine --output ../out",),
    ("table 3", "report --results ../results --output ../out/report.html"),
    ("figure regression --results ../results --output ../out/regression.svg",),
    ("merge ../results --output ../out/merged", "reproduce paper-quick --plan --output ../out"),
    (
        SIMULATE,
        "data validate ../out/some.csv",
        FIT,
        "predict --model ../out/m.stiff --input ../out/some.csv --output ../out/all.csv",
        "export --model ../out/m.stiff --output ../out/mlp.onnx",
        "path example --points 9 --output ../out/path.csv",
        "path compensate --model ../out/m.stiff --path ../out/path.csv --output ../out/c.csv "
        "--figure ../out/path.png",
    ),
)
REGISTER = "data register kr10-measured ../out/mine.csv"


def test_every_command_is_started_here_as_a_user_does():
    """Other tests call it in their own process."""
    ours = [f"{words} " for words in itertools.chain(LEADERBOARD, *WRITE_BELOW_OUTPUT, [REGISTER])]
    names = {leaf.name for leaf in LEAVES}
    assert [name for name in names if not any(words.startswith(f"{name} ") for words in ours)] == []


@pytest.mark.slow
def test_a_python_file_runs_where_it_is_named(place):
    """The next test's own test: the files do leave their mark."""
    place.bench("list models --plugin my_model.py")
    assert (place.top / "ran").read_text().endswith("my_model.py")


@pytest.mark.parametrize(
    "commands",
    [LEADERBOARD, *(pytest.param(one, marks=pytest.mark.slow) for one in WRITE_BELOW_OUTPUT)],
    ids=lambda commands: commands[-1].split(" --")[0],
)
def test_no_command_writes_elsewhere_or_runs_what_lies_about(place, commands):
    before, shared = place.files(), set(os.listdir("/dev/shm"))
    for words in commands:
        done = place.bench(words)
        assert done.returncode == 0, (words, done.stderr)
        assert place.files() == before, words
        assert not [name for name in {*os.listdir("/dev/shm")} - shared if "stiff" in name], words


@pytest.mark.slow
def test_what_is_registered_goes_into_stiffbenchs_home(place, tmp_path):
    shutil.copy(next(DATA.glob("*.csv")), tmp_path / "out" / "mine.csv")
    place.environment["STIFFBENCH_HOME"] = str(tmp_path / "out" / "home")
    before = place.files()
    assert place.bench(REGISTER).returncode == 0
    assert place.files() == before
