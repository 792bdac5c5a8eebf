"""Check that files are written only to --output, the cache and stiffbench's home.

Python files in the working directory are not run.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from helpers.command_line import bench
from helpers.command_tree import COMMANDS as COMMAND_NAMES
from helpers.made_results import MadeResults

ROOT = Path(__file__).parents[1]
DATA = ROOT / "datasets" / "stiff_datasets" / "data"
SKIPPED = {"PYTHONDONTWRITEBYTECODE", "MPLCONFIGDIR"}


LIE_ABOUT = (
    "conftest sitecustomize usercustomize my_model test_my_model numpy torch cyclopts signal "
    "pickle multiprocessing stiff_bench stiff_models stiff_plugins matplotlibrc "
    "stiff_bench/__init__"
)


class Place:
    """Make a user's folders: home, working directory, temporary files, cache, output.

    The working directory has many Python files, which write the file `ran` if they run.
    """

    def __init__(self, top: Path) -> None:
        self.top = top
        for name in ("home", "work", "tmp", "cache", "out"):
            (top / name).mkdir()
        (top / "cache").chmod(0o700)
        made = MadeResults(top / "results")
        made.add_run("run-1", [*made.add("vjm", [0.1, 0.2]), *made.add("mlp", [0.3, 0.1])])
        plugin, folder = "quadratic_springs.py", top / "out" / "submitted"  # Python writes a .pyc
        shutil.copytree(ROOT / "results" / "submissions" / "quadratic-springs", folder)
        (folder / "code" / plugin).rename(folder / plugin)
        (top / "work" / "stiff_bench").mkdir()
        leave_a_mark = f"open({str(top / 'ran')!r}, 'a').write(__file__)"
        for name in LIE_ABOUT.split():
            (top / "work" / f"{name}.py").write_text(f"{leave_a_mark}\nMODELS = []\n")
        (top / "work" / "x.pth").write_text(f"import os; {leave_a_mark}\n")
        shutil.copy(DATA / "fanuc_r2000ic.csv", top / "out" / "mine.csv")
        about = {"HOME": "home", "TMPDIR": "tmp", "STIFFBENCH_CACHE": "cache"}
        about |= {"STIFFBENCH_HOME": "out/home"}
        self.environment = {
            name: value
            for name, value in os.environ.items()
            if name not in SKIPPED and not name.startswith("XDG_")
        } | {name: str(top / folder) for name, folder in about.items()}

    def bench(self, words: str):
        return bench(*shlex.split(words), cwd=self.top / "work", env=self.environment)

    def files(self) -> set[str]:
        """Return all paths except in cache and output."""
        paths = {path.relative_to(self.top) for path in self.top.rglob("*")}
        return {path.as_posix() for path in paths if path.parts[0] not in ("cache", "out")}


@pytest.fixture()
def place():
    """Make a place with a short path: the names of Linux's sockets end at 107 characters."""
    with TemporaryDirectory() as top:
        yield Place(Path(top))


LEADERBOARD = "leaderboard --results ../results"
SIDE_BY_SIDE = "run --model knn --model mlp@epochs=2 --splits 1 --output ../out --jobs 2"
"""A command whose processes start others; these must not run files of the working directory."""
COMMANDS = """
run --model vjm --model mlp-pretrained@pretrain_steps=3 --splits 1 --output ../out
list models
show vjm
check vjm
compare vjm mlp --results ../results
data info kr10-twin --output ../out
data register ../out/mine.csv --dataset kr10-measured
data plan --poses 5 --candidates 50 --output ../out/plan.csv
data simulate --samples 60 --output ../out/some.csv
data simulate --samples 60 --output ../out/some.parquet
data validate ../out/some.csv
data export kr10-twin --output ../out/shared
new model mine --output ../out
table 3
report --results ../results --output ../out/report.html
figure regression --results ../results --output ../out/regression.svg
merge ../results --output ../out/merged
results export --results ../out --output ../out/records.jsonl
submit --card ../out/submitted/card.toml --output ../out/submission
reproduce paper-quick --plan --output ../out
fit --model mlp@width=8@epochs=2 --dataset kr10-twin --output ../out/m.stiff
fit --model vjm --dataset kr10-twin --output ../out/v.stiff --urdf-out ../out/v.urdf
predict --model ../out/m.stiff --input ../out/some.csv --output ../out/all.csv
export --model ../out/m.stiff --output ../out/mlp.onnx
export --model ../out/m.stiff --output ../out/mlp.c --format c
path example --points 9 --output ../out/path.csv
path compensate --model ../out/m.stiff --path ../out/path.csv --output ../out/c.csv --figure ../out/path.png
map --model ../out/m.stiff --load 0,0,-60 --grid 6 --output ../out/map.csv --figure ../out/map.png
posture --model ../out/m.stiff --point 600,0,400,180,0,180 --load 0,0,-60 --turns 4 --output ../out/p.csv
"""  # noqa: E501
SEALED = ("bench verify",)
"""Commands with tests of what they may do, tests/bench/submissions/test_sealed_fit.py."""
ONE_AFTER_ANOTHER = """
import shlex, sys
from stiffbench.main import main
for words in filter(None, sys.stdin.read().splitlines()):
    try:
        main(shlex.split(words))
    except SystemExit as left:
        if left.code:
            sys.exit(f"{words}: status {left.code}")
"""
"""A program that runs commands in one process; a start per command takes two seconds."""


def test_every_command_is_among_them():
    ours = [f"{words} " for words in (LEADERBOARD, *COMMANDS.splitlines())]
    names = [name.removeprefix("bench ") for name in COMMAND_NAMES if name not in SEALED]
    assert [name for name in names if not any(words.startswith(f"{name} ") for words in ours)] == []


@pytest.mark.slow
def test_a_python_file_runs_where_it_is_named(place):
    """Check that the files of the other tests write `ran` if they run."""
    place.bench("list models --plugin my_model.py")
    assert (place.top / "ran").read_text().endswith("my_model.py")


@pytest.mark.parametrize("words", [LEADERBOARD, pytest.param(SIDE_BY_SIDE, marks=pytest.mark.slow)])
def test_a_command_writes_nothing_elsewhere_and_runs_nothing_that_lies_about(words, place):
    files_before, shared_memory = place.files(), set(os.listdir("/dev/shm"))
    process = place.bench(words)
    assert process.returncode == 0, process.stderr
    assert place.files() == files_before
    assert not [name for name in {*os.listdir("/dev/shm")} - shared_memory if "stiff" in name]


@pytest.mark.slow
def test_no_command_writes_elsewhere_or_runs_what_lies_about(place):
    files_before = place.files()
    process = subprocess.run(
        [sys.executable, "-P", "-c", ONE_AFTER_ANOTHER],
        input=COMMANDS,
        cwd=place.top / "work",
        env=place.environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    assert place.files() == files_before
