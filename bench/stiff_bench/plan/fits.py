"""The plan of a run and its fits: model by data set by protocol by split.

`plan_run` checks a run before anything is computed. `fit_tasks` yields the fits, each with all
that it needs.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from stiff_bench.console import say
from stiff_bench.plan.options import (
    Choice,
    TunedChoice,
    chosen,
    chosen_dataset,
    options_of,
    parse_option,
)
from stiff_bench.plan.registry import Info, Registry
from stiff_models.model_catalog import MODELS, REFERENCE_MODEL
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    ModelError,
    StiffBenchError,
    StiffBenchWarning,
    describe_error,
)
from stiff_protocols.contract.evaluation import Evaluation
from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, ProtocolInfo
from stiff_protocols.contract.protocol_base import EvaluationProtocol, completed
from stiff_protocols.contract.record import (
    INTERVAL_VERSION,
    Fit,
    Presentation,
)
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.stiffness_model import (
    StiffnessModel,
    interface_fault,
    offers,
    optional,
)
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Split, check_coverage
from stiff_protocols.scoring.metrics import Metric, metric
from stiff_protocols.splits.checks import check_source, first_fault
from stiff_protocols.splits.generators import LazySplits

DEFAULT_COVERAGE = 0.9
NO_TEST = (
    "reports samples that the models learned from among the others: its errors are no test errors, "
    "and are neither ranked nor compared."
)
"""Note for a protocol that declares `reports_training`."""
NO_SOURCE = "no pre-training"
"""Regime of a model without source domain, if other models have one of another robot."""


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
    registry: Registry,
    *,
    models: Sequence[str | Choice[ModelInfo]],
    datasets: Sequence[str | Choice[DatasetInfo]],
    protocols: Sequence[str] = (),
    settings: Sequence[str] = (),
    output: Path,
    with_reference: bool = False,
    metrics: Sequence[str] = (),
    splits: int | None = None,
    seed: int = 0,
    device: str = "auto",
    command: str = "",
    coverage: float | None = None,
) -> RunPlan:
    """Check a run and return its plan.

    Args:
        registry: knows the keys, also those that protocols name as sources.
        models: words ``KEY@OPTION=VALUE@...``, or choices; see `chosen`.
        datasets: the same of data sets.
        protocols: the same of protocols.
        settings: ``KEY.option=value`` words.
        output: folder of the results.
        with_reference: True to run the reference model before the others.
        metrics: keys.
        splits: number of splits; None: the protocol's own.
        seed: of splits and models.
        device: "auto", "cpu" or "cuda", for models that have a choice.
        command: the command line, for the record.
        coverage: nominal coverage of the intervals; None: 0.9 where a metric needs intervals.

    Raises:
        ConfigError: an option or a value is wrong.
    """
    if not models:
        raise ConfigError(f"give at least one --model (valid: {', '.join(registry.models)}, all)")
    choices = chosen(
        {"model": models, "dataset": datasets, "protocol": protocols}, settings, registry
    )
    if with_reference and REFERENCE_MODEL not in (model.name for model in choices["model"]):
        choices["model"].insert(0, Choice.of(registry.model(REFERENCE_MODEL)))
    scored = tuple(metric(key) for key in dict.fromkeys(metrics))
    coverage = _coverage(coverage, scored)
    plan = RunPlan(
        models=_different([_on_device(choice, device) for choice in choices["model"]]),
        datasets=_different(choices["dataset"]),
        protocols=_different(choices["protocol"]),
        metrics=scored,
        splits=splits,
        seed=seed,
        output=output,
        command=command,
        coverage=coverage,
    )
    for model in plan.models:
        check_model(model)
    for dataset in plan.datasets:
        _made(dataset, "load")
    return replace(plan, sources=_sources(plan.protocols, registry))


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


def true_joint_turns(fit: Fit, registry: Registry) -> Callable[[FloatArray], FloatArray] | None:
    """Return `BenchmarkData.joint_turn` of a fit's data; None: not known, or data have changed."""
    try:
        data = loaded(Choice.of_stored(registry.datasets[fit.dataset], fit.dataset_params))
    except (KeyError, StiffBenchError):
        return None
    return data.joint_turn if data.sha256 == fit.data_sha256 else None


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
    model = choice.make()
    if fault := interface_fault(model):
        raise ConfigError(f"{choice.info.key!r} {fault}")
    if not choice.missing():
        optional(model, "check_params")()


def _made(choice: Choice[Any], *methods: str) -> Any:
    """Return what a choice stands for, which has these methods."""
    made = choice.make()
    missing = [name for name in methods if not callable(getattr(made, name, None))]
    if missing:
        raise ConfigError(f"{choice.info.key!r} has no {' and no '.join(missing)} method")
    return made


@dataclass(frozen=True, eq=False, kw_only=True)
class FitTask(Evaluation):
    """Hold a fit with its model and its evaluation.

    Attributes:
        fit: its identity.
        presentation: names, marks and notes to show with its numbers.
        model: catalogue line of the model with its options.
        chooses_epoch: True if the model chooses its epoch by validation rows.
        n_splits: number of splits of its protocol on its data set, in one condition.
    """

    fit: Fit
    presentation: Presentation
    model: Choice[ModelInfo]
    chooses_epoch: bool
    n_splits: int


def make_protocol(choice: Choice[ProtocolInfo]) -> EvaluationProtocol:
    """Return a new protocol with its options; ConfigError: it cannot be made."""
    return completed(choice.make())


def made_model(choice: Choice[ModelInfo], source: BenchmarkData | None) -> StiffnessModel:
    """Return a new model, which gets samples and robot of its source if it learns from one.

    Raises:
        ModelError: the constructor changes an option.
    """
    model: StiffnessModel = choice.make()
    for name, value in choice.params.items():
        if repr(stored := getattr(model, name, value)) != repr(value):
            raise ModelError(
                f"the constructor changes {name} from {value!r} to {stored!r}: store it as given"
            )
    if offers(model, "use_source"):
        model.use_source(source and source.without_truth())
    return model


def fit_tasks(*plans: RunPlan) -> Iterator[FitTask]:
    """Yield every fit of some plans once: data set by protocol by split by model.

    All splits of a data set under a protocol are checked before its first fit.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided, or is not a valid source for
            another; a grid of candidate options is wrong.
    """
    seen: set[str] = set()
    # plans of one study share their data sets, and what protocols make of them
    held: dict[str, BenchmarkData] = {}
    prepared: dict[tuple[str, str], tuple[EvaluationProtocol, BenchmarkData]] = {}

    def once(choice: Choice[DatasetInfo]) -> BenchmarkData:
        if choice.name not in held:
            held[choice.name] = loaded(choice)
        return held[choice.name]

    for plan in plans:
        models = {protocol.name: models_under(protocol, plan.models) for protocol in plan.protocols}
        sources = {word: once(choice) for word, choice in plan.sources.items()}
        for dataset in plan.datasets:
            data = once(dataset)
            for word, source in sources.items():
                check_source(word, source, dataset.name, data)
            for protocol in plan.protocols:
                of_protocol, names = models[protocol.name], (dataset.name, protocol.name)
                if names not in prepared:
                    made = make_protocol(protocol)
                    with _naming(dataset, protocol):
                        prepared[names] = made, made.prepared(data)
                ready = prepared[names]
                for task in _of_protocol(
                    plan, dataset, data, protocol, ready, of_protocol, sources
                ):
                    if task.fit.key not in seen:
                        seen.add(task.fit.key)
                        yield task


def models_under(
    protocol: Choice[ProtocolInfo], models: Sequence[Choice[ModelInfo]]
) -> Sequence[Choice[ModelInfo]]:
    """Return the models for a protocol: unchanged, or tuned in their fits.

    Raises:
        ConfigError: a protocol has no candidates for these models, or a candidate is wrong.
    """
    tuner, classes = make_protocol(protocol), {model.info.key: model.cls for model in models}

    def parse(source_text: str, info: ModelInfo, name: str, text: str) -> object:
        return parse_option(source_text, info.key, classes[info.key], name, text)

    grids = tuner.grids([model.info for model in models], parse)
    if grids is None:
        return models
    tuned = []
    for model in models:
        grid, is_set = grids.get(model.info.key, {}), {**model.params, **model.context}
        open_options = {name: values for name, values in grid.items() if name not in is_set}
        choice = TunedChoice(
            model.info, model.cls, model.params, model.context, tuner, open_options
        )
        try:
            check_model(choice)
        except ConfigError as error:
            raise ConfigError(f"{protocol.name}: {model.info.key}: {error}") from error
        tuned.append(choice)
    return tuned


def _of_protocol(
    plan: RunPlan,
    dataset: Choice[DatasetInfo],
    measured: BenchmarkData,
    choice: Choice[ProtocolInfo],
    ready: tuple[EvaluationProtocol, BenchmarkData],
    models: Sequence[Choice[ModelInfo]],
    sources: Mapping[str, BenchmarkData],
) -> Iterator[FitTask]:
    """Yield the fits of one data set under one protocol; `ready`: it, and the data it divides."""
    protocol, data = ready
    splits, n_splits, first_of_source = _divided(protocol, choice, dataset, data, plan)
    has_more = data.samples is not measured.samples
    no_test = f"{choice.name} {NO_TEST}" if protocol.reports_training else ""
    caveat = f"{choice.info.key}: {protocol.caveat}" if protocol.caveat else ""

    def on_first_split(model: Choice[ModelInfo], split: Split) -> FitTask:
        """Return a model's fit on the first split with a source: what is asked once is asked."""
        source = sources.get(split.source)
        made = made_model(model, source)
        optional(made, "check_robot")(data.robot)
        chooses = uses_validation(model.info, made)
        regimes = [
            NO_SOURCE if source is not None and not offers(made, "use_source") else "",
            getattr(made, "regime", ""),
        ]
        of_source = getattr(made, "source_words", "")
        fit = Fit(
            model=model.info.key,
            model_params=model.identity,
            dataset=dataset.info.key,
            dataset_params=dataset.identity,
            data_sha256=data.sha256,
            protocol=choice.info.key,
            protocol_params=choice.identity,
            split_index=split.index,
            split_sha256=split.sha256,
            seed=plan.seed,
            coverage=plan.coverage,
            source_sha256="" if source is None else source.sha256,
            model_version=version_of(model),
            interval_version=0 if plan.coverage is None else INTERVAL_VERSION,
        )
        of_data = plan.sources[split.source].info.caveats if split.source else ()
        caveats = filter(None, (*dataset.info.caveats, *of_data, caveat))
        presentation = Presentation(
            model=model.name,
            dataset=dataset.name,
            protocol=choice.name,
            kind=dataset.info.kind,
            regime=", ".join(filter(None, regimes)),
            picked_on_test=protocol.selects_on_test and chooses,
            selects_on_test=protocol.selects_on_test,
            pooled=protocol.pooled,
            caveats=tuple(dict.fromkeys(caveats)),
            published="" if has_more else dataset.info.published,
            source=of_source,
            warning=" ".join(filter(None, [choice.info.warning, no_test])),
            reports_training=bool(no_test),
            measured_sha256=measured.sha256 if has_more else "",
        )
        return FitTask(
            make_protocol=partial(make_protocol, choice),
            data=data,
            split=split,
            source=source,
            fit=fit,
            presentation=presentation,
            model=model,
            chooses_epoch=chooses,
            n_splits=n_splits[split.condition],
        )

    firsts = {
        word: [on_first_split(model, split) for model in models]
        for word, split in first_of_source.items()
    }
    for split in splits:
        for first in firsts[split.source]:
            fit = replace(
                first.fit,
                split_index=split.index,
                split_sha256=split.sha256,
                condition=split.condition,
                rows_sha256="" if split.sha256 == split.rows_sha256 else split.rows_sha256,
            )
            yield replace(first, fit=fit, split=split, n_splits=n_splits[split.condition])


def _divided(
    protocol: EvaluationProtocol,
    choice: Choice[ProtocolInfo],
    dataset: Choice[DatasetInfo],
    data: BenchmarkData,
    plan: RunPlan,
) -> tuple[Sequence[Split], Mapping[str, int], Mapping[str, Split]]:
    """Return valid splits without leaks, their counts, and the first split of each source.

    Counts are by condition; the source of the training rows is "". Splits of built-in protocols
    are computed one at a time.
    """
    n_splits: Counter[str] = Counter()
    first_of_source: dict[str, Split] = {}

    def seen(splits: Sequence[Split]) -> Iterator[Split]:
        for split in splits:
            n_splits[split.condition] += 1
            first_of_source.setdefault(split.source, split)
            yield split

    with _naming(dataset, choice):
        given_splits = protocol.splits(data.samples, n_splits=plan.splits, seed=plan.seed)
        # a third-party collection may give other splits on a second pass
        splits = given_splits if isinstance(given_splits, LazySplits) else tuple(given_splits)
        fault = first_fault(
            seen(splits),
            len(data.samples),
            selects_on_test=protocol.selects_on_test,
            reports_training=protocol.reports_training,
        )
    if fault:
        raise ConfigError(f"protocol {choice.info.key!r}: {fault}")
    if unknown := first_of_source.keys() - {"", *plan.sources}:
        reason = f"a split's source is {min(unknown)!r}, which its source_datasets does not return"
        valid = ", ".join(plan.sources) or "none"
        raise ConfigError(f"protocol {choice.info.key!r}: {reason} (valid: {valid})")
    return splits, n_splits, first_of_source


@contextmanager
def _naming(dataset: Choice[DatasetInfo], protocol: Choice[ProtocolInfo]) -> Iterator[None]:
    """Turn errors of a protocol inside the block into a ConfigError that names it."""
    try:
        yield
    except StiffBenchError as error:
        raise ConfigError(f"{dataset.name} under {protocol.name}: {error}") from error
    except Exception as error:  # a third-party protocol may raise anything
        raise ConfigError(f"protocol {protocol.info.key!r}: {describe_error(error)}") from error


def uses_validation(info: ModelInfo, model: StiffnessModel) -> bool:
    """Say whether a model, as it is set up, chooses its epoch by validation rows."""
    return info.uses_validation and bool(optional(model, "chooses_epoch")())


def version_of(choice: Choice[ModelInfo]) -> str:
    """Return the version of a model, which changes whenever its numbers may change.

    For a built-in model: its version and the version of the library that it wraps. For a plugin's
    model also the hash of its files and the versions of the built-in models that it extends.
    """
    info = choice.info
    bases = {f"{base.__module__}:{base.__qualname__}" for base in choice.cls.__mro__}
    extended = [] if info in MODELS else [line for line in MODELS if line.target in bases]
    library = f"{info.library} {installed(info.library)}" if info.library else ""
    code = code_of(choice.cls, type(choice.make()))
    words = [str(info.version), library, *(f"{base.key} {base.version}" for base in extended), code]
    return ", ".join(filter(None, words))


def installed(package: str) -> str:
    """Return the version of a package, or "not installed"."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
