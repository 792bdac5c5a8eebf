"""Write the reports of fits: notes below a table, and a table of springs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from stiff_bench.store.names import grouped
from stiff_bench.tables.table import Column, Entry, Quantity, Table
from stiff_bench.tables.units import counted, first_few, percent
from stiff_protocols.contract.plugin import in_words
from stiff_protocols.contract.record import CellResult
from stiff_protocols.springs.identification import IdentifiedSprings

SPRING_INTERVAL = 0.9


def size_notes(results: Sequence[CellResult]) -> list[str]:
    """Return a note on the numbers of training and test samples; none if unknown.

    The results belong to one protocol.
    """
    sizes = [
        (result.n_train, len(result.prediction.rows))
        for result in results
        if result.prediction is not None and result.n_train
    ]
    if not sizes:
        return []
    trained, tested = map(_range, zip(*sizes, strict=True))
    if results[0].presentation.reports_training:
        return [f"a split trains on {trained} samples and reports {tested}, including these."]
    of_paths = " points of tool paths" if results[0].presentation.measured_sha256 else ""
    trains = f"a split trains on {trained} samples, validation included, and tests on {tested}"
    return [f"{trains}{of_paths}."]


def _range(numbers: Iterable[int]) -> str:
    sizes = [*numbers]
    return " to ".join(map(str, sorted({min(sizes), max(sizes)})))


def model_notes(results: Sequence[CellResult]) -> list[str]:
    """Return all notes of a model's fits."""
    return [*number_notes(results), *outcome_notes(results)]


def number_notes(results: Sequence[CellResult]) -> list[str]:
    """Return a note with the mean diagnostics of a model's fits; none without diagnostics."""
    done = [result for result in results if result.status == "ok"]
    numbers = []
    for key in dict.fromkeys(key for result in done for key in result.diagnostics):
        values = [result.diagnostics[key] for result in done if key in result.diagnostics]
        share_text = (
            "" if len(values) == len(done) else f" (in {len(values)} of {len(done)} splits)"
        )
        numbers.append(f"{key} {_mean_text(values)}{share_text}")
    over = f" (means over {len(done)} splits)" if len(done) > 1 else ""
    return [f"{results[0].presentation.model}{over}: {', '.join(numbers)}."] if numbers else []


def _mean_text(values: Sequence[float]) -> str:
    """Format a mean; infinite values (rigid joints) are counted separately."""
    finite = [value for value in values if not math.isinf(value)]
    if len(finite) == len(values) or not finite:
        return f"{float(np.mean(values)):.4g}"
    n_infinite = len(values) - len(finite)
    return f"{float(np.mean(finite)):.4g} (and infinite in {n_infinite} of {len(values)})"


def outcome_notes(results: Sequence[CellResult]) -> list[str]:
    """Return notes on chosen options, intervals, warnings and failures."""
    presentation, coverage = results[0].presentation, results[0].cell.coverage
    done = [result for result in results if result.status == "ok"]
    notes = [f"source domain: {presentation.source}."] if presentation.source else []
    choices = Counter(in_words(result.chosen) for result in done if result.chosen)
    if choices:
        choice_texts = "; ".join(f"{choice}{_times(n, done)}" for choice, n in choices.items())
        notes.append(f"options chosen by inner cross-validation: {choice_texts}.")
    if partly_labelled := [result for result in done if 0 < result.n_labels < result.n_train]:
        labels, of_all = (
            _range(r.n_labels for r in partly_labelled),
            _range(r.n_train for r in partly_labelled),
        )
        notes.append(f"trained on {labels} of {of_all} samples; the others choose the epoch.")
    if coverage is not None and any(r.prediction and r.prediction.interval for r in done):
        samples = _range(result.calibration_samples for result in done)
        split_conformal = f"split-conformal, with {samples} calibration samples"
        kind = "the model's own" if samples == "0" else split_conformal
        notes.append(f"{percent(coverage)} intervals are {kind}.")
    messages = [("warning", message) for result in results for message in result.warnings]
    for status in ("failed", "skipped"):
        messages += [
            (status.upper(), result.failure) for result in results if result.status == status
        ]
    message_counts = Counter((kind, " ".join(text.split())) for kind, text in messages)
    notes += [f"{kind}{_times(n, results)}: {text}" for (kind, text), n in message_counts.items()]
    return [f"{presentation.model}: {note}" for note in notes]


def failure_lines(results: Iterable[CellResult]) -> list[str]:
    """Return a line per reason for missing results, with the models."""
    failures = [result for result in results if result.status != "ok"]
    lines = []
    by_reason = grouped(
        failures, lambda result: (result.status.upper(), " ".join(result.failure.split()))
    )
    for (status, reason), of_reason in by_reason.items():
        models = first_few(list(dict.fromkeys(result.presentation.model for result in of_reason)))
        lines.append(f"{status}: {models} ({counted(len(of_reason), 'fit')}): {reason}")
    return lines


def _times(n: int, results: Sequence[CellResult]) -> str:
    return f" ({n} of {len(results)} splits)" if len(results) > 1 else ""


def springs_table(springs: IdentifiedSprings) -> Table:
    """Return the stiffness of each spring with its interval."""
    rows: list[list[Entry]] = []
    for name, unit, compliance, is_known, (low, high) in zip(
        springs.names,
        springs.units,
        springs.compliance.tolist(),
        springs.is_identified,
        springs.interval(SPRING_INTERVAL).tolist(),
        strict=True,
    ):
        stiffness = Quantity(1.0 / compliance) if compliance else Quantity(status="rigid")
        label = f"{name} [{unit}]" if is_known else f"{name} [{unit}], not identifiable: prior"
        rows.append([label, stiffness, Quantity(low=low, high=high)])
    return Table(
        "",
        [
            Column("spring", "text"),
            Column("stiffness", format=".4g"),
            Column(f"{percent(SPRING_INTERVAL)} interval", format=".4g"),
        ],
        rows,
        [
            f"rank {springs.rank}, condition number {springs.condition:.4g}",
            "The springs absorb what the model leaves out, such as tilting bearings. The intervals "
            "cover the noise of the samples, not the joints' own stiffness.",
        ],
    )
