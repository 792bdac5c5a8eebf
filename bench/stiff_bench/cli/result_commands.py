"""Commands that read stored results, such as `bench leaderboard` and `bench compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stiff_bench import api
from stiff_bench.api import RESULTS
from stiff_bench.cli.click_options import (
    FILE,
    PICTURE,
    PROBABILITY,
    Millimetres,
    WholeRange,
    case_options,
    command_line,
    data_options,
    format_option,
    output_option,
    plugin_option,
    print_tables,
    ranking_options,
    results_option,
    seed_option,
    selection_options,
)
from stiff_bench.cli.help_pages import command, group
from stiff_bench.console import print_prose, say, warnings_on_stderr
from stiff_protocols.contract.errors import ConfigError

if TYPE_CHECKING:
    from stiff_bench.results.selection import Selection
    from stiff_bench.submissions.export import ExportFormat


@command(epilog="bench leaderboard --results results/runs")
@results_option
@ranking_options
@format_option
def leaderboard(results: Path, selection: Selection, fmt: str, **ranking: Any) -> None:
    """Rank models over data sets and protocols, with intervals."""
    print_tables(_stored(results, selection).leaderboard(**ranking), fmt)


@command(epilog="bench compare vjm-gp vjm --dataset fanuc-r2000ic")
@click.argument("a")
@click.argument("b")
@results_option
@case_options
@click.option(
    "--equivalence",
    "equivalence_mm",
    type=Millimetres(min=0),
    default="0.01mm",
    metavar="LENGTH",
    help="Largest difference in mean error that is negligible in practice.",
)
@click.option(
    "--confidence", type=PROBABILITY, default=0.95, help="Level of intervals and verdicts."
)
@seed_option
@format_option
def compare(a: str, b: str, results: Path, selection: Selection, fmt: str, **question: Any) -> None:
    """Test whether model A is better than B, by how much and where.

    A and B are models with their options, as `bench run` names them: vjm, ft-mlp@freeze=full.
    """
    print_tables(_stored(results, selection).compare(a, b, **question), fmt)


def _stored(folder: Path, selection: Selection) -> api.pictures.Results:
    return api.pictures.Results(folder, command=command_line(), selection=selection)


@command(epilog="bench table 10")
@click.argument(
    "number", type=click.Choice([str(number) for number in range(1, 11)]), metavar="NUMBER"
)
@click.option(
    "--results",
    type=FILE,
    metavar="DIR",
    help="Results of `bench reproduce`.  [default: results/paper/runs]",
)
@format_option
def table(number: str, results: Path | None, fmt: str) -> None:
    """Print a table of the source paper with our numbers.

    \b
    NUMBER  1   measured poses
            2   errors of the VJM on the samples it was fitted to
            3   identified joint stiffnesses
            4   poses of the simulated pre-training data
            5   wrenches of the simulated pre-training data
            6   errors on these data by depth
            7   errors on these data by activation
            8   unfrozen layers
            9   last epoch against best epoch
            10  VJM, FT-MLP and DT-CNN, scored in three ways
    """  # noqa: D301  # click keeps the lines below \b
    print_tables(api.pictures.paper_table(number, results, command=command_line()), fmt)


@command(epilog="bench report --output report.html")
@click.option(
    "--results",
    "folders",
    type=FILE,
    multiple=True,
    default=(RESULTS,),
    metavar="DIR",
    help="Folder of results; may be repeated. Each folder is a section of its own.",
)
@output_option("FILE.html", "File to write; an existing one is replaced.")
@ranking_options
def report(folders: tuple[Path, ...], output: Path, selection: Selection, **ranking: Any) -> None:
    """Write results as one HTML page that needs no network.

    Verdict, robots and stiffnesses, ranking, pairwise comparisons, scores, figures, failures and
    provenance.
    """
    first, *other_results = (_stored(folder, selection) for folder in folders)
    first.report(output, other_results=other_results, **ranking)
    say(f"{output}: written")


@command(epilog="bench figure regression --output regression.pdf")
@click.argument("name")
@click.option(
    "--results",
    type=FILE,
    metavar="DIR",
    help=f"Folder of results.  [default: {RESULTS}; results/paper/runs for the paper's figures]",
)
@click.option(
    "--output",
    type=PICTURE,
    metavar="FILE.pdf",
    help="File to write: .png, .pdf or .svg.  [default: figure-NAME.png]",
)
@selection_options
@data_options
@click.option(
    "--model-file",
    type=FILE,
    metavar="FILE",
    help="Model file of `bench fit`, for the figure robot: draw its prediction.",
)
@click.option(
    "--row",
    type=WholeRange(0),
    metavar="N",
    help="Sample of the figure robot, from 0.  [default: the one with the largest deflection]",
)
@plugin_option
def figure(
    name: str,
    results: Path | None,
    output: Path | None,
    selection: Selection,
    data: Sequence[api.data_sets.Dataset],
    model_file: Path | None,
    row: int | None,
) -> None:
    """Draw a figure and print its caption.

    NAME is a figure of the source paper (4, 5, 6, 8, 9) or a general one: `bench list figures`. The
    caption names the data set and protocol that are shown.

    The figure robot draws results (--results), a data set (--dataset or --data) or a model
    (--model-file).
    """
    model = None if model_file is None else api.model.load_model(model_file)
    dataset = _shown_data_set(results, selection, data) if name == "robot" else None
    if data and dataset is None:
        raise ConfigError("--data: drawn by the figure robot only, and without --results")
    stored = _stored(results or RESULTS, selection) if selection.options else results
    with warnings_on_stderr():
        prepared = api.pictures.figure(name, dataset or stored, model=model, row=row)
    target = output or Path(f"figure-{name}.png")
    prepared.save(target)
    print_prose(f"{target}: {prepared.title}. {prepared.caption}")


def _shown_data_set(
    results: Path | None, selection: Selection, data: Sequence[api.data_sets.Dataset]
) -> api.data_sets.Dataset | None:
    """Return the data set that the figure robot draws; None where it draws results."""
    if results is not None or not (data or selection.datasets):
        return None
    if len([*data, *selection.options]) > 1:
        raise ConfigError("the figure robot draws one --dataset or --data, or --results")
    return next(iter(data), None) or api.data_sets.load_dataset(selection.datasets[0])


@command(epilog="bench merge laptop/runs server/runs --output results/runs")
@click.argument("folders", metavar="DIR...", type=FILE, nargs=-1, required=True)
@output_option("DIR", "Folder to merge into: new, or with results.")
def merge(folders: tuple[Path, ...], output: Path) -> None:
    """Merge the results of several machines into one folder.

    Folders with different numbers for the same fit are refused. The given folders do not change.
    """
    for line in api.pictures.merge(folders, output).report:
        say(line)


@group(epilog="bench results export --format csv --output results.csv")
def results() -> None:
    """Export stored results, and add results of submissions."""


@results.command(epilog="bench results add results/submissions/quadratic-springs")
@click.argument("folders", metavar="DIR...", type=FILE, nargs=-1, required=True)
@click.option(
    "--results",
    type=FILE,
    default=Path("results/leaderboard/runs"),
    metavar="DIR",
    help="Folder of results to add to, with the VJM on the same splits.",
)
def add(folders: tuple[Path, ...], results: Path) -> None:
    """Add the fits of verified submissions to results.

    The fits are not computed again. `bench reproduce leaderboard --write-only` then has a column
    of status: verified or reported.
    """
    for folder in folders:
        n_fits = api.submissions.add_submission(folder, results)
        say(f"{results}: {n_fits} fits of {folder} added")


@results.command("export", epilog="bench results export --format csv --output results.csv")
@results_option
@selection_options
@click.option(
    "--format",
    "fmt",
    type=click.Choice(["jsonl", "csv", "parquet"]),
    default="jsonl",
    metavar="FORMAT",
    help="jsonl, csv or parquet.",
)
@output_option("FILE", "File to write; an existing one is replaced.")
def export_results(
    results: Path,
    selection: Selection,
    fmt: ExportFormat,
    output: Path,
) -> None:
    """Write one record per fit: identity, hashes, metrics, predictions and cost.

    Lengths are in mm. The fields are described in results/schema/record.json, a JSON Schema.
    """
    n_records = api.records.export_results(_stored(results, selection), output, fmt)
    say(f"{output}: {n_records} records written")
