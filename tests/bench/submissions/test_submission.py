"""A submission holds a card and code, and nothing else."""

from __future__ import annotations

import json
import os

import pytest

from helpers.changed_submissions import changed_submissions
from helpers.command_line import bench_here
from stiff_bench.submissions.submission import CARD, pack_submission, read_submission
from stiff_protocols.contract.errors import ConfigError, StoreError

PLUGIN = "import helper_of_mine\nMODELS = []\n"


@pytest.fixture
def folder(submission_of):
    return submission_of(PLUGIN)


def test_a_model_is_packed_with_the_files_that_it_imports_and_nothing_else(tmp_path, folder):
    sources = tmp_path / "sources"
    sources.mkdir()
    (sources / "mine.py").write_text(PLUGIN)
    (sources / "helper_of_mine.py").write_text("X = 1\n")
    (sources / "secret.py").write_text("KEY = 1\n")
    packed = pack_submission(folder / CARD, sources / "mine.py", tmp_path / "packed")
    names = {path.relative_to(packed.folder).as_posix() for path in packed.folder.rglob("*.*")}
    assert names == {"card.toml", "code/mine.py", "code/helper_of_mine.py"}
    with pytest.raises(StoreError, match="exists"):
        pack_submission(folder / CARD, sources / "mine.py", tmp_path / "packed")


def test_the_command_packs_the_plugin_that_it_is_given(tmp_path, folder):
    (tmp_path / "mine.py").write_text("MODELS = []\n")
    words = ("--card", folder / CARD, "--plugin", "mine.py", "--output", "packed")
    done = bench_here("submit", *words, cwd=tmp_path)
    assert not done.returncode, done.stderr
    assert (tmp_path / "packed/code/mine.py").read_text() == "MODELS = []\n"


def test_its_hash_is_that_of_every_name_and_byte(folder):
    before = read_submission(folder).sha256
    (folder / "code/more.py").write_text("X = 1\n")
    with_more = read_submission(folder).sha256
    (folder / "code/more.py").write_text("X = 2\n")
    assert len({before, with_more, read_submission(folder).sha256}) == 3


@pytest.mark.parametrize(
    "name",
    [
        *("verification.json", "records.jsonl", "manifest.json", "results.sqlite", ".hidden"),
        *("code/.hidden.py", "code/run.sh", "code/native.so", "code/weights.pkl", "code/a b.py"),
        *("other/mine.py", "code/.git/config.py"),
    ],
)
def test_numbers_hidden_files_and_other_kinds_are_refused_by_name(folder, name):
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text("{}")
    with pytest.raises(ConfigError, match=r"valid: ") as error:
        read_submission(folder)
    assert name.split("/")[-1] in str(error.value) or name.split("/")[-2] in str(error.value)


def test_links_and_pipes_are_refused(folder):
    (folder / "code/link.py").symlink_to("/etc/passwd")
    with pytest.raises(ConfigError, match=r"link\.py.*regular"):
        read_submission(folder)
    (folder / "code/link.py").unlink()
    os.mkfifo(folder / "code/pipe.py")
    with pytest.raises(ConfigError, match=r"pipe\.py.*regular"):
        read_submission(folder)


def test_sizes_and_numbers_of_files_are_bounded(folder):
    large = folder / "code/table.csv"
    large.write_bytes(b"0" * (6 * 2**20))
    with pytest.raises(ConfigError, match=r"table\.csv has .* bytes"):
        read_submission(folder)
    large.unlink()
    for number in range(60):
        (folder / f"code/part_{number}.py").write_text("")
    with pytest.raises(ConfigError, match="more than 50 files"):
        read_submission(folder)


def test_a_card_without_its_plugin_is_refused(folder):
    (folder / "code/mine.py").unlink()
    with pytest.raises(ConfigError, match=r"code/mine\.py"):
        read_submission(folder)


def test_only_a_submission_without_fits_of_its_bytes_is_evaluated_by_the_checks(tmp_path, folder):
    submissions, board = tmp_path / "results/submissions", tmp_path / "results/leaderboard"
    submissions.mkdir(parents=True)
    board.mkdir()
    mine = folder.rename(submissions / "mine")
    (submissions / "README.md").write_text("| model |")
    assert changed_submissions(tmp_path / "results") == [mine]
    entry = {"mine": {"submission": read_submission(mine).sha256}}
    (board / "fresh.json").write_text(json.dumps(entry))
    assert changed_submissions(tmp_path / "results") == []
    (mine / "code/mine.py").write_text(f"{PLUGIN}NUMBER = 1\n")
    assert changed_submissions(tmp_path / "results") == [mine]
