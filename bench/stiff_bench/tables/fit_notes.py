"""What stands beneath a table of what a model's fits reported: numbers, choices, warnings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from stiff_bench.tables.units import percent
from stiff_protocols.contract.plugin import in_words
from stiff_protocols.contract.record import CellResult


def size_notes(results: Sequence[CellResult]) -> list[str]:
    """Return how many samples a split's training side and its reported rows are; none if unknown.

    The results are of one protocol.
    """
    sizes = {
        (result.n_train, len(result.prediction.rows))
        for result in results
        if result.prediction is not None and result.n_train
    }
    if not sizes:
        return []
    trained, tested = (_range(column) for column in zip(*sizes, strict=True))
    if results[0].shown.reports_training:
        return [f"a split trains on {trained} samples and reports {tested}, these among them."]
    trains = f"a split trains on {trained} samples, validation included, and tests on {tested}"
    if results[0].shown.measured_sha256:
        trains += " points of tool paths"
    return [f"{trains}."]


def _range(numbers: tuple[int, ...]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low}" if low == high else f"{low} to {high}"


def model_notes(results: Sequence[CellResult]) -> list[str]:
    """Return all that a model's cells reported."""
    return [*number_notes(results), *outcome_notes(results)]


def number_notes(results: Sequence[CellResult]) -> list[str]:
    """Return the numbers that a model's fits reported, as means; none where there are none."""
    done = [result for result in results if result.status == "ok"]
    over = f" (means over {len(done)} splits)" if len(done) > 1 else ""
    numbers = _mean_diagnostics(done)
    return [f"{results[0].shown.model}{over}: {', '.join(numbers)}."] if numbers else []


def outcome_notes(results: Sequence[CellResult]) -> list[str]:
    """Return a model's choices, what its intervals are, warnings and reasons of failure."""
    name = results[0].shown.model
    done = [result for result in results if result.status == "ok"]
    notes = [*_source_notes(results), *_chosen_notes(name, done), *_label_notes(name, done)]
    coverage = results[0].cell.coverage
    predictions = [result.prediction for result in done]
    if coverage is not None and any(one and one.interval is not None for one in predictions):
        notes.append(f"{name}: {percent(coverage)} intervals are {_interval_kind(done)}.")
    for kind, messages in (
        ("warning", [message for result in results for message in result.warnings]),
        ("FAILED", [result.failure for result in results if result.status == "failed"]),
        ("SKIPPED", [result.failure for result in results if result.status == "skipped"]),
    ):
        for message, times in Counter(" ".join(text.split()) for text in messages).items():
            where = f" ({times} of {len(results)} splits)" if len(results) > 1 else ""
            notes.append(f"{name}: {kind}{where}: {message}")
    return notes


def _mean_diagnostics(done: Sequence[CellResult]) -> list[str]:
    """Return each number's mean; fits that chose different options report different numbers."""
    numbers = []
    for key in dict.fromkeys(key for result in done for key in result.diagnostics):
        values = [result.diagnostics[key] for result in done if key in result.diagnostics]
        some = "" if len(values) == len(done) else f" (in {len(values)} of {len(done)} splits)"
        numbers.append(f"{key} {_mean_text(values)}{some}")
    return numbers


def _chosen_notes(name: str, done: Sequence[CellResult]) -> list[str]:
    """Return which options the fits chose, and in how many splits each; none where none did."""
    choices = Counter(in_words(result.chosen) for result in done if result.chosen)
    each = [
        f"{chosen} ({times} of {len(done)} splits)" if len(done) > 1 else chosen
        for chosen, times in choices.items()
    ]
    return [f"{name}: options chosen by inner cross-validation: {'; '.join(each)}."] if each else []


def _source_notes(results: Sequence[CellResult]) -> list[str]:
    """Return what the model's source domain is; none where it has none."""
    shown = results[0].shown
    return [f"{shown.model}: source domain: {shown.source}."] if shown.source else []


def _label_notes(name: str, done: Sequence[CellResult]) -> list[str]:
    """Return how many of the training samples the fits learned from, where not from all."""
    some = [result for result in done if 0 < result.n_labels < result.n_train]
    if not some:
        return []
    labels = _range(tuple(result.n_labels for result in some))
    of_all = _range(tuple(result.n_train for result in some))
    return [f"{name}: trained on {labels} of {of_all} samples; the others choose the epoch."]


def _mean_text(values: Sequence[float]) -> str:
    """Return a mean for people; an infinite value (a joint found rigid) is counted apart."""
    finite = [value for value in values if not math.isinf(value)]
    if len(finite) == len(values) or not finite:
        return f"{float(np.mean(values)):.4g}"
    n_infinite = len(values) - len(finite)
    return f"{float(np.mean(finite)):.4g} (and infinite in {n_infinite} of {len(values)})"


def _interval_kind(results: Sequence[CellResult]) -> str:
    counts = sorted({result.calibration_samples for result in results})
    if counts[-1] == 0:
        return "the model's own"
    of_splits = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"split-conformal, with {of_splits} calibration samples"
