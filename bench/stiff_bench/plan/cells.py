"""The cells of a plan: model by data set by protocol by split, each with all that it needs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from stiff_bench.plan.options import Choice
from stiff_bench.plan.request import RunPlan, loaded
from stiff_bench.plan.search import tuned_models
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, said_by
from stiff_protocols.contract.interfaces import (
    ChecksRobot,
    CorrectsPaths,
    DividesByRobot,
    EvaluationProtocol,
    LearnsFromSource,
    StatesSource,
    StiffnessModel,
    chooses_epoch,
    regime_of,
    reports_training,
)
from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, ProtocolInfo
from stiff_protocols.contract.record import (
    INTERVAL_VERSION,
    Cell,
    Presentation,
)
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot, Samples, Split
from stiff_protocols.splits.checks import first_fault
from stiff_protocols.splits.generators import LazySplits


def check_source(word: str, source: BenchmarkData, dataset: str, target: BenchmarkData) -> None:
    """See that a source fits a target and holds none of its samples.

    All samples of the source, which `word` names, identify the VJM that makes the source domain;
    on the target, `dataset`, models are fine-tuned and tested.

    Raises:
        ConfigError: the joints are others, or samples are the target's.
    """
    if source.robot.joint_types != target.robot.joint_types:
        raise ConfigError(
            f"source {word!r}: robot {source.robot.name!r} has {_joints(source.robot)}, robot "
            f"{target.robot.name!r} of {dataset!r} has {_joints(target.robot)} (valid: a robot "
            "with the same joints, base to tip)"
        )
    held = {row.tobytes() for row in _numbers(source.samples)}
    common = sum(row.tobytes() in held for row in _numbers(target.samples))
    if common:
        raise ConfigError(
            f"source {word!r} holds {common} of the {len(target.samples)} samples of its target "
            f"{dataset!r}, whose test part no source may hold (valid: samples of another robot or "
            "another specimen)"
        )


def _joints(robot: Robot) -> str:
    types = robot.joint_types
    of = types[0] if len(set(types)) == 1 else ", ".join(types)
    return f"{robot.n_joints} joints ({of})"


def _numbers(samples: Samples) -> FloatArray:
    """Return (n, .) poses, loads and deflections; adding 0.0 makes -0.0 and 0.0 one number."""
    return np.hstack([samples.q, samples.wrench, samples.deflection]) + 0.0


NO_TEST = (
    "reports samples that the models learned from among the others: its errors are no test errors, "
    "and are neither ranked nor compared."
)
"""What a protocol that declares `reports_training` does."""
PATH_ERRORS = "errors are path errors that a model's corrections leave; a pose is a whole path."
"""What a protocol scores that has models correct tool paths."""
NO_SOURCE = "no pre-training"
"""Regime of a model that has no source domain, where the others' comes from another robot."""


@dataclass(frozen=True, eq=False)
class CellTask:
    """A cell and all that is needed to compute it.

    Attributes:
        cell: its identity.
        shown: what must stand beside its numbers.
        model: the line it was made from.
        data: the whole data set.
        split: the rows.
        chooses_epoch: the model as it is set up uses validation rows.
        n_splits: of its protocol on its data set, in one condition.
        source: data of the other robot or specimen that its source domain comes from; None: the
            training rows.
        paths: the protocol, where it scores tool paths that the model corrects.
    """

    cell: Cell
    shown: Presentation
    model: Choice[ModelInfo]
    data: BenchmarkData
    split: Split
    chooses_epoch: bool
    n_splits: int
    source: BenchmarkData | None = None
    paths: Choice[ProtocolInfo] | None = None


def tell_source(model: StiffnessModel, source: BenchmarkData | None) -> None:
    """Give a model that learns from one its source, which it must not ask for more."""
    if isinstance(model, LearnsFromSource):
        model.use_source(source and source.without_truth())


def cell_tasks(*plans: RunPlan) -> Iterator[CellTask]:
    """Yield every cell of some plans once: data set by protocol by split by model.

    All splits of a data set under a protocol are checked before its first cell comes.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided, or is no source for another; a
            grid of options to choose from is wrong.
    """
    seen: set[str] = set()
    held: dict[str, BenchmarkData] = {}  # plans of one study share their data sets

    def once(choice: Choice[DatasetInfo]) -> BenchmarkData:
        if choice.name not in held:
            held[choice.name] = loaded(choice)
        return held[choice.name]

    for plan in plans:
        tuned = tuned_models(plan.protocols, plan.models)
        sources = {word: once(choice) for word, choice in plan.sources.items()}
        for dataset in plan.datasets:
            data = once(dataset)
            for word, source in sources.items():
                check_source(word, source, dataset.name, data)
            for protocol in plan.protocols:
                models = tuned.get(protocol.name, plan.models)
                for task in _of_protocol(plan, dataset, data, protocol, models, sources):
                    if task.cell.key not in seen:
                        seen.add(task.cell.key)
                        yield task


def _of_protocol(
    plan: RunPlan,
    dataset: Choice[DatasetInfo],
    data: BenchmarkData,
    choice: Choice[ProtocolInfo],
    models: Sequence[Choice[ModelInfo]],
    sources: Mapping[str, BenchmarkData],
) -> Iterator[CellTask]:
    """Yield the cells of one data set under one protocol."""
    protocol: EvaluationProtocol = choice.make()
    paths = protocol if isinstance(protocol, CorrectsPaths) else None
    measured_sha256 = "" if paths is None else data.sha256
    if paths is not None:
        with _naming(dataset, choice):
            data = paths.with_paths(data)
    splits, n_splits, first_of_source = _divided(protocol, choice, dataset, data, plan)
    no_test = f"{choice.name} {NO_TEST}" if reports_training(protocol) else ""

    def on_first_split(model: Choice[ModelInfo], split: Split) -> CellTask:
        """Return a model's cell on the first split with a source: what is asked once is asked."""
        source = sources.get(split.source)
        made = model.make()
        tell_source(made, source)
        if isinstance(made, ChecksRobot):
            made.check_robot(data.robot)
        chooses = uses_validation(model.info, made)
        regimes = [
            NO_SOURCE if source is not None and not isinstance(made, LearnsFromSource) else "",
            regime_of(made),
        ]
        of_source = made.source_words if isinstance(made, StatesSource) else ""
        cell = Cell(
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
        caveats = plan.sources[split.source].info.caveats if split.source else ()
        caveats += (f"{choice.info.key}: {PATH_ERRORS}",) if paths is not None else ()
        shown = Presentation(
            model=model.name,
            dataset=dataset.name,
            protocol=choice.name,
            kind=dataset.info.kind,
            task=dataset.info.task,
            regime=", ".join(filter(None, regimes)),
            picked_on_test=protocol.selects_on_test and chooses,
            selects_on_test=protocol.selects_on_test,
            pooled=protocol.pooled,
            caveats=tuple(dict.fromkeys(dataset.info.caveats + caveats)),
            published="" if paths is not None else dataset.info.published,
            source=of_source,
            warning=" ".join(filter(None, [choice.info.warning, no_test])),
            reports_training=bool(no_test),
            measured_sha256=measured_sha256,
        )
        n_drawn = n_splits[split.condition]
        of_paths = choice if paths is not None else None
        return CellTask(cell, shown, model, data, split, chooses, n_drawn, source, of_paths)

    firsts = {
        word: [on_first_split(model, split) for model in models]
        for word, split in first_of_source.items()
    }
    for split in splits:
        for first in firsts[split.source]:
            cell = replace(
                first.cell,
                split_index=split.index,
                split_sha256=split.sha256,
                condition=split.condition,
                rows_sha256="" if split.sha256 == split.rows_sha256 else split.rows_sha256,
            )
            yield replace(first, cell=cell, split=split, n_splits=n_splits[split.condition])


def _divided(
    protocol: EvaluationProtocol,
    choice: Choice[ProtocolInfo],
    dataset: Choice[DatasetInfo],
    data: BenchmarkData,
    plan: RunPlan,
) -> tuple[Sequence[Split], Mapping[str, int], Mapping[str, Split]]:
    """Return splits that can be used and do not leak, with what was seen of them.

    That is how many each condition has, and the first one of each source, "" for the training
    rows. Where the protocol is ours, splits are computed while they are looked at.
    """
    n_splits: Counter[str] = Counter()
    first_of_source: dict[str, Split] = {}

    def seen(splits: Sequence[Split]) -> Iterator[Split]:
        for split in splits:
            n_splits[split.condition] += 1
            first_of_source.setdefault(split.source, split)
            yield split

    with _naming(dataset, choice):
        if isinstance(protocol, DividesByRobot):
            protocol.use_robot(data.robot)
        found = protocol.splits(data.samples, n_splits=plan.splits, seed=plan.seed)
        # a stranger's collection need not give the same splits twice
        splits = found if isinstance(found, LazySplits) else tuple(found)
        fault = first_fault(
            seen(splits),
            len(data.samples),
            selects_on_test=protocol.selects_on_test,
            reports_training=reports_training(protocol),
        )
    if fault:
        raise ConfigError(f"protocol {choice.info.key!r}: {fault}")
    if unknown := first_of_source.keys() - {"", *plan.sources}:
        why = f"a split's source is {min(unknown)!r}, which its source_datasets does not return"
        valid = ", ".join(plan.sources) or "none"
        raise ConfigError(f"protocol {choice.info.key!r}: {why} (valid: {valid})")
    return splits, n_splits, first_of_source


@contextmanager
def _naming(dataset: Choice[DatasetInfo], protocol: Choice[ProtocolInfo]) -> Iterator[None]:
    """Turn what a protocol raises inside the block into a ConfigError that names it."""
    try:
        yield
    except StiffBenchError as error:
        raise ConfigError(f"{dataset.name} under {protocol.name}: {error}") from error
    except Exception as error:  # whatever a stranger's protocol raises
        raise ConfigError(f"protocol {protocol.info.key!r}: {said_by(error)}") from error


def uses_validation(info: ModelInfo, model: StiffnessModel) -> bool:
    """Say whether a model, as it is set up, chooses its epoch by validation rows."""
    return info.uses_validation and chooses_epoch(model)


def version_of(choice: Choice[ModelInfo]) -> str:
    """Return what tells a model's numbers from those of an older state of it.

    Of a built-in model its version, with that of the library that it wraps; of a plugin's the hash
    of its files too, and the versions of the built-in models whose classes it extends.
    """
    info = choice.info
    bases = {f"{base.__module__}:{base.__qualname__}" for base in choice.cls.__mro__}
    extended = [] if info in MODELS else [line for line in MODELS if line.target in bases]
    library = f"{info.library} {installed(info.library)}" if info.library else ""
    code = code_of(choice.cls, type(choice.make()))
    words = [str(info.version), library, *(f"{one.key} {one.version}" for one in extended), code]
    return ", ".join(filter(None, words))


def installed(package: str) -> str:
    """Return the version of an installed package, or that it is not."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
