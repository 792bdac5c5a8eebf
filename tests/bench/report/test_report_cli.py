"""`bench report`: a complete page, or one error and no file."""

from __future__ import annotations

import pytest

from helpers.command_line import assert_refused, bench_here
from helpers.made_results import MadeResults

pytestmark = pytest.mark.usefixtures("no_figures")


@pytest.fixture()
def folder(tmp_path):
    made = MadeResults(tmp_path / "runs")
    made.add_run("run-1", [*made.add("vjm", [0.1, 0.2]), *made.add("mlp", [0.3, 0.1])])
    return made.folder


def test_the_page_is_written_and_its_path_printed(folder, tmp_path):
    page = tmp_path / "page.html"
    done = bench_here("report", "--results", folder, "--output", page, cwd=tmp_path)
    assert done.returncode == 0
    assert f"{page}: written" in done.stderr
    assert done.stdout == ""
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_several_folders_are_parts_of_one_page_not_compared_and_each_has_every_model_named(
    folder, tmp_path
):
    second_results, page = MadeResults(tmp_path / "others"), tmp_path / "page.html"
    second_results.add("gp", [0.1])
    words = ["report", "--results", folder, "--results", second_results.folder, "--output", page]
    assert bench_here(*words, cwd=tmp_path).returncode == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("<h2") == 2
    assert "are not compared with each other" in text
    assert_refused(bench_here(*words, "--model", "gp", cwd=tmp_path), "'gp'")
