"""Help pages fit a terminal, list commands and options in groups, and show a valid example."""

from __future__ import annotations

import re
import shlex

import pytest

from helpers.command_line import bench_here
from helpers.command_tree import COMMANDS, GROUPS, PARAMETERS
from stiffbench.commands import GROUPS as GROUP_NAMES
from stiffbench.main import BY_WORDS, command_app

BROKEN = re.compile(r"\w-\n|^(?!Usage).*\.\.\.\n", re.MULTILINE)
"""A name broken between lines, or a description cut off."""


OPTION = r"--[a-z][a-z-]*"
OPTION_LINE = re.compile(rf"^\W{{0,4}}((?:-\w[,/ ]+)?{OPTION}(?:[,/ ]+{OPTION})*)", re.MULTILINE)
"""Beginning of the lines of an option in the help of its command."""


@pytest.fixture(scope="module")
def help_page(tmp_path_factory):
    """A function that returns the help of a command in a terminal of some width."""
    folder = tmp_path_factory.mktemp("help")

    def printed(command: str, width: int = 100) -> str:
        words = [*command.split()[1:], "--help"]
        done = bench_here(*words, cwd=folder, env={"COLUMNS": str(width)})
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    return printed


@pytest.mark.parametrize("command", PARAMETERS)
def test_a_page_fits_the_terminal_and_breaks_no_name(command, help_page):
    lines = help_page(command, 80).splitlines()
    assert [line for line in lines if len(line) > 80 or not line.isprintable()] == []
    assert BROKEN.search("\n".join(lines)) is None


@pytest.mark.slow
def test_the_commands_and_options_of_the_table_are_those_with_a_description(help_page):
    assert {f"bench {words}" for words in BY_WORDS} == {*COMMANDS}
    for command in COMMANDS:
        page = help_page(command)
        names = {*re.findall(OPTION, " ".join(OPTION_LINE.findall(page)))}
        assert names == {name for name in PARAMETERS[command] if name.startswith("--")}
        for name in PARAMETERS[command]:
            description = rf"{re.escape(name)}(?![\w-])[^\n]*(?:  |\n {{4,}})\w"
            assert re.search(description, page), (command, name)


@pytest.mark.slow
@pytest.mark.parametrize("command", [*COMMANDS, *GROUPS])
def test_every_command_has_an_example_that_is_accepted(command, help_page):
    example = help_page(command).partition("Example:\n")[2]
    assert command in example
    for line in example.splitlines():
        _, *words = shlex.split(line)
        if "--help" not in words:
            length = 2 if words[0] in GROUP_NAMES else 1
            app = command_app(BY_WORDS[" ".join(words[:length])])
            app.parse_args(words[length:], print_error=False, exit_on_error=False)


def test_a_group_without_a_command_prints_its_help_and_ends_with_2(tmp_path):
    for words in ((), ("data",)):
        done = bench_here(*words, cwd=tmp_path)
        assert done.returncode == 2 and done.stdout == ""
        assert done.stderr.startswith(" ".join(["Usage: bench", *words]))
