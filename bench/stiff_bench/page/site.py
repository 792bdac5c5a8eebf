"""Write the web pages of a study's leaderboard: first page, models and data sets."""

from __future__ import annotations

import re
import shlex
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from pandas import DataFrame

from stiff_bench.figures import robot_picture, springs, workspace
from stiff_bench.figures.board_figures import score_against_cost, score_against_poses
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.page.page import (
    Link,
    Page,
    Section,
    drawn_figures,
    html_page,
    table_script,
    write_text,
)
from stiff_bench.paper.study_file import Study
from stiff_bench.results.columns import RATIO_FORMAT
from stiff_bench.results.leaderboard import StudyLeaderboard
from stiff_bench.results.notes import sources
from stiff_bench.store.names import split_word
from stiff_bench.tables.table import Column, Quantity, Table
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
        board: leaderboard of the study.
        command: command that writes the pages.
        load_dataset: function that returns a data set by its name.
        show_model: function that returns the description of a model by its key.
    """

    study: Study
    board: StudyLeaderboard
    command: str
    load_dataset: Callable[[str], Any]
    show_model: Callable[[str], str]

    @cached_property
    def errors(self) -> DataFrame:
        """Return the mean errors of each model on each data set."""
        return errors_frame(self.board.scores.frame)

    def write(self, folder: Path) -> Iterator[Path]:
        """Write all pages into a folder, and yield each file; the first page is the last.

        Raises:
            ConfigError: the study has too few results.
            StoreError: a file cannot be written.
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
        yield write_text(folder / SCRIPT, table_script())
        scores = render(self.board.tables, "csv", self.command)
        yield write_text(folder / SCORES, f"{scores}\n")
        page = Page(TITLE, [self._first_section(datasets)], self.command, pages)
        yield write_text(folder / INDEX, html_page(page, SCRIPT))

    def _first_section(self, datasets: Mapping[str, str]) -> Section:
        board, stored, summary = self.board, self.board.stored, self.board.summary
        ratios, *other_tables = board.tables
        notes = [note for note in ratios.notes if note not in summary.lines]
        counts = Counter(result.run_id for result in stored.every)
        figures = drawn_figures(
            (partial(make, board), self.command)
            for make in (score_against_cost, score_against_poses)
        )
        return Section(
            summary.headline,
            f"{self.study.title} · {counts.total()} fits",
            texts=summary.sentences,
            tables=[replace(ratios, title="Models", notes=[])],
            sections=[
                Section("Notes", notes=[*self.study.notes, *notes], is_folded=True),
                Section("Cost and number of poses", figures=figures),
                Section("How sure, and other numbers", tables=other_tables, is_folded=True),
                Section("Data sets", links=[Link(*item) for item in datasets.items()]),
                Section(
                    "Provenance",
                    notes=[sources(stored.folder, stored.runs, counts)],
                    links=[Link(f"{SCORES}: all numbers of this page", SCORES)],
                ),
            ],
        )

    def _model_section(self, name: str) -> Section:
        number = [*self.board.board_frame["model"]].index(name)
        task = next(task.task for task in self.board.scores.tasks if name in task.scores)
        pair = {key: task.models[key] for key in dict.fromkeys((name, REFERENCE_MODEL))}
        source = FigureSource(self.board.stored.folder, (replace(task, models=pair),), (name,))
        figures = drawn_figures(
            (partial(make, source), self.command) for make in (workspace.workspace, springs.springs)
        )
        scores = [  # a row per model
            replace(table, title=title, rows=table.rows[number : number + 1], notes=[])
            for title, table in zip(
                ("Leaderboard", "Other numbers"), self.board.tables, strict=False
            )
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
            figures=figures,
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
        command = shlex.join(["bench", "figure", "robot", "--dataset", name])
        title = "Models on this data set, smallest ratio first"
        frame = self.errors[self.errors["data set"] == name]
        links = [
            Link(file.name, f"{FILES}/{files.name}/{file.name}") for file in sorted(files.iterdir())
        ]
        export = shlex.join(["bench", "data", "export", name, "--output", file_stem(name)])
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
    rows = rows[rows["error ratio"] > 0.0].rename(columns={"dataset": "data set"})
    columns = {
        **{"log": np.log(rows["error ratio"]), "3-D error": MM * rows["error"]},
        **{"95th percentile": MM * rows["p95"], "left on tool paths": rows["path"]},
    }
    groups = rows.assign(**columns).groupby(["model", "data set"], sort=False)
    means = groups[[*columns]].mean().reset_index()
    return means.assign(ratio=np.exp(means["log"])).sort_values("ratio", kind="stable")


def errors_table(title: str, first: str, frame: DataFrame) -> Table:
    """Return errors in mm and ratios by the column `first` of an `errors_frame`."""

    def ratio(row: Mapping[str, Any]) -> Quantity:
        return Quantity(row["ratio"], ratio=row["ratio"])

    error, *more = (
        Column(name, unit="mm", format=".4f")
        for name in ("3-D error", "95th percentile", "left on tool paths")
    )
    ratios = Column("error / VJM's", format=RATIO_FORMAT, value=ratio)
    return Table.of(title, [Column(first, "text"), error, ratios, *more], frame)
