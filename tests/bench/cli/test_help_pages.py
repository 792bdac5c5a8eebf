"""Help pages fit a terminal, list commands in groups, and show a valid example."""

from __future__ import annotations

import io
import os
import re
import shlex
from collections import Counter
from contextlib import redirect_stdout
from unittest import mock

import click
import pytest

from helpers.command_line import LEAVES, Leaf
from stiff_bench.cli.help_pages import COMMAND_GROUPS, MANY_OPTIONS, OPTION_GROUPS
from stiff_bench.cli.main import bench

WORDS = [(), *sorted({leaf.words[:n] for leaf in LEAVES for n in range(1, len(leaf.words) + 1)})]
"""Words that call each command and group."""
BROKEN = re.compile(r"\w-\n|^(?!Usage).*\.\.\.\n", re.MULTILINE)
"""A name broken between lines, or a description cut off."""
RANGE = re.compile(r"\d<|<=?x|x[<>]|RANGE")


def help_page(words: tuple[str, ...], width: int) -> str:
    printed = io.StringIO()  # click's test runner sets its own width
    with mock.patch.dict(os.environ, COLUMNS=str(width)), redirect_stdout(printed):
        bench.main([*words, "--help"], prog_name="bench", standalone_mode=False)
    return printed.getvalue()


@pytest.mark.parametrize("width", [80, 100])
def test_help_fits_the_terminal_and_is_plain_text_without_one(width):
    for words in WORDS:
        lines = help_page(words, width).splitlines()
        assert [line for line in lines if len(line) > width or not line.isprintable()] == [], words


def test_help_uses_a_wide_terminal():
    assert max(map(len, help_page(("run",), 100).splitlines())) > 80


@pytest.mark.parametrize("width", [80, 100])
def test_no_line_of_help_ends_within_a_name_or_names_a_range(width):
    pages = {words: help_page(words, width) for words in WORDS}
    broken = [page for page in pages.values() if BROKEN.search(page)]
    assert broken == []
    assert [words for words, page in pages.items() if RANGE.search(page)] == []


def test_every_command_is_in_one_group_and_every_group_is_shown():
    grouped = Counter(name for names in COMMAND_GROUPS.values() for name in names)
    assert grouped == Counter([*bench.commands])
    headings = re.findall(r"^(\S.*):$", help_page((), 80), re.MULTILINE)
    assert headings == [*COMMAND_GROUPS, "Options", "Example"]


def test_the_options_of_run_are_all_in_groups():
    page = help_page(("run",), 80)
    headings = re.findall(r"^(\S.*):$", page, re.MULTILINE)
    assert headings == [*OPTION_GROUPS, "Example"]
    assert len(bench.commands["run"].params) >= MANY_OPTIONS


@pytest.mark.parametrize("leaf", LEAVES, ids=lambda leaf: leaf.name)
def test_help_lists_every_option_once(leaf: Leaf):
    page, listed = help_page(leaf.words, 80), [option.opts[0] for option in options(leaf.command)]
    printed = re.findall(r"^  (--[a-z-]+)", page, re.MULTILINE)
    printed = [name for name in printed if name != "--help"]  # "-h, --help" where first called so
    assert sorted(printed) == sorted(listed)


def options(command: click.Command) -> list[click.Option]:
    return [option for option in command.params if isinstance(option, click.Option)]


@pytest.mark.parametrize("words", WORDS, ids=" ".join)
def test_every_command_has_an_example_that_click_accepts(words):
    command: click.Command = bench
    for word in words:
        assert isinstance(command, click.Group)
        command = command.commands[word]
    examples = (command.epilog or "").splitlines()
    assert examples
    assert help_page(words, 80).endswith("".join(f"  {line}\n" for line in examples))
    for line in examples:
        called = accepted(shlex.split(line)[1:])
        assert called[: len(words)] == words, line


def accepted(arguments: list[str]) -> tuple[str, ...]:
    """Return the words that call a command; raise if it refuses what follows them."""
    called: list[str] = []
    command: click.Command = bench
    context = click.Context(bench)
    while isinstance(command, click.Group):
        name, command_found, arguments = command.resolve_command(context, arguments)
        assert name is not None and command_found is not None
        called, command = [*called, name], command_found
    if arguments != ["--help"]:
        with mock.patch("stiff_bench.api.registered.use_only"):  # the plugin does not exist yet
            command.make_context(name, arguments)
    return tuple(called)
