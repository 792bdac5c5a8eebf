"""Write the web pages of a study's leaderboard: first page, models and data sets."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from pandas import DataFrame

from stiff_bench.analysis.board import Board, BoardRow, p95_error, path_error
from stiff_bench.analysis.board_tables import RATIO_FORMAT, board_headline, board_sentences
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.figures import robot_picture, springs, workspace
from stiff_bench.figures.board_figures import score_against_cost, score_against_poses
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.page.html import html_page, table_script
from stiff_bench.page.page import Link, Page, Section, drawn_figures, write_text
from stiff_bench.paper.study_board import StudyResults
from stiff_bench.paper.study_file import Study
from stiff_bench.plan.options import options_of
from stiff_bench.plan.registry import Registry
from stiff_bench.store.names import split_word
from stiff_bench.store.versions import sources
from stiff_bench.tables.table import Column, Entry, Quantity, Table, quantity, text_columns
from stiff_bench.tables.units import MM, counted, duration
from stiff_bench.tables.writers import render
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.plugin import ModelInfo

INDEX, MODELS, DATASETS = "index.html", "models", "data"
FILES = "files"
"""Folder of the data sets' files, inside the folder of their pages."""
SCORES, SCRIPT = "scores.csv", "tables.js"
TITLE = "stiffbench leaderboard"
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


def file_stem(name: str) -> str:
    """Return the name of a model or data set as part of a file's name.

    >>> file_stem("ft-mlp@anchor=none")
    'ft-mlp_anchor_none'
    """
    return _UNSAFE.sub("_", name)


@dataclass(frozen=True, eq=False)
class LeaderboardSite:
    """The pages of a study's leaderboard.

    Attributes:
        study: study with a board.
        results: folder of its results.
        command: command that writes the pages.
        registry: models with their descriptions.
        load_dataset: function that returns a data set by its name.
        statuses: "verified" or "reported" by model; empty: the board has no such column.
    """

    study: Study
    results: Path
    command: str
    registry: Registry
    load_dataset: Callable[[str], Any]
    statuses: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def content(self) -> StudyResults:
        """Return the study with its results."""
        return StudyResults(self.study, StoredResults.read(self.results), self.statuses)

    @property
    def board(self) -> Board:
        """Return the board; ConfigError: the study has no board, or too few results."""
        return self.content.board

    @cached_property
    def errors(self) -> DataFrame:
        """Return the mean errors of each model on each data set."""
        return errors_frame(self.board)

    def write(self, folder: Path) -> Iterator[Path]:
        """Write all pages into a folder, and yield each file.

        Raises:
            ConfigError: the study has no board, or too few results.
            StoreError: nothing is stored, or a file cannot be written.
        """
        rows = {row.name: row for row in self.board.rows}
        models = {name: f"{MODELS}/{file_stem(name)}.html" for name in rows}
        names = dict.fromkeys(case.name.dataset for case in self.board.answer.cases)
        datasets = {name: f"{DATASETS}/{file_stem(name)}.html" for name in names}
        yield write_text(folder / SCRIPT, table_script())
        addresses = {name: f"../{address}" for name, address in {**models, **datasets}.items()}

        def page(name: str, section: Section) -> str:
            up = Link(TITLE, f"../{INDEX}")
            return html_page(Page(name, [section], self.command, addresses, up), f"../{SCRIPT}")

        for name, address in models.items():
            yield write_text(folder / address, page(name, self._model_section(rows[name])))
        for name, address in datasets.items():
            files = folder / DATASETS / FILES / file_stem(name)
            shutil.rmtree(files, ignore_errors=True)
            make_folder(files.parent)
            dataset = self.load_dataset(name)
            dataset.export(files)
            yield from sorted(files.iterdir())
            yield write_text(folder / address, page(name, self._dataset_section(dataset, files)))
        tables = self.content.board_tables
        yield write_text(folder / SCORES, f"{render(tables, 'csv', self.command)}\n")
        first = Page(
            TITLE, [self._first_section(models, datasets)], self.command, {**models, **datasets}
        )
        yield write_text(folder / INDEX, html_page(first, SCRIPT))

    def _first_section(self, models: Mapping[str, str], datasets: Mapping[str, str]) -> Section:
        board, stored = self.board, self.content.merged
        ratios, numbers, *tables = self.content.board_tables
        dates = [run.started[:10] for run in stored.runs if run.started]
        counts = Counter(result.run_id for case in stored.cases for result in case.every)
        makers = (score_against_cost, score_against_poses)
        figures = drawn_figures((partial(make, board), self.command) for make in makers)
        sentences = board_sentences(board)
        told = [f"{label}: {text}" for label, text in sentences]
        notes = [*self.study.notes, *(note for note in ratios.notes if note not in told)]
        parts = [
            Section("Notes", notes=notes, is_folded=True),
            Section("Cost and number of poses", figures=figures),
            Section("How sure, and other numbers", tables=tables, is_folded=True),
            Section("Pages of models", links=[Link(*item) for item in models.items()]),
            Section("Pages of data sets", links=[Link(*item) for item in datasets.items()]),
            Section("Downloads", links=[Link(f"{SCORES}: all numbers of this page", SCORES)]),
            Section("Provenance", notes=[sources(self.results, stored.runs, counts)]),
        ]
        return Section(
            board_headline(board),
            " · ".join([self.study.title, *dates[-1:], f"{counts.total()} fits"]),
            texts=sentences,
            tables=[colored(with_charts(ratios, board)), colored(numbers)],
            sections=parts,
        )

    def _model_section(self, row: BoardRow) -> Section:
        info = self.registry.models.get(split_word(row.name)[0])
        facts = {"status": self.statuses.get(row.name, ""), "fit": duration(row.fit_s)}
        options = []
        if info is None:
            facts["model"] = "of a submission, see results/submissions"
        else:
            facts |= {"model": info.summary, "equation": info.equation}
            facts |= {"reference": info.reference, "version": str(info.version)}
            facts |= {"command": f"bench run --model {row.name} --dataset kr10-twin"}
            options = [Section("Options", tables=[options_table(info)], is_folded=True)]
        frame = self.errors[self.errors["model"] == row.name]
        case = next(c.case for c in self.board.answer.cases if row.name in c.case.competitors)
        pair = {name: case.competitors[name] for name in dict.fromkeys((row.name, REFERENCE_MODEL))}
        sources_of = {
            make: FigureSource(self.results, (replace(case, competitors=names),), (row.name,))
            for make, names in (
                (workspace.workspace, {row.name: pair[row.name]}),
                (springs.springs, pair),
            )
        }
        figures = drawn_figures(
            (partial(make, source), self.command) for make, source in sources_of.items()
        )
        return Section(
            row.name,
            texts=[("Over robots", ratio_text(row, self.board))],
            tables=[
                facts_table(facts),
                errors_table("Errors on each data set, best ratio first", "data set", frame),
            ],
            figures=figures,
            sections=options,
        )

    def _dataset_section(self, dataset: Any, files: Path) -> Section:
        info, name = dataset.choice.info, dataset.name
        picture = partial(
            robot_picture.robot_picture, dataset.samples, dataset.robot, name, info.kind
        )
        command = f"bench figure robot --dataset {name}"
        title = "Models on this data set, smallest ratio first"
        frame = self.errors[self.errors["data set"] == name]
        export = f"bench data export {name} --output {file_stem(name)}"
        return Section(
            name,
            f"{info.kind} · {counted(len(dataset), 'sample')}",
            texts=[("Data", info.summary), *(("Caveat", text) for text in info.caveats)],
            tables=[errors_table(title, "model", frame), facts_table(dict(dataset.data.facts))],
            figures=drawn_figures([(picture, command), (dataset.plot, command)]),
            sections=[
                Section(
                    "Files",
                    links=[
                        Link(file.name, f"{FILES}/{files.name}/{file.name}")
                        for file in sorted(files.iterdir())
                    ],
                    command=export,
                ),
                *([Section("Data card", log=dataset.card, is_folded=True)] if dataset.card else []),
            ],
        )


def with_charts(table: Table, board: Board) -> Table:
    """Return the first table of a board with a chart of the intervals, without its notes."""
    rows = [
        [*cells[:2], Quantity(low=mean.low, high=mean.high, ratio=mean.ratio), *cells[3:]]
        for cells, mean in zip(table.rows, (row.mean for row in board.rows), strict=True)
    ]
    name, ratio, interval, *others = table.columns
    columns = [name, ratio, replace(interval, is_chart=True), *others]
    return replace(table, title="Models", columns=columns, rows=rows, notes=[])


def colored(table: Table) -> Table:
    """Return a table with its ratios in colours."""

    def cell(column: Column, entry: Entry) -> Entry:
        number = quantity(entry)
        is_ratio = column.format == RATIO_FORMAT and column.name != "noise"
        if number is None or not is_ratio or number.value is None:
            return entry
        return replace(number, ratio=number.value)

    rows = [[*map(cell, table.columns, row)] for row in table.rows]
    return replace(table, rows=rows)


def errors_frame(board: Board) -> DataFrame:
    """Return a row per model and data set: means over seeds and splits, in mm."""
    answer = board.answer
    rows = [
        {
            "model": name,
            "data set": case.name.dataset,
            "robot": case.data.robot.name,
            "error": MM * case.mean(name),
            "log ratio": np.log(ratio),
            "95th percentile": _scaled(p95_error(name, case), MM),
            "left on tool paths": _scaled(path_error(name, case), 1.0),
            "noise": _scaled(answer.noise(case), MM),
        }
        for case in answer.cases
        for name in answer.model_names
        if (ratio := answer.ratio(name, case)) is not None
    ]
    means = DataFrame(rows).groupby(["model", "data set", "robot"], sort=False).mean().reset_index()
    means["ratio"] = np.exp(means.pop("log ratio"))
    means["error / noise"] = means["error"] / means.pop("noise")
    return means.sort_values("ratio", kind="stable")


def _scaled(value: float | None, factor: float) -> float:
    return np.nan if value is None else factor * value


def errors_table(title: str, first: str, frame: DataFrame) -> Table:
    """Return errors in mm and ratios by the column `first` of an `errors_frame`."""
    columns = [
        *text_columns(first, *["robot"] * (first != "model")),
        Column("3-D error", unit="mm", format=".4f", value=lambda row: row["error"]),
        Column(
            "error / VJM's",
            format=RATIO_FORMAT,
            value=lambda row: Quantity(row["ratio"], ratio=row["ratio"]),
        ),
        Column("95th percentile", unit="mm", format=".4f"),
        Column("left on tool paths", unit="mm", format=".4f"),
        Column("error / noise", format=RATIO_FORMAT),
    ]
    return Table.of(title, columns, frame)


def ratio_text(row: BoardRow, board: Board) -> str:
    """Return the score of a model in one sentence."""
    if row.name == REFERENCE_MODEL:
        return "the baseline: the errors of all models are divided by its errors."
    mean = row.mean
    return (
        f"{mean.ratio:.2f} times the VJM's error ({mean.low:.2f} to {mean.high:.2f} over "
        f"{board.answer.claim_scope}); {row.verdict}; worst on {row.worst_robot} ({row.worst:.2f})."
    )


def facts_table(facts: Mapping[str, Entry]) -> Table:
    """Return facts in two columns."""
    rows = [[name, str(value)] for name, value in facts.items() if value not in ("", None)]
    return Table("Facts", text_columns("fact", "value"), rows)


def options_table(info: ModelInfo) -> Table:
    """Return the options of a model."""
    columns = text_columns("option", "default", "valid", "meaning")
    rows = [
        [option.name, str(option.default), option.type_text, option.description]
        for option in options_of(info.load()).values()
    ]
    return Table("Options", columns, rows)
