"""The words of a command line: models, data sets and protocols with their options.

They are taken apart here and nowhere else; what follows them has the typed `Choice`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stiff_bench.plan.options import Choice, Chosen, options_of, parse_option
from stiff_bench.plan.registry import EVERY_MODEL, Kind, Registry
from stiff_bench.store.names import split_word
from stiff_datasets.dataset_catalog import MEASURED_FILE
from stiff_datasets.measured.file_options import FileOptions
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo
from stiff_protocols.contract.types import BenchmarkData, Robot


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
    models: Sequence[str | Choice[ModelInfo]],
    datasets: Sequence[str | Choice[DatasetInfo]] = (),
    protocols: Sequence[str] = (),
    settings: Sequence[str] = (),
) -> Chosen:
    """Return what words and choices stand for; "all" stands for every model that is registered.

    Raises:
        ConfigError: a key, option or value is unknown or wrong.
    """
    if not models:
        raise ConfigError(f"give at least one --model (valid: {', '.join(registry.models)}, all)")
    every = [one for word in models for one in (registry.models if word == EVERY_MODEL else [word])]
    given: dict[Kind, Sequence[str | Choice[Any]]] = {
        "model": every,
        "dataset": datasets,
        "protocol": protocols,
    }
    words = {kind: [one for one in of if isinstance(one, str)] for kind, of in given.items()}
    found = {kind: iter(of) for kind, of in chosen(words, settings, registry).items()}
    in_order = {
        kind: [next(found[kind]) if isinstance(one, str) else one for one in of]
        for kind, of in given.items()
    }
    return Chosen(in_order["model"], in_order["dataset"], in_order["protocol"])


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
