"""`bench leaderboard`, `compare`, `table` and `report`: words in, one call, the result printed."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stiff_bench.api import RESULTS
from stiff_bench.cli.options import (
    FILE,
    PROBABILITY,
    FiniteRange,
    Millimetres,
    WholeRange,
    case_options,
    command_line,
    format_option,
    output_option,
    picture,
    plugin_option,
    ranking_options,
    results_option,
    seed_option,
    several_keys,
)
from stiff_bench.console import print_text, say
from stiff_protocols.contract.errors import ConfigError

if TYPE_CHECKING:
    from stiff_bench.api.results import Results


@click.command()
@results_option
@ranking_options
@click.option(
    "--figure",
    type=FILE,
    callback=picture,
    metavar="FILE.png",
    help="Draw the critical-difference diagrams, too.",
)
@format_option
def leaderboard(
    results: Path, metric: str, axis: str | None, figure: Path | None, fmt: str, **chosen: Any
) -> int:
    """Rank models over data sets and protocols, with intervals.

    Exit status 1: there is no critical difference, so that --figure was not drawn.
    """
    ranks = _stored(results).leaderboard(metric, axis, **chosen)
    why_none = ranks.why_no_diagrams if figure is not None else ""
    if figure is not None and not why_none:
        ranks.save_diagrams(figure)  # before the tables: what fails here prints none
    print_text(ranks.text_as(fmt))
    if why_none:
        say(f"{figure} was not drawn: {why_none}")
    return 1 if why_none else 0


def _needs_perturb(ctx: click.Context, option: click.Parameter, value: Any) -> Any:
    if value is not None and not ctx.params["perturb"]:
        raise ConfigError("goes with --perturb; give it too", option.opts[0].removeprefix("--"))
    return value


perturbing = partial(click.option, callback=_needs_perturb)
"""An option of `bench compare --perturb`; not given, it is left to `Results.sensitivity`."""


@click.command()
@click.argument("models", nargs=-1, metavar="A B")
@results_option
@case_options
@several_keys("--condition", "conditions", help='Condition of a protocol, such as "n = 40".')
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
@click.option(
    "--perturb",
    is_flag=True,
    is_eager=True,
    help="Does the order of the models outlast mistakes of the measurement? Fits them anew, on "
    "perturbed copies of the data set.",
)
@perturbing(
    "--tcp-off",
    "tcp_off_mm",
    type=Millimetres(min=0),
    metavar="LENGTH",
    help="With --perturb: how far the TCP lies from where it was said to be.  [default: 0.5mm]",
)
@perturbing(
    "--force-noise",
    "force_noise_percent",
    type=FiniteRange(0, 100),
    metavar="PERCENT",
    help="With --perturb: standard deviation of each component of force and torque, of its norm.  "
    "[default: 2]",
)
@perturbing(
    "--registration",
    "registration_deg",
    type=FiniteRange(0, 180),
    metavar="DEGREES",
    help="With --perturb: angle between the measuring device's frame and the robot's base.  "
    "[default: 0.1]",
)
@perturbing(
    "--deflection-shift",
    "deflection_shift_mm",
    type=Millimetres(min=0),
    metavar="LENGTH",
    help="With --perturb: a constant that is in every deflection.  [default: 0.05mm]",
)
@perturbing(
    "--draws",
    type=WholeRange(1, 10_000),
    help="With --perturb: how often each of them is drawn.  [default: 10]",
)
@perturbing(
    "--jobs",
    type=WholeRange(1, 1024),
    help="With --perturb: number of fits at once, each in its own process.  [default: 1]",
)
@plugin_option
@seed_option
@format_option
def compare(models: tuple[str, ...], results: Path, fmt: str, perturb: bool, **asked: Any) -> None:
    """Test whether model A is better than B, by how much and where.

    A and B are models with their options, as `bench run` names them: vjm, ft-mlp@freeze=full. With
    --perturb there may be more of them, or none: then all that have results take part.
    """
    asked = {name: value for name, value in asked.items() if value is not None}
    if not perturb and len(models) != 2:
        raise click.UsageError(f"{len(models)} models: give two, A and B, or --perturb")
    stored = _stored(results)
    found = stored.sensitivity(*models, **asked) if perturb else stored.compare(*models, **asked)
    print_text(found.text_as(fmt))


def _stored(folder: Path) -> Results:
    from stiff_bench.api.results import Results

    return Results(folder, command=command_line())


@click.command()
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
    """Print a table of the source paper, beside ours where there are ours: 1 to 10.

    1: measured poses; 2: errors of the VJM on the samples it was fitted to; 3: identified joint
    stiffnesses; 4, 5: poses and wrenches of the simulated pre-training data; 6, 7: errors on these
    by depth and by activation; 8: unfrozen layers; 9: last epoch against best epoch; 10: VJM,
    FT-MLP and DT-CNN, read on the test part, on all samples and by an honest holdout.
    """
    from stiff_bench.api.figures import paper_table

    print_text(paper_table(number, results, command=command_line()).text_as(fmt))


@click.command()
@click.option(
    "--results",
    "folders",
    type=FILE,
    multiple=True,
    default=(RESULTS,),
    metavar="DIR",
    help="Folder of results; may be repeated. Folders are not compared with each other.",
)
@output_option("FILE.html", "File to write; an older one is replaced.")
@ranking_options
def report(folders: tuple[Path, ...], output: Path, **chosen: Any) -> None:
    """Write results as one HTML page that needs no network.

    Verdict, robots and stiffnesses, ranking, pairwise comparisons, scores, figures, failures and
    provenance.
    """
    first, *others = map(_stored, folders)
    first.report(output, others=others, **chosen)
    say(f"{output}: written")
