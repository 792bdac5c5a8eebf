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

from stiff_bench.figures import robot_picture, springs, workspace
from stiff_bench.figures.board_figures import score_against_cost, score_against_poses
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.page.html import html_page, table_script
from stiff_bench.page.page import Link, Page, Section, drawn_figures, write_text
from stiff_bench.page.study_page import study_leaderboard
from stiff_bench.paper.study_file import Study
from stiff_bench.results.columns import RATIO_FORMAT
from stiff_bench.results.leaderboard import StudyLeaderboard
from stiff_bench.results.load import StoredResults
from stiff_bench.results.notes import sources
from stiff_bench.store.names import split_word
from stiff_bench.tables.table import Column, Quantity, Table, text_columns
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
    def board(self) -> StudyLeaderboard:
        """Return the leaderboard; ConfigError: the study has no board, or too few results."""
        return study_leaderboard(self.study, StoredResults.read(self.results), self.statuses)

    @cached_property
    def errors(self) -> DataFrame:
        """Return the mean errors of each model on each data set."""
        return errors_frame(self.board.scores.frame)

    @cached_property
    def first_tables(self) -> list[Table]:
        """Return the models with a chart of their ratios, and their other numbers."""
        ratios, *other_tables = self.board.tables
        more = [table for table in other_tables if table.about.get("table") == "more"]
        return [replace(ratios, title="Models", notes=[]), *more]

    def write(self, folder: Path) -> Iterator[Path]:
        """Write all pages into a folder, and yield each file.

        Raises:
            ConfigError: the study has no board, or too few results.
            StoreError: nothing is stored, or a file cannot be written.
        """
        names = [*self.board.board_frame["model"]]
        models = {name: f"{MODELS}/{file_stem(name)}.html" for name in names}
        names = [*dict.fromkeys(task.name.dataset for task in self.board.scores.tasks)]
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
        scores = render(self.board.tables, "csv", self.command)
        yield write_text(folder / SCORES, f"{scores}\n")

    def _first_section(self, models: Mapping[str, str], datasets: Mapping[str, str]) -> Section:
        board, stored, summary = self.board, self.board.stored, self.board.summary
        ratios, *other_tables = board.tables
        counts = Counter(result.run_id for result in stored.every)
        makers = (score_against_cost, score_against_poses)
        notes = [*self.study.notes, *(note for note in ratios.notes if note not in summary.lines)]
        return Section(
            summary.headline,
            f"{self.study.title} · {counts.total()} fits",
            texts=summary.sentences,
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
        number = [*self.board.board_frame["model"]].index(name)
        task = next(task.task for task in self.board.scores.tasks if name in task.scores)
        pair = {key: task.models[key] for key in dict.fromkeys((name, REFERENCE_MODEL))}

        def source(models: Mapping[str, Any]) -> FigureSource:
            return FigureSource(self.results, (replace(task, models=models),), (name,))

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


def errors_frame(rows: DataFrame) -> DataFrame:
    """Return a row per model and data set from `Scores.frame`: means over seeds and splits, mm."""
    rows = rows[rows["error ratio"] > 0.0]
    columns = {
        **{"data set": rows["dataset"], "error": MM * rows["error"]},
        **{"log ratio": np.log(rows["error ratio"]), "noise": MM * rows["noise"]},
        **{"95th percentile": MM * rows["p95"], "left on tool paths": rows["path"]},
    }
    groups = rows.assign(**columns).groupby(["model", "data set", "robot"], sort=False)
    numbers = ["error", "log ratio", "95th percentile", "left on tool paths", "noise"]
    means = groups[numbers].mean().reset_index()
    means["ratio"] = np.exp(means.pop("log ratio"))
    means["error / noise"] = means["error"] / means.pop("noise")
    return means.sort_values("ratio", kind="stable")


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
