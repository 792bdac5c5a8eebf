"""The source paper's tables, next to ours where we have them, by their numbers.

Tables 1, 4 and 5 are only the paper's; 2 and 3 are of a VJM that is fitted here; 6 to 8 are of
networks that differ in size, activation and fine-tuned layers; 9 and 10 of the fine-tuned network
and the paper's methods. The paper does not say on which samples the errors of its Table 10 are, nor
of which error its Table 9 is. Both are shown in each sense: docs/reproduction.md says which fits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from stiff_bench.figures.variants import SOURCE_MAE
from stiff_bench.paper import paper_models as models
from stiff_bench.paper.paper_models import (
    DATASET,
    FAIR_PROTOCOL,
    PAPER_PROTOCOL,
    READ_ON_ALL,
    SEED,
)
from stiff_bench.paper.paper_results import REPRODUCE, Found, PaperResults, named_results
from stiff_bench.store.names import Variant
from stiff_bench.store.newest import Slot, slot_of
from stiff_bench.tables.metric_table import mark_of, mean_over, pooled_prediction
from stiff_bench.tables.published import (
    about_table,
    claimed_reductions,
    published_errors,
    published_lines,
    published_stiffness,
)
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import MM, counted
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.physics.vjm import fitted_physics
from stiff_protocols.contract.errors import StoreError, unknown_name
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES, Prediction
from stiff_protocols.scoring.metrics import absolute_errors, metric, norm_errors
from stiff_protocols.springs.identification import spring_key

NEEDS_NO_RESULTS = {
    **dict.fromkeys(("1", "4", "5"), "is the paper's alone"),
    **dict.fromkeys(("2", "3"), "is fitted here"),
}
"""Tables that need no stored results -> why: nothing of them is ours, or a second makes it."""


def read_table(number: str, folder: Path | None) -> list[Table]:
    """Return a table of the paper next to ours; folder, None and errors as in `named_results`.

    Raises:
        ConfigError: the paper has no table of that number.
    """
    if number not in TABLES:
        raise unknown_name("table of the paper", number, TABLES)
    made_of = NEEDS_NO_RESULTS.get(number, "")
    return TABLES[number](named_results(folder, f"table {number}", made_of=made_of))


Label = TypeVar("Label")
Labels = tuple[str, ...]
"""Texts of a row: one under each row heading."""
Numbers = Mapping[tuple[Labels, str], float]
"""(row, column) -> number."""
GroupNumbers = dict[tuple[Labels, str], Quantity]
"""The same with spread and marks; a missing one is a dash."""
PUBLISHED = "published"
SIMULATED = f"{DATASET} (simulated)"


def number_columns(
    group: str,
    names: Iterable[str],
    decimals: int,
    numbers: GroupNumbers,
    *,
    protocol: str = "",
    data: str = SIMULATED,
    source: str = "ours",
) -> list[Column]:
    """Return the columns of a group, whose numbers are of one origin.

    `protocol` is what our models were tested by, "" for none.
    """
    about: dict[str, object] = {"group": group, "source": source, "data": data}
    about |= {"protocol": protocol, "seed": SEED if protocol else None}

    def column(name: str) -> Column:
        return Column(
            name,
            format=f".{decimals}f",
            group=group,
            about=about,
            marks_shown=False,
            value=lambda row: numbers.get((row, name)),
        )

    return [*map(column, names)]


def published_columns(values: Numbers, decimals: int = 4) -> list[Column]:
    """Return the paper's columns."""
    numbers = {place: Quantity(value, n=1) for place, value in values.items()}
    names = dict.fromkeys(name for _, name in values)
    origin = {"data": "KR10 (measured)", "source": PUBLISHED}
    return number_columns(PUBLISHED, names, decimals, numbers, **origin)


def mean_numbers(each: Sequence[Numbers], mark: str = "") -> GroupNumbers:
    """Return the means over splits, or specimens, at the places that all of them have."""
    shared = [at for at in (each[0] if each else ()) if all(at in one for one in each)]
    return {at: mean_over([one[at] for one in each], mark) for at in shared}


def model_numbers(
    found: Found,
    models: Mapping[Label, Variant],
    errors: Callable[[Label, CellResult], Numbers],
) -> GroupNumbers:
    """Return the means over the splits of the errors of each model, which its label places."""
    numbers = GroupNumbers()
    for label, model in models.items():
        if results := found.results.get(model.name):
            each = [errors(label, result) for result in results]
            numbers |= mean_numbers(each, mark_of(results[0].shown))
    return numbers


def paper_table(
    table: str, rows: Iterable[Labels], columns: Iterable[Column], notes: Iterable[str] = ()
) -> Table:
    """Return a table that `results/published/tables.toml` describes.

    `rows` are the texts under its headings, beside which the columns are; `notes` follow its own.
    """
    said = about_table(table)
    number, unit, headings = said.get("number", table), said["unit"], enumerate(said["headings"])
    every_column = [
        *(Column(heading, "text", value=itemgetter(place)) for place, heading in headings),
        *(replace(column, unit=unit) for column in columns),
    ]
    title, every_note = f"Table {number}. {said['caption']} [{unit}]", [*said["notes"], *notes]
    about = {"table": int(number)}
    return Table.of(title, every_column, rows, every_note, unit=unit, about=about)


def published_numbers(lines: Mapping[Labels, Mapping[str, str]], columns: Iterable[str]) -> Numbers:
    """Return the numbers of a published file: "train MAE" is its column "train_mae_mm"."""
    return {
        (row, column): float(line[f"{column.replace(' ', '_').lower()}_mm"])
        for column in columns
        for row, line in lines.items()
    }


def _published_table(number: str, _: PaperResults) -> list[Table]:
    """Return a table that holds nothing of ours, as it was typed.

    The note names what was decided where the paper is silent or contradicts itself.
    """
    lines, said = published_lines(f"table_{number}"), about_table(number)

    def column(name: str) -> Column:
        if name in said["headings"]:
            return Column(name, "text")
        shown, _, unit = name.partition("_")  # begin_deg
        return Column(
            shown,
            unit=unit,
            format="g",
            about={"source": PUBLISHED},
            value=lambda line: float(line[name]) if line[name] else None,
        )

    title, about = f"Table {number}. {said['caption']} ({PUBLISHED})", {"table": int(number)}
    return [Table.of(title, [*map(column, lines[0])], lines, said["notes"], about=about)]


ROWS_10: dict[Labels, tuple[str, str]] = {
    (axis.upper(), metric(key).label): (key, axis) for axis in AXES for key in models.METRICS
}
"""Texts of a row of Table 10 -> its metric and axis."""
SPECIMENS = range(5)
KILO = 1e3
"""Of Table 3: it is in 10^3 N m/rad."""
_IN_SAMPLE = "in-sample fit"


@cache
def fitted_vjm(specimen: int = 0) -> tuple[Prediction, Mapping[str, float]]:
    """Return the VJM's predictions of all samples of a robot, which it is fitted to.

    With them, what it reports: its stiffnesses.
    """
    data = Kr10Twin(specimen=specimen).load()
    samples, model = data.samples, fitted_physics("vjm", data.samples, data.robot)
    predicted = model.predict(samples.q, samples.wrench)
    prediction = Prediction(np.arange(len(samples)), predicted, samples.deflection)
    return prediction, model.diagnostics_


def errors_by_axis(result: CellResult) -> dict[Labels, float]:
    """Return errors [mm] by row of Table 10."""
    return _by_axis(pooled_prediction([result]))


def _by_axis(prediction: Prediction) -> dict[Labels, float]:
    values = {key: metric(key).values(prediction) for key in models.METRICS}
    return {row: values[key][axis] * MM for row, (key, axis) in ROWS_10.items()}


def _table_2(_: PaperResults) -> list[Table]:
    """Return the VJM's errors by axis, on the samples it was fitted to."""

    def placed(errors: Mapping[Labels, float]) -> Numbers:
        # a row of Table 10, axis and error, is a row and a column here
        return {((axis,), error): value for (axis, error), value in errors.items()}

    values = published_errors("table_2")["VJM"]
    published = placed({row: values[at] for row, at in ROWS_10.items()})
    ours = [placed(_by_axis(predicted)) for predicted, _ in map(fitted_vjm, SPECIMENS)]
    return _vjm_table("2", 3, published, ours)


def _table_3(_: PaperResults) -> list[Table]:
    """Return the identified joint stiffnesses."""

    def placed(stiffness: Mapping[str, float]) -> Numbers:
        return {((joint,), "stiffness"): value / KILO for joint, value in stiffness.items()}

    published = published_stiffness()
    ours = [
        {joint: found[spring_key("stiffness", joint, "Nm/rad")] for joint in published}
        for _, found in map(fitted_vjm, SPECIMENS)
    ]
    return _vjm_table("3", 2, placed(published), [*map(placed, ours)])


def _vjm_table(
    number: str, decimals: int, published: Numbers, ours: Sequence[Numbers]
) -> list[Table]:
    """Return the paper's VJM next to ours of each specimen."""
    of_paper = published_columns(published, decimals)
    names = [column.name for column in of_paper]
    first, of_all = (mean_numbers(one, _IN_SAMPLE) for one in (ours[:1], ours))
    specimens = f"{DATASET}@specimen=0..4 (simulated)"
    columns = [
        *of_paper,
        *number_columns(f"ours, {DATASET}", names, decimals, first),
        *number_columns("ours, specimens 0 to 4", names, decimals, of_all, data=specimens),
    ]
    return [paper_table(number, dict.fromkeys(row for row, _ in published), columns)]


ON_SOURCE = {
    "train MAE": "source training MAE [mm]",
    "train STDE": "source training STDE [mm]",
    "test MAE": SOURCE_MAE,
    "test STDE": "source test STDE [mm]",
}
"""Column of Tables 6 and 7 -> what a pre-trained network reports."""
_ON_TARGET = ("validation MAE", "validation STDE")
EARLY = "ours, stopped early"


def _on_source(
    number: str, networks: Mapping[str, Mapping[str, Any]], results: PaperResults
) -> list[Table]:
    """Return a table of pre-trained networks; `networks`: row -> options of `pretrained`."""
    published = zip(networks, published_lines(f"table_{number}"), strict=True)
    lines: dict[Labels, dict[str, str]] = {(row,): line for row, line in published}
    ours = {row: models.pretrained(**options) for row, options in networks.items()}
    early = {
        row: models.pretrained(**options, stopped_early=True) for row, options in networks.items()
    }
    found = results.on_shared_splits([*ours.values(), *early.values()], PAPER_PROTOCOL)
    columns = published_columns(published_numbers(lines, ON_SOURCE))
    for label, of_group, decimals in ((f"ours, {PAPER_PROTOCOL}", ours, 5), (EARLY, early, 4)):
        numbers = model_numbers(found, of_group, _source_errors)
        columns += number_columns(label, ON_SOURCE, decimals, numbers, protocol=PAPER_PROTOCOL)
    return [paper_table(number, lines, columns, _stored(results, found))]


def _source_errors(row: str, result: CellResult) -> Numbers:
    """Return the errors on both parts of the source domain that were reported."""
    reported = result.diagnostics
    return {((row,), column): reported[key] for column, key in ON_SOURCE.items() if key in reported}


def _table_8(results: PaperResults) -> list[Table]:
    """Return the errors of fine-tuned networks by layers."""
    networks: dict[Labels, Variant] = {
        (counted(len(layers), "layer"), " + ".join(layers)): models.unfrozen(layers)
        for layers in (*models.ALL_SINGLES, *models.ALL_PAIRS)
    }
    found = results.on_shared_splits(networks.values(), PAPER_PROTOCOL)
    numbers = model_numbers(found, networks, _target_errors)
    label = f"ours, {PAPER_PROTOCOL}"
    columns = number_columns(label, _ON_TARGET, 4, numbers, protocol=PAPER_PROTOCOL)
    rows = [row for row, model in networks.items() if model.name not in found.missing]
    return [paper_table("8", rows, columns, _stored(results, found))]


def _target_errors(row: Labels, result: CellResult) -> Numbers:
    """Return the errors on the test part, mm, all axes and samples together."""
    errors = absolute_errors(pooled_prediction([result])) * MM
    mae, stde = _ON_TARGET
    return {(row, mae): float(errors.mean()), (row, stde): float(errors.std())}


def _stored(results: PaperResults, *shown: Found, more: Sequence[str] = ()) -> list[str]:
    """Return two notes on the results of a table: what they are, and which stiffbench made them."""
    settings = [found.setting for found in shown if found.results]
    absences = [note for found in shown for note in found.absences()]
    ours = f"Ours, {DATASET}, mean ± standard deviation over splits:"
    return [" ".join([ours, *settings, *more, *absences]), results.provenance(shown)]


LAST, BEST = "normal (last epoch)", "optimized (best epoch)"
TRAININGS = {LAST: models.FT_MLP_LAST_EPOCH, BEST: models.FT_MLP}
BY_RECIPE = {LAST: models.FT_MLP_PAPER_RECIPE_LAST_EPOCH, BEST: models.FT_MLP_PAPER_RECIPE}
COLUMNS_9 = ("train MAE", "train STDE", "validation MAE", "validation STDE")
LENGTH = "3-D"
ERRORS_9 = (LENGTH, *(axis.upper() for axis in AXES))
HOW_RECIPE = (
    "The paper's own recipe (100,000 + 50,000 iterations) is not stored: "
    f"{REPRODUCE} computes its first split."
)


def _table_9(results: PaperResults) -> list[Table]:
    """Return the errors of the fine-tuned network on training and validation part."""
    lines = zip(TRAININGS, published_lines("table_9"), strict=True)
    of_paper = published_numbers({(label, LENGTH): line for label, line in lines}, COLUMNS_9)
    columns, shown, more = published_columns(of_paper), list[Found](), list[str]()
    for label, trainings in (
        (f"ours, {PAPER_PROTOCOL}", TRAININGS),
        ("ours, the paper's recipe", BY_RECIPE),
    ):
        if (
            trainings is BY_RECIPE
            and not results.of_models(trainings.values(), PAPER_PROTOCOL).results
        ):
            more.append(HOW_RECIPE)
            continue
        tested = results.on_shared_splits(trainings.values(), PAPER_PROTOCOL)
        read = results.of_models(trainings.values(), READ_ON_ALL)
        numbers = model_numbers(tested, trainings, partial(_on_both_parts, read, trainings))
        shown += [tested, read]
        columns += number_columns(label, COLUMNS_9, 5, numbers, protocol=PAPER_PROTOCOL)
    rows = [(label, error) for label in TRAININGS for error in ERRORS_9]
    return [paper_table("9", rows, columns, _stored(results, *shown, more=more))]


def _on_both_parts(
    read: Found, trainings: Mapping[str, Variant], training: str, result: CellResult
) -> Numbers:
    """Return errors on the validation part and, of the same fit read on all samples, the rest."""
    numbers = _on_part(training, "validation", result)
    for fit in read.results.get(trainings[training].name, ()):
        if fit.cell.rows_sha256 == result.cell.split_sha256:
            held_out = pooled_prediction([result]).rows
            numbers |= _on_part(training, "train", fit, held_out)
    return numbers


def _on_part(
    training: str, part: str, result: CellResult, without: ArrayLike = ()
) -> dict[tuple[Labels, str], float]:
    """Return means and deviations of the errors [mm] of a result, except for some of its rows."""
    prediction = pooled_prediction([result])
    chosen = ~np.isin(prediction.rows, without)
    along = absolute_errors(prediction)[chosen] * MM  # (n, 3)
    sizes = zip(ERRORS_9, (norm_errors(prediction)[chosen] * MM, *along.T), strict=True)
    return {
        ((training, error), f"{part} {kind}"): float(value)
        for error, size in sizes
        for kind, value in (("MAE", size.mean()), ("STDE", size.std()))
    }


OLD, NEW, OWN_SOURCE, RECIPE = "VJM", "FT-MLP", "FT-MLP, own source", "FT-MLP, paper's recipe"
METHODS = {
    OLD: models.VJM,
    NEW: models.FT_MLP,
    OWN_SOURCE: models.FT_MLP_OWN_SOURCE,
    "DT-CNN": models.DT_CNN,
}
"""Name of a method -> our model; the paper's name, where the paper has it."""
FINE_TUNED = (NEW, OWN_SOURCE, RECIPE)
"""Methods whose errors are compared with the VJM's."""
READINGS = {
    "test part": PAPER_PROTOCOL,
    "all samples": READ_ON_ALL,
    "holdout": FAIR_PROTOCOL,
}
"""Name of a reading of Table 10 -> the protocol whose results it is."""
CLAIMED, RECOMPUTED = "claimed", "from Table 10"


def _table_10(results: PaperResults) -> list[Table]:
    """Return the errors of the paper's methods, and by how much FT-MLP errs less than the VJM."""
    published, claimed = published_errors("table_10"), claimed_reductions()
    old, new = published[OLD], published[NEW]
    of_paper = {
        (row, method): values[at]
        for method, values in published.items()
        for row, at in ROWS_10.items()
    }
    reductions = {(row, CLAIMED): claimed[at] for row, at in ROWS_10.items()}
    reductions |= {(row, RECOMPUTED): reduction(old[at], new[at]) for row, at in ROWS_10.items()}
    of_errors, of_reductions = published_columns(of_paper), published_columns(reductions, 1)
    shown, absent, how_recipe = list[Found](), list[StoreError](), [HOW_RECIPE]
    for reading, protocol in READINGS.items():
        try:
            found = results.on_shared_splits(METHODS.values(), protocol)
        except StoreError as error:
            absent.append(error)
            continue
        recipe = results.of_models([models.FT_MLP_PAPER_RECIPE], protocol)  # on the first split
        methods = METHODS | ({RECIPE: models.FT_MLP_PAPER_RECIPE} if recipe.results else {})
        both = replace(found, results=found.results | recipe.results)
        of_old = {
            slot_of(one): errors_by_axis(one) for one in found.results.get(METHODS[OLD].name, ())
        }
        numbers = model_numbers(both, methods, partial(_errors_and_reductions, of_old))
        label = f"ours, {reading}"
        of_errors += number_columns(label, methods, 4, numbers, protocol=protocol)
        compared = [f"{method} against {OLD}" for method in methods if method in FINE_TUNED]
        of_reductions += number_columns(label, compared, 1, numbers, protocol=protocol)
        shown.append(found)
        if recipe.results:
            shown.append(recipe)
            how_recipe = []
    if not shown:
        raise absent[0]
    more = [*(f"{error}." for error in absent), *how_recipe]
    notes = _stored(results, *shown, more=more)
    return [
        paper_table("10", ROWS_10, of_errors, notes),
        paper_table("claimed_reductions", ROWS_10, of_reductions, notes),
    ]


def _errors_and_reductions(
    of_old: Mapping[Slot, Mapping[Labels, float]], method: str, result: CellResult
) -> Numbers:
    """Return a method's errors [mm], and by how much they are below the VJM's [%]."""
    errors = errors_by_axis(result)
    old_errors = of_old.get(slot_of(result), {})
    return {
        **{(row, method): error for row, error in errors.items()},
        **{
            (row, f"{method} against {OLD}"): reduction(old, errors[row])
            for row, old in old_errors.items()
            if old
        },
    }


def reduction(old: float, new: float) -> float:
    """Return by how many per cent `new` is below `old`; negative where it is above."""
    return 100.0 * (1.0 - new / old)


TABLES: Mapping[str, Callable[[PaperResults], list[Table]]] = {
    "1": partial(_published_table, "1"),
    "2": _table_2,
    "3": _table_3,
    "4": partial(_published_table, "4"),
    "5": partial(_published_table, "5"),
    "6": partial(_on_source, "6", models.BY_DEPTH),
    "7": partial(_on_source, "7", models.BY_ACTIVATION),
    "8": _table_8,
    "9": _table_9,
    "10": _table_10,
}
"""Number in the paper -> what returns the table: all of the paper's."""
