"""Write the web pages of a study's leaderboard: first page, models and data sets."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

from stiff_bench.analysis.board import Board, BoardRow
from stiff_bench.analysis.collected import Case, StoredResults
from stiff_bench.api.data_sets import load_dataset
from stiff_bench.api.registered import registry
from stiff_bench.figures import robot_picture, springs, workspace
from stiff_bench.figures.board_figures import score_against_cost, score_against_poses
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.paper.study_board import StudyResults
from stiff_bench.paper.study_file import Study
from stiff_bench.plan.options import options_of
from stiff_bench.report.board_pages import (
    board_screen,
    dataset_table,
    facts_table,
    model_sentences,
    model_table,
    scoped_table,
)
from stiff_bench.report.html_page import Block, Link, Part, embedded, render_page
from stiff_bench.store.names import split_word
from stiff_bench.store.versions import sources
from stiff_bench.tables.table import Table, text_columns
from stiff_bench.tables.units import counted, duration
from stiff_bench.tables.writers import render
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.files import make_folder, written_whole
from stiff_protocols.contract.plugin import ModelInfo

INDEX, MODELS, DATASETS = "index.html", "models", "data"
FILES = "files"
"""Folder of the data sets' files, inside the folder of their pages."""
SCORES = "scores.csv"
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
        statuses: "verified" or "reported" by model; empty: the board has no such column.
    """

    study: Study
    results: Path
    command: str
    statuses: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def content(self) -> StudyResults:
        """Return the study with its results."""
        return StudyResults(self.study, StoredResults.read(self.results), self.statuses)

    @property
    def stored(self) -> StoredResults:
        """Return the results, without the pre-training seed in model names."""
        return self.content.merged

    @property
    def board(self) -> Board:
        """Return the board; ConfigError: the study has no board, or too few results."""
        return self.content.board

    @cached_property
    def datasets(self) -> dict[str, Case]:
        """Return a comparison of the board by data set."""
        return {case.name.dataset: case.case for case in self.board.answer.cases}

    def write(self, folder: Path) -> Iterator[Path]:
        """Write all pages into a folder, and yield each file.

        Raises:
            ConfigError: the study has no board, or too few results.
            StoreError: nothing is stored, or a file cannot be written.
        """
        for sub in (MODELS, DATASETS):
            make_folder(folder / sub)
        models = {row.name: f"{MODELS}/{file_stem(row.name)}.html" for row in self.board.rows}
        datasets = {name: f"{DATASETS}/{file_stem(name)}.html" for name in self.datasets}
        up = Link(TITLE, f"../{INDEX}")
        from_below = {name: f"../{address}" for name, address in {**models, **datasets}.items()}
        for row in self.board.rows:
            part = {row.name: self._model_part(row)}
            text = render_page(part, self.command, title=row.name, addresses=from_below, back=up)
            yield _written(folder / models[row.name], text)
        for name in self.datasets:
            files = folder / DATASETS / FILES / file_stem(name)
            yield from _exported(name, files)
            part = {name: self._dataset_part(name, files)}
            text = render_page(part, self.command, title=name, addresses=from_below, back=up)
            yield _written(folder / datasets[name], text)
        tables = self.content.board_tables
        yield _written(folder / SCORES, render(tables, "csv", self.command))
        part = {self.study.title: self._first_part(models, datasets, tables)}
        text = render_page(part, self.command, title=TITLE, addresses={**models, **datasets})
        yield _written(folder / INDEX, text)

    def _first_part(
        self, models: Mapping[str, str], datasets: Mapping[str, str], tables: Sequence[Table]
    ) -> Part:
        board = self.board
        dates = [run.started[:10] for run in self.stored.runs if run.started]
        counts = Counter(result.run_id for case in self.stored.cases for result in case.every)
        pictures = [
            embedded(figure, self.command)
            for make in (score_against_cost, score_against_poses)
            if (figure := _made(partial(make, board)))
        ]
        made_by = sources(self.results, self.stored.runs, counts)
        screen = board_screen(board)
        if withdrawn := self.content.columns.withdrawn:
            screen = replace(screen, headline=withdrawn)
        return Part(
            " · ".join(
                [self.study.title, *([max(dates)] if dates else []), f"{counts.total()} fits"]
            ),
            screen,
            notes=[*self.study.notes, *tables[0].notes],
            blocks=[
                Block("Board to sort and filter", tables=[scoped_table(board)]),
                Block("Cost and number of poses", pictures=pictures),
                Block("How sure, and other numbers", tables=tables, is_detail=True),
                Block("Pages of models", links=[Link(*item) for item in models.items()]),
                Block("Pages of data sets", links=[Link(*item) for item in datasets.items()]),
                Block("Downloads", links=[Link(f"{SCORES}: all numbers of this page", SCORES)]),
                Block("Provenance", texts=[made_by], command=self.command, is_detail=True),
            ],
        )

    def _model_part(self, row: BoardRow) -> Part:
        key, _ = split_word(row.name)
        info = registry().models.get(key)
        status = {"status": self.statuses[row.name]} if row.name in self.statuses else {}
        facts = {"model": "of a submission, see results/submissions", "fit": duration(row.fit_s)}
        if info is not None:
            facts = {
                "model": info.summary,
                "equation": info.equation,
                "reference": info.reference,
                "version": str(info.version),
                "fit": duration(row.fit_s),
                "command": f"bench run --model {row.name} --dataset kr10-twin",
            }
        pictures = [
            embedded(figure, self.command) for figure in self._model_figures(row.name) if figure
        ]
        table = model_table(self.board, row.name)
        return Part(
            f"{counted(len(table.rows), 'data set')}",
            headline=row.name,
            sentences=model_sentences(self.board, row),
            blocks=[
                Block("Model", tables=[facts_table({**facts, **status}, "Facts")]),
                Block("Where it is better and worse", tables=[table]),
                *([Block("Pictures", pictures=pictures)] if pictures else []),
                *([] if info is None else [_options_block(info)]),
            ],
        )

    def _model_figures(self, name: str) -> Iterator[Prepared | None]:
        """Yield the error map, and torque-deflection curves if the model has them."""
        case = next(case for case in self.datasets.values() if name in case.competitors)
        pair = {key: case.competitors[key] for key in dict.fromkeys((name, REFERENCE_MODEL))}
        model_case = replace(case, competitors={name: pair[name]})
        for make, figure_case in (
            (workspace.workspace, model_case),
            (springs.springs, replace(case, competitors=pair)),
        ):
            yield _made(partial(make, FigureSource(self.results, (figure_case,), (name,))))

    def _dataset_part(self, name: str, files: Path) -> Part:
        dataset = load_dataset(name)
        info = dataset.choice.info
        pictures = [
            embedded(figure, f"bench figure robot --dataset {name}")
            for figure in (
                _made(
                    lambda: robot_picture.robot_picture(
                        dataset.samples, dataset.robot, name, info.kind
                    )
                ),
                _made(dataset.plot),
            )
            if figure
        ]
        facts = dict(dataset.data.facts)
        return Part(
            f"{info.kind} · {counted(len(dataset), 'sample')}",
            headline=name,
            sentences=[("Data", info.summary), *(("Caveat", text) for text in info.caveats)],
            blocks=[
                Block("Robot, poses and loads", pictures=pictures),
                Block("Models", tables=[dataset_table(self.board, name)]),
                Block(
                    "Files",
                    links=[
                        Link(file.name, f"{FILES}/{files.name}/{file.name}")
                        for file in sorted(files.iterdir())
                    ],
                ),
                Block(
                    "Data",
                    tables=[facts_table(facts, "Facts")],
                    folds=[("Data card", dataset.card)] if dataset.card else [],
                    command=f"bench data export {name} --output {file_stem(name)}",
                ),
            ],
        )


def _exported(name: str, folder: Path) -> Iterator[Path]:
    """Replace a data set's files in a folder of the pages, and yield them."""
    shutil.rmtree(folder, ignore_errors=True)
    load_dataset(name).export(folder)
    yield from sorted(folder.iterdir())


def _made(make: Callable[[], Prepared]) -> Prepared | None:
    """Return a figure; None if the results are not sufficient."""
    try:
        return make()
    except (StiffBenchError, ArithmeticError, ValueError):  # write the page without this figure
        return None


def _written(path: Path, text: str) -> Path:
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return path


def _options_block(info: ModelInfo) -> Block:
    """Return the options of a model as a table."""
    columns = text_columns("option", "default", "valid", "meaning")
    rows = [
        [option.name, str(option.default), option.type_text, option.description]
        for option in options_of(info.load()).values()
    ]
    return Block("Options", tables=[Table("Options", columns, rows)], is_detail=True)
