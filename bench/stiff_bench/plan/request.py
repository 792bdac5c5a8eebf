"""Check a run before anything is computed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stiff_bench.console import say
from stiff_bench.plan.options import Choice, Chosen, chosen_dataset, options_of
from stiff_bench.plan.registry import Info, Registry
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    StiffBenchError,
    StiffBenchWarning,
    describe_error,
)
from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, ProtocolInfo
from stiff_protocols.contract.protocol_base import completed
from stiff_protocols.contract.record import Cell
from stiff_protocols.contract.stiffness_model import optional
from stiff_protocols.contract.types import BenchmarkData, FloatArray, check_coverage
from stiff_protocols.scoring.metrics import Metric, metric

DEFAULT_COVERAGE = 0.9


@dataclass(frozen=True)
class RunPlan:
    """Checked models, data sets, protocols and options of a run.

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


def plan_run(
    requested: Chosen,
    registry: Registry,
    *,
    output: Path,
    metrics: Sequence[str] = (),
    splits: int | None = None,
    seed: int = 0,
    device: str = "auto",
    command: str = "",
    coverage: float | None = None,
) -> RunPlan:
    """Check a run and return its plan.

    Args:
        requested: the models, data sets and protocols.
        registry: knows the data sets that protocols name as sources.
        output: folder of the results.
        metrics: keys.
        splits: number of splits; None: the protocol's own.
        seed: of splits and models.
        device: "auto", "cpu" or "cuda", for models that have a choice.
        command: the command line, for the record.
        coverage: nominal coverage of the intervals; None: 0.9 where a metric needs intervals.

    Raises:
        ConfigError: an option or a value is wrong.
    """
    scored = tuple(metric(key) for key in dict.fromkeys(metrics))
    coverage = _coverage(coverage, scored)
    models = _different([_on_device(choice, device) for choice in requested.models])
    for model in models:
        check_model(model)
    datasets, protocols = _different(requested.datasets), _different(requested.protocols)
    for dataset in datasets:
        _made(dataset, "load")
    sources = _sources(protocols, registry)
    return RunPlan(
        models=models,
        datasets=datasets,
        protocols=protocols,
        metrics=scored,
        splits=splits,
        seed=seed,
        output=output,
        command=command,
        coverage=coverage,
        sources=sources,
    )


def with_reference(requested: Chosen, registry: Registry) -> Chosen:
    """Return what is chosen, with the reference model before the others."""
    info = registry.model(REFERENCE_MODEL)
    if REFERENCE_MODEL in (model.name for model in requested.models):
        return requested
    return replace(requested, models=[Choice.of(info), *requested.models])


def _different(choices: Sequence[Choice[Info]]) -> tuple[Choice[Info], ...]:
    """Return each choice once, however it was spelled.

    Raises:
        ConfigError: two things have one name, by which their results would be taken for each other.
    """
    choices_by_name: dict[str, Choice[Info]] = {}
    for choice in choices:
        first = choices_by_name.setdefault(choice.name, choice)
        if (first.cls, first.context) != (choice.cls, choice.context):
            raise ConfigError(
                f"{choice.name!r} is the name of two things: give one of them once, or another "
                "name, as by Dataset.from_samples(samples, robot, name=...)"
            )
    return tuple(choices_by_name.values())


def _sources(
    protocols: Sequence[Choice[ProtocolInfo]], registry: Registry
) -> dict[str, Choice[DatasetInfo]]:
    """Return the data sets that protocols name as sources; only the word sets options."""
    datasets = {}
    for protocol in protocols:
        for word in completed(_made(protocol, "splits")).source_datasets():
            try:
                datasets[word] = chosen_dataset(word, (), registry)
                _made(datasets[word], "load")
            except ConfigError as error:
                message = f"{protocol.name}: source {word!r}: {error}"
                raise ConfigError(message, "protocol") from error
    return datasets


def loaded(dataset: Choice[DatasetInfo]) -> BenchmarkData:
    """Load a data set.

    Raises:
        DataError: it cannot be loaded, also if a third-party loader raises another error.
    """
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", StiffBenchWarning)
            data = dataset.make().load()
    except StiffBenchError:
        raise
    except Exception as error:
        raise DataError(f"{dataset.info.key!r}: {describe_error(error)}") from error
    for warning in caught:
        say(f"warning: {warning.message}")
    if not isinstance(data, BenchmarkData):
        raise DataError(
            f"{dataset.info.key!r}: load returned {type(data).__name__}, expected BenchmarkData"
        )
    return data


def true_joint_turns(cell: Cell, registry: Registry) -> Callable[[FloatArray], FloatArray] | None:
    """Return `BenchmarkData.joint_turn` of a cell's data; None: not known, or data have changed."""
    try:
        data = loaded(Choice.of_stored(registry.datasets[cell.dataset], cell.dataset_params))
    except (KeyError, StiffBenchError):
        return None
    return data.joint_turn if data.sha256 == cell.data_sha256 else None


def _coverage(requested: float | None, metrics: Sequence[Metric]) -> float | None:
    """Return the intervals' coverage where a metric needs intervals: they cost a second fit."""
    if any(metric.needs_interval for metric in metrics):
        coverage = DEFAULT_COVERAGE if requested is None else requested
        check_coverage(coverage)
        return coverage
    if requested is not None:
        reason = "no metric of this run needs intervals; add the metric coverage or width"
        raise ConfigError(f"{requested:g}: {reason}", "coverage")
    return None


def _on_device(choice: Choice[ModelInfo], device: str) -> Choice[ModelInfo]:
    """Give the device to a model that has a choice; --set has the last word."""
    if "device" not in options_of(choice.cls):
        return choice
    params = dict(choice.params)
    return replace(choice, context={"device": params.pop("device", device)}, params=params)


def check_model(choice: Choice[ModelInfo]) -> None:
    """See that a model can be made, fits and predicts.

    Raises:
        ConfigError: it cannot, or an option's value is wrong.
    """
    model = _made(choice, "fit", "predict")
    if not choice.missing():
        optional(model, "check_params")()


def _made(choice: Choice[Any], *methods: str) -> Any:
    """Return what a choice stands for, which has these methods."""
    made = choice.make()
    missing = [name for name in methods if not callable(getattr(made, name, None))]
    if missing:
        raise ConfigError(f"{choice.info.key!r} has no {' and no '.join(missing)} method")
    return made
