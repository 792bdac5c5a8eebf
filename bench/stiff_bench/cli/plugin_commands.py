"""`bench list`, `show`, `check` and `new`: what can be named, and plugins."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench import api
from stiff_bench.cli.click_options import (
    FILE,
    format_option,
    plugin_option,
    print_tables,
    settings_option,
)
from stiff_bench.cli.help_pages import command, group
from stiff_bench.console import print_markdown, print_prose

KINDS = ("models", "datasets", "protocols", "metrics", "figures")


@command("list", epilog="bench list models")
@click.argument("kind", metavar="KIND", type=click.Choice(KINDS))
@plugin_option
@format_option
def list_(kind: str, fmt: str) -> None:
    """List models, data sets, protocols, metrics or figures.

    KIND is one of models, datasets, protocols, metrics and figures.
    """
    print_tables(getattr(api.registered, f"list_{kind}")(), fmt)


@command(epilog="bench show vjm-gp")
@click.argument("key")
@plugin_option
def show(key: str) -> None:
    """Explain a model, data set or protocol, with its options."""
    text = api.registered.show(key)
    show_text = print_markdown if text.startswith("#") else print_prose
    show_text(text)


@command(epilog="bench check my-model --plugin my_model.py")
@click.argument("key")
@click.option(
    "--dataset",
    default="fanuc-r2000ic",
    metavar="KEY",
    help="Data set to check a model or protocol on.",
)
@settings_option
@plugin_option
def check(key: str, dataset: str, settings: tuple[str, ...]) -> int:
    """Check the interface of a model, data set or protocol.

    Exit status: 0 no check failed; 1 a check failed; 2 it cannot be checked.
    """
    checked = api.registered.check(key, dataset=dataset, settings=settings)
    print_prose(repr(checked))
    return 0 if checked.passed else 1


@group(epilog="bench new model my-model")
def new() -> None:
    """Write the first files of a plugin."""


@new.command(epilog="bench new model my-model")
@click.argument("name")
@click.option("--output", type=FILE, default=Path(), metavar="DIR", help="Folder to write to.")
def model(name: str, output: Path) -> None:
    """Write a small working model and its test."""
    print_prose(api.registered.new_model(name, output))
