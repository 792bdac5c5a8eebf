"""Content of the report page, from folders of results. SI is converted to mm here."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

from stiff_bench.figures.figure_catalog import FIGURES
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.page.html import FEW_ROWS, html_page
from stiff_bench.page.page import Figure, Page, Section, drawn_figures, write_text
from stiff_bench.parameter_types import AxisName, FilePath, Seed
from stiff_bench.results.columns import matrix_table, metric_columns, model_table
from stiff_bench.results.fit_values import mean_over, metric_values
from stiff_bench.results.leaderboard import Leaderboard, build_leaderboard, leaderboard_tables
from stiff_bench.results.load import StoredResults
from stiff_bench.results.notes import (
    NO_MANIFEST,
    caveats_of,
    failure_lines,
    left_out_notes,
    mark_of,
    model_notes,
    same_name_other_data,
    version_of_run,
)
from stiff_bench.results.results import Results
from stiff_bench.results.scored_task import SortKey, sort_key
from stiff_bench.results.scores import Scores, model_frame
from stiff_bench.results.selection import EVERYTHING, Selection
from stiff_bench.results.summary import correction_text, summarize
from stiff_bench.store.names import grouped
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table, text_columns
from stiff_bench.tables.units import counted
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError, StoreError, unsupported_extension
from stiff_protocols.contract.record import CellResult, RunManifest
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.springs.identification import spring_key

SUFFIXES = (".html", ".htm")
Fits = Sequence[CellResult]
DataOf = Callable[[str], StoredData]
"""Function that reads the samples with a hash; StoreError if they are not stored."""


@dataclass(frozen=True)
class PageOptions:
    """Selection and ranking of a page.

    Without `axis`, models are ranked by the mean over the axes. `seed` is for the random draws.
    """

    selection: Selection = EVERYTHING
    metric: str = "norm"
    axis: str | None = None
    seed: int = 0

    def command(self, *words: str, folder: Path, ranked: bool = False) -> str:
        """Return a command line that begins with `words`.

        With `ranked`, it includes the options for ranking and random draws.
        """
        options: list[tuple[str, object]] = [("results", folder), *self.selection.options]
        if ranked:
            given = {"metric": self.metric, "axis": self.axis, "seed": self.seed}
            usual = {"metric": "norm", "axis": None, "seed": 0}
            options += [(name, value) for name, value in given.items() if value != usual[name]]
        words = (*words, *(word for name, value in options for word in (f"--{name}", str(value))))
        return shlex.join(["bench", *words])


def report(
    output: FilePath,
    results: Results | Sequence[Results],
    *,
    metric: str = "norm",
    axis: AxisName | None = None,
    seed: Seed = 0,
) -> Path:
    """Write results as one HTML page that needs no network.

    Verdict, robots and stiffnesses, ranking, pairwise comparisons, scores, figures, failures and
    provenance.

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
    folders = [part.folder for part in parts]
    for number, folder in enumerate(folders):
        if folder.resolve() in {earlier_folder.resolve() for earlier_folder in folders[:number]}:
            raise ConfigError(f"{folder}: given twice; give each folder once", "results")
    key = sort_key(metric, axis)
    sections = [
        folder_section(part.stored, PageOptions(part.selection, metric, axis, seed), key)
        for part in parts
    ]
    return write_text(output, html_page(Page("stiffbench report", sections, parts[0].command)))


def folder_section(stored: StoredResults, choice: PageOptions, key: SortKey) -> Section:
    """Return the content of the page for one folder.

    Raises:
        ConfigError: a word has no results in the folder.
        StoreError: a file of the folder is corrupt.
    """
    folder, selection = stored.folder, choice.selection
    selection.models_of(stored.tasks)  # each has results
    tasks = tuple(selection.tasks_of(stored.tasks))
    if not tasks:
        words = ", ".join(f"{kind} {word}" for kind, word in selection.options)
        raise ConfigError(f"no result in {folder} matches all of {words}; select less")
    stored = StoredResults(folder, tasks, stored.runs)
    names = set(selection.models_of(tasks))
    results = [fit for fit in stored.newest_results() if fit.presentation.model in names]
    scores, board, reasons = None, None, []
    try:  # scores need neither other models nor samples
        board = build_leaderboard(stored, key, Selection(selection.models), seed=choice.seed)
    except (ConfigError, StoreError) as error:
        reasons.append(f"No ranking: {str(error).removesuffix('.')}.")
    try:
        scores = Scores.of(stored, key, tasks, names, seed=choice.seed)
    except (ConfigError, StoreError) as error:
        reasons.insert(0, f"No summary: {str(error).removesuffix('.')}.")
    notes = [
        *caveats_of(tasks),
        *same_name_other_data(tasks, stored.data_of),
        *left_out_notes(tasks),
    ]
    headline, texts, tables = folder.name or str(folder), list[tuple[str, str]](), list[Table]()
    if scores:
        models = model_frame(scores)
        summary = summarize(scores, models)
        headline, texts = summary.headline, summary.sentences
        tables = [
            model_table(scores, models, "Models", ()),
            matrix_table(scores, [*models["model"]]),
        ]
    ranked = choice.command("leaderboard", folder=folder, ranked=True)
    parts = [
        Section("Notes on the data", notes=notes, is_folded=True),
        *_figures(FigureSource(folder, tasks, selection.models), scores, choice),
        *failure_sections(results),
        Section(
            "Robots and data",
            tables=[
                table
                for make in (data_table, stiffness_table)
                if (table := make(results, stored.data_of)).rows
            ],
            is_folded=True,
        ),
        *(_ranking(board, ranked) if board else ()),
        scores_section(results, key.metric.key),
        runs_section(stored.runs, results, [board.provenance] if board else ()),
    ]
    return Section(
        headline,
        _facts(folder, stored.runs, results, key),
        texts=texts,
        tables=tables,
        notes=reasons,
        sections=[part for part in parts if not part.is_folded or _has_content(part)],
    )


def _has_content(section: Section) -> bool:
    return bool(section.tables or section.notes or section.sections)


def _facts(folder: Path, runs: Sequence[RunManifest], results: Fits, key: SortKey) -> str:
    """Return folder, date of the newest run, counts, and metric, in one line."""
    statuses = Counter(result.status for result in results)
    presentations = [result.presentation for result in results]
    things = {
        "model": {presentation.model for presentation in presentations},
        "data set": {presentation.dataset for presentation in presentations},
        "protocol": {presentation.protocol for presentation in presentations},
    }
    counts = [counted(len(names), thing) for thing, names in things.items()]
    counts += [counted(len(results) - statuses["skipped"], "fit"), f"{statuses['failed']} failed"]
    counts += [f"{statuses['skipped']} skipped"] if statuses["skipped"] else []
    dates = [run.started[: len("2026-01-01")] for run in runs if run.started]
    kinds = Counter(
        {
            (presentation.dataset, presentation.kind): presentation.kind
            for presentation in presentations
        }.values()
    )
    texts = [
        folder.name or str(folder),
        *([max(dates)] if dates else []),
        ", ".join(counts),
        ", ".join(f"{number} {kind}" for kind, number in kinds.items()),
        f"score: {key.text}",
    ]
    return " · ".join(texts)


OF_ONE_TASK = ("errors", "regression", "workspace")
"""Figures that are drawn for each data set and protocol."""
MOST_TASKS = 12
"""Number of data sets and protocols with figures of their own; a figure takes a second."""


def _figures(source: FigureSource, scores: Scores | None, choice: PageOptions) -> Iterator[Section]:
    """Yield the figures of all results, then the figures of each matrix column."""

    def drawn(names: Sequence[str], source: FigureSource, choice: PageOptions) -> list[Figure]:
        return drawn_figures(
            (partial(FIGURES[name], source), choice.command("figure", name, folder=source.folder))
            for name in names
            if name in FIGURES
        )

    columns = [*scores.columns.items()] if scores else []
    parts = []
    for heading, tasks in columns[:MOST_TASKS]:
        name = tasks[0].name
        conditions = (name.condition,) if name.condition else ()
        selected = Selection(choice.selection.models, (name.dataset,), (name.protocol,), conditions)
        of_task = replace(source, tasks=(tasks[0].task,))
        figures = drawn(OF_ONE_TASK, of_task, replace(choice, selection=selected))
        if figures:
            parts.append(
                Section(" | ".join(filter(None, heading)), figures=figures, is_folded=True)
            )
    figures = drawn([name for name in FIGURES if name not in OF_ONE_TASK], source, choice)
    notes = [
        f"The first {MOST_TASKS} of {len(columns)} data sets and protocols have their own "
        "figures; draw others with `bench figure`, --dataset and --protocol."
    ]
    if figures or parts:
        is_cut = len(columns) > MOST_TASKS
        yield Section("Figures", figures=figures, notes=notes * is_cut, sections=parts)


def failure_sections(results: Fits) -> list[Section]:
    """Return the failures with their logs, equal failures in one row; [] if nothing failed.

    Skipped fits have one line per reason, such as a package that is not installed.
    """
    failed = [result for result in results if result.status == "failed"]
    skipped = failure_lines(result for result in results if result.status == "skipped")
    if not failed and not skipped:
        return []
    alike = grouped(failed, lambda fit: (*_place(fit), fit.cause, fit.failure))
    rows = [
        [*place, reason, cause or None, ", ".join(str(fit.cell.split_index) for fit in fits)]
        for (*place, cause, reason), fits in alike.items()
    ]
    headings = ("model", "data set", "protocol", "condition", "reason", "cause", "splits")
    title = f"{counted(len(failed), 'fit')} without a result"
    logs = [
        Section(f"Log of {' | '.join(filter(None, _place(fit)))}", log=log, is_folded=True)
        for fit, *_ in alike.values()
        if (log := "\n".join(fit.log))
    ]
    table = Table(title, text_columns(*headings), rows)
    return [
        Section(
            "Failed and skipped",
            tables=[table] if failed else [],
            notes=skipped,
            sections=logs,
            is_folded=len(rows) > FEW_ROWS,
        )
    ]


def _place(result: CellResult) -> tuple[str, str, str, str | None]:
    """Return model, data set, protocol and condition of a fit."""
    presentation = result.presentation
    return (
        presentation.model,
        presentation.dataset,
        presentation.protocol,
        result.cell.condition or None,
    )


def _ranking(board: Leaderboard, command: str) -> Iterator[Section]:
    """Yield the tables of a leaderboard, and the pairs of its models."""
    tables = leaderboard_tables(board)
    yield Section("Leaderboard", tables=tables, command=command, is_folded=True)
    pairs = pair_table(board.scores)
    yield Section("Pairs of models", tables=[pairs] if pairs.rows else [], is_folded=True)


MOST_MODELS = 20
"""Largest number of models in the table of pairs; the verdicts take a second."""


def pair_table(section: Scores) -> Table:
    """Return comparisons won and lost, with a row and a column per model."""
    verdicts: dict[tuple[str, str], Counter[str]] = {}
    every = [*dict.fromkeys([*model_frame(section)["model"], *section.missing])]
    for task in section.tasks:
        names = [name for name in every[:MOST_MODELS] if name in task.scores]
        pairs = [*permutations(names, 2)]
        decided = task.verdicts(pairs) if pairs else None
        for pair, verdict in zip(pairs, decided or [], strict=False):
            verdicts.setdefault(pair, Counter())[verdict] += 1
    models = [name for name in every if any(name in pair for pair in verdicts)]

    def cell(pair: tuple[str, str]) -> Quantity | None:
        if pair not in verdicts:
            return None
        won, lost = verdicts[pair]["a"], verdicts[pair]["b"]
        return Quantity(won - lost, share=(won, lost))

    rows = [
        [Name(f"{n} {row}", section.mark(row)), *(cell((row, column)) for column in models)]
        for n, row in enumerate(models, start=1)
    ]
    left_out = every[MOST_MODELS:]
    return Table(
        f"Pairs of models, {section.key.text}: comparisons won and lost",
        [
            Column("model", "text"),
            *(
                Column(str(n), format=_won_and_lost, by_sign=1)
                for n, _ in enumerate(models, start=1)
            ),
        ],
        rows,
        [
            "5 : 1 in a row: better than the column's model in 5 comparisons, worse in 1; "
            f"{correction_text(section.tasks)}.",
            *[f"Without {counted(len(left_out), 'further model')}; select with --model."]
            * bool(left_out),
        ],
    )


def _won_and_lost(difference: Quantity) -> str:
    return " : ".join(map(str, difference.share or ()))


def data_table(results: Fits, data_of: DataOf) -> Table:
    """Return kind, robot, TCP, size and hash of each data set."""

    def row(sha256: str, result: CellResult) -> list[Entry]:
        presentation = result.presentation
        try:
            data = data_of(result.cell.data_sha256)
        except StoreError:
            return [presentation.dataset, presentation.kind, None, None, None, None, sha256]
        tcp = ", ".join(f"{length:g}" for length in data.robot.tcp_on_flange)
        n_poses = len(set(data.measured.pose_id))
        return [
            *(presentation.dataset, presentation.kind, data.robot.name, tcp),
            *(len(data.measured), n_poses, sha256),
        ]

    fits = {fit.presentation.measured_sha256 or fit.cell.data_sha256: fit for fit in results}
    columns = [
        *text_columns("data set", "kind", "robot", "TCP, frame of the last link [m]"),
        *(Column("samples"), Column("poses"), Column("sha256 of samples and robot", "text")),
    ]
    return Table("Data sets", columns, [row(*item) for item in fits.items()])


def stiffness_table(results: Fits, data_of: DataOf) -> Table:
    """Return the joint stiffnesses that the VJM identified, a row per data set and joint."""
    fits = [fit for fit in results if fit.presentation.model == REFERENCE_MODEL]
    rows: list[list[Entry]] = []
    for (place, sha256), of_data in grouped(
        fits, lambda fit: (_place(fit), fit.cell.data_sha256)
    ).items():
        try:
            data = data_of(sha256)
        except StoreError:  # the table of data sets shows that
            continue
        for joint, unit in zip(data.robot.joint_names, data.stiffness_units, strict=True):
            key = spring_key("stiffness", joint, unit)
            values = [fit.diagnostics.get(key, math.inf) for fit in of_data]
            finite = [value for value in values if math.isfinite(value)]
            rows += [[*place[1:], f"{joint} [{unit}]", mean_over(finite)]] if finite else []
    return Table(
        f"Joint stiffnesses by {REFERENCE_MODEL}, mean ± standard deviation over splits",
        [
            *text_columns("data set", "protocol", "condition", "joint"),
            Column("stiffness", format=",.0f"),
        ],
        rows,
    )


def scores_section(results: Fits, ranked_by: str) -> Section:
    """Return the scores of all models, the ranking metric first, and the notes of their fits."""
    metrics = [METRICS[key] for key in dict.fromkeys((ranked_by, "norm", "mae", "stde", "me"))]
    rows: list[dict[Any, Entry]] = []
    notes: dict[str, None] = {}
    for (model, *place, seed), fits in grouped(
        results, lambda fit: (*_place(fit), fit.cell.seed)
    ).items():
        done = [fit for fit in fits if fit.status == "ok"]
        n_requested = max(len(fits), *(fit.n_splits for fit in fits))
        rows.append(
            {
                "model": Name(model, mark_of(fits[0].presentation)),
                **dict(zip(("data set", "protocol", "condition"), place, strict=True)),
                "seed": seed,
                "splits": Quantity(share=(len(done), n_requested)),
                **(metric_values(done, metrics) if done else {}),
            }
        )
        notes |= dict.fromkeys(model_notes(done) if done else [])
    table = Table.of(
        "Scores, mean ± standard deviation over splits",
        [
            *text_columns("model", "data set", "protocol", "condition"),
            *(Column("seed"), Column("splits")),
            *(column for metric in metrics for column in metric_columns([metric])),
        ],
        rows,
        ["splits: completed / requested."],
    )
    heading = f"Notes of the fits: {counted(len(notes), 'note')}"
    folds = [Section(heading, notes=[*notes], is_folded=True)] if notes else []
    return Section("Scores", tables=[table], sections=folds, is_folded=True)


def runs_section(runs: Sequence[RunManifest], results: Fits, provenance: Sequence[str]) -> Section:
    """Return the runs of a folder, newest first, with their commands and machines."""
    counts = Counter(result.run_id for result in results if result.status == "ok")
    newest = sorted(runs, key=lambda run: run.run_id, reverse=True)
    rows: list[list[Entry]] = [
        [
            *(run.run_id, run.started, run.status, run.command, run.wall_s or None),
            *(len(run.cells), counts.pop(run.run_id, 0), version_of_run(run)),
        ]
        for run in newest
    ]
    rows += [[NO_MANIFEST, *[None] * 5, counts.total(), None]] if counts else []
    columns = [
        *text_columns("run", "started (UTC)", "state", "command"),
        Column("wall time", unit="s", format=".0f"),
        *(Column("results requested"), Column("results shown"), Column("made by", "text")),
    ]
    machines = [
        Section(
            f"Versions and machine of {same[0].run_id}"
            + f" and {counted(len(same) - 1, 'more run')}" * (len(same) > 1),
            log=text,
            is_folded=True,
        )
        for text, same in grouped(newest, _environment).items()
    ]
    table = Table("Runs", columns, rows, [*provenance])
    return Section("Provenance", tables=[table], sections=machines, is_folded=True)


def _environment(run: RunManifest) -> str:
    """Return versions and machine of a run, then of its other machines."""
    environments = {"": run.environment}
    environments |= {f"machine {name}\n": facts for name, facts in sorted(run.machines.items())}
    return "\n\n".join(
        head + "\n".join(f"{name}: {value}" for name, value in facts.items())
        for head, facts in environments.items()
    )
