"""Does the order of the models outlast the mistakes of a measurement? `bench compare --perturb`."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import cast

import numpy as np

from stiff_bench.analysis.collected import (
    Case,
    Competitor,
    StoredResults,
    chosen_cases,
    competitor_meant,
)
from stiff_bench.analysis.comparison import NORM, compare, under
from stiff_bench.analysis.comparison_text import VERDICTS
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.analysis.verdict import Question, Verdict
from stiff_bench.plan.cells import CellTask, cell_tasks
from stiff_bench.plan.options import Choice, Chosen
from stiff_bench.plan.registry import Registry
from stiff_bench.plan.request import RunPlan, plan_run
from stiff_bench.plan.words import held_data
from stiff_bench.run.execution import Execution
from stiff_bench.run.progress import Display, display
from stiff_bench.run.runner import chosen_execution
from stiff_bench.store.database import mean_seconds, read_data
from stiff_bench.store.names import Variant, grouped
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.metric_table import (
    TRAINING_MARK,
    mark_of,
    mean_over,
    number_format,
    setting,
)
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Column, Entry, Quantity, Table
from stiff_bench.tables.units import MM, PRINTED, counted, marked
from stiff_datasets.measured.perturbations import Draw, Perturbations
from stiff_protocols.contract.errors import ConfigError, DataError, ModelError
from stiff_protocols.contract.plugin import ModelInfo, ProtocolInfo
from stiff_protocols.contract.record import Cell, CellResult
from stiff_protocols.contract.types import BenchmarkData, BoolArray, FloatArray
from stiff_protocols.scoring.paired import ranked


@dataclass(frozen=True, eq=False)
class Mistake:
    """What becomes of m models under one mistake of the measurement, drawn S times.

    Attributes:
        name: what it is, with its size.
        unperturbed: (m,) mean 3-D errors on the data as they are, m, ascending.
        errors: (S, m) the same of each draw, m.
    """

    name: str
    unperturbed: FloatArray
    errors: FloatArray

    @property
    def ranks(self) -> FloatArray:
        """(m,) ranks by the mean over the draws; 1 is the smallest error."""
        return ranked(self.errors.mean(axis=0))

    @property
    def best_held(self) -> int:
        """In how many draws the first model is the best, alone or with others."""
        return int((self.errors[:, 0] == self.errors.min(axis=1)).sum())

    @cached_property
    def pairs_held(self) -> BoolArray:
        """(S, m, m) whether two models stand in the order of the unperturbed data."""
        signs = np.sign(self.errors[:, :, None] - self.errors[:, None])
        return np.asarray(signs == np.sign(self.unperturbed[:, None] - self.unperturbed))

    @property
    def orders_held(self) -> int:
        """In how many draws all of them do."""
        return int(self.pairs_held.all(axis=(1, 2)).sum())

    @property
    def taus(self) -> FloatArray:
        """(S,) Kendall's tau-b of each draw with the unperturbed order; NaN where all tie."""
        from scipy.stats import kendalltau

        return np.array([kendalltau(self.unperturbed, one).statistic for one in self.errors])


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The models of one case under every mistake.

    Attributes:
        case: the stored results.
        models: names, the best on the unperturbed data first.
        mistakes: one at least.
        notes: what must be read with the numbers.
    """

    case: Case
    models: tuple[str, ...]
    mistakes: tuple[Mistake, ...]
    notes: tuple[str, ...] = ()

    @property
    def n_splits(self) -> int:
        """Number of splits that all of the models have."""
        return len(self.case.shared_slots(self.models))

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Places of each pair of models, the better one first."""
        return [*combinations(range(len(self.models)), 2)]


def sensitivities(
    folder: Path,
    models: Sequence[str],
    perturbations: Perturbations,
    registry: Registry,
    *,
    draws: int,
    question: Question,
    threads: int,
    jobs: int = 1,
    datasets: Sequence[str] = (),
    protocols: Sequence[str] = (),
    conditions: Sequence[str] = (),
) -> list[Sensitivity]:
    """Fit and score models of stored results anew under the mistakes of a measurement.

    They keep their options, seeds and splits, on copies of the data set that hold a mistake each.
    Nothing is stored. The seed of the question is that of the draws; `threads` are those of each
    fit, the other arguments those of `Results.sensitivity`.

    Raises:
        ConfigError: a name is unknown, fewer than two models can be compared, or models, data or
            splits cannot be had again.
        ModelError: a fit fails.
        StoreError: the folder holds no results, or corrupt ones.
    """
    mistakes = perturbations.mistakes()
    if not mistakes:
        raise ConfigError("nothing is perturbed: every size is 0 (valid: one of them above 0)")
    stored = StoredResults.read(folder)
    names = [*dict.fromkeys(competitor_meant(word, stored.cases) for word in models)]
    if len(names) == 1:
        raise ConfigError(f"{names[0]} alone has no order (valid: two models or more, or none)")
    cases = chosen_cases(stored.cases, datasets=datasets, protocols=protocols)
    whys, fits = [], []
    for case in under(conditions, cases):
        asked = names or [name for name, one in case.competitors.items() if one.done]
        if why := _why_not(case, asked):
            whys.append(f"{case.name.text}: {why}")
        else:
            fits.append(_fits_of(folder, case, asked, registry))
    if not fits:
        raise ConfigError(f"nothing to perturb: {'; '.join(whys)}")
    found = []
    for one in fits:  # all of them are there before the first is computed
        execution = chosen_execution(one.plan, registry, threads=threads, jobs=jobs)
        with display() as shown:
            cells = one.tasks * (1 + draws * len(mistakes))
            shown.begin(cells, 0, mean_seconds(folder), execution.at_once)
            found.append(_of_fits(one, execution, shown, mistakes, draws, question))
    left_out = tuple(f"not computed: {why}." for why in whys)
    return [replace(found[0], notes=(*found[0].notes, *left_out)), *found[1:]]


def _why_not(case: Case, models: Sequence[str]) -> str:
    """Return why the models of a case cannot be put in order, "" where they can."""
    if len(models) < 2:
        return "fewer than two models have results"
    if lacking := [m for m in models if m not in case.competitors or not case.competitors[m].done]:
        return f"no result of {', '.join(lacking)}"
    if any(case.competitors[model].shown.reports_training for model in models):
        return TRAINING_MARK
    if case.has_paths:
        return "its paths need the robot that was asked, and results hold none"
    return "" if case.shared_slots(models) else "the models have no result on the same split"


@dataclass(frozen=True, eq=False)
class _Fits:
    """The fits of the models of a case, as they were when their results were stored.

    `tasks` are of each model, its splits in order, with the cells and so the seeds that are stored;
    `notes` are on what is not as it was.
    """

    case: Case
    stored: StoredData
    data: BenchmarkData
    plan: RunPlan
    tasks: list[CellTask]
    notes: list[str]

    def errors(self, data: BenchmarkData, execution: Execution, shown: Display) -> dict[str, float]:
        """Return each model's mean 3-D error [m] where it is fitted to and tested on other data."""
        done = {}
        tasks = [replace(task, data=data) for task in self.tasks]
        for result in execution.results(tasks, "", shown):
            if result.status != "ok":
                raise ModelError(
                    f"{result.shown.model} on {self.case.name.text}: {result.why_none} (without "
                    "it: name the other models)"
                )
            done[result.cell.key] = result
            shown.end(result)
        by_model = grouped(self.tasks, lambda task: task.shown.model)
        return {
            model: mean_error([done[task.cell.key] for task in of_model])
            for model, of_model in by_model.items()
        }


def mean_error(results: Sequence[CellResult]) -> float:
    """Return a model's mean 3-D error over its splits, or over all their samples together, m."""
    values = sort_key(NORM, None).of_splits(results)
    assert values is not None
    return float(values.mean())


def _fits_of(folder: Path, case: Case, models: Sequence[str], registry: Registry) -> _Fits:
    """Return the fits that made the results of some models; ConfigError: they cannot be had."""
    stored = read_data(folder, case.name.data_sha256)
    data = BenchmarkData(stored.samples, stored.robot)
    try:
        chosen = [_choice_of(case.competitors[model], registry) for model in models]
        info = registry.find(case.cell.protocol, "protocol")
        protocol = Choice.of_stored(cast(ProtocolInfo, info), case.cell.protocol_params)
    except ConfigError as error:
        raise ConfigError(
            f"{case.name.text} cannot be computed anew: {error}; what is a plugin's needs --plugin"
        ) from error
    asked = Chosen(chosen, [held_data(data, case.name.dataset)], [protocol])
    plan = plan_run(asked, registry, output=folder, seed=case.name.seed)
    names = {choice.name: name for choice, name in zip(asked.models, models, strict=True)}
    slots = case.shared_slots(models)
    asked_for = [case.competitors[model].n_asked for model in models]
    n_splits = max(1 + max(index for index, _ in slots), *asked_for)
    for splits in (None, n_splits):  # some have a number of their own, and others none
        try:
            of_plan = {
                (names[task.shown.model], (task.cell.split_index, task.cell.split_sha256)): task
                for task in cell_tasks(replace(plan, splits=splits))
                if task.cell.condition == case.name.condition
                and task.cell.source_sha256 == case.name.source_sha256
            }
        except ConfigError:
            if splits is None:
                raise
            continue  # there cannot be so many
        if of_plan.keys() >= {*product(models, slots)}:
            break
    else:
        raise ConfigError(
            f"{case.name.text}: this stiffbench divides the data otherwise than the one that "
            "stored these results; the same `bench run` once more divides them anew"
        )
    tasks, notes = [], []
    for model, slot in product(models, slots):
        task, result = of_plan[model, slot], case.competitors[model].done[slot]
        cell = replace(result.cell, coverage=None)
        if _version(task.cell) != _version(cell):
            notes.append(
                f"{model}: the stored results are of another version or other options than those "
                "fitted here."
            )
        tasks.append(replace(task, cell=cell, shown=result.shown))
    if len(slots) < len(case.slots):
        notes.append(f"only the {len(slots)} of {len(case.slots)} splits that all have count.")
    lacking = [m for m, one in case.competitors.items() if m not in models and not one.done]
    if lacking:
        notes.append(f"no result of {', '.join(lacking)}.")
    return _Fits(case, stored, data, plan, tasks, [*dict.fromkeys(notes)])


def _choice_of(competitor: Competitor, registry: Registry) -> Choice[ModelInfo]:
    """Return the model with the options that its name shows: `nested` chooses the others."""
    cell = competitor.cell
    shown = Variant.shown(cell.model, competitor.name, cell.model_params)
    return Choice.of_stored(registry.model(cell.model), shown.options)


def _version(cell: Cell) -> tuple[object, ...]:
    return cell.model_version, cell.interval_version, dict(cell.model_params)


def _of_fits(
    fits: _Fits,
    execution: Execution,
    shown: Display,
    mistakes: Mapping[str, Draw],
    draws: int,
    question: Question,
) -> Sensitivity:
    before = fits.errors(fits.data, execution, shown)
    models = sorted(before, key=lambda model: before[model])
    base = np.array([before[model] for model in models])
    found = []
    for number, (name, draw) in enumerate(mistakes.items()):
        seeds = [[question.seed, number, index] for index in range(draws)]
        perturbed = (draw(fits.data, np.random.default_rng(seed)) for seed in seeds)
        errors = [fits.errors(data, execution, shown) for data in perturbed]
        rows = np.array([[one[model] for model in models] for one in errors])
        found.append(Mistake(name, base, rows))
    without_notes = Sensitivity(fits.case, tuple(models), tuple(found))
    return replace(without_notes, notes=tuple(_notes(without_notes, fits, question)))


def _notes(found: Sensitivity, fits: _Fits, question: Question) -> Iterator[str]:
    """Yield which pairs change places, the most often first, and what must be read with them."""
    verdict_of = functools.cache(functools.partial(_verdict, fits, question))
    changes = []
    for mistake in found.mistakes:
        draws = len(mistake.errors)
        for i, j in found.pairs:
            if (held := int(mistake.pairs_held[:, i, j].sum())) < draws:
                changes.append((held, draws, mistake.name, found.models[i], found.models[j]))
    for held, draws, name, a, b in sorted(changes):
        verdicts = VERDICTS | {"a": f"{a} better", "b": f"{b} better"}
        unperturbed = f"without it: {verdicts[verdict_of(a, b)]}"
        yield f"{name}: {a} is ahead of {b} in {held} of {draws} draws ({unperturbed})."
    yield from fits.notes
    yield from fits.case.competitors[found.models[0]].shown.caveats


def _verdict(fits: _Fits, question: Question, a: str, b: str) -> Verdict:
    """Return the verdict on two models of the stored results."""
    try:
        return compare(fits.case, a, b, fits.stored, question).row(NORM).verdict
    except DataError:  # one pose alone
        return "open"


def render_sensitivities(found: Sequence[Sensitivity], fmt: str, command: str) -> str:
    """Return the tables as text of the given format, with all notes in json."""
    return render([*map(sensitivity_table, found)], fmt, command, text=sentence(found))


def sentence(found: Sequence[Sensitivity]) -> str:
    """Return the result, a sentence a case."""
    parts = []
    for one in found:
        draws = sum(len(mistake.errors) for mistake in one.mistakes)
        best = sum(mistake.best_held for mistake in one.mistakes)
        whole = sum(mistake.orders_held for mistake in one.mistakes)
        parts.append(
            f"{one.case.name.text}: {one.models[0]} stays the best in {best} of {draws} perturbed "
            f"data sets, and the whole order ({', '.join(one.models)}) holds in {whole}."
        )
    return " ".join(parts)


def sensitivity_table(found: Sensitivity) -> Table:
    """Return a row a mistake: errors with ranks, and in how many draws the order holds."""
    case, key = found.case, sort_key(NORM, None)
    shown = case.competitors[found.models[0]].shown
    unit, _ = PRINTED[key.metric.unit]
    draws = len(found.mistakes[0].errors)
    spread = "" if draws == 1 else ", mean ± standard deviation"
    names = [marked(one, mark_of(case.competitors[one].shown)) for one in found.models]
    first = found.mistakes[0].unperturbed
    ranks = ranked(first)
    shares = [None] * (3 + len(found.pairs))
    placed = [Quantity(MM * e, mark=_mark(r)) for e, r in zip(first.tolist(), ranks, strict=True)]
    rows: list[list[Entry]] = [["none", *placed, *ranks, *shares]]
    for one in found.mistakes:
        held = one.pairs_held
        of_pairs = [Quantity(share=(int(held[:, i, j].sum()), draws)) for i, j in found.pairs]
        n_held = sum(pair.share[0] for pair in of_pairs if pair.share is not None)
        rows.append(
            [
                one.name,
                *map(mean_over, (MM * one.errors).T.tolist(), map(_mark, one.ranks)),
                *one.ranks.tolist(),
                Quantity(share=(one.best_held, draws)),
                Quantity(share=(n_held, draws * len(of_pairs))),
                _tau(one.taus),
                *of_pairs,
            ]
        )
    return Table(
        title=(
            f"{setting(shown, case.name.condition, found.n_splits, case.name.seed)} | "
            f"{key.metric.label} [{unit}]{spread} over {counted(draws, 'draw')} (rank)"
        ),
        columns=[
            Column("perturbed", "text"),
            *(Column(name, unit=unit, format=number_format(key.metric)) for name in names),
            *(Column(f"rank of {name}", hidden=True) for name in found.models),
            Column("best holds"),
            Column("pairs hold"),
            Column("Kendall's tau", format=".2f"),
            *(
                Column(f"{found.models[i]} before {found.models[j]}", hidden=True)
                for i, j in found.pairs
            ),
        ],
        rows=rows,
        notes=found.notes,
        brief=True,
        unit=unit,
        about={
            **{"dataset": shown.dataset, "protocol": shown.protocol},
            **{"condition": case.name.condition, "seed": case.name.seed},
            **{"splits": found.n_splits, "draws": draws},
        },
    )


def _mark(rank: float) -> str:
    return f"({rank:g})"


def _tau(taus: FloatArray) -> Quantity:
    """Return mean and deviation over the draws; none where all models tie."""
    found = taus[np.isfinite(taus)]
    return mean_over(found.tolist()) if len(found) else Quantity(status="ties")
