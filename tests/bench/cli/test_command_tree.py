"""Every option and argument of every command is given nonsense, and each is refused in one line.

The commands are found in click's own tree, so that a new one is covered by being there.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Iterator

import click
import matplotlib.font_manager  # noqa: F401  # it writes its cache where it is first imported
import pytest

import stiffbench as sb
from helpers.command_line import LEAVES, Leaf, assert_refused, bench_here
from stiff_bench.cli.main import bench

WRITTEN = {"--output", "--figure"}
"""Options that name what is written: a file or folder that is not there yet is right for them."""
SENSE = {
    ("data validate", "FILE"),  # its report says on standard output what is wrong with any file
}
"""(command, parameter) for which every text is valid."""
NEW_NAMES = {("new model", "NAME")}
"""(command, parameter) that take the name of something new, so that an unknown word is right."""
NEEDED = {"--model": "vjm", "--dataset": "kr10-twin", "A": "vjm", "B": "mean"}
"""What stands for a required word, or one that another option needs; any other is nonsense."""
WORDS = (
    "no-such-thing",
    "",
    "@",
    "=",
    "a=b",
    "a.b=c",
    "../..",
    "-",
    "é\udcff",
    "vjm@x=1",
    "x" * 5000,
)
"""Nonsense where a text belongs."""
NUMBERS = ("nonsense", "", "nan", "1e", "0x10", "1,5", "--help")
"""Nonsense where a number belongs."""


@pytest.fixture()
def refused(tmp_path, monkeypatch, capfd):
    """A function that runs a command line and checks that it is refused as it should be."""
    (tmp_path / "file.txt").write_bytes(b"\x00\xff\xfe no table, no model, no Python \x80")
    (tmp_path / "folder").mkdir()
    for variable in ("STIFFBENCH_HOME", "STIFFBENCH_CACHE"):
        monkeypatch.setenv(variable, str(tmp_path / "home"))
    there = sorted(tmp_path.rglob("*"))

    def check(words: list[str]) -> str:
        done = bench_here(*words, cwd=tmp_path)
        assert_refused(done)
        assert capfd.readouterr() == ("", ""), words  # nor does a library say anything
        assert sorted(tmp_path.rglob("*")) == there, words
        return done.stderr

    return check


def nonsense(leaf: Leaf, parameter: click.Parameter) -> list[str]:
    """Return words that are wrong for a parameter, by its type."""
    kind, name = parameter.type, spelled(parameter)
    if (leaf.name, name) in SENSE:
        return []
    if isinstance(kind, click.Choice):
        return ["no-such-thing", "", kind.choices[0].upper() + "x", "\udcff"]
    if is_number(parameter):
        lower, upper = getattr(kind, "min", None), getattr(kind, "max", None)
        whole = isinstance(kind, click.types.IntParamType)
        return [
            *NUMBERS,
            *(["1.5", "inf", "1e3"] if whole else ["inf", "-inf", "1e999"]),
            *([] if lower is None else [str(lower - 1)]),
            *([] if upper is None else [str(upper + 1)]),
        ]
    if isinstance(kind, click.Path):
        missing = [] if name in WRITTEN else ["none.csv", "none\udcff.toml", "folder"]
        return ["", "file.txt/below", "x" * 5000, *missing, "file.txt"]
    words = WORDS[1:] if (leaf.name, name) in NEW_NAMES else WORDS
    return [word for word in words if word or parameter.default != ""]


def spelled(parameter: click.Parameter) -> str:
    return (
        parameter.opts[-1] if isinstance(parameter, click.Option) else parameter.human_readable_name
    )


def needed(leaf: Leaf, but: click.Parameter | None = None) -> list[str]:
    """Return the words that a command cannot do without, but for one parameter's."""
    found = []
    for parameter in leaf.command.params:
        name = spelled(parameter)
        wanted = parameter.required or name == "--model"
        if parameter is but or not wanted:
            continue
        word = "new.csv" if name in WRITTEN else NEEDED.get(name, first_of(parameter))
        found += [name, word] if isinstance(parameter, click.Option) else [word]
    return found


def first_of(parameter: click.Parameter) -> str:
    kind = parameter.type
    return kind.choices[0] if isinstance(kind, click.Choice) else "no-such-thing"


@pytest.mark.parametrize("leaf", LEAVES, ids=lambda leaf: leaf.name)
def test_nonsense_for_any_parameter_is_refused_in_one_line(leaf, refused):
    for parameter in leaf.command.params:
        name = spelled(parameter)
        if isinstance(parameter, click.Option) and parameter.is_flag:
            refused([*leaf.words, *needed(leaf), f"{name}=nonsense"])
            continue
        for word in nonsense(leaf, parameter):
            if isinstance(parameter, click.Option):
                said = refused([*leaf.words, *needed(leaf, parameter), f"{name}={word}"])
                if is_number(parameter):
                    assert name.strip("-") in said and "(valid: " in said, word
            else:
                refused([*leaf.words, *needed_around(leaf, parameter, word)])


def is_number(parameter: click.Parameter) -> bool:
    return isinstance(parameter.type, click.types.IntParamType | click.types.FloatParamType)


def needed_around(leaf: Leaf, argument: click.Parameter, word: str) -> list[str]:
    """Return the needed words with `word` in the place of an argument."""
    options = [p for p in leaf.command.params if isinstance(p, click.Option)]
    arguments = [p for p in leaf.command.params if isinstance(p, click.Argument)]
    only_options = Leaf(leaf.words, click.Command(leaf.name, params=options))
    words = [
        word if each is argument else NEEDED.get(spelled(each), first_of(each))
        for each in arguments
    ]
    return [*needed(only_options), "--", *words]


@pytest.mark.parametrize("leaf", LEAVES, ids=lambda leaf: leaf.name)
def test_unknown_missing_and_superfluous_words_are_refused_in_one_line(leaf, refused):
    words = [*leaf.words, *needed(leaf)]
    said = refused([*words, "--no-such-option"])
    assert "no-such-option" in said
    options = [one for one in leaf.command.params if isinstance(one, click.Option)]
    assert all(spelled(option) in said for option in options)
    for parameter in leaf.command.params:
        if isinstance(parameter, click.Option) and not parameter.is_flag:
            assert spelled(parameter) in refused([*words, spelled(parameter)])
        if parameter.required:
            assert spelled(parameter) in refused([*leaf.words, *needed(leaf, parameter)])
    if all(parameter.nargs == 1 for parameter in leaf.command.params):
        refused([*words, "superfluous"])


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
    said = refused([*words, "no-such-command"])
    assert all(name in said for name in ("no-such-command", *group.commands))
    assert "--no-such-option" in refused([*words, "--no-such-option"])


API = {
    "compare": sb.Results.compare,
    "data plan": sb.plan_poses,
    "data simulate": sb.simulate,
    "leaderboard": sb.Results.leaderboard,
    "path compensate": sb.compensate_path,
    "path example": sb.example_path,
}
"""Command -> the function of the Python API that has its options as arguments."""


@pytest.mark.parametrize("name", API)
def test_the_help_of_an_option_states_the_default_of_the_python_api(name):
    (command,) = (leaf.command for leaf in LEAVES if leaf.name == name)
    arguments, stated = inspect.signature(API[name]).parameters, 0
    for option in command.params:
        argument = arguments.get(option.name)
        if not isinstance(option, click.Option) or not isinstance(argument, inspect.Parameter):
            continue
        if argument.default in (None, (), False, inspect.Parameter.empty):
            continue
        shown = re.search(r"\[default: ([\w.]+)", option.help)
        text = str(option.default if shown is None else shown[1]).removesuffix("mm")
        assert type(argument.default)(text) == argument.default, option.name
        stated += 1
    assert stated


def test_the_tree_is_whole():
    names = {leaf.name for leaf in LEAVES}
    assert {"run", "data validate", "new model", "cache clear", "predict"} <= names
    assert {command for command, _ in SENSE | NEW_NAMES} <= names
