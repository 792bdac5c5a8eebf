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
from stiff_bench.plan.options import options_of
from stiff_bench.plan.registry import Registry
from stiff_bench.results.columns import RATIO_FORMAT
from stiff_bench.results.leaderboard_tables import StudyLeaderboard
from stiff_bench.results.load import StoredResults
from stiff_bench.results.notes import sources
from stiff_bench.results.summary import model_summary
from stiff_bench.store.names import split_word
from stiff_bench.tables.table import Column, Entry, Quantity, Table, text_columns
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
    def board(self) -> StudyLeaderboard:
        """Return the leaderboard; ConfigError: the study has no board, or too few results."""
        return study_leaderboard(self.study, StoredResults.read(self.results), self.statuses)

    @cached_property
    def errors(self) -> DataFrame:
        """Return the mean errors of each model on each data set."""
        return errors_frame(self.board.scores.frame)

    def write(self, folder: Path) -> Iterator[Path]:
        """Write all pages into a folder, and yield each file.

        Raises:
            ConfigError: the study has no board, or too few results.
            StoreError: nothing is stored, or a file cannot be written.
        """
        rows = {row["model"]: row for row in self.board.board_frame.to_dict("records")}
        models = {name: f"{MODELS}/{file_stem(name)}.html" for name in rows}
        names = dict.fromkeys(task.name.dataset for task in self.board.scores.tasks)
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
        tables = self.board.tables
        yield write_text(folder / SCORES, f"{render(tables, 'csv', self.command)}\n")
        first = Page(
            TITLE, [self._first_section(models, datasets)], self.command, {**models, **datasets}
        )
        yield write_text(folder / INDEX, html_page(first, SCRIPT))

    def _first_section(self, models: Mapping[str, str], datasets: Mapping[str, str]) -> Section:
        board, stored = self.board, self.board.stored
        ratios, *tables = board.tables
        dates = [run.started[:10] for run in stored.runs if run.started]
        counts = Counter(result.run_id for task in stored.tasks for result in task.every)
        makers = (score_against_cost, score_against_poses)
        figures = drawn_figures((partial(make, board), self.command) for make in makers)
        summary = board.summary
        notes = [*self.study.notes, *(note for note in ratios.notes if note not in summary.lines)]
        parts = [
            Section("Notes", notes=notes, is_folded=True),
            Section("Cost and number of poses", figures=figures),
            Section("How sure, and other numbers", tables=tables[1:], is_folded=True),
            Section("Pages of models", links=[Link(*item) for item in models.items()]),
            Section("Pages of data sets", links=[Link(*item) for item in datasets.items()]),
            Section("Downloads", links=[Link(f"{SCORES}: all numbers of this page", SCORES)]),
            Section("Provenance", notes=[sources(self.results, stored.runs, counts)]),
        ]
        return Section(
            summary.headline,
            " · ".join([self.study.title, *dates[-1:], f"{counts.total()} fits"]),
            texts=summary.sentences,
            tables=[replace(ratios, title="Models", notes=[]), tables[0]],
            sections=parts,
        )

    def _model_section(self, row: Mapping[Any, Any]) -> Section:
        model = row["model"]
        info = self.registry.models.get(split_word(model)[0])
        facts = {"status": self.statuses.get(model, ""), "fit": duration(row["fit_s"])}
        options = []
        if info is None:
            facts["model"] = "of a submission, see results/submissions"
        else:
            facts |= {"model": info.summary, "equation": info.equation}
            facts |= {"reference": info.reference, "version": str(info.version)}
            facts |= {"command": f"bench run --model {model} --dataset kr10-twin"}
            options = [Section("Options", tables=[options_table(info)], is_folded=True)]
        frame = self.errors[self.errors["model"] == model]
        task = next(t.task for t in self.board.scores.tasks if model in t.scores)
        pair = {name: task.models[name] for name in dict.fromkeys((model, REFERENCE_MODEL))}
        sources_of = {
            make: FigureSource(self.results, (replace(task, models=names),), (model,))
            for make, names in (
                (workspace.workspace, {model: pair[model]}),
                (springs.springs, pair),
            )
        }
        figures = drawn_figures(
            (partial(make, source), self.command) for make, source in sources_of.items()
        )
        return Section(
            model,
            texts=model_summary(self.board.scores, row).sentences,
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
