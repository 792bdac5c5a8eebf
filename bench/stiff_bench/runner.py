"""Runs the cells of a plan: (model, data set, protocol, split, seed) -> results in a store."""

from __future__ import annotations

import time
import traceback
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from stiff_bench.choice import Choice
from stiff_bench.config import RunPlan, loaded
from stiff_bench.costs import MemoryMeter, latency, throughput
from stiff_bench.messages import printing_to_stderr
from stiff_bench.provenance import environment, peak_memory_bytes
from stiff_bench.sources import check_named, check_source
from stiff_bench.store import ResultStore
from stiff_bench.tuning import tuned_models
from stiff_models.catalog import REFERENCE_MODEL, model_info
from stiff_protocols.conformal import SplitConformal
from stiff_protocols.contract import (
    ChecksRobot,
    ChoosesEpoch,
    ChoosesOptions,
    DividesByRobot,
    EvaluationProtocol,
    LearnsFromSource,
    PredictsInterval,
    ReportsDiagnostics,
    StatesRegime,
    StiffnessModel,
)
from stiff_protocols.cost import Cost
from stiff_protocols.errors import (
    ConfigError,
    ModelError,
    StiffBenchError,
    StiffBenchWarning,
    TooFewToCalibrate,
)
from stiff_protocols.metrics import METRICS
from stiff_protocols.plugin import DatasetInfo, ModelInfo, ProtocolInfo
from stiff_protocols.record import (
    Cell,
    CellResult,
    Presentation,
    ResultRecord,
    RunManifest,
)
from stiff_protocols.sanity import check_prediction, check_units
from stiff_protocols.splits import leak_of
from stiff_protocols.types import (
    BenchmarkData,
    FloatArray,
    IntArray,
    Interval,
    Prediction,
    Samples,
    Split,
)

ROWS_FOR_UNITS = 256
"""How many training rows are predicted to see that a model predicts m: enough, and soon done."""
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


Watcher = Callable[[int, int, CellTask], None]
"""Is told the number of the cell that starts, how many there are, and the cell."""


def cell_tasks(plan: RunPlan) -> list[CellTask]:
    """Load the data, divide it, and list every cell: data set by protocol by split by model.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided, or is no source for another; a
            grid of options to choose from is wrong.
    """
    tasks = []
    tuned = tuned_models(plan.protocols, plan.models)
    sources = {word: loaded(choice) for word, choice in plan.sources.items()}
    for dataset in plan.datasets:
        data = loaded(dataset)
        data_sha256 = data.sha256
        models = {"": [_prepared(choice, data) for choice in plan.models]}
        for word, source in sources.items():
            check_source(word, source, dataset.name, data)
            models[word] = [_prepared(choice, data, source) for choice in plan.models]
        for choice in plan.protocols:
            protocol: EvaluationProtocol = choice.make()
            if isinstance(protocol, DividesByRobot):
                protocol.use_robot(data.robot)
            splits = protocol.splits(data.samples, n_splits=plan.splits, seed=plan.seed)
            check_named(splits, plan.sources, choice.info.key)
            _refuse_leaks(choice.info.key, protocol, splits)
            n_splits = 1 + max(split.index for split in splits)
            entered = models
            if choice.name in tuned:
                entered = {"": [_prepared(model, data) for model in tuned[choice.name]]}
            for split in splits:
                same = Cell(
                    model="",
                    model_params={},
                    dataset=dataset.info.key,
                    dataset_params=dataset.identity,
                    data_sha256=data_sha256,
                    protocol=choice.info.key,
                    protocol_params=choice.identity,
                    split_index=split.index,
                    split_sha256=split.sha256,
                    seed=plan.seed,
                    coverage=plan.coverage,
                    condition=split.condition,
                    rows_sha256="" if split.wrench_error is None else split.rows_sha256,
                    source_sha256=sources[split.source].sha256 if split.source else "",
                )
                tasks += [
                    CellTask(
                        cell=replace(
                            same, model=model.choice.info.key, model_params=model.choice.identity
                        ),
                        shown=_presentation(
                            model, dataset, choice, protocol, plan.sources.get(split.source)
                        ),
                        model=model.choice,
                        data=data,
                        split=split,
                        chooses_epoch=model.chooses_epoch,
                        n_splits=n_splits,
                        source=sources.get(split.source),
                    )
                    for model in entered[split.source]
                ]
    return tasks


def _refuse_leaks(key: str, protocol: EvaluationProtocol, splits: Sequence[Split]) -> None:
    """See that no split lets a model learn from test rows, whoever wrote the protocol.

    Raises:
        ConfigError: there is no split, or one leaks without saying so.
    """
    if not splits:
        raise ConfigError(f"protocol {key!r} made no split of these samples")
    for split in splits:
        leak = leak_of(split, selects_on_test=protocol.selects_on_test)
        if leak:
            raise ConfigError(f"protocol {key!r}: split {split.index} {leak}")


@dataclass(frozen=True)
class _Prepared:
    """A model of the plan: what is asked of it once, not once a cell."""

    choice: Choice[ModelInfo]
    chooses_epoch: bool
    regime: str


def _prepared(
    choice: Choice[ModelInfo], data: BenchmarkData, source: BenchmarkData | None = None
) -> _Prepared:
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
    return _Prepared(choice, chooses, ", ".join(filter(None, regimes)))


def _presentation(
    model: _Prepared,
    dataset: Choice[DatasetInfo],
    choice: Choice[ProtocolInfo],
    protocol: EvaluationProtocol,
    source: Choice[DatasetInfo] | None,
) -> Presentation:
    caveats = dataset.info.caveats + (() if source is None else source.info.caveats)
    return Presentation(
        model=model.choice.name,
        dataset=dataset.name,
        protocol=choice.name,
        kind=dataset.info.kind,
        task=dataset.info.task,
        regime=model.regime,
        picked_on_test=protocol.selects_on_test and model.chooses_epoch,
        selects_on_test=protocol.selects_on_test,
        pooled=protocol.pooled,
        caveats=tuple(dict.fromkeys(caveats)),
        published=dataset.info.published,
        warning=choice.info.warning,
    )


def run_cells(
    tasks: Sequence[CellTask], plan: RunPlan, store: ResultStore, watcher: Watcher
) -> Iterator[CellResult]:
    """Compute the cells one after another, store each as it ends, and yield it.

    The run's manifest is written first and completed at the end, also when it is interrupted.
    """
    started = time.perf_counter()
    manifest = RunManifest(
        run_id=f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{uuid.uuid4().hex[:6]}",
        command=plan.command,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        status="running",
        environment=environment(),
        cells=tuple(task.cell.key for task in tasks),
    )
    store.write_manifest(manifest)
    kept = {task.cell.data_sha256: task.data for task in tasks}
    kept |= {task.cell.source_sha256: task.source for task in tasks if task.source is not None}
    for data in kept.values():
        store.write_data(data)
    done = 0
    try:
        for number, task in enumerate(tasks):
            watcher(number, len(tasks), task)
            result = compute_cell(task, manifest.run_id)
            store.write_cell(result)
            done += 1
            yield result
    finally:
        store.write_manifest(
            replace(
                manifest,
                status="finished" if done == len(tasks) else "interrupted",
                wall_s=time.perf_counter() - started,
                peak_memory_bytes=peak_memory_bytes(),
            )
        )


def compute_cell(task: CellTask, run_id: str) -> CellResult:
    """Fit, predict and score one cell; what goes wrong in the model becomes a failed result.

    Every metric is stored, whichever a table shows; those of intervals where there are intervals.
    A model that cannot be used on this machine gives a skipped result.
    """
    with printing_to_stderr(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            missing = task.model.missing()
            if missing:
                result = _unfinished(task, run_id, "skipped", missing)
            else:
                result = _fit_predict_score(task, run_id)
        except StiffBenchError as error:
            result = _unfinished(task, run_id, "failed", str(error))
        except (
            Exception,
            SystemExit,
        ) as error:  # whatever a plugin raises is that cell's failure alone
            where = traceback.extract_tb(error.__traceback__)[-1]
            reason = f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})"
            result = _unfinished(task, run_id, "failed", reason)
    messages = dict.fromkeys(str(warning.message) for warning in caught)
    return replace(result, warnings=tuple(messages))


def _unfinished(
    task: CellTask, run_id: str, status: Literal["failed", "skipped"], reason: str
) -> CellResult:
    return CellResult(task.cell, task.shown, run_id, status, failure=reason)


def _fit_predict_score(task: CellTask, run_id: str) -> CellResult:
    """Fit and predict, and only then look at what was measured at the test rows."""
    train, validation = _training_side(task, chooses_epoch=task.chooses_epoch)
    q, wrench = task.data.samples.q[task.split.test], task.split.test_wrench(task.data.samples)
    model = task.make()
    intervals = _interval_source(task, model, train, validation)
    memory = MemoryMeter()
    start = time.perf_counter()
    model.fit(train, robot=task.data.robot, validation=validation, seed=task.cell.model_seed)
    fitted = time.perf_counter()
    predicted = np.asarray(model.predict(q, wrench))
    predict_s = time.perf_counter() - fitted
    memory_bytes = memory.rise()
    check_prediction(predicted, len(q))
    _check_units(model, train)
    cost = Cost(
        fit_s=fitted - start,
        predict_s=predict_s,
        latency_s=latency(model, q, wrench),
        throughput_per_s=throughput(model, q, wrench, predict_s),
        memory_bytes=memory_bytes,
    )
    interval = None
    if intervals is not None and task.cell.coverage is not None:
        interval = _interval(intervals, q, wrench, task.cell.coverage)
    reference = _reference(task, q, wrench)
    measured = task.data.samples.deflection[task.split.test]
    prediction = Prediction(task.split.test, predicted, measured, interval, reference)
    return CellResult(
        cell=task.cell,
        shown=task.shown,
        run_id=run_id,
        status="ok",
        records=tuple(
            ResultRecord(metric.key, axis, value, metric.unit)
            for metric in METRICS.values()
            for axis, value in metric.values(prediction, cost).items()
        ),
        prediction=prediction,
        cost=cost,
        diagnostics=(
            {str(name): float(value) for name, value in model.diagnostics_.items()}
            if isinstance(model, ReportsDiagnostics)
            else {}
        ),
        calibration_samples=(
            len(intervals.residuals_) if isinstance(intervals, SplitConformal) else 0
        ),
        n_train=len(_training_rows(task)),
        chosen=(
            {name: str(value) for name, value in model.best_params_.items()}
            if isinstance(model, ChoosesOptions)
            else {}
        ),
    )


def _reference(task: CellTask, q: FloatArray, wrench: FloatArray) -> FloatArray | None:
    """Return what the reference model predicts that learned from the whole training side.

    It takes a millisecond; None where these data do not identify it.
    """
    model = model_info(REFERENCE_MODEL).load()()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            train, _ = _training_side(task, chooses_epoch=False)
            model.fit(train, robot=task.data.robot, seed=task.cell.model_seed)
            return np.asarray(model.predict(q, wrench))
    except StiffBenchError:
        return None


def _interval_source(
    task: CellTask, model: StiffnessModel, train: Samples, validation: Samples | None
) -> PredictsInterval | None:
    """Return what will give the intervals: the model itself, or a second fit on fewer rows.

    None where there are none to give: not asked for, or the training side is too small for the
    coverage, which is a warning and leaves the point predictions alone.
    """
    if task.cell.coverage is None:
        return None
    if isinstance(model, PredictsInterval):
        return model
    conformal = SplitConformal(task.make(), coverage=task.cell.coverage)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StiffBenchWarning)
        try:
            conformal.fit(
                train, robot=task.data.robot, validation=validation, seed=task.cell.model_seed
            )
        except TooFewToCalibrate as error:
            found, said = None, [f"no intervals: {error}"]
        else:
            found = conformal
            said = [f"fit for the intervals: {w.message}" for w in caught]  # its rows are fewer
    for message in dict.fromkeys(said):
        warnings.warn(message, StiffBenchWarning, stacklevel=1)
    return found


def _interval(
    source: PredictsInterval, q: FloatArray, wrench: FloatArray, coverage: float
) -> Interval:
    interval = source.predict_interval(q, wrench, coverage)
    if not isinstance(interval, Interval):
        raise ModelError(f"predict_interval returned {type(interval).__name__}, expected Interval")
    return interval


def _check_units(model: StiffnessModel, train: Samples) -> None:
    rows = np.linspace(0, len(train) - 1, min(len(train), ROWS_FOR_UNITS)).astype(np.int64)
    some = train.take(rows)
    predicted = np.asarray(model.predict(some.q, some.wrench))
    check_prediction(predicted, len(some))
    check_units(predicted, some.deflection)


def _training_side(task: CellTask, *, chooses_epoch: bool) -> tuple[Samples, Samples | None]:
    """Return training and validation samples.

    A model that chooses no epoch has no use for validation rows; it learns from all of the
    training side instead.
    """
    samples, split = task.data.samples, task.split
    if chooses_epoch:
        validation = samples.take(split.validation) if len(split.validation) else None
        return samples.take(split.train), validation
    return samples.take(_training_rows(task)), None


def _training_rows(task: CellTask) -> IntArray:
    """Return the rows of the training side, those that choose an epoch too.

    Where the validation rows are the test rows, nobody learns from them.
    """
    split = task.split
    if task.shown.selects_on_test:
        return split.train
    return np.sort(np.concatenate([split.train, split.validation]))
