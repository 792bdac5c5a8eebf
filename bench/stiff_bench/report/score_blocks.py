"""Scores, data and identified stiffnesses of a page's cases. SI is converted to mm here."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

from stiff_bench.analysis.collected import Case, Competitor, in_order
from stiff_bench.report.html_page import Block
from stiff_bench.store.names import grouped, labels, natural_key
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.fit_notes import model_notes
from stiff_bench.tables.metric_table import (
    mark_of,
    mean_over,
    metric_columns,
    metric_values,
)
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table, text_columns
from stiff_bench.tables.units import counted
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.scoring.metrics import METRICS, Metric
from stiff_protocols.springs.identification import spring_key

MOST_NOTES = 200
"""Largest number of embedded notes on fits."""
RequestedModels = Mapping[Case, Sequence[Competitor]]
"""Case -> its requested models."""
_ALWAYS = ("norm", "mae", "stde", "me")


def score_block(requested_models: RequestedModels, metric: str) -> Block:
    """Return the scores of models; the ranking `metric` comes first."""
    metrics = [METRICS[key] for key in dict.fromkeys((metric, *_ALWAYS))]
    case_labels = labels(case.name for case in requested_models)
    case_models = [
        (case, competitor)
        for case in sorted(requested_models, key=in_order)
        for competitor in requested_models[case]
    ]
    notes = [
        (note, case_labels[case.name])
        for case, competitor in case_models
        if competitor.done
        for note in model_notes(case.results(competitor.name))
    ]
    table = Table.of(
        "Scores, mean ± standard deviation over splits",
        [
            *text_columns("model", "data set", "protocol", "condition"),
            *(Column("seed"), Column("splits")),
            *(column for metric in metrics for column in metric_columns([metric])),
        ],
        [_row(case, competitor, metrics) for case, competitor in case_models],
        ["splits: completed / requested."],
    )
    return Block("Scores", tables=[table], folds=_fit_notes(notes), is_detail=True)


def _row(case: Case, competitor: Competitor, metrics: Sequence[Metric]) -> dict[Any, Entry]:
    """Return the cells by column name, or by (metric key, axis)."""
    name = case.name
    results = case.results(competitor.name)
    n_requested = max(competitor.n_requested, len(competitor.done) + len(competitor.failures))
    return {
        "model": Name(competitor.name, mark_of(competitor.presentation)),
        **{"data set": name.dataset, "protocol": name.protocol},
        **{"condition": name.condition or None, "seed": name.seed},
        "splits": Quantity(share=(len(results), n_requested)),
        **(metric_values(results, metrics) if results else {}),
    }


def _fit_notes(notes: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the notes of fits with their first case, as a collapsed text; [] for none."""
    if not notes:
        return []
    lines = [
        f"{places[0][1]}{f' and {len(places) - 1} more' if len(places) > 1 else ''}: {note}"
        for note, places in grouped(notes, itemgetter(0)).items()
    ]
    more = f"; the first {MOST_NOTES} are shown" if len(lines) > MOST_NOTES else ""
    summary = f"Notes of the fits: {counted(len(lines), 'note')}{more}"
    return [(summary, "\n".join(lines[:MOST_NOTES]))]


def data_block(cases: Sequence[Case], data_of: Callable[[str], StoredData]) -> Block:
    """Return robot, TCP and size of the data sets, and the stiffnesses.

    `data_of` returns the samples with a hash. It raises StoreError if they are not stored.
    """
    rows: list[list[Entry]] = []
    for case in _case_of_data(cases):
        presentation = case.presentation
        try:
            data = data_of(case.name.data_sha256)
            n_poses = len(set(data.measured.pose_id))
            size: list[Entry] = [data.robot.name, _tcp(data), len(data.measured), n_poses]
        except StoreError:
            size = [None, None, None, None]
        rows.append([case.name.dataset, presentation.kind, *size])
    columns = [
        *(Column(name, "text") for name in ("data set", "kind", "robot")),
        *(Column("TCP, frame of the last link [m]", "text"), Column("samples"), Column("poses")),
    ]
    tables = [Table("Data sets", columns, rows), *_stiffnesses(cases, data_of)]
    return Block("Robots and data", tables=tables, is_detail=True)


def data_hashes(cases: Sequence[Case]) -> Table:
    """Return the sha256 of each data set's samples and robot."""
    return Table(
        "Data sets by their content",
        text_columns("data set", "sha256 of samples and robot"),
        [[case.name.dataset, case.measured_sha256] for case in _case_of_data(cases)],
    )


def _case_of_data(cases: Sequence[Case]) -> list[Case]:
    """Return one case for each data set, in the order of their names."""
    of_data = {case.measured_sha256: case for case in cases}
    return sorted(
        of_data.values(), key=lambda case: (natural_key(case.name.dataset), case.measured_sha256)
    )


def _tcp(data: StoredData) -> str:
    """Return the TCP in the format of `--tcp`."""
    return ", ".join(f"{length:g}" for length in data.robot.tcp_on_flange)


Joint = tuple[str, str]
"""Name, and the unit of its stiffness."""


def _stiffnesses(cases: Sequence[Case], data_of: Callable[[str], StoredData]) -> Iterator[Table]:
    """Yield the joint stiffnesses that the reference model identified, a table for each robot."""
    stiffnesses: dict[str, tuple[str, str, dict[Joint, Quantity]]] = {}
    for case in sorted(cases, key=in_order):
        if REFERENCE_MODEL not in case.competitors or case.name.dataset in stiffnesses:
            continue
        try:
            data = data_of(case.name.data_sha256)
        except StoreError:  # the table of data sets shows that
            continue
        fits = [result.diagnostics for result in case.results(REFERENCE_MODEL)]
        values = {
            joint: [fit[key] for fit in fits if math.isfinite(fit.get(key, math.inf))]
            for joint in zip(data.robot.joint_names, data.stiffness_units, strict=True)
            for key in [spring_key("stiffness", *joint)]
        }
        row = {joint: mean_over(of_fits) for joint, of_fits in values.items() if of_fits}
        if row:
            stiffnesses[case.name.dataset] = (data.robot.name, case.name.protocol, row)
    for robot, datasets in grouped(stiffnesses, lambda name: stiffnesses[name][0]).items():
        joints = dict.fromkeys(joint for name in datasets for joint in stiffnesses[name][2])
        yield Table(
            f"Joint stiffnesses of {robot} by {REFERENCE_MODEL}, mean ± standard deviation over "
            "splits",
            [
                *text_columns("data set", "protocol"),
                *(Column(name, unit=unit, format=",.0f") for name, unit in joints),
            ],
            [
                [name, stiffnesses[name][1], *(stiffnesses[name][2].get(joint) for joint in joints)]
                for name in datasets
            ],
        )
