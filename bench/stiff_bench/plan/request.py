"""What `bench run` was asked for, checked before anything is computed."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stiff_bench.plan.options import Choice, options_of, parse_settings, parse_word
from stiff_bench.plan.registry import EVERY_MODEL, Registry, lookup
from stiff_bench.plan.robots import RobotWords
from stiff_bench.store.names import split_word
from stiff_datasets.catalog import MEASURED_FILE
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.interfaces import ChecksParams, NamesSources
from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, PluginInfo, ProtocolInfo
from stiff_protocols.contract.types import BenchmarkData
from stiff_protocols.scoring.metrics import Metric, metric

DEFAULT_COVERAGE = 0.9


@dataclass(frozen=True)
class RunRequest:
    """The words of a `bench run` command line.

    Attributes:
        models, datasets, protocols: keys, each with options of its own if need be
            (``KEY@OPTION=VALUE``).
        metrics: keys.
        splits: number of splits; None: the protocol's own.
        seed: of splits and models.
        settings: ``KEY.option=value`` words.
        device: "auto", "cpu" or "cuda", for models that have a choice.
        output: folder of the results.
        data, robot: a measured CSV or Parquet file, and the words that name its robot.
        command: the command line, for the record.
        coverage: nominal coverage of the intervals; None: 0.9 where a metric needs intervals.
    """

    models: tuple[str, ...]
    datasets: tuple[str, ...]
    protocols: tuple[str, ...]
    metrics: tuple[str, ...]
    splits: int | None
    seed: int
    settings: tuple[str, ...]
    device: str
    output: Path
    data: Path | None
    robot: RobotWords
    command: str
    coverage: float | None = None


@dataclass(frozen=True)
class RunPlan:
    """A checked request.

    Attributes:
        coverage: nominal coverage of the intervals; None: no metric needs any.
        sources: data sets that protocols have source domains made of, by their words.
    """

    models: tuple[Choice[ModelInfo], ...]
    datasets: tuple[Choice[DatasetInfo], ...]
    protocols: tuple[Choice[ProtocolInfo], ...]
    metrics: tuple[Metric, ...]
    splits: int | None
    seed: int
    output: Path
    command: str
    coverage: float | None
    sources: Mapping[str, Choice[DatasetInfo]] = field(default_factory=dict)


def plan_run(request: RunRequest, registry: Registry) -> RunPlan:
    """Check a request against the registry.

    Raises:
        ConfigError: a key, option or value is unknown or wrong.
    """
    words = {
        "model": _models(request, registry),
        "dataset": _datasets(request),
        "protocol": list(request.protocols),
    }
    classes = {
        key: _info(kind, key, registry).load()
        for kind, said in words.items()
        for key, _ in map(split_word, said)
    }
    params = parse_settings(request.settings, classes)

    def chosen(kind: str) -> list[Choice[Any]]:
        return [_choice(kind, word, classes, params, registry) for word in words[kind]]

    metrics = tuple(metric(key) for key in dict.fromkeys(request.metrics))
    plan = RunPlan(
        models=tuple(
            _different([_on_device(choice, request.device) for choice in chosen("model")])
        ),
        datasets=(*_different(chosen("dataset")), *_own_file(request, classes)),
        protocols=tuple(_different(chosen("protocol"))),
        metrics=metrics,
        splits=request.splits,
        seed=request.seed,
        output=request.output,
        command=request.command,
        coverage=_coverage(request.coverage, metrics),
    )
    for model in plan.models:
        _check_model(model)
    for dataset in plan.datasets:
        _require_methods(dataset.info, dataset.make(), "load")
    for protocol in plan.protocols:
        _require_methods(protocol.info, protocol.make(), "splits")
    return replace(plan, sources=_sources(plan.protocols, registry))


def _info(kind: str, key: str, registry: Registry) -> PluginInfo:
    if kind == "model":
        return registry.model(key)
    if kind == "dataset":
        return lookup(registry.datasets, kind, key)
    return lookup(registry.protocols, kind, key)


def _choice(
    kind: str,
    word: str,
    classes: Mapping[str, type],
    params: Mapping[str, dict[str, Any]],
    registry: Registry,
) -> Choice[Any]:
    """Return what a word stands for: its own options have the last word, then --set."""
    key, settings = split_word(word)
    own = parse_word(f"--{kind} {word!r}", key, settings, classes[key])
    return Choice(_info(kind, key, registry), classes[key], {**params[key], **own}, {})


def _different(choices: Sequence[Choice[Any]]) -> list[Choice[Any]]:
    """Return each thing once, however it was spelled."""
    return list({choice.name: choice for choice in choices}.values())


def chosen_dataset(word: str, settings: Sequence[str], registry: Registry) -> Choice[DatasetInfo]:
    """Return one data set with its options.

    Raises:
        ConfigError: the key, an option or a value is unknown or wrong.
    """
    key, _ = split_word(word)
    classes = {key: lookup(registry.datasets, "dataset", key).load()}
    return _choice("dataset", word, classes, parse_settings(settings, classes), registry)


def _sources(
    protocols: Sequence[Choice[ProtocolInfo]], registry: Registry
) -> dict[str, Choice[DatasetInfo]]:
    """Return the data sets that protocols name as sources; a word alone sets their options."""
    found = {}
    for protocol in protocols:
        made = protocol.make()
        for word in made.source_datasets() if isinstance(made, NamesSources) else ():
            try:
                found[word] = chosen_dataset(word, (), registry)
                _require_methods(found[word].info, found[word].make(), "load")
            except ConfigError as error:
                said = f"--protocol {protocol.name}: source {word!r}"
                raise ConfigError(f"{said}: {error}") from error
    return found


def loaded(dataset: Choice[DatasetInfo]) -> BenchmarkData:
    """Load a data set.

    Raises:
        DataError: it cannot be loaded; what a stranger's loader raises becomes one clear error.
    """
    try:
        data = dataset.make().load()
    except StiffBenchError:
        raise
    except Exception as error:
        raise DataError(f"{dataset.info.key!r}: {type(error).__name__}: {error}") from error
    if not isinstance(data, BenchmarkData):
        raise DataError(
            f"{dataset.info.key!r}: load returned {type(data).__name__}, expected BenchmarkData"
        )
    return data


def _models(request: RunRequest, registry: Registry) -> list[str]:
    """Return the models' words; "all" stands for every one that is registered."""
    if not request.models:
        raise ConfigError(f"give at least one --model (valid: {', '.join(registry.models)}, all)")
    return [
        key
        for word in request.models
        for key in (registry.models if word == EVERY_MODEL else (word,))
    ]


def _coverage(asked: float | None, metrics: Sequence[Metric]) -> float | None:
    """Return the intervals' coverage where a metric needs intervals: they cost a second fit."""
    if any(metric.needs_interval for metric in metrics):
        coverage = DEFAULT_COVERAGE if asked is None else asked
        if not 0.0 < coverage < 1.0:
            raise ConfigError(f"--coverage {coverage:g}: must lie between 0 and 1")
        require("a metric of intervals", "crepes")  # before the models are fitted
        return coverage
    if asked is not None:
        raise ConfigError(
            f"--coverage {asked:g}: no metric of this run needs intervals; add --metric coverage "
            "or --metric width"
        )
    return None


def _datasets(request: RunRequest) -> list[str]:
    """Return the data sets' words; the default is left out where a file is given."""
    if request.data is not None:
        return list(request.datasets)
    if request.robot.given:
        raise ConfigError(
            "--robot, --urdf and --tcp describe the robot of --data FILE.csv; give it too"
        )
    return list(request.datasets) or ["kr10-twin"]


def _own_file(request: RunRequest, keys: Container[str]) -> tuple[Choice[DatasetInfo], ...]:
    """Return the data set that stands for the user's own file, if there is one.

    Raises:
        ConfigError: its name is a key of the run, or its robot is missing.
    """
    if request.data is None:
        return ()
    if request.data.name in keys:
        raise ConfigError(f"--data {request.data}: its name is also a key of this run; rename it")
    if not (request.robot.urdf or request.robot.robot):
        raise ConfigError(
            f"--data {request.data}: needs its robot too: --urdf FILE.urdf or --robot NAME"
        )
    info = replace(MEASURED_FILE, key=request.data.name)
    files = {"csv": request.data, "robot": request.robot.read()[0]}
    return (Choice(info, info.load(), {}, files),)


def _on_device(choice: Choice[ModelInfo], device: str) -> Choice[ModelInfo]:
    """Give the device to a model that has a choice; --set has the last word."""
    if "device" not in options_of(choice.cls):
        return choice
    params = dict(choice.params)
    return replace(choice, context={"device": params.pop("device", device)}, params=params)


def _check_model(choice: Choice[ModelInfo]) -> None:
    model = choice.make()
    _require_methods(choice.info, model, "fit", "predict")
    if isinstance(model, ChecksParams) and not choice.missing():
        model.check_params()


def _require_methods(info: PluginInfo, made: object, *names: str) -> None:
    missing = [name for name in names if not callable(getattr(made, name, None))]
    if missing:
        raise ConfigError(f"{info.key!r} has no {' and no '.join(missing)} method")
