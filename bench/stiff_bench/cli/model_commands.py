"""The commands that take a model to work: words in, the Python API called, the result printed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from stiff_bench import api
from stiff_bench.cli.click_options import (
    FILE,
    coverage_option,
    data_options,
    device_option,
    output_option,
    plugin_option,
    seed_option,
    settings_option,
    several_keys,
    sheet_option,
)
from stiff_bench.cli.help_pages import command
from stiff_bench.console import print_prose, print_text, warnings_on_stderr
from stiff_protocols.contract.files import check_new_file

model_file_option = click.option(
    "--model", type=FILE, required=True, metavar="FILE", help="Model file of `bench fit`."
)


@command(epilog="bench fit --model gp-springs --data my.csv --robot ur5 --output my.stiff")
@several_keys("--model", "models", required=True, help="Model to fit.")
@several_keys("--dataset", "datasets", help="Data set to fit it to.")
@data_options
@settings_option
@seed_option
@device_option
@plugin_option
@click.option(
    "--cross-validate/--no-cross-validate",
    default=True,
    help="Store the error at left-out poses, from one more fit for each fifth of the poses.",
)
@output_option("FILE")
def fit(
    output: Path,
    seed: int,
    device: str,
    cross_validate: bool,
    models: tuple[str, ...],
    datasets: tuple[str, ...],
    data: Sequence[api.data_sets.Dataset],
    settings: tuple[str, ...],
) -> None:
    """Fit a model to all samples of a data set and save it.

    As in `bench run`, a network chooses its number of epochs by cross-validation, then learns from
    every sample. With `training=best`, a fifth of the poses chooses the epoch instead.
    """
    model, samples = api.evaluation.model_and_data(
        models, [*datasets, *data], settings=settings, device=device
    )
    check_new_file(output)
    with warnings_on_stderr():
        model.fit(samples, seed=seed)
        model.save(output, cross_validate=cross_validate)
    print_prose(f"{output}: {model.report(samples, seed)}")


@command(epilog="bench predict --model my.stiff --input poses.csv --output deflections.csv")
@model_file_option
@click.option(
    "--input",
    "loads",
    type=FILE,
    required=True,
    metavar="FILE.csv",
    help="Poses and wrenches; deflections are ignored.",
)
@output_option(
    "FILE.csv", "New file: the same rows with dx_mm, dy_mm, dz_mm; `-` for standard output."
)
@coverage_option("Add prediction intervals of this coverage, per axis.")
@sheet_option
@plugin_option
def predict(model: Path, loads: Path, output: Path, **words: Any) -> None:
    """Predict the deflections of a file of poses and wrenches.

    The column `extrapolates` names what is unlike the training samples: joints, pose-gap, load or
    load-gap. Such a prediction is a guess.
    """
    fitted = api.model.load_model(model)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "rows.csv" if str(output) == "-" else output
        with warnings_on_stderr():
            n_rows = fitted.predict_file(loads, file, **words)
        if file != output:
            print_text(file.read_text(encoding="utf-8").removesuffix("\n"))
            return
    number = "1 row" if n_rows == 1 else f"{n_rows} rows"
    print_prose(f"{output}: {number} predicted by {fitted.name}, robot {fitted.fitted.robot_.name}")


@command(epilog="bench export --model mlp.stiff --output mlp.onnx")
@model_file_option
@output_option("FILE.onnx")
def export(model: Path, output: Path) -> None:
    """Write a saved network as ONNX."""
    print_prose(api.model.load_model(model).export(output))
