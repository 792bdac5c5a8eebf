"""Build the source paper's tables, with our results next to them.

Tables 1, 4 and 5 have only the paper's numbers. Tables 2 and 3 are of a VJM that is fitted here.
Tables 6 to 8 compare networks by size, activation and fine-tuned layers. Tables 9 and 10 compare
the fine-tuned network with the paper's methods. The paper does not state the samples of its Table
10, nor the error of its Table 9. Both are shown in every interpretation; docs/reproduction.md
compares them.
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
from stiff_bench.paper.paper_results import REPRODUCE, PaperResults, ProtocolResults, named_results
from stiff_bench.results.fit_values import mean_over, pooled_prediction
from stiff_bench.results.load import SplitId, split_of
from stiff_bench.results.notes import mark_of
from stiff_bench.store.names import Variant
from stiff_bench.tables.published import (
    about_table,
    published_errors,
    published_lines,
)
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import MM, counted
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.physics.vjm import fitted_physics
from stiff_protocols.contract.errors import StoreError, unknown_name
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.types import AXES, Prediction
from stiff_protocols.scoring.metrics import absolute_errors, metric, norm_errors
from stiff_protocols.springs.identification import spring_key

NEEDS_NO_RESULTS = {
    **dict.fromkeys(("1", "4", "5"), "is the paper's alone"),
    **dict.fromkeys(("2", "3"), "is fitted here"),
}
"""Tables that need no stored results -> reason."""


def read_table(number: str, folder: Path | None) -> list[Table]:
    """Return a table of the paper next to ours; folder and errors as in `named_results`.

    Raises:
        ConfigError: the number is not a table of the paper.
    """
    if number not in TABLES:
        raise unknown_name("table of the paper", number, TABLES)
    made_of = NEEDS_NO_RESULTS.get(number, "")
    return TABLES[number](named_results(folder, f"table {number}", made_of=made_of))


Label = TypeVar("Label")
Labels = tuple[str, ...]
"""Texts of a row, one per row heading."""
Numbers = Mapping[tuple[Labels, str], float]
"""(row, column) -> number."""
GroupNumbers = dict[tuple[Labels, str], Quantity]
"""Numbers with spread and marks; a missing number is printed as a dash."""
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
    """Return the columns of a group of numbers from the same source.

    `protocol` is the protocol of our results; "" without results.
    """
    about: dict[str, object] = {"group": group, "source": source, "data": data}
    about |= {"protocol": protocol, "seed": SEED if protocol else None}

    def column(name: str) -> Column:
        return Column(
            name,
            format=lambda number: number.text(f".{decimals}f"),  # without its mark
            group=group,
            about=about,
            value=lambda row: numbers.get((row, name)),
        )

    return [*map(column, names)]


def published_columns(values: Numbers, decimals: int = 4) -> list[Column]:
    """Return the paper's columns."""
    numbers = {place: Quantity(value, n=1) for place, value in values.items()}
    names = dict.fromkeys(name for _, name in values)
    origin = {"data": "KR10 (measured)", "source": PUBLISHED}
    return number_columns(PUBLISHED, names, decimals, numbers, **origin)


def mean_numbers(repeats: Sequence[Numbers], mark: str = "") -> GroupNumbers:
    """Return the means over splits or specimens, at the places common to all."""
    first_places = repeats[0] if repeats else ()
    shared = [place for place in first_places if all(place in numbers for numbers in repeats)]
    return {place: mean_over([numbers[place] for numbers in repeats], mark) for place in shared}


def model_numbers(
    stored: ProtocolResults,
    models: Mapping[Label, Variant],
    errors: Callable[[Label, FitResult], Numbers],
) -> GroupNumbers:
    """Return the mean errors over splits of each model, at the places of its label."""
    numbers = GroupNumbers()
    for label, model in models.items():
        if fits := stored.results.get(model.name):
            split_errors = [errors(label, fit) for fit in fits]
            numbers |= mean_numbers(split_errors, mark_of(fits[0].presentation))
    return numbers


def paper_table(
    table: str, rows: Iterable[Labels], columns: Iterable[Column], notes: Iterable[str] = ()
) -> Table:
    """Return a table that `results/published/tables.toml` describes.

    `rows` are the texts under its headings; the columns follow them. `notes` follow its own notes.
    """
    entry = about_table(table)
    number, unit, headings = entry.get("number", table), entry["unit"], enumerate(entry["headings"])
    every_column = [
        *(Column(heading, "text", value=itemgetter(place)) for place, heading in headings),
        *(replace(column, unit=unit) for column in columns),
    ]
    title, every_note = f"Table {number}. {entry['caption']} [{unit}]", [*entry["notes"], *notes]
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
    """Return one of the paper's tables without our numbers, as it was typed.

    The notes name the choices made for gaps and contradictions in the paper.
    """
    lines, entry = published_lines(f"table_{number}"), about_table(number)

    def column(name: str) -> Column:
        if name in entry["headings"]:
            return Column(name, "text")
        heading, _, unit = name.partition("_")  # begin_deg
        return Column(
            heading,
            unit=unit,
            format="g",
            about={"source": PUBLISHED},
            value=lambda line: float(line[name]) if line[name] else None,
        )

    title, about = f"Table {number}. {entry['caption']} ({PUBLISHED})", {"table": int(number)}
    return [Table.of(title, [*map(column, lines[0])], lines, entry["notes"], about=about)]


ROWS_10: dict[Labels, tuple[str, str]] = {
    (axis.upper(), metric(key).label): (key, axis) for axis in AXES for key in models.METRICS
}
"""Texts of a row of Table 10 -> its metric and axis."""
SPECIMENS = range(5)
KILO = 1e3
"""Unit of Table 3: 10^3 N m/rad."""
_IN_SAMPLE = "in-sample fit"


@cache
def fitted_vjm(specimen: int = 0) -> tuple[Prediction, Mapping[str, float]]:
    """Return the VJM's predictions of its own training samples, and its stiffnesses.

    The VJM is fitted to all samples of a robot.
    """
    data = Kr10Twin(specimen=specimen).load()
    samples, model = data.samples, fitted_physics("vjm", data.samples, data.robot)
    predicted = model.predict(samples.q, samples.wrench)
    prediction = Prediction(np.arange(len(samples)), predicted, samples.deflection)
    return prediction, model.diagnostics_


def errors_by_axis(result: FitResult) -> dict[Labels, float]:
    """Return errors [mm] by row of Table 10."""
    return _by_axis(pooled_prediction([result]))


def _by_axis(prediction: Prediction) -> dict[Labels, float]:
    values = {key: metric(key).values(prediction) for key in models.METRICS}
    return {row: values[key][axis] * MM for row, (key, axis) in ROWS_10.items()}


def _table_2(_: PaperResults) -> list[Table]:
    """Return the VJM's errors by axis on its training samples."""

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

    lines = published_lines("table_3")
    published = {line["joint"]: float(line["stiffness_Nm_per_rad"]) for line in lines}
    ours = [
        {joint: diagnostics[spring_key("stiffness", joint, "Nm/rad")] for joint in published}
        for _, diagnostics in map(fitted_vjm, SPECIMENS)
    ]
    return _vjm_table("3", 2, placed(published), [*map(placed, ours)])


def _vjm_table(
    number: str, decimals: int, published: Numbers, ours: Sequence[Numbers]
) -> list[Table]:
    """Return the paper's VJM next to ours of each specimen."""
    of_paper = published_columns(published, decimals)
    names = [column.name for column in of_paper]
    first, of_all = (mean_numbers(specimens, _IN_SAMPLE) for specimens in (ours[:1], ours))
    data = f"{DATASET}@specimen=0..4 (simulated)"
    columns = [
        *of_paper,
        *number_columns(f"ours, {DATASET}", names, decimals, first),
        *number_columns("ours, specimens 0 to 4", names, decimals, of_all, data=data),
    ]
    return [paper_table(number, dict.fromkeys(row for row, _ in published), columns)]


ON_SOURCE = {
    "train MAE": "source training MAE [mm]",
    "train STDE": "source training STDE [mm]",
    "test MAE": SOURCE_MAE,
    "test STDE": "source test STDE [mm]",
}
"""Column of Tables 6 and 7 -> diagnostic of a pre-trained network."""
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
    stored = results.on_shared_splits([*ours.values(), *early.values()], PAPER_PROTOCOL)
    columns = published_columns(published_numbers(lines, ON_SOURCE))
    for label, of_group, decimals in ((f"ours, {PAPER_PROTOCOL}", ours, 5), (EARLY, early, 4)):
        numbers = model_numbers(stored, of_group, _source_errors)
        columns += number_columns(label, ON_SOURCE, decimals, numbers, protocol=PAPER_PROTOCOL)
    return [paper_table(number, lines, columns, _result_notes(results, stored))]


def _source_errors(row: str, result: FitResult) -> Numbers:
    """Return the reported errors on both parts of the source domain."""
    reported = result.diagnostics
    return {((row,), column): reported[key] for column, key in ON_SOURCE.items() if key in reported}


def _table_8(results: PaperResults) -> list[Table]:
    """Return the errors of fine-tuned networks by layers."""
    networks: dict[Labels, Variant] = {
        (counted(len(layers), "layer"), " + ".join(layers)): models.unfrozen(layers)
        for layers in (*models.ALL_SINGLES, *models.ALL_PAIRS)
    }
    stored = results.on_shared_splits(networks.values(), PAPER_PROTOCOL)
    numbers = model_numbers(stored, networks, _target_errors)
    label = f"ours, {PAPER_PROTOCOL}"
    columns = number_columns(label, _ON_TARGET, 4, numbers, protocol=PAPER_PROTOCOL)
    rows = [row for row, model in networks.items() if model.name not in stored.missing]
    return [paper_table("8", rows, columns, _result_notes(results, stored))]


def _target_errors(row: Labels, result: FitResult) -> Numbers:
    """Return the errors on the test part, mm, all axes and samples together."""
    errors = absolute_errors(pooled_prediction([result])) * MM
    mae, stde = _ON_TARGET
    return {(row, mae): float(errors.mean()), (row, stde): float(errors.std())}


def _result_notes(
    results: PaperResults, *printed: ProtocolResults, more: Sequence[str] = ()
) -> list[str]:
    """Return two notes on a table's results: their setting and their provenance."""
    settings = [stored.setting for stored in printed if stored.results]
    absences = [note for stored in printed for note in stored.absences()]
    ours = f"Ours, {DATASET}, mean ± standard deviation over splits:"
    return [" ".join([ours, *settings, *more, *absences]), results.provenance(printed)]


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
    columns, printed, more = published_columns(of_paper), list[ProtocolResults](), list[str]()
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
        printed += [tested, read]
        columns += number_columns(label, COLUMNS_9, 5, numbers, protocol=PAPER_PROTOCOL)
    rows = [(label, error) for label in TRAININGS for error in ERRORS_9]
    return [paper_table("9", rows, columns, _result_notes(results, *printed, more=more))]


def _on_both_parts(
    read: ProtocolResults, trainings: Mapping[str, Variant], training: str, result: FitResult
) -> Numbers:
    """Return a fit's errors on the validation part and on the training part.

    The errors on the training part are from `read`, the same fits tested on all samples.
    """
    numbers = _on_part(training, "validation", result)
    for fit in read.results.get(trainings[training].name, ()):
        if fit.fit.rows_sha256 == result.fit.split_sha256:
            held_out = pooled_prediction([result]).rows
            numbers |= _on_part(training, "train", fit, held_out)
    return numbers


def _on_part(
    training: str, part: str, result: FitResult, without: ArrayLike = ()
) -> dict[tuple[Labels, str], float]:
    """Return means and deviations of a result's errors [mm], without some rows."""
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
"""Name of a method, if possible the paper's -> our model."""
FINE_TUNED = (NEW, OWN_SOURCE, RECIPE)
"""Methods whose errors are compared with the VJM's."""
READINGS = {
    "test part": PAPER_PROTOCOL,
    "all samples": READ_ON_ALL,
    "holdout": FAIR_PROTOCOL,
}
"""Interpretation of Table 10 -> its protocol."""
CLAIMED, RECOMPUTED = "claimed", "from Table 10"


def _table_10(results: PaperResults) -> list[Table]:
    """Return the errors of the paper's methods, and FT-MLP's reductions against the VJM."""
    published = published_errors("table_10")
    claimed = published_errors("claimed_reductions")["reduction_percent"]
    old, new = published[OLD], published[NEW]
    of_paper = {
        (row, method): values[at]
        for method, values in published.items()
        for row, at in ROWS_10.items()
    }
    reductions = {(row, CLAIMED): claimed[at] for row, at in ROWS_10.items()}
    reductions |= {(row, RECOMPUTED): reduction(old[at], new[at]) for row, at in ROWS_10.items()}
    of_errors, of_reductions = published_columns(of_paper), published_columns(reductions, 1)
    printed, absent, how_recipe = list[ProtocolResults](), list[StoreError](), [HOW_RECIPE]
    for reading, protocol in READINGS.items():
        try:
            stored = results.on_shared_splits(METHODS.values(), protocol)
        except StoreError as error:
            absent.append(error)
            continue
        recipe = results.of_models([models.FT_MLP_PAPER_RECIPE], protocol)  # on the first split
        methods = METHODS | ({RECIPE: models.FT_MLP_PAPER_RECIPE} if recipe.results else {})
        with_recipe = replace(stored, results=stored.results | recipe.results)
        of_old = {
            split_of(fit): errors_by_axis(fit) for fit in stored.results.get(METHODS[OLD].name, ())
        }
        numbers = model_numbers(with_recipe, methods, partial(_errors_and_reductions, of_old))
        label = f"ours, {reading}"
        of_errors += number_columns(label, methods, 4, numbers, protocol=protocol)
        compared = [f"{method} against {OLD}" for method in methods if method in FINE_TUNED]
        of_reductions += number_columns(label, compared, 1, numbers, protocol=protocol)
        printed.append(stored)
        if recipe.results:
            printed.append(recipe)
            how_recipe = []
    if not printed:
        raise absent[0]
    more = [*(f"{error}." for error in absent), *how_recipe]
    notes = _result_notes(results, *printed, more=more)
    return [
        paper_table("10", ROWS_10, of_errors, notes),
        paper_table("claimed_reductions", ROWS_10, of_reductions, notes),
    ]


def _errors_and_reductions(
    of_old: Mapping[SplitId, Mapping[Labels, float]], method: str, result: FitResult
) -> Numbers:
    """Return a method's errors [mm] and their reductions against the VJM [%]."""
    errors = errors_by_axis(result)
    old_errors = of_old.get(split_of(result), {})
    return {
        **{(row, method): error for row, error in errors.items()},
        **{
            (row, f"{method} against {OLD}"): reduction(old, errors[row])
            for row, old in old_errors.items()
            if old
        },
    }


def reduction(old: float, new: float) -> float:
    """Return the reduction from `old` to `new` in per cent; negative if `new` is larger."""
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
"""Number in the paper -> function that returns the table; all tables of the paper."""
