"""Names in strangers' results do no harm: in tables, reports and messages, as text or as paths."""

from __future__ import annotations

import csv
import io
import itertools
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from importlib.resources import files

import pytest

from helpers.command_line import assert_refused, bench_here
from helpers.made_results import MadeResults
from stiff_bench.console import one_line, printable
from stiff_bench.tables.render import LATEX_NEEDS, csv_cell, markdown_text, render
from stiff_bench.tables.table import Column, Name, Quantity, Table

SCRIPT = "<script>alert(1)</script>"
HOSTILE = (
    SCRIPT,
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
)
TABLE = Table(
    title=" ".join(HOSTILE),
    columns=[
        Column("name", "text"),
        *(Column(name, "text") for name in HOSTILE[::2]),
        *(Column(name, unit=name, about={name: name}) for name in HOSTILE[1::2]),
    ],
    rows=[
        [
            Name(name, name),
            *HOSTILE[::2],
            *(Quantity(mark=other, status=other) for other in HOSTILE[1::2]),
        ]
        for name in HOSTILE
    ],
    notes=HOSTILE,
    about={HOSTILE[0]: HOSTILE[10]},
)


class Tags(HTMLParser):
    """Notes which tags a page has, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)

    def handle_data(self, data):
        self.text += data


def tags(page: str) -> Tags:
    found = Tags()
    found.feed(page)
    return found


OURS = set("section h2 table thead tbody tr th td ul li code p".split())


def assert_harmless(text: str, fmt: str) -> None:
    """No control character, and nothing that the format would run, load or take for a row."""
    assert all(sign.isprintable() or sign == "\n" for sign in text)
    if fmt == "html":
        assert tags(text).tags <= OURS
    elif fmt == "github":
        plain = re.sub(r"(`+)(?!`).*?(?<!`)\1(?!`)", "", text)  # code stands as it is
        assert not re.search(r"(?<!\\)<[A-Za-z/!?]|\]\(", plain)
    elif fmt == "latex":
        text = text.removeprefix(LATEX_NEEDS)
        commands = set(re.findall(r"(?<!\\)\\([A-Za-z]+)", text))
        assert not commands & {"input", "write", "include", "def", "csname"}
        assert not re.search(r"(?<!\\)[#%]|\^\^", text)
    elif fmt == "csv":
        for cell in itertools.chain.from_iterable(csv.reader(io.StringIO(text))):
            assert not cell or cell[0] not in "=+@\t\r"
            assert not cell.startswith("-") or float(cell) <= 0.0
    else:
        json.loads(text)


@pytest.mark.parametrize("fmt", ["github", "latex", "csv", "html", "json"])
def test_a_table_of_hostile_texts_keeps_its_shape_and_runs_nothing(fmt):
    text = printable(render([TABLE], fmt, f"bench run {' '.join(HOSTILE)}"))  # as print_text does
    assert_harmless(text, fmt)
    n = len(HOSTILE)
    if fmt == "github":
        rows = [line for line in text.splitlines() if line.startswith("| ")]
        assert len(rows) == n + 1
        assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {n + 2}
        assert len(text.splitlines()) == 1 + 1 + n + 2 + 1 + n + 1
    if fmt == "html":
        assert text.count("<tr>") == n + 1 and text.count("<td") == n * (n + 1)
        assert SCRIPT in tags(text).text
    if fmt == "latex":
        body = text.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
        rows = body.strip().splitlines()
        assert len(rows) == n
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {n}


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs LaTeX")
def test_latex_reads_no_file_that_a_name_asks_for(tmp_path):
    text = render([TABLE], "latex", "bench")
    page = (
        r"\documentclass{article}\usepackage{booktabs}\usepackage{graphicx}\usepackage{siunitx}"
        rf"\begin{{document}}{text}\end{{document}}"
    )
    (tmp_path / "page.tex").write_text(page)
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-recorder", "page.tex"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True)
    assert done.returncode == 0, done.stdout
    assert "passwd" not in (tmp_path / "page.fls").read_text()


def test_control_characters_are_shown_and_not_obeyed():
    assert printable("a\x1b[31m\0\u202eü ±\n\t") == "a\\x1b[31m\\x00\\u202eü ±\n\t"
    assert one_line("a\nb\r\nc\u2028d\x1be") == "a b c d\\x1be"
    assert (
        printable("M\udcffller") == "M\\udcffller"
    )  # a byte of a file's name that is no character


def test_markdown_texts_stay_what_they_were_where_nothing_is_to_escape():
    for text in ("p < 0.001", "a <= b", "ME [mm]", "A -> B", "5 (of 10)"):
        assert markdown_text(text) == text
    assert markdown_text("<b>") == r"\<b>" and markdown_text("[a](b)") == r"[a]\(b)"


def test_texts_that_a_spreadsheet_would_compute_are_quoted_and_numbers_are_not():
    numbers = ["-0.5", "-1e-05", "+3", "-inf", "1", "", -0.5, None]
    assert [csv_cell(number) for number in numbers] == [*numbers[:-2], "-0.5", None]
    for text in ("=1+1", "+cmd", "-2+3", "@SUM(A1)", "\t=1", "\r=1", "-"):
        assert csv_cell(text) == f"'{text}"
    assert csv_cell("ft-mlp") == "ft-mlp" and csv_cell("a=b") == "a=b"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Results whose every name is hostile; each name is a model, some a data set and a protocol."""
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


@pytest.mark.parametrize("fmt", ["github", "latex", "csv", "html", "json"])
@pytest.mark.parametrize(
    "words",
    [
        ("leaderboard",),
        ("compare", HOSTILE[0], HOSTILE[10]),
        ("compare", HOSTILE[0], HOSTILE[10], "--dataset", HOSTILE[0]),
    ],
)
def test_what_is_said_of_hostile_results_is_harmless(words, fmt, folder, tmp_path):
    done = bench_here(*words, "--results", str(folder), "--format", fmt, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_harmless(done.stdout, fmt)
    assert not [*tmp_path.iterdir()]


def test_a_hostile_word_on_the_command_line_is_refused_in_one_printable_line(tmp_path):
    asked = [
        words
        for name in HOSTILE
        if "\0" not in name  # no operating system hands it over
        for words in (
            ["run", "--model", name],
            ["run", "--model", "vjm", "--dataset", name],
            ["run", "--model", "vjm", "--protocol", name],
            ["run", "--model", "vjm", "--robot", name, "--data", f"{name}.csv"],
            ["run", "--model", "vjm", "--plugin", f"{name}.py"],
            ["run", "--model", "mlp", "--set", f"mlp.width={name}"],
            ["leaderboard", "--results", f"{name}.results"],
            ["show", name],
        )
    ]
    for words in asked:
        done = bench_here(*words, cwd=tmp_path)
        assert_refused(done)
        assert one_line(done.stderr) == done.stderr.rstrip("\n"), words
    assert not [*tmp_path.iterdir()]


def test_the_name_of_a_strangers_robot_is_printed_escaped(tmp_path):
    urdf = (files("stiff_datasets") / "robots" / "ur5.urdf").read_text(encoding="utf-8")
    named = urdf.replace('robot name="ur5"', 'robot name="a\u009b2Jb\u202ec"')
    (tmp_path / "arm.urdf").write_text(named, encoding="utf-8")
    words = ["--urdf", "arm.urdf", "--load", "0,0,-10,0,0,0", "--output", "p.csv"]
    done = bench_here("path", "example", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "for a\\x9b2Jb\\u202ec" in done.stdout
