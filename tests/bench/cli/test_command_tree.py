"""Nonsense for any option or argument of any command is refused in one line.

The commands come from click's own tree, so that new commands are covered at once.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

import click
import matplotlib.font_manager  # noqa: F401  # it writes its cache where it is first imported
import pytest

from helpers.command_line import LEAVES, Leaf, assert_refused, bench_here
from stiff_bench.cli.main import bench

WRITTEN = {"--output", "--figure"}
"""Options that name an output; a path that does not exist yet is valid."""
SENSE = {("data validate", "FILE")}
"""(command, parameter) for which every text is valid; the report lists its errors."""
NEW_NAMES = {("new model", "NAME")}
"""(command, parameter) that take a new name, so that an unknown word is valid."""
NEEDED = {"--model": "vjm", "--dataset": "kr10-twin", "A": "vjm", "B": "mean"}
"""Valid values of required parameters; every other value is nonsense."""
WORDS = ("no-such-thing", "", "=", "../..", "é\udcff", "x" * 5000)
"""Nonsense values of a text parameter."""
NUMBERS = ("nonsense", "", "nan", "1,5")
"""Nonsense values of a number parameter."""


@pytest.fixture()
def refused(tmp_path, monkeypatch, capfd):
    """A function that runs a command line and checks its refusal."""
    (tmp_path / "file.txt").write_bytes(b"\x00\xff\xfe no table, no model, no Python \x80")
    (tmp_path / "folder").mkdir()
    for variable in ("STIFFBENCH_HOME", "STIFFBENCH_CACHE"):
        monkeypatch.setenv(variable, str(tmp_path / "home"))
    files_before = sorted(tmp_path.rglob("*"))

    def check(words: list[str]) -> str:
        done = bench_here(*words, cwd=tmp_path)
        assert_refused(done)
        assert capfd.readouterr() == ("", ""), words  # no library prints anything
        assert sorted(tmp_path.rglob("*")) == files_before, words
        return done.stderr

    return check


def is_number(parameter: click.Parameter) -> bool:
    return isinstance(parameter.type, click.types.IntParamType | click.types.FloatParamType)


def nonsense(leaf: Leaf, parameter: click.Parameter) -> list[str]:
    """Return invalid words for a parameter, by its type."""
    kind, name = parameter.type, spelled(parameter)
    if (leaf.name, name) in SENSE:
        return []
    if isinstance(kind, click.Choice):
        return ["no-such-thing", ""]
    if is_number(parameter):
        is_integer = isinstance(kind, click.types.IntParamType)
        bounds = ((getattr(kind, "min", None), -1), (getattr(kind, "max", None), 1))
        beyond = [str(bound + step) for bound, step in bounds if bound is not None]
        return [*NUMBERS, *(["1.5"] if is_integer else ["inf", "1e999"]), *beyond]
    if isinstance(kind, click.Path):
        missing = [] if name in WRITTEN else ["none.csv", "none\udcff.toml", "folder"]
        return ["", "file.txt/below", "x" * 5000, *missing, "file.txt"]
    words = WORDS[1:] if (leaf.name, name) in NEW_NAMES else WORDS
    return [word for word in words if word or parameter.default != ""]


def spelled(parameter: click.Parameter) -> str:
    is_option = isinstance(parameter, click.Option)
    return parameter.opts[-1] if is_option else parameter.human_readable_name


def needed(
    leaf: Leaf, skipped_parameter: click.Parameter | None = None, word: str | None = None
) -> list[str]:
    """Return the words that a command requires, except for one parameter.

    `word` takes the place of that parameter if it is an argument.
    """
    options: list[str] = []
    arguments: list[str] = []
    for parameter in leaf.command.params:
        name, kind = spelled(parameter), parameter.type
        usual = kind.choices[0] if isinstance(kind, click.Choice) else "no-such-thing"
        usual = "new.csv" if name in WRITTEN else NEEDED.get(name, usual)
        if parameter is skipped_parameter:
            arguments += [] if word is None else [word]
        elif isinstance(parameter, click.Argument):
            arguments += [usual] * (parameter.required or word is not None)
        elif parameter.required or name == "--model":
            options += [name, usual]
    return [*options, "--", *arguments] if arguments else options


@pytest.mark.parametrize("leaf", LEAVES, ids=lambda leaf: leaf.name)
def test_nonsense_for_any_parameter_is_refused_in_one_line(leaf, refused):
    for parameter in leaf.command.params:
        name = spelled(parameter)
        if not isinstance(parameter, click.Option):
            for word in nonsense(leaf, parameter):
                refused([*leaf.words, *needed(leaf, parameter, word)])
            continue
        for word in ["nonsense"] if parameter.is_flag else nonsense(leaf, parameter):
            message = refused([*leaf.words, f"{name}={word}", *needed(leaf, parameter)])
            if is_number(parameter):
                assert name.strip("-") in message and "(valid: " in message, word


@pytest.mark.parametrize("leaf", LEAVES, ids=lambda leaf: leaf.name)
def test_unknown_missing_and_superfluous_words_are_refused_in_one_line(leaf, refused):
    words = needed(leaf)
    message = refused([*leaf.words, "--no-such-option", *words])
    assert "no-such-option" in message
    options = [
        parameter for parameter in leaf.command.params if isinstance(parameter, click.Option)
    ]
    assert all(spelled(option) in message for option in options)
    for parameter in leaf.command.params:
        if parameter.required:
            assert spelled(parameter) in refused([*leaf.words, *needed(leaf, parameter)])
    if all(parameter.nargs == 1 for parameter in leaf.command.params):
        refused([*leaf.words, *words, "superfluous"])


def groups(command: click.Command, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if isinstance(command, click.Group):
        yield words
        for name, below in command.commands.items():
            yield from groups(below, (*words, name))


@pytest.mark.parametrize(
    "words", list(groups(bench)), ids=lambda words: " ".join(("bench", *words))
)
def test_an_unknown_command_is_refused_in_one_line(words, refused):
    group = functools.reduce(lambda above, word: above.commands[word], words, bench)
    message = refused([*words, "no-such-command"])
    assert all(name in message for name in ("no-such-command", *group.commands))
    assert "--no-such-option" in refused([*words, "--no-such-option"])
