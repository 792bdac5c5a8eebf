"""The command line as users see it: commands, options, exit statuses and refusals."""

from __future__ import annotations

from decimal import Decimal

import matplotlib.font_manager  # noqa: F401  # it writes its cache where it is first imported
import pytest

from helpers.command_line import assert_refused, bench_here
from helpers.command_tree import COMMANDS, GROUPS, PARAMETERS

WRITTEN = {"--output", "--figure", "--loads-template", "--urdf-out"}
"""Options that name an output; a path that does not exist yet is valid."""
SENSE = {("bench data validate", "FILE")}
"""(command, parameter) for which every text is valid; the report lists its errors."""
NEW_NAMES = {("bench new model", "NAME")}
"""(command, parameter) that take a new name, so that an unknown word is valid."""
NEEDED = {"--model": "vjm", "--dataset": "kr10-twin", "A": "vjm", "B": "mean"}
"""Valid values of required parameters; every other value is nonsense."""
WORDS = ("no-such-thing", "", "é\udcff")
"""Nonsense values of a text parameter."""
NUMBERS = ("nonsense", "nan")
"""Nonsense values of a number parameter."""


@pytest.fixture()
def refused(tmp_path, monkeypatch, capfd):
    """A function that runs a command line and checks its refusal."""
    (tmp_path / "file.txt").write_bytes(b"\x00\xff\xfe no table, no model, no Python \x80")
    (tmp_path / "folder").mkdir()
    for variable in ("STIFFBENCH_HOME", "STIFFBENCH_CACHE"):
        monkeypatch.setenv(variable, str(tmp_path / "home"))
    files_before = sorted(tmp_path.rglob("*"))

    def check(command: str, *words: str) -> str:
        done = bench_here(*command.split()[1:], *words, cwd=tmp_path)
        assert_refused(done)
        assert capfd.readouterr() == ("", ""), words  # no library prints anything
        assert sorted(tmp_path.rglob("*")) == files_before, words
        return str(done.stderr)

    return check


def bounds(kind: str) -> list[str]:
    """Return a number below the lower bound, and one above the upper bound."""
    if " " not in kind:
        return []
    low, _, high = kind.split()[1].partition("..")
    return [str(Decimal(bound) + step) for bound, step in ((low, -1), (high, 1)) if bound]


def nonsense(command: str, name: str, kind: str) -> list[str]:
    """Return invalid words for a parameter, by its kind."""
    if (command, name) in SENSE:
        return []
    if kind == "flag":
        return ["nonsense"]
    if kind == "path":
        missing = [] if name in WRITTEN else ["none\udcff.toml", "folder"]
        return ["", "file.txt/below", *missing, "file.txt"]
    if kind == "text":
        return list(WORDS[1:] if (command, name) in NEW_NAMES else WORDS)
    if kind.startswith("integer"):
        return [*NUMBERS, "1.5", *bounds(kind)]
    if kind.startswith("number"):
        return [*NUMBERS, "1e999", *bounds(kind)]
    return ["no-such-thing", ""]


def needed(command: str, skipped: str = "", word: str | None = None) -> list[str]:
    """Return the words that a command requires, except for one parameter.

    `word` takes the place of that parameter if it is an argument.
    """
    options: list[str] = []
    arguments: list[str] = []
    for name, kind in PARAMETERS[command].items():
        first_choice = kind.partition("|")[0] if "|" in kind else "no-such-thing"
        usual = "new.csv" if name in WRITTEN else NEEDED.get(name, first_choice)
        if name == skipped:
            arguments += [] if word is None else [word]
        elif not name.startswith("--"):
            arguments.append(usual)
        elif kind.endswith(" required") or name == "--model":
            options += [name, usual]
    return [*options, "--", *arguments] if arguments else options


FIRST_WITH = {
    (name, kind): command
    for command in reversed(COMMANDS)
    for name, kind in PARAMETERS[command].items()
}
"""Option and kind -> the first command that has it; one reader reads it in all commands."""


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_nonsense_for_any_parameter_is_refused_in_one_line(command, refused):
    for name, kind_and_need in PARAMETERS[command].items():
        kind = kind_and_need.removesuffix(" required")
        if name == "--help" or FIRST_WITH[name, kind_and_need] != command:
            continue
        for word in nonsense(command, name, kind):
            if not name.startswith("--"):
                refused(command, *needed(command, name, word))
                continue
            message = refused(command, f"{name}={word}", *needed(command, name))
            if kind.startswith(("integer", "number")):
                assert name.strip("-") in message and "(valid: " in message, word
            if "|" in kind and word:
                assert word in message


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_unknown_missing_and_superfluous_words_are_refused_in_one_line(command, refused):
    words = needed(command)
    assert "no-such-option" in refused(command, "--no-such-option", *words)
    for name, kind in PARAMETERS[command].items():
        if kind.endswith(" required"):
            message = refused(command, *needed(command, name))
            assert name in message or not name.startswith("--")  # without A, B is missing
    if not any(name.endswith("...") for name in PARAMETERS[command]):
        refused(command, *words, "superfluous")


@pytest.mark.parametrize("group", GROUPS)
def test_an_unknown_command_is_refused_in_one_line(group, refused):
    message = refused(group, "no-such-command")
    names = [name.removeprefix(f"{group} ") for name in PARAMETERS if name.startswith(f"{group} ")]
    assert all(name in message for name in ("no-such-command", *names) if " " not in name)
    assert "--no-such-option" in refused(group, "--no-such-option")
