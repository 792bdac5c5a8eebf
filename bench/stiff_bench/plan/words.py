"""The words of a command line: models, data sets and protocols with their options, and robots.

They are taken apart here and nowhere else; what follows them has the typed `Choice`.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from stiff_bench.console import say
from stiff_bench.plan.options import Choice, Chosen, options_of, parse_option
from stiff_bench.plan.registry import EVERY_MODEL, Kind, Registry
from stiff_bench.store.names import split_word
from stiff_datasets.dataset_catalog import MEASURED_FILE
from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_datasets.robots.shipped_robots import DEFAULT_ROBOT, named_robot
from stiff_datasets.robots.urdf_reader import ChainModel, read_chain, robot_of
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import BenchmarkData, Robot

DEFAULT_DATASET = "kr10-twin"


@dataclass(frozen=True)
class RobotWords:
    """What names a robot; None was not given.

    Attributes:
        robot: name of a shipped one.
        urdf: file of another one.
        tcp: (3,) tool centre point in the frame of the last link, m.
        tip: last link of the chain in `urdf`.

    Raises:
        ConfigError: there is a tip and no URDF.
    """

    robot: str | None = None
    urdf: Path | str | None = None
    tcp: Sequence[float] | None = None
    tip: str | None = None

    def __post_init__(self) -> None:
        if self.urdf is None and self.tip is not None:
            raise ConfigError(f"{self.tip}: names a link of a URDF; give --urdf too", "tip")

    @property
    def given(self) -> bool:
        """Whether any of them was given."""
        return self != NO_ROBOT

    @property
    def text(self) -> str:
        """The same as words of a command line, with a space before; "" for none."""
        tcp = None if self.tcp is None else ",".join(map(str, self.tcp))
        pairs = (
            *(("--robot", self.robot), ("--urdf", self.urdf)),
            *(("--tip", self.tip), ("--tcp", tcp)),
        )
        return "".join(f" {name} {shlex.quote(str(value))}" for name, value in pairs if value)

    @property
    def is_papers(self) -> bool:
        """Whether it is the shipped KR10 of the source paper."""
        return self.urdf is None and self.robot in (None, DEFAULT_ROBOT)

    def read(self) -> tuple[Robot, ChainModel, float | None]:
        """Return the robot, its chain, and its payload in kg if it is known.

        The first call prints what was chosen in a description that leaves a choice.

        Raises:
            ConfigError: two robots were named, an unknown one, or an unknown tip.
            DataError: the URDF cannot be read.
        """
        return self._read

    @cached_property
    def _read(self) -> tuple[Robot, ChainModel, float | None]:
        if self.urdf is not None:
            if self.robot is not None:
                raise ConfigError(f"{self.robot} and urdf {self.urdf}: give one of them", "robot")
            tcp = (0.0, 0.0, 0.0) if self.tcp is None else self.tcp
            chain, payload_kg = read_chain(Path(self.urdf), tcp=tcp, tip=self.tip), None
            for note in chain.notes:
                say(f"note: {note}")
        else:
            shipped = named_robot(DEFAULT_ROBOT if self.robot is None else self.robot)
            chain, payload_kg = shipped.chain(self.tcp), shipped.payload_kg
        return robot_of(chain), chain, payload_kg


NO_ROBOT = RobotWords()
"""No robot was named."""


def parse_settings(
    settings: Sequence[str], classes: Mapping[str, type]
) -> dict[str, dict[str, Any]]:
    """Turn ``KEY.option=value`` words into checked values by key and option.

    `classes` has every key of the run and its class.

    Raises:
        ConfigError: a word is malformed, names what is not in the run, or its value is wrong.
    """
    parsed: dict[str, dict[str, Any]] = {key: {} for key in classes}
    for setting in settings:
        target, equals, text = setting.partition("=")
        key, dot, name = target.rpartition(".")
        if not (equals and dot and key and name):
            raise ConfigError(f"--set {setting!r}: expected KEY.option=value")
        if key not in classes:
            raise ConfigError(f"--set {setting!r}: {unknown_name('key', key, classes)} in this run")
        _parse_one(parsed[key], f"--set {setting!r}", key, classes[key], name, text)
    return parsed


def _own_options(
    kind: Kind, word: str, key: str, parts: Sequence[str], cls: type
) -> dict[str, Any]:
    """Turn the ``OPTION=VALUE`` parts of a word into checked values."""
    parsed: dict[str, Any] = {}
    try:
        for part in parts:
            name, equals, text = part.partition("=")
            if not (equals and name):
                raise ConfigError(f"{word!r}: expected KEY@OPTION=VALUE")
            if parsed and name not in options_of(cls):
                unknown = unknown_name(f"{key} option", name, options_of(cls))
                raise ConfigError(f"{word!r}: {unknown}; an @ inside a value is doubled: @@")
            _parse_one(parsed, repr(word), key, cls, name, text)
    except ConfigError as error:
        error.argument = kind
        raise
    return parsed


def _parse_one(
    parsed: dict[str, Any], said: str, key: str, cls: type, name: str, text: str
) -> None:
    value = parse_option(said, key, cls, name, text)
    if name in parsed:
        raise ConfigError(f"{said}: {key}.{name} is set twice")
    parsed[name] = value


def chosen(
    words: Mapping[Kind, Sequence[str]], settings: Sequence[str], registry: Registry
) -> dict[Kind, list[Choice[Any]]]:
    """Return what words stand for: a word's own options have the last word, then `settings`.

    Args:
        words: of each kind, ``KEY@OPTION=VALUE@...``.
        settings: ``KEY.option=value`` words; each must be of a key among the words.
        registry: knows the keys.

    Raises:
        ConfigError: a key, an option or a value is unknown or wrong.
    """
    parts = {kind: [(word, *split_word(word)) for word in of] for kind, of in words.items()}
    infos = {key: registry.find(key, kind) for kind, of in parts.items() for _, key, _ in of}
    classes = {key: info.load() for key, info in infos.items()}
    params = parse_settings(settings, classes)
    found: dict[Kind, list[Choice[Any]]] = {kind: [] for kind in words}
    for kind, of in parts.items():
        for word, key, own in of:
            options = params[key] | _own_options(kind, word, key, own, classes[key])
            found[kind].append(Choice(infos[key], classes[key], options, {}))
    return found


def chosen_dataset(word: str, settings: Sequence[str], registry: Registry) -> Choice[DatasetInfo]:
    """Return one data set with its options.

    Raises:
        ConfigError: the key, an option or a value is unknown or wrong.
    """
    return chosen({"dataset": (word,)}, settings, registry)["dataset"][0]


def choices(
    registry: Registry,
    *,
    models: Sequence[str],
    datasets: Sequence[str] = (),
    protocols: Sequence[str] = (),
    settings: Sequence[str] = (),
    data: Sequence[Path] = (),
    options: FileOptions = DEFAULTS,
    robot: RobotWords = NO_ROBOT,
) -> Chosen:
    """Return what is chosen by the options of these names.

    "all" stands for every model that is registered; without a data set and a file, it is the
    default one.

    Raises:
        ConfigError: a key, option or value is unknown or wrong.
    """
    if not models:
        raise ConfigError(f"give at least one --model (valid: {', '.join(registry.models)}, all)")
    if not data and robot.given:
        raise ConfigError(
            "--robot, --urdf, --tip and --tcp describe the robot of --data; give it too"
        )
    if not data and options != DEFAULTS:
        raise ConfigError(
            "--no-torque, --sheet and --pose-tolerance describe a measured file; give --data too"
        )
    every = [key for word in models for key in (registry.models if word == EVERY_MODEL else [word])]
    if not data and not datasets:
        datasets = [DEFAULT_DATASET]
    words: dict[Kind, Sequence[str]] = {"model": every, "dataset": datasets, "protocol": protocols}
    found = chosen(words, settings, registry)
    keys = {choice.info.key for of_kind in found.values() for choice in of_kind}
    for path in data:
        if path.name in keys:
            why = f"something else in this run is called {path.name!r}"
            raise ConfigError(f"--data {path}: {why}; give a file once, or rename it")
        keys.add(path.name)
        found["dataset"].append(own_file(path, robot, options))
    return Chosen(found["model"], found["dataset"], found["protocol"])


def own_file(data: Path, robot: RobotWords, options: FileOptions) -> Choice[DatasetInfo]:
    """Return the data set that stands for the user's own file.

    Raises:
        ConfigError: its robot is not named.
    """
    if robot.urdf is None and robot.robot is None:
        raise ConfigError(f"{data}: needs its robot too: --urdf FILE.urdf or --robot NAME")
    return measured_file(data, robot.read()[0], options)


def measured_file(path: Path, robot: Robot, options: FileOptions) -> Choice[DatasetInfo]:
    """Return the data set of a file of measured samples, which has the file's name."""
    context = {"csv": path, "robot": robot, "options": options}
    return replace(Choice.of(replace(MEASURED_FILE, key=path.name)), context=context)


@dataclass(frozen=True)
class HeldData:
    """A data set that is in memory."""

    data: BenchmarkData

    def load(self) -> BenchmarkData:
        """Return it."""
        return self.data


OWN_DATA = DatasetInfo(
    key="own-data", target=HeldData, kind="user's data", summary="samples from memory"
)


def held_data(data: BenchmarkData, name: str, info: DatasetInfo = OWN_DATA) -> Choice[DatasetInfo]:
    """Return the data set of this name that is in memory; `info` says what it is."""
    return Choice(replace(info, key=name, target=HeldData), HeldData, {}, {"data": data})
