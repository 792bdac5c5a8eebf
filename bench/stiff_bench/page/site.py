"""Write the web pages of a study's leaderboard: first page, models and data sets."""

from __future__ import annotations

import re
import shlex
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

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
from stiff_bench.results.columns import (
    FIT,
    INTERVAL,
    MODEL,
    RATIO_FORMAT,
    names_of_kind,
    number,
    ratio_column,
)
from stiff_bench.results.fresh_robots import UNSEEN, flag_of
from stiff_bench.results.leaderboard import StudyLeaderboard
from stiff_bench.results.notes import sources
from stiff_bench.results.scored_task import ScoredTask
from stiff_bench.store.names import split_word
from stiff_bench.submissions.card import Card, read_card
from stiff_bench.submissions.submission import CARD, CODE
from stiff_bench.tables.table import Column, Quantity, Table, text_columns
from stiff_bench.tables.units import MM
from stiff_bench.tables.writers import render
from stiff_datasets.robots.shipped_robots import TITLES
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import Citation

INDEX, MODELS, DATASETS = "index.html", "models", "data"
FILES = "files"
"""Folder of the data sets' files, inside the folder of their pages."""
SCORES, SCRIPT = "scores.csv", "tables.js"
TITLE = "stiffbench leaderboard"
CITATIONS = "citations.bib"
WORDS = {
    "VJM": "virtual joint model: one linear spring per joint, fitted by least squares",
    "rank": "place in the order of the ratios; 1 is the smallest",
    "kind": "what a model is made of",
    "physics": "springs and other parts of a robot, with parameters that a fit identifies",
    "Gaussian process": "a distribution of functions, which also gives intervals",
    "network": "a neural network that learns from measured samples only",
    "hybrid": "physics and a learned part: a network or a Gaussian process",
    "method": "authors and year of the paper or report that defines the method",
    "error / VJM's": "mean 3-D error at test poses, divided by the VJM's on the same split; "
    "geometric mean over robots. Below 1: better than the VJM",
    INTERVAL: "where the mean over all robots of the generator lies with 95 % confidence",
    "truth": "deflection of the simulated robot itself, without noise",
    "readings": "what the simulated tracker shows, with its noise",
    "95th percentile": "error that 95 % of the test poses do not exceed",
    "tool paths": "error left after a correction by the model, on 36 tool paths of each robot",
    "clean": "world with elastic gears and tilting bearings only",
    "friction": "world in which gears have friction, too",
    "structure": "world in which links and base bend, bearings have play and wrists are coupled",
    "workshop": "world with the errors of a workshop: force point, sensor, tracker, masses, drift",
    "all": "world with the effects of friction, structure and workshop at once",
    UNSEEN: "world of fresh robots, whose effects no model has a group for",
    "named robots": "the 12 robots of this board, which authors of models know",
    "fresh robots": "12 robots that a generator drew after the model was written or sent",
    "fresh / named": "error over the best other model's on fresh robots, over the same on named "
    "ones; about 1: the model is not better on the robots that its authors know",
    "verdict": "against the VJM: better, worse or open",
    "better": "less error than the VJM, significant over robots (sign flips, Holm)",
    "worse": "more error than the VJM, significant over robots (sign flips, Holm)",
    "open": "the robots do not show whether the model or the VJM is better",
    "worst robot": "robot with the largest ratio",
    "won": "number of robots on which the model has the smallest error; a tie counts for no model",
    "fit": "median time of one fit",
    "date": "day of the newest fit",
}
"""Words of a board, and what they mean."""
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
    def _tasks(self) -> list[ScoredTask]:
        """Return the tasks of the board, and of measured data that it does not average."""
        of_board = self.board.scores.tasks
        names = {task.name for task in of_board}
        measured = chain.from_iterable(self.board.readings.measured.values())
        return [*of_board, *(task for task in measured if task.name not in names)]

    @cached_property
    def errors(self) -> DataFrame:
        """Return the mean errors of each model on each data set."""
        return errors_frame(self.board.scores.over(self._tasks).frame)

    def write(self, folder: Path) -> Iterator[Path]:
        """Write all pages into a folder, and yield each file; the first page is the last.

        Raises:
            ConfigError: the study has too few results.
            StoreError: a file cannot be written.
        """
        models = {name: f"{MODELS}/{file_stem(name)}.html" for name in self.methods}
        datasets = {
            title: f"{DATASETS}/{file_stem(name)}.html" for name, title in self.titles.items()
        }
        pages = {**models, **datasets}
        from_below = {name: f"../{address}" for name, address in pages.items()}
        paper_links = {
            method.citation.text: method.citation.url
            for method in self.methods.values()
            if method.citation and _is_web_address(method.citation.url)
        }
        up = Link(TITLE, f"../{INDEX}")
        for name, address in models.items():
            addresses = {**paper_links, **from_below}
            page = Page(name, [self._model_section(name)], self.command, addresses, up, WORDS)
            yield write_text(folder / address, html_page(page, f"../{SCRIPT}"))
        for name, title in self.titles.items():
            files = folder / DATASETS / FILES / file_stem(name)
            section = self._dataset_section(name, files)
            yield from sorted(files.iterdir())
            page = Page(title, [section], self.command, from_below, up, WORDS)
            yield write_text(folder / datasets[title], html_page(page, f"../{SCRIPT}"))
        yield write_text(folder / SCRIPT, table_script())
        scores = render(self.board.tables, "csv", self.command)
        yield write_text(folder / SCORES, f"{scores}\n")
        entries = [
            method.citation.bibtex(name) for name, method in self.methods.items() if method.citation
        ]
        yield write_text(folder / CITATIONS, "\n\n".join(entries) + "\n")
        first = [self._first_section(datasets)]
        page = Page(TITLE, first, self.command, {**paper_links, **pages}, words=WORDS)
        yield write_text(folder / INDEX, html_page(page, SCRIPT))

    @cached_property
    def methods(self) -> dict[str, Method]:
        """Return kind and origin of the board's models, best first."""
        cards = submission_cards(self.board.stored.folder.parents[1])
        return {name: method_of(name, cards) for name in self.board.board_frame["model"]}

    @cached_property
    def titles(self) -> dict[str, str]:
        """Return the data sets' names as people say them: robot, world and plan."""
        tasks = {task.name.dataset: task for task in self._tasks}
        titles = {name: dataset_title(task) for name, task in tasks.items()}
        counts = Counter(titles.values())
        return {name: title if counts[title] == 1 else name for name, title in titles.items()}

    @cached_property
    def _facts(self) -> dict[Any, dict[Any, Any]]:
        """Return what is known of each model besides the metrics, by name."""
        board, fresh = self.board, self.board.fresh
        rows = board.board_frame.set_index("model", drop=False)
        if fresh is not None:
            rows = rows.join(fresh.set_index("model"))
        started = {run.run_id: run.started[:10] for run in board.stored.runs}
        facts: dict[Any, dict[Any, Any]] = rows.to_dict("index")
        for name, row in facts.items():
            method = self.methods[name]
            every = [fit for task in board.scores.tasks for fit in task.results.get(name, ())]
            date = max((started.get(fit.run_id, "") for fit in every), default="")
            row["date"] = date.replace("-", "\N{NON-BREAKING HYPHEN}")
            row["kind"] = method.kind
            row["method"] = method.citation.text if method.citation else None
        return facts

    def _choices(self) -> Iterator[tuple[str, Table]]:
        """Yield the table of the models for each metric, smallest ratio first."""
        measured = {
            ("measured", name): self.titles.get(name, name)
            for name in names_of_kind(self.board.frame, "measured")
        }
        for metric, frame in self.board.metrics.items():
            keys: Any = [*frame]
            worlds = {(name, end): name for name, end in keys if name and end == "ratio"}
            rows = [
                {**self._facts[name], **row, "rank": place}
                for place, (name, row) in enumerate(frame.to_dict("index").items(), start=1)
            ]
            columns = [
                Column("rank"),
                MODEL,
                *text_columns("kind", "method"),
                ratio_column("error / VJM's", ("", "ratio")),
                ratio_column(
                    INTERVAL, ends=(("", "low"), ("", "high")), color=("", "ratio"), is_chart=True
                ),
                *(
                    ratio_column(name, key, color=key)
                    for key, name in {**worlds, **measured}.items()
                ),
                *FRESH_COLUMNS,
                FIT,
                Column("date", "text"),
            ]
            table = Table.of(f"Error over the VJM's: {metric}", columns, rows)
            yield metric, table.without_empty_columns()

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
            choices=[*self._choices()],
            sections=[
                Section("Words", notes=[f"{word}: {text}" for word, text in WORDS.items()]),
                Section("Notes", notes=[*self.study.notes, *notes], is_folded=True),
                Section("Cost and number of poses", figures=figures),
                Section(
                    "How sure, and other numbers",
                    tables=[replace(ratios, title="Verdicts", notes=[]), *other_tables],
                    is_folded=True,
                ),
                Section("Data sets", links=[Link(*item) for item in datasets.items()]),
                Section(
                    "Provenance",
                    notes=[sources(stored.folder, stored.runs, counts)],
                    links=[
                        Link(f"{SCORES}: all numbers of this page", SCORES),
                        Link(f"{CITATIONS}: papers of the models as BibTeX", CITATIONS),
                    ],
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
        frame = frame.assign(**{"data set": frame["data set"].map(self.titles)})
        errors = errors_table("Errors on each data set, best ratio first", "data set", frame)
        method = self.methods[name]
        sections = [
            Section(f"Code: {file}", log=text, is_folded=True) for file, text in method.code.items()
        ]
        try:
            about = self.show_model(split_word(name)[0])
            sections.insert(0, Section("Model and its options", log=about, is_folded=True))
        except ConfigError:  # a submission's model: its code says more
            pass
        facts = [("kind", method.kind)]
        if citation := method.citation:
            facts.insert(1, ("method", f"{citation.text}. {citation.title}"))
            links = [Link(citation.url, citation.url)] * _is_web_address(citation.url)
            sections.insert(0, Section("BibTeX", links=links, log=citation.bibtex(name)))
        return Section(
            name, texts=facts, tables=[*scores, errors], figures=figures, sections=sections
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
            self.titles[name],
            info.kind,
            texts=[
                ("name", f"`{name}`"),
                ("what it is", info.summary),
                *dataset.data.facts,
                *caveats,
            ],
            tables=[errors_table(title, "model", frame)],
            figures=drawn_figures([(picture, command), (dataset.plot, command)]),
            sections=[
                Section("Files", links=links, command=export),
                Section("Data card", log=dataset.card or "none", is_folded=True),
            ],
        )


class Method(NamedTuple):
    """Kind and origin of a model.

    Attributes:
        kind: what it is made of.
        citation: paper or report that defines it; None: unknown.
        code: files of its code: address in the repository -> text.
    """

    kind: str
    citation: Citation | None
    code: Mapping[str, str]


def _fresh_over_named(row: Mapping[Any, Any]) -> Quantity | None:
    ratio = number(row, ("change", "ratio"))
    return None if ratio is None else Quantity(ratio, status=flag_of(row))


FRESH_COLUMNS = (
    ratio_column("fresh robots", ("fresh", "ratio"), color=("fresh", "ratio")),
    Column("fresh / named", format=RATIO_FORMAT, value=_fresh_over_named),
    ratio_column(UNSEEN, (UNSEEN, "ratio"), color=(UNSEEN, "ratio")),
)
"""Columns of fresh robots; see `fresh_robots.fresh_frame`."""


def submission_cards(results: Path) -> dict[str, tuple[Card, Path]]:
    """Return card and folder of each submission in RESULTS/submissions, by its model."""
    files = sorted((results / "submissions").glob(f"*/{CARD}"))
    cards = [(read_card(file), file.parent) for file in files]
    return {card.model: (card, folder) for card, folder in cards}


def method_of(name: str, cards: Mapping[str, tuple[Card, Path]]) -> Method:
    """Return kind and origin of a shipped model or of a submission's."""
    if name in cards:
        card, folder = cards[name]
        files = {
            f"results/submissions/{folder.name}/{CODE}/{card.plugin}": folder / CODE / card.plugin
        }
        return Method(card.kind, card.citation, _texts(files))
    try:
        info = model_info(split_word(name)[0])
    except ConfigError:
        return Method("other", None, {})
    module = str(info.target).partition(":")[0]
    package, *file_parts = module.split(".")
    file = Path(str(resources.files(package)), *file_parts).with_suffix(".py")
    return Method(info.kind, info.citation, _texts({f"models/{module.replace('.', '/')}.py": file}))


def _texts(files: Mapping[str, Path]) -> dict[str, str]:
    return {address: file.read_text(encoding="utf-8") for address, file in files.items()}


def _is_web_address(url: str) -> bool:
    return url.startswith(("https://", "http://"))


def dataset_title(task: ScoredTask) -> str:
    """Return a data set's name as people say it, such as "KR 240, structure, wide"."""
    params, robot = task.task.fit.dataset_params, task.data.robot.name
    usual_values = {"specimen": 0, "seed": 0}
    more = [
        f"{key} {params[key]}"
        for key, usual in usual_values.items()
        if params.get(key, usual) != usual
    ]
    parts = [params.get("world"), params.get("plan"), *more]
    if task.kind == "measured":
        parts.append("measured")
    return ", ".join([TITLES.get(robot, robot), *filter(None, parts)])


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
