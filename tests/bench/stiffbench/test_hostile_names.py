"""Hostile names in results are harmless in tables, reports, messages and paths."""

from __future__ import annotations

import csv
import html
import io
import json
import re

import pytest

from helpers.command_line import assert_refused, bench_here
from helpers.made_results import MadeResults
from stiff_bench.console import one_line

HOSTILE = (
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "../../etc/x",
    "/etc/passwd",
    "\x1b[31mred\x1b]0;title\x07",
    "two\nlines\r\nand\u2028more",
    "nul\0nul",
    "a|b",
    "50 & 60_% # $x$ ^{2} ~",
    "\\input{/etc/passwd}",
    "=cmd|' /C calc'!A0",
    "[click](javascript:alert(1))",
    "![](http://127.0.0.1:9/seen)",
    "`code` ``more``",
    "right\u202eto left",
    "a\\|b",
    "\\<script>alert(2)</script>",
)
FORMATS = ("github", "latex", "csv", "html", "json")
OURS = set("p strong table thead tbody tr th td ul li code".split())
"""Tags of our own pages."""


def assert_harmless(text: str, fmt: str) -> None:
    """Check for control characters, and for text that the format would run or load."""
    assert all(sign.isprintable() or sign == "\n" for sign in text)
    if fmt == "html":
        assert {*re.findall(r"<[\s/]*([^\s/>]*)", text)} <= OURS
        assert HOSTILE[0] in html.unescape(text)
    elif fmt == "github":
        plain = re.sub(r"(`+)(?!`).*?(?<!`)\1(?!`)", "", text)  # code is printed unchanged
        assert not re.search(r"(?<!\\)(?:\\\\)*<[A-Za-z/!?]|\]\(", plain)
        for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
            assert (
                len({len(re.findall(r"(?<!\\)(?:\\\\)*\|", row)) for row in table.splitlines()})
                == 1
            )
    elif fmt == "latex":
        text = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
        commands = set(re.findall(r"(?<!\\)\\([A-Za-z]+)", text))
        assert not commands & {"input", "write", "include", "def", "csname"}
        assert not re.search(r"(?<!\\)[#%]|\^\^", text)
    elif fmt == "csv":
        assert len({len(row) for row in csv.reader(io.StringIO(text))}) == 1
    else:
        json.loads(text)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of results in which every name is hostile."""
    made = MadeResults(tmp_path_factory.mktemp("hostile"))
    keys = []
    about = {"kind": HOSTILE[0], "caveats": HOSTILE, "warning": HOSTILE[1]}
    for dataset, protocol in ((HOSTILE[0], HOSTILE[10]), (HOSTILE[10], HOSTILE[4])):
        for number, model in enumerate(HOSTILE):
            keys += made.add(
                model,
                [0.1 + 0.01 * number, 0.2],
                dataset,
                protocol,
                condition=HOSTILE[9],
                run_id="../../x",
                **about,
            )
        keys += made.add("=broken", [], dataset, protocol, failed=[0], run_id=HOSTILE[5], **about)
    made.add_run("run-1", keys)
    return made.folder


@pytest.mark.slow
@pytest.mark.parametrize("fmt", FORMATS)
@pytest.mark.parametrize(
    "words",
    [
        ("leaderboard",),
        ("compare", HOSTILE[0], HOSTILE[10], "--dataset", HOSTILE[0]),
    ],
    ids=["leaderboard", "compare"],
)
def test_output_about_hostile_results_is_harmless(words, fmt, folder, tmp_path):
    done = bench_here(*words, "--results", str(folder), "--format", fmt, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_harmless(done.stdout, fmt)
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_a_hostile_word_on_the_command_line_is_refused_in_one_printable_line(tmp_path):
    for name in HOSTILE:
        if "\0" in name:  # no operating system passes it
            continue
        for words in (
            ["run", "--model", name],
            ["run", "--model", "vjm", "--robot", name, "--data", f"{name}.csv"],
            ["run", "--model", "knn", "--set", f"knn.neighbours={name}"],
            ["leaderboard", "--results", f"{name}.results"],
            ["show", name],
        ):
            done = bench_here(*words, cwd=tmp_path)
            assert_refused(done)
            assert one_line(done.stderr) == done.stderr.rstrip("\n"), words
    assert not [*tmp_path.iterdir()]
