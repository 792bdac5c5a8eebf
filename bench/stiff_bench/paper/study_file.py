"""Read a study: a TOML file with its runs and the contents of its page.

Keys of a run (`StudyRun`) at the top of the file are for all runs. A file without [[run]] is one
run.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from stiff_bench.plan.fits import RunPlan, plan_run
from stiff_bench.plan.registry import Registry
from stiff_bench.results.selection import BoardSettings
from stiff_bench.store.names import split_word
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.files import read_toml


def _checked_line(text: str) -> str:
    """Return a text of one printable line; ValueError for another."""
    if not text.isprintable():
        raise ValueError("it should be one line without control characters")
    return text


Words = tuple[str, ...]
Line = Annotated[str, AfterValidator(_checked_line)]
NO_OTHER_KEYS = ConfigDict(extra="forbid")
SUFFIX = ".toml"
UNKNOWN_KEY = "unexpected_keyword_argument"
"""Name of this error in pydantic."""
MESSAGE_START = re.compile("^(Input should|Value error, it should)")


@dataclass(frozen=True, config=NO_OTHER_KEYS)
class StudyRun:
    """Run every model on every data set under every protocol.

    Attributes:
        models: words of `bench run --model`, such as "knn@neighbours=3"; "all": every model.
        datasets: words of `--dataset`, or groups of the study.
        protocols: words of `--protocol`.
        settings: words of `--set`.
        splits: number of splits; None: the protocol's own.
        seed: seed of splits and models.
        intervals: True to compute prediction intervals, too, which metric `coverage` needs.
    """

    models: Words
    datasets: Words
    protocols: Words = ("holdout",)
    settings: Words = ()
    splits: Annotated[int, Field(ge=1, le=10_000)] | None = None
    seed: Annotated[int, Field(ge=0, le=2**32 - 20_000)] = 0
    intervals: bool = False


@dataclass(frozen=True, config=NO_OTHER_KEYS)
class Study:
    """Describe the runs of a study and its page.

    Attributes:
        name: name of the folder with page and results; default: the file's name.
        title: title of the page.
        run: runs; their results are stored in one folder.
        notes: notes on the results, printed under the title of the page.
        metrics: keys of the metrics whose scores are printed.
        coverage: nominal coverage of prediction intervals; None: 0.9 if a metric needs them.
        tables: names of the tables on the page (`study_page.TABLES`).
        figures: names of the figures on the page; `bench list figures` lists them.
        groups: name -> data sets. Runs may name groups.
        board: settings of table "leaderboard"; None: as `bench leaderboard` prints it.
        lite: data sets of the short version of the study (`lite_version`).
        file: file of the study; errors name it.
    """

    name: Annotated[Line, Field(pattern=r"^[^./\\][^/\\]*$")]  # a folder, not a path
    title: Line
    run: tuple[StudyRun, ...]
    notes: tuple[Line, ...] = ()
    metrics: Words = ()
    coverage: Annotated[float, Field(gt=0, lt=1)] | None = None
    tables: Words = ("scores",)
    figures: Words = ()
    groups: Mapping[str, Words] = Field(default_factory=dict)
    board: BoardSettings | None = None
    lite: Words = ()
    file: Path = Path()

    @property
    def word(self) -> str:
        """Name or path for `find_study`, valid in any working directory."""
        shipped = self.file.parent.resolve() == shipped_folder()
        return self.name if shipped else str(self.file.resolve())

    def datasets_of(self, run: StudyRun) -> list[str]:
        """Return the data sets of a run and of its groups."""
        return [word for name in run.datasets for word in self.groups.get(name, [name])]

    def lite_version(self) -> Study:
        """Return the short version: the first split of the first run on the data sets `lite`.

        It has the models of every run that shares protocols and seed with the first run.

        Raises:
            ConfigError: the study has no short version.
        """
        if not self.lite:
            raise ConfigError(f"{self.file}: has no key lite, the data sets of --lite")
        first = self.run[0]
        alike = [run for run in self.run if _division(run) == _division(first)]
        short = replace(
            first,
            models=_once(word for run in alike for word in run.models),
            datasets=self.lite,
            settings=_once(word for run in alike for word in run.settings),
            splits=1,
        )
        return replace(self, run=(short,))

    def with_models(self, models: Sequence[str]) -> Study:
        """Return the study with these models in place of its own models.

        Settings of other models are omitted. No data set is divided twice in the same way: of two
        runs with the same protocols and seed, the one with more splits counts.
        """
        keys = {split_word(word)[0] for word in models}
        settings: dict[Hashable, Words] = {}  # of each data set and division
        splits = dict[Hashable, int | None]()
        for run in self.run:
            words = (
                word for word in run.settings if word.partition("=")[0].rpartition(".")[0] in keys
            )
            of_run = _once(words)
            for dataset in self.datasets_of(run):
                place = dataset, _division(run)
                settings[place] = _once([*settings.get(place, ()), *of_run])
                splits[place] = _more_splits(run.splits, splits.get(place, 0))
        runs: dict[Hashable, StudyRun] = {}
        for run in self.run:
            for dataset in self.datasets_of(run):
                place = dataset, _division(run)
                of_place = settings.pop(place, None)
                if of_place is None:  # already in an earlier run
                    continue
                alike = _division(run), of_place, splits[place]
                earlier = runs[alike].datasets if alike in runs else ()
                datasets = (*earlier, dataset)
                runs[alike] = replace(
                    run,
                    models=tuple(models),
                    datasets=datasets,
                    settings=of_place,
                    splits=splits[place],
                )
        return replace(self, run=tuple(runs.values()))

    def plans(self, registry: Registry, *, output: Path, command: str) -> list[RunPlan]:
        """Check the runs, whose results are all stored in `output`.

        Raises:
            ConfigError: a model, data set, protocol, metric or option is unknown or wrong.
        """
        try:
            return [
                plan_run(
                    registry,
                    models=run.models,
                    datasets=self.datasets_of(run),
                    protocols=run.protocols,
                    settings=run.settings,
                    output=output,
                    metrics=_once([*self.metrics, *["coverage"] * run.intervals]),
                    splits=run.splits,
                    seed=run.seed,
                    command=command,
                    coverage=self.coverage,
                )
                for run in self.run
            ]
        except ConfigError as error:
            raise ConfigError(f"{self.file}: {error}") from error


def _once(words: Iterable[str]) -> Words:
    """Return each word once, in the order of their appearance."""
    return tuple(dict.fromkeys(words))


def _division(run: StudyRun) -> tuple[Words, int]:
    """Return the settings that divide a run's data sets into splits, without their number."""
    return run.protocols, run.seed


def _more_splits(first: int | None, second: int | None) -> int | None:
    """Return the larger number of splits; None, the protocol's own, counts as larger."""
    return None if None in (first, second) else max(first or 0, second or 0)


def shipped_folder() -> Path:
    """Return the folder of the studies that are shipped."""
    with as_file(files("stiff_studies")) as folder:
        return Path(folder).resolve()


def find_study(name: str) -> Study:
    """Read a shipped study or the file of a study.

    Raises:
        ConfigError: the name is unknown, or the file is wrong.
    """
    if name.endswith(SUFFIX):
        return read_study(Path(name))
    folder = files("stiff_studies")
    shipped = [file.name.removesuffix(SUFFIX) for file in folder.iterdir() if SUFFIX in file.name]
    if name not in shipped:
        raise unknown_name("study", name, [*shipped, f"FILE{SUFFIX}"])
    with as_file(folder / f"{name}{SUFFIX}") as path:
        return read_study(path)


def read_study(path: Path) -> Study:
    """Read the file of a study.

    Raises:
        ConfigError: it cannot be read, or a key or value is wrong; the message names it.
    """
    content = read_toml(path, error=ConfigError)
    of_run = {field.name for field in fields(StudyRun)}
    every = {key: content.pop(key) for key in [*content] if key in of_run}
    runs = content.get("run", [{}])
    if isinstance(runs, list):
        content["run"] = [every | run if isinstance(run, dict) else run for run in runs]
    try:
        study = TypeAdapter(Study).validate_python({"name": path.stem, **content, "file": path})
    except ValidationError as error:
        # an unknown key first: it is why another is missing
        first = min(error.errors(), key=lambda problem: problem["type"] != UNKNOWN_KEY)
        raise ConfigError(f"{path}: {_describe(first)}") from None
    datasets = {word for run in study.run for word in study.datasets_of(run)}
    for word in study.lite:
        if word not in datasets:
            raise ConfigError(f"{path}: lite: {unknown_name('data set', word, datasets)}")
    return study


def _describe(problem: Mapping[str, Any]) -> str:
    """Return which key of a file is wrong, its value, and what is valid."""
    *place, key = (str(part) for part in problem["loc"])
    table = {"run": StudyRun, "board": BoardSettings}.get(place[0] if place else "", Study)
    keys = [field.name for field in fields(table)]
    if problem["type"] == UNKNOWN_KEY:
        of_runs = () if table is BoardSettings else fields(StudyRun)
        return str(unknown_name("key", key, {*keys, *(field.name for field in of_runs)}))
    where = ".".join([*place, key])
    if problem["type"] == "missing":
        return f"{where} is missing (valid keys: {', '.join(keys)})"
    return f"{where} = {problem['input']!r}: {MESSAGE_START.sub('it should', problem['msg'])}"
