"""The commands that take a model to work: words in, one function of `model_tools` called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from stiff_bench.cli.options import (
    FILE,
    FiniteRange,
    chosen,
    data_options,
    debug_option,
    device_option,
    plugin_option,
    seed_option,
    settings_option,
)

model_file_option = click.option(
    "--model", type=FILE, required=True, metavar="FILE", help="A model that `bench fit` wrote."
)


@click.command()
@click.option(
    "--model",
    "models",
    required=True,
    multiple=True,
    metavar="KEY",
    help="One model that stiffbench ships.",
)
@click.option("--dataset", "datasets", multiple=True, metavar="KEY", help="A data set to fit to.")
@data_options
@settings_option
@seed_option("the model")
@device_option("Where networks are trained.")
@plugin_option
@click.option("--output", type=FILE, required=True, metavar="FILE", help="A new file.")
@debug_option
def fit(plugins: tuple[Path, ...], **words: Any) -> None:
    """Fit a model to all samples of a data set and save it."""
    from stiff_bench.model_tools.saved import fit_model
    from stiff_bench.plan.registry import usable_registry
    from stiff_bench.plan.request import plan_run
    from stiff_protocols.contract.errors import ConfigError

    if len(words["datasets"]) + len(words["data"]) != 1:
        raise ConfigError("give one of --dataset KEY and --data FILE.csv")
    registry = usable_registry(plugins)
    click.echo(fit_model(plan_run(chosen(words, registry), registry, **words)))


@click.command()
@model_file_option
@click.option(
    "--input",
    "loads",
    type=FILE,
    required=True,
    metavar="FILE.csv",
    help="Poses and wrenches, in the columns of a measurement; deflections are not read.",
)
@click.option(
    "--output",
    type=FILE,
    required=True,
    metavar="FILE.csv",
    help="A new file: the same rows with dx_mm, dy_mm, dz_mm.",
)
@click.option(
    "--coverage",
    type=FiniteRange(0, 1, min_open=True, max_open=True),
    help="Write intervals that are to hold each deflection with this probability too.",
)
@debug_option
def predict(model: Path, loads: Path, output: Path, coverage: float | None) -> None:
    """Predict the deflections of a file of poses and wrenches."""
    from stiff_bench.model_tools.saved import predict_file

    click.echo(predict_file(model, loads, output, coverage))


@click.command()
@model_file_option
@click.option("--output", type=FILE, required=True, metavar="FILE.onnx", help="A new file.")
@debug_option
def export(model: Path, output: Path) -> None:
    """Write a saved network as ONNX."""
    from stiff_bench.model_tools.saved import export_file

    click.echo(export_file(model, output))


@click.command()
@click.argument("key")
@click.option(
    "--dataset",
    default="fanuc-r2000ic",
    show_default=True,
    metavar="KEY",
    help="What a model or a protocol is checked on.",
)
@settings_option
@plugin_option
@debug_option
def check(key: str, dataset: str, settings: tuple[str, ...], plugins: tuple[Path, ...]) -> int:
    """Check that a model, data set or protocol keeps its contract.

    Exit status: 0 nothing failed, 1 a check failed, 2 it cannot be checked.
    """
    from stiff_bench.model_tools.plugins import checklist
    from stiff_bench.plan.registry import usable_registry

    text, kept = checklist(key, dataset, settings, usable_registry(plugins))
    click.echo(text)
    return 0 if kept else 1


@click.group()
def new() -> None:
    """Write the files of a plugin to begin with."""


@new.command()
@click.argument("name")
@click.option(
    "--output", type=FILE, default=Path(), show_default=True, metavar="DIR", help="Where they go."
)
@debug_option
def model(name: str, output: Path) -> None:
    """Write a small working model and its test."""
    from stiff_bench.model_tools.plugins import new_model
    from stiff_bench.plan.registry import usable_registry

    click.echo(new_model(name, output, usable_registry()))
