"""Help pages: commands and options in groups, and an example of each command."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import click

from stiff_protocols.contract.errors import unknown_name

COMMAND_GROUPS = {
    "Your robot's data": ("data",),
    "Fit and test models": ("run", "reproduce"),
    "Read results": ("leaderboard", "compare", "report", "figure", "table", "merge", "results"),
    "Use a model on your robot": ("fit", "predict", "path", "map", "posture", "export"),
    "Look up and add names": ("list", "show", "check", "new"),
    "Take part in the leaderboard": ("submit", "verify"),
}
"""Heading -> commands of `bench`, in the order of the help page."""
OPTION_GROUPS = {
    "Models and data": (
        *("--model", "--dataset", "--protocol", "--condition", "--splits", "--set", "--study"),
        *("--lite", "--against"),
        *("--metric", "--axis", "--coverage", "--seed", "--plugin", "--results", "--input"),
    ),
    "Your own data": (
        *("--data", "--urdf", "--robot", "--tip", "--tcp", "--no-torque", "--sheet"),
        *("--pose-tolerance", "--licence", "--citation", "--source"),
    ),
    "Computation": (
        *("--plan", "--rerun", "--jobs", "--threads", "--device", "--isolate", "--timeout"),
        *("--memory", "--dask"),
    ),
    "Output": ("--output", "--figure", "--format", "--paper", "--verbose", "-h"),
}
"""Heading -> options of all commands, in the order of the help page."""
MANY_OPTIONS = 12
"""A command with fewer options has one list of them."""
WIDEST_PAGE = 100
NAME_COLUMN = 28
"""Width of the column of options' names; longer names have a line of their own."""
KEPT_TOGETHER = re.compile(r"`[^`]*`|default: |-")
"""Parts of a text that no line break divides."""
UNBREAKABLE = str.maketrans({"-": "\u2011", " ": "\u00a0"})
BREAKABLE = str.maketrans({"\u2011": "-", "\u00a0": " "})


class HelpFormatter(click.HelpFormatter):
    """Formats help pages; no line break divides a name or a command."""

    def write(self, string: str) -> None:
        """Write a text with its usual spaces and hyphens."""
        super().write(string.translate(BREAKABLE))

    def write_heading(self, heading: str) -> None:
        """Write a heading, bold on a terminal."""
        self.write(" " * self.current_indent + click.style(f"{heading}:", bold=True) + "\n")

    def write_text(self, text: str) -> None:
        """Write paragraphs."""
        super().write_text(_kept_together(text))

    def write_dl(
        self, rows: Iterable[tuple[str, str]], col_max: int = NAME_COLUMN, col_spacing: int = 2
    ) -> None:
        """Write names and their descriptions as two columns."""
        kept_rows = [(name, _kept_together(text)) for name, text in rows]
        super().write_dl(kept_rows, col_max, col_spacing)


def _kept_together(text: str) -> str:
    """Replace the spaces and hyphens at which lines must not break."""
    return KEPT_TOGETHER.sub(lambda part: part[0].translate(UNBREAKABLE), text)


class HelpContext(click.Context):
    """Formats help pages by `HelpFormatter`."""

    formatter_class = HelpFormatter


class Command(click.Command):
    """A command whose help has groups of options and an example, its epilog."""

    context_class = HelpContext

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, in groups if there are many."""
        records = {
            option.opts[0]: record
            for option in self.get_params(ctx)
            if isinstance(option, click.Option) and (record := option.get_help_record(ctx))
        }
        groups = OPTION_GROUPS if len(records) >= MANY_OPTIONS else {}
        _write_groups(formatter, records, groups, "Options")

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the example, each line as it is."""
        if self.epilog:
            with formatter.section("Example"):
                for line in self.epilog.splitlines():
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")


class Commands(Command, click.Group):
    """A group whose help has groups of commands, and that names the valid commands in errors."""

    command_class = Command
    group_class = type

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command; ConfigError: there is none of this name."""
        if not args[0].startswith("-") and args[0] not in self.commands:
            raise unknown_name(f"{ctx.command_path} command", args[0], self.commands)
        return super().resolve_command(ctx, args)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, then the options."""
        records = {
            name: (name, command.get_short_help_str(formatter.width))
            for name, command in self.commands.items()
        }
        groups = COMMAND_GROUPS if ctx.parent is None else {}
        _write_groups(formatter, records, groups, "Commands")
        Command.format_options(self, ctx, formatter)


def _write_groups(
    formatter: click.HelpFormatter,
    records: Mapping[str, tuple[str, str]],
    groups: Mapping[str, tuple[str, ...]],
    ungrouped_heading: str,
) -> None:
    """Write records (name, description) in groups, those without a group first."""
    names = [name for name, _ in records.values() if len(name) <= NAME_COLUMN]
    width = max(map(len, names), default=0)
    grouped = {key for keys in groups.values() for key in keys}
    ungrouped = tuple(key for key in records if key not in grouped)
    keys_of = {ungrouped_heading: ungrouped, **groups}
    for heading, keys in keys_of.items():
        chosen = [records[key] for key in keys if key in records]
        if chosen:
            with formatter.section(heading):
                formatter.write_dl([(f"{name:<{width}}", text) for name, text in chosen], width)


def command(
    name: str | None = None, *, epilog: str, **attributes: Any
) -> Callable[[Callable[..., Any]], click.Command]:
    """Decorate a function as a command; `epilog` is its example, a shell command per line."""
    return click.command(name, cls=Command, epilog=epilog, **attributes)


def group(*, epilog: str, **attributes: Any) -> Callable[[Callable[..., Any]], Commands]:
    """Decorate a function as a group of commands; `epilog` is its example."""
    return click.group(cls=Commands, epilog=epilog, **attributes)
