"""Content of the report page, from folders of results. SI is converted to mm here."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.page.page import (
    FEW_ROWS,
    Figure,
    Page,
    Section,
    drawn_figures,
    html_page,
    write_text,
)
from stiff_bench.parameter_types import AxisName, FilePath, Seed
from stiff_bench.results.columns import matrix_table, model_table
from stiff_bench.results.fit_values import mean_over
from stiff_bench.results.notes import (
    caveats_of,
    failure_lines,
    left_out_notes,
    same_name_other_data,
    version_of_run,
)
from stiff_bench.results.results import Results
from stiff_bench.results.scored_task import SortKey, sort_key
from stiff_bench.results.scores import model_frame
from stiff_bench.results.summary import summarize
from stiff_bench.store.names import grouped
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.table import Column, Entry, Table, text_columns
from stiff_bench.tables.units import counted, first_few
from stiff_bench.tables.writers import of_format
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError, StoreError, unsupported_extension
from stiff_protocols.contract.record import FitResult, RunManifest

SUFFIXES = (".html", ".htm")
STIFFNESS = "stiffness "
"""Start of the name of a joint's stiffness among the numbers that a fit reports."""
Fits = Sequence[FitResult]


def report(
    output: FilePath,
    results: Results | Sequence[Results],
    *,
    metric: str = "norm",
    axis: AxisName | None = None,
    seed: Seed = 0,
) -> Path:
    """Write results as one HTML page that needs no network.

    Verdict, figures, failures, robots and stiffnesses, ranking, metrics and provenance.

    Args:
        output: file to write; an existing one is replaced.
        results: folder of results; may be repeated: each folder is a section of its own.
        metric: metric to rank by.
        axis: axis of the metric; by default the mean over the axes.
        seed: seed of the resampling of poses.

    Raises:
        ConfigError: the file's extension is not supported, a folder is given twice, a name has no
            results in a folder, or the metric cannot rank.
        StoreError: a folder has no results or corrupt results, or the file cannot be written.
    """
    output = Path(output)
    if output.suffix.lower() not in SUFFIXES:
        raise unsupported_extension(output, SUFFIXES, "output")
    parts = [results] if isinstance(results, Results) else [*results]
    folders = [part.folder.resolve() for part in parts]
    for part in parts:
        if folders.count(part.folder.resolve()) > 1:
            raise ConfigError(f"{part.folder}: given twice; give each folder once", "results")
    sections = [folder_section(part, metric, axis, seed) for part in parts]
    return write_text(output, html_page(Page("stiffbench report", sections, parts[0].command)))


def folder_section(
    results: Results, metric: str = "norm", axis: AxisName | None = None, seed: int = 0
) -> Section:
    """Return the content of the page for the selected results of one folder.

    Raises:
        ConfigError: a selected name has no results in the folder, or the metric cannot rank.
        StoreError: a file of the folder is corrupt.
    """
    key, stored, fits = sort_key(metric, axis), results.stored, results.fits
    if not fits:
        words = ", ".join(f"{kind} {word}" for kind, word in results.selection.options)
        raise ConfigError(f"no result in {results.folder} matches all of {words}; select less")
    tasks = results.selection.tasks_of(stored.tasks)
    notes = [
        *caveats_of(tasks),
        *same_name_other_data(tasks, stored.data_of),
        *left_out_notes(tasks),
    ]
    headline, texts, reasons = results.folder.resolve().name, list[tuple[str, str]](), list[str]()
    tables, board = list[Table](), list[Table]()
    try:
        scores = results.scores(metric, axis, seed=seed)
        models = model_frame(scores)
        summary = summarize(scores, models)
        headline, texts = summary.headline, summary.sentences
        matrix = matrix_table(scores, [*models["model"]])
        tables = [model_table(scores, models, "Models", ()), matrix]
    except (ConfigError, StoreError) as error:
        reasons.append(f"No summary: {str(error).removesuffix('.')}.")
    try:
        board = of_format(results.leaderboard(metric, axis, seed=seed).tables, "html")
    except (ConfigError, StoreError) as error:
        reasons.append(f"No ranking: {str(error).removesuffix('.')}.")
    robots = [data_table(fits, stored.data_of), stiffness_table(results)]
    parts = [
        Section("Notes on the data", notes=notes, is_folded=True),
        Section("Figures", figures=_figures(results)),
        failure_section(fits),
        Section("Robots and data", tables=[t for t in robots if t.rows], is_folded=True),
        Section("Leaderboard", tables=board, is_folded=True),
        Section("Metrics of each data set", tables=results.table().tables, is_folded=True),
        runs_section(stored.runs),
    ]
    return Section(
        headline,
        _facts(results, key),
        texts=texts,
        tables=tables,
        notes=reasons,
        sections=[part for part in parts if part.tables or part.notes or part.figures],
    )


def _facts(results: Results, key: SortKey) -> str:
    """Return folder, date of the newest run, counts, and metric, in one line."""
    fits = results.fits
    kinds = {"model": "model", "dataset": "data set", "protocol": "protocol"}
    counts = [
        counted(len({getattr(fit.presentation, kind) for fit in fits}), thing)
        for kind, thing in kinds.items()
    ]
    statuses = Counter(fit.status for fit in fits if fit.status != "ok")
    counts += [counted(len(fits), "fit"), *(f"{n} {status}" for status, n in statuses.items())]
    newest = max((run.started for run in results.stored.runs), default="")
    date, score = newest[: len("2026-01-01")], f"score: {key.text}"
    return " · ".join(filter(None, (results.folder.resolve().name, date, ", ".join(counts), score)))


def _figures(results: Results) -> list[Figure]:
    """Draw each figure that the results allow; a figure of one data set shows the first."""
    tasks = tuple(results.selection.tasks_of(results.stored.tasks))
    source = FigureSource(results.folder, tasks, results.selection.models)
    options = [("results", str(results.folder)), *results.selection.options]
    words = [word for name, value in options for word in (f"--{name}", value)]
    return drawn_figures(
        (partial(make, source), shlex.join(["bench", "figure", name, *words]))
        for name, make in FIGURES.items()
    )


def failure_section(fits: Fits) -> Section:
    """Return a line per reason for missing results, and the logs of failed fits."""
    notes = failure_lines(fits)
    logs = grouped(
        (fit for fit in fits if fit.log and fit.status == "failed"),
        lambda fit: (
            *(fit.presentation.model, fit.presentation.dataset, fit.presentation.protocol),
            *(fit.fit.condition, "\n".join(fit.log)),
        ),
    )
    sections = [
        Section(f"Log of {' | '.join(filter(None, place))}", log=log, is_folded=True)
        for *place, log in logs
    ]
    is_folded = len(notes) > FEW_ROWS
    return Section("Failed and skipped", notes=notes, sections=sections, is_folded=is_folded)


def data_table(fits: Fits, data_of: Callable[[str], StoredData]) -> Table:
    """Return kind, robot, TCP, size and hash of each data set.

    `data_of` returns the samples with a hash; StoreError if they are not stored.
    """

    def row(sha256: str, fit: FitResult) -> list[Entry]:
        name, kind = fit.presentation.dataset, fit.presentation.kind
        try:
            data = data_of(fit.fit.data_sha256)
        except StoreError:
            return [name, kind, None, None, None, None, sha256]
        tcp = ", ".join(f"{length:g}" for length in data.robot.tcp_on_flange)
        n_poses = len(set(data.measured.pose_id))
        return [name, kind, data.robot.name, tcp, len(data.measured), n_poses, sha256]

    by_hash = {fit.presentation.measured_sha256 or fit.fit.data_sha256: fit for fit in fits}
    columns = [
        *text_columns("data set", "kind", "robot", "TCP, frame of the last link [m]"),
        *(Column("samples"), Column("poses"), Column("sha256 of samples and robot", "text")),
    ]
    return Table("Data sets", columns, [row(*item) for item in by_hash.items()])


def stiffness_table(results: Results) -> Table:
    """Return the joint stiffnesses that the VJM identified, a row per data set and joint."""
    columns = ["dataset", "protocol", "condition", "diagnostic"]
    frame = results.diagnostics().reindex(columns=["model", *columns, "value"])
    frame = frame[(frame["model"] == REFERENCE_MODEL) & np.isfinite(frame["value"])]
    rows: list[list[Entry]] = [
        [*place, joint.removeprefix(STIFFNESS), mean_over([*values])]
        for (*place, joint), values in frame.groupby(columns, sort=False)["value"]
        if joint.startswith(STIFFNESS)
    ]
    return Table(
        f"Joint stiffnesses by {REFERENCE_MODEL}, mean ± standard deviation over splits",
        [
            *text_columns("data set", "protocol", "condition", "joint"),
            Column("stiffness", format=",.0f"),
        ],
        rows,
    )


def runs_section(runs: Sequence[RunManifest]) -> Section:
    """Return the runs of a folder, newest first, with their commands and machines."""
    newest = sorted(runs, key=lambda run: run.run_id, reverse=True)
    rows: list[list[Entry]] = [
        [run.run_id, run.started, run.status, run.command, run.wall_s or None, version_of_run(run)]
        for run in newest
    ]
    columns = [
        *text_columns("run", "started (UTC)", "state", "command"),
        *(Column("wall time", unit="s", format=".0f"), Column("made by", "text")),
    ]
    machines = [
        Section(
            f"Versions and machine of {first_few([run.run_id for run in same], 1)}",
            log=text,
            is_folded=True,
        )
        for text, same in grouped(newest, _environment).items()
    ]
    tables = [Table("Runs", columns, rows)]
    return Section("Provenance", tables=tables, sections=machines, is_folded=True)


def _environment(run: RunManifest) -> str:
    """Return versions and machine of a run, then of its other machines."""
    environments = {"": run.environment}
    environments |= {f"machine {name}\n": facts for name, facts in sorted(run.machines.items())}
    return "\n\n".join(
        head + "\n".join(f"{name}: {value}" for name, value in facts.items())
        for head, facts in environments.items()
    )
