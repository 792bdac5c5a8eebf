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

from stiff_bench.analysis.board import Board, p95_error, path_error
from stiff_bench.analysis.board_tables import RATIO_FORMAT, board_headline, board_sentences
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.figures import robot_picture, springs, workspace
from stiff_bench.figures.board_figures import score_against_cost, score_against_poses
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.page.html import html_page, table_script
from stiff_bench.page.page import Link, Page, Section, drawn_figures, write_text
from stiff_bench.paper.study_board import StudyResults
from stiff_bench.paper.study_file import Study
from stiff_bench.store.names import split_word
from stiff_bench.store.versions import sources
from stiff_bench.tables.table import Column, Quantity, Table, quantity, text_columns
from stiff_bench.tables.units import MM
from stiff_bench.tables.writers import render
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError

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
        load_dataset: function that returns a data set by its name.
        show_model: function that returns the description of a model by its key.
        statuses: "verified" or "reported" by model; empty: the board has no such column.
    """

    study: Study
    results: Path
    command: str
    load_dataset: Callable[[str], Any]
    show_model: Callable[[str], str]
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

    @cached_property
    def first_tables(self) -> list[Table]:
        """Return the models with a chart of their ratios, and their other numbers."""
        ratios, *other_tables = self.content.board_tables
        more = [table for table in other_tables if table.about.get("table") == "more"]
        return [with_charts(colored(ratios), self.board), *map(colored, more)]

    def write(self, folder: Path) -> Iterator[Path]:
        """Write all pages into a folder, and yield each file.

        Raises:
            ConfigError: the study has no board, or too few results.
            StoreError: nothing is stored, or a file cannot be written.
        """
        names = [row.name for row in self.board.rows]
        models = {name: f"{MODELS}/{file_stem(name)}.html" for name in names}
        names = [*dict.fromkeys(case.name.dataset for case in self.board.answer.cases)]
        datasets = {name: f"{DATASETS}/{file_stem(name)}.html" for name in names}
        pages = {**models, **datasets}
        from_below = {name: f"../{address}" for name, address in pages.items()}
        up = Link(TITLE, f"../{INDEX}")
        for name, address in pages.items():
            if name in models:
                section = self._model_section(name)
            else:
                files = folder / DATASETS / FILES / file_stem(name)
                section = self._dataset_section(name, files)
                yield from sorted(files.iterdir())
            page = Page(name, [section], self.command, from_below, up)
            yield write_text(folder / address, html_page(page, f"../{SCRIPT}"))
        page = Page(TITLE, [self._first_section(models, datasets)], self.command, pages)
        yield write_text(folder / INDEX, html_page(page, SCRIPT))
        yield write_text(folder / SCRIPT, table_script())
        scores = render(self.content.board_tables, "csv", self.command)
        yield write_text(folder / SCORES, f"{scores}\n")

    def _first_section(self, models: Mapping[str, str], datasets: Mapping[str, str]) -> Section:
        board, stored = self.board, self.content.merged
        ratios, *other_tables = self.content.board_tables
        counts = Counter(result.run_id for case in stored.cases for result in case.every)
        makers = (score_against_cost, score_against_poses)
        sentences = board_sentences(board)
        sentence_notes = [f"{label}: {text}" for label, text in sentences]
        notes = [*self.study.notes, *(note for note in ratios.notes if note not in sentence_notes)]
        return Section(
            board_headline(board),
            f"{self.study.title} · {counts.total()} fits",
            texts=sentences,
            tables=self.first_tables,
            sections=[
                Section("Notes", notes=notes, is_folded=True),
                Section(
                    "Cost and number of poses",
                    figures=drawn_figures((partial(make, board), self.command) for make in makers),
                ),
                Section("How sure, and other numbers", tables=other_tables, is_folded=True),
                Section("Pages of models", links=[Link(*item) for item in models.items()]),
                Section("Pages of data sets", links=[Link(*item) for item in datasets.items()]),
                Section("Downloads", links=[Link(f"{SCORES}: all numbers of this page", SCORES)]),
                Section("Provenance", notes=[sources(self.results, stored.runs, counts)]),
            ],
        )

    def _model_section(self, name: str) -> Section:
        number = [row.name for row in self.board.rows].index(name)
        case = next(c.case for c in self.board.answer.cases if name in c.case.competitors)
        pair = {key: case.competitors[key] for key in dict.fromkeys((name, REFERENCE_MODEL))}

        def source(models: Mapping[str, Any]) -> FigureSource:
            return FigureSource(self.results, (replace(case, competitors=models),), (name,))

        makers = [
            partial(workspace.workspace, source({name: pair[name]})),
            partial(springs.springs, source(pair)),
        ]
        scores = [
            replace(table, rows=table.rows[number : number + 1]) for table in self.first_tables
        ]
        frame = self.errors[self.errors["model"] == name]
        errors = errors_table("Errors on each data set, best ratio first", "data set", frame)
        try:
            about = self.show_model(split_word(name)[0])
        except ConfigError:
            about = f"{name}: model of a submission, see results/submissions"
        return Section(
            name,
            tables=[*scores, errors],
            figures=drawn_figures((make, self.command) for make in makers),
            sections=[Section("Model and its options", log=about, is_folded=True)],
        )

    def _dataset_section(self, name: str, files: Path) -> Section:
        """Return the content of a data set's page, and write its files."""
        dataset = self.load_dataset(name)
        shutil.rmtree(files, ignore_errors=True)
        dataset.export(files)
        info = dataset.choice.info
        picture = partial(
            robot_picture.robot_picture, dataset.samples, dataset.robot, name, info.kind
        )
        command = f"bench figure robot --dataset {name}"
        title = "Models on this data set, smallest ratio first"
        frame = self.errors[self.errors["data set"] == name]
        links = [
            Link(file.name, f"{FILES}/{files.name}/{file.name}") for file in sorted(files.iterdir())
        ]
        export = f"bench data export {name} --output {file_stem(name)}"
        caveats = [("caveat", caveat) for caveat in info.caveats]
        return Section(
            name,
            info.kind,
            texts=[("what it is", info.summary), *dataset.data.facts, *caveats],
            tables=[errors_table(title, "model", frame)],
            figures=drawn_figures([(picture, command), (dataset.plot, command)]),
            sections=[
                Section("Files", links=links, command=export),
                Section("Data card", log=dataset.card or "none", is_folded=True),
            ],
        )


def with_charts(table: Table, board: Board) -> Table:
    """Return the first table of a board with a chart of the intervals, without its notes."""
    rows = [
        [*cells[:2], Quantity(low=mean.low, high=mean.high, ratio=mean.ratio), *cells[3:]]
        for cells, mean in zip(table.rows, (row.mean for row in board.rows), strict=True)
    ]
    name, ratio, interval, *other_columns = table.columns
    columns = [name, ratio, replace(interval, is_chart=True), *other_columns]
    return replace(table, title="Models", columns=columns, rows=rows, notes=[])


def colored(table: Table) -> Table:
    """Return a table with its ratios in colours."""
    is_ratio = [c.format == RATIO_FORMAT and c.name != "noise" for c in table.columns]
    rows = [
        [
            replace(number, ratio=number.value)
            if is_colored and (number := quantity(cell))
            else cell
            for cell, is_colored in zip(row, is_ratio, strict=True)
        ]
        for row in table.rows
    ]
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
