"""The cells of a plan: model by data set by protocol by split, each with all that it needs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from stiff_bench.plan.options import Choice
from stiff_bench.plan.request import RunPlan, loaded
from stiff_bench.plan.search import tuned_models
from stiff_models.catalog import MODELS
from stiff_protocols.contract.errors import ConfigError, StiffBenchError
from stiff_protocols.contract.interfaces import (
    ChecksRobot,
    ChoosesEpoch,
    DividesByRobot,
    EvaluationProtocol,
    LearnsFromSource,
    StatesRegime,
    StiffnessModel,
)
from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, ProtocolInfo
from stiff_protocols.contract.record import SCORING_VERSION, Cell, Presentation
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot, Samples, Split
from stiff_protocols.splits.checks import first_fault
from stiff_protocols.splits.generators import LazySplits


def check_source(word: str, source: BenchmarkData, dataset: str, target: BenchmarkData) -> None:
    """See that a source fits a target and holds none of its samples.

    Args:
        word: names the source.
        source: whose VJM makes the source domain, identified on all of its samples.
        dataset: names the target.
        target: what models are fine-tuned and tested on.

    Raises:
        ConfigError: the joints are others, or samples are the target's: these are tested.
    """
    if source.robot.joint_types != target.robot.joint_types:
        raise ConfigError(
            f"source {word!r}: robot {source.robot.name!r} has {_joints(source.robot)}, robot "
            f"{target.robot.name!r} of {dataset!r} has {_joints(target.robot)} (valid: a robot "
            "with the same joints, base to tip)"
        )
    common = _common(source.samples, target.samples)
    if common:
        raise ConfigError(
            f"source {word!r} holds {common} of the {len(target.samples)} samples of its target "
            f"{dataset!r}, whose test part no source may hold (valid: samples of another robot or "
            "another specimen)"
        )


def check_named(splits: Sequence[Split], sources: Collection[str], protocol: str) -> None:
    """See that a protocol's splits name no source that it did not announce.

    Raises:
        ConfigError: one does.
    """
    unknown = {split.source for split in splits} - {"", *sources}
    if unknown:
        raise ConfigError(
            f"protocol {protocol!r}: a split's source is {min(unknown)!r}, which its "
            f"source_datasets does not return (valid: {', '.join(sources) or 'none'})"
        )


def _joints(robot: Robot) -> str:
    types = robot.joint_types
    of = types[0] if len(set(types)) == 1 else ", ".join(types)
    return f"{robot.n_joints} joints ({of})"


def _common(source: Samples, target: Samples) -> int:
    """Return how many of the target's samples the source holds: same pose, load and deflection."""
    held = {row.tobytes() for row in _numbers(source)}
    return sum(row.tobytes() in held for row in _numbers(target))


def _numbers(samples: Samples) -> FloatArray:
    # adding 0.0 makes -0.0 and 0.0 one number
    return np.hstack([samples.q, samples.wrench, samples.deflection]) + 0.0


NO_SOURCE = "no source: target alone"
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
    """

    cell: Cell
    shown: Presentation
    model: Choice[ModelInfo]
    data: BenchmarkData
    split: Split
    chooses_epoch: bool
    n_splits: int
    source: BenchmarkData | None = None

    def make(self) -> StiffnessModel:
        """Return a new model that knows its source."""
        model: StiffnessModel = self.model.make()
        if isinstance(model, LearnsFromSource):
            model.use_source(self.source)
        return model


def cell_tasks(*plans: RunPlan) -> Iterator[CellTask]:
    """Yield every cell of some plans once: data set by protocol by split by model.

    All splits of a data set under a protocol are checked before its first cell comes.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided, or is no source for another; a
            grid of options to choose from is wrong.
    """
    seen: set[str] = set()
    for plan in plans:
        for task in _of_plan(plan):
            if task.cell.key not in seen:
                seen.add(task.cell.key)
                yield task


def _of_plan(plan: RunPlan) -> Iterator[CellTask]:
    tuned = tuned_models(plan.protocols, plan.models)
    sources = {word: loaded(choice) for word, choice in plan.sources.items()}
    for dataset in plan.datasets:
        data = loaded(dataset)
        for word, source in sources.items():
            check_source(word, source, dataset.name, data)
        for protocol in plan.protocols:
            models = tuned.get(protocol.name, plan.models)
            yield from _of_protocol(plan, dataset, data, protocol, models, sources)


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
    divided = _divided(protocol, choice.info.key, dataset.name, data, plan)
    common = Cell(
        model="",
        model_params={},
        dataset=dataset.info.key,
        dataset_params=dataset.identity,
        data_sha256=data.sha256,
        protocol=choice.info.key,
        protocol_params=choice.identity,
        split_index=0,
        split_sha256="",
        seed=plan.seed,
        coverage=plan.coverage,
        scoring_version=SCORING_VERSION,
    )
    shown = Presentation(
        model="",
        dataset=dataset.name,
        protocol=choice.name,
        kind=dataset.info.kind,
        task=dataset.info.task,
        regime="",
        picked_on_test=False,
        selects_on_test=protocol.selects_on_test,
        pooled=protocol.pooled,
        caveats=dataset.info.caveats,
        published=dataset.info.published,
        warning=choice.info.warning,
    )
    entered = {}
    for word in divided.sources:
        caveats = plan.sources[word].info.caveats if word else ()
        with_source = replace(shown, caveats=tuple(dict.fromkeys(shown.caveats + caveats)))
        entered[word] = [_entrant(model, data, sources.get(word), with_source) for model in models]
    for split in divided.splits:
        source = sources.get(split.source)
        of_split = replace(
            common,
            split_index=split.index,
            split_sha256=split.sha256,
            condition=split.condition,
            rows_sha256="" if split.wrench_error is None else split.rows_sha256,
            source_sha256="" if source is None else source.sha256,
        )
        for model in entered[split.source]:
            yield CellTask(
                cell=replace(
                    of_split,
                    model=model.choice.info.key,
                    model_params=model.identity,
                    model_version=model.version,
                ),
                shown=model.shown,
                model=model.choice,
                data=data,
                split=split,
                chooses_epoch=model.chooses_epoch,
                n_splits=divided.n_splits[split.condition],
                source=source,
            )


@dataclass(frozen=True)
class _Divided:
    """The splits of a data set, all of them checked.

    Attributes:
        splits: computed while they are looked at, or held where a stranger's protocol made them.
        n_splits: of each condition.
        sources: words of the data sets that source domains come from; "" for the training rows.
    """

    splits: Sequence[Split]
    n_splits: Mapping[str, int]
    sources: Collection[str]


def _divided(
    protocol: EvaluationProtocol, key: str, dataset: str, data: BenchmarkData, plan: RunPlan
) -> _Divided:
    """Return the splits of a data set, each of which can be used and does not leak.

    Raises:
        ConfigError: the data cannot be divided, or a split is none.
    """
    n_splits: Counter[str] = Counter()
    first_of_source: dict[str, Split] = {}

    def seen(splits: Sequence[Split]) -> Iterator[Split]:
        for split in splits:
            n_splits[split.condition] += 1
            first_of_source.setdefault(split.source, split)
            yield split

    try:
        if isinstance(protocol, DividesByRobot):
            protocol.use_robot(data.robot)
        found = protocol.splits(data.samples, n_splits=plan.splits, seed=plan.seed)
        # a stranger's collection need not give the same splits twice
        splits = found if isinstance(found, LazySplits) else tuple(found)
        fault = first_fault(
            seen(splits), len(data.samples), selects_on_test=protocol.selects_on_test
        )
    except StiffBenchError as error:
        raise ConfigError(f"{dataset}: {error}") from error
    except Exception as error:  # whatever a stranger's protocol raises
        raise ConfigError(f"protocol {key!r}: {type(error).__name__}: {error}") from error
    if fault:
        raise ConfigError(f"protocol {key!r}: {fault}")
    check_named(tuple(first_of_source.values()), plan.sources, key)
    return _Divided(splits, n_splits, tuple(first_of_source))


@dataclass(frozen=True)
class _Entrant:
    """A model of the plan with a source: what is asked of it once, not once a cell."""

    choice: Choice[ModelInfo]
    identity: Mapping[str, Any]
    version: str
    chooses_epoch: bool
    shown: Presentation


def _entrant(
    choice: Choice[ModelInfo],
    data: BenchmarkData,
    source: BenchmarkData | None,
    of_all: Presentation,
) -> _Entrant:
    made = choice.make()
    regimes = []
    if isinstance(made, LearnsFromSource):
        made.use_source(source)
    elif source is not None:
        regimes.append(NO_SOURCE)
    if isinstance(made, ChecksRobot):
        made.check_robot(data.robot)
    chooses = choice.info.uses_validation
    if chooses and isinstance(made, ChoosesEpoch):
        chooses = made.chooses_epoch()
    if isinstance(made, StatesRegime):
        regimes.append(made.regime)
    shown = replace(
        of_all,
        model=choice.name,
        regime=", ".join(filter(None, regimes)),
        picked_on_test=of_all.selects_on_test and chooses,
    )
    return _Entrant(choice, choice.identity, version_of(choice), chooses, shown)


def version_of(choice: Choice[ModelInfo]) -> str:
    """Return what tells a model's numbers from those of an older state of it.

    Of a built-in model its version, with that of the library that it wraps; of a plugin's the hash
    of its files too, and the versions of the built-in models whose classes it extends.
    """
    info = choice.info
    bases = {f"{base.__module__}:{base.__qualname__}" for base in choice.cls.__mro__}
    extended = [] if info in MODELS else [line for line in MODELS if line.target in bases]
    words = [
        str(info.version),
        f"{info.library} {_installed(info.library)}" if info.library else "",
        *(f"{line.key} {line.version}" for line in extended),
        code_of(choice.cls, type(choice.make())),
    ]
    return ", ".join(filter(None, words))


def _installed(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "not installed"
