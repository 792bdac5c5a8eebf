"""Write notes on stored results: sources, left-out results, and reports of fits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from stiff_bench.results.load import Task
from stiff_bench.store.names import SHORT, grouped, labels
from stiff_bench.store.samples import StoredData, what_differs
from stiff_bench.tables.units import counted, first_few, percent
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.plugin import in_words
from stiff_protocols.contract.record import FitResult, Presentation, RunManifest

SELECTION_MARK = "epoch picked on test part"
TRAINING_MARK = "training samples among those reported"
NO_MANIFEST = "a run without a manifest"


def mark_of(presentation: Presentation) -> str:
    """Return the mark printed next to the model's name; "" for none."""
    picked = SELECTION_MARK if presentation.picked_on_test else ""
    trained_on = TRAINING_MARK if presentation.reports_training else ""
    return ", ".join(filter(None, [presentation.regime, picked, trained_on]))


# tasks


def same_name_other_data(
    tasks: Sequence[Task],
    data_of: Callable[[str], StoredData],
    outcome: str = "they are never compared",
) -> Iterator[str]:
    """Yield a line per data set name that is used for different data.

    Source domains of tasks are checked in the same way. `data_of` returns the data with a hash; it
    raises StoreError if they are not stored. `outcome` ends the line.
    """
    of_dataset = grouped(sorted(tasks, key=lambda t: t.newest_run), lambda task: task.name.dataset)
    for dataset, dataset_tasks in sorted(of_dataset.items()):
        # the newest hash is the last
        hashes = {task.measured_sha256: task.name.data_sha256 for task in dataset_tasks}
        what = "data or TCP"
        if len(hashes) > 1:
            with suppress(StoreError):
                what = what_differs([data_of(sha256) for sha256 in hashes.values()])
        yield from _several(dataset, f"data here: {what}", hashes, outcome)
    names = labels(task.name for task in tasks)
    for dataset_tasks in grouped(tasks, lambda task: replace(task.name, source_sha256="")).values():
        sources = {task.name.source_sha256 for task in dataset_tasks}
        name = names[dataset_tasks[0].name]
        yield from _several(name, "pre-training data here", sorted(sources), outcome)


def _several(name: str, what: str, hashes: Collection[str], outcome: str) -> Iterator[str]:
    if len(hashes) > 1:
        short = ", ".join(sha256[:SHORT] for sha256 in hashes)
        yield f"{name} is the name of different {what} ({short}); {outcome}."


def left_out_notes(tasks: Sequence[Task]) -> Iterator[str]:
    """Yield a line per reason why results of these tasks do not count."""
    names = labels(task.name for task in tasks)
    reasons = [(reason, names[task.name]) for task in tasks for reason in task.left_out]
    for reason, pairs in grouped(reasons, lambda pair: pair[0]).items():
        places = list(dict.fromkeys(place for _, place in pairs))
        where = places[0] if len(places) == 1 else f"{len(places)} comparisons"
        yield f"{where}: {reason} are left out."


def caveats_of(tasks: Iterable[Task]) -> list[str]:
    """Return warnings and caveats of the tasks' protocols and data sets, without repeats."""
    texts = [task.presentation for task in tasks]
    caveats = [caveat for of_task in texts for caveat in of_task.caveats]
    return [*filter(None, dict.fromkeys([*(of_task.warning for of_task in texts), *caveats]))]


# runs


def sources(folder: Path, runs: Sequence[RunManifest], n_results: Mapping[str, int]) -> str:
    """Return a line that names the versions and commits that made results of a folder.

    `n_results` maps a run's id to the number of its results that are shown.
    """
    versions = {run.run_id: version_of_run(run) for run in runs}
    counts = Counter[str]()
    for run_id, count in n_results.items():
        counts[versions.get(run_id, NO_MANIFEST)] += count
    several = len(counts) > 1
    made = ", ".join(f"{name} ({n})" if several else name for name, n in sorted(counts.items()))
    return f"{counts.total()} results of {folder}, made by {made}."


def version_of_run(run: RunManifest) -> str:
    """Return version and commit of stiffbench."""
    facts = run.environment
    commit = facts.get("commit", "")[:SHORT]
    changed = " with uncommitted changes" if facts.get("dirty") == "true" else ""
    at = f" at {commit}{changed}" if commit else ""
    return f"stiffbench {facts.get('stiffbench', 'of an unknown version')}{at}"


def outdated_models(results: Iterable[FitResult]) -> list[str]:
    """Return the shipped models with results of an earlier version.

    Third-party models are omitted: their versions are not plain numbers.
    """
    today = {info.key: str(info.version) for info in MODELS}
    of_fits = {(result.fit.model, result.fit.model_version) for result in results}
    numbered = {(key, version) for key, version in of_fits if version.isdecimal()}
    return sorted({key for key, version in numbered if today.get(key, version) != version})


# fits


def size_notes(results: Sequence[FitResult]) -> list[str]:
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
    trained, tested = map(span_text, zip(*sizes, strict=True))
    if results[0].presentation.reports_training:
        return [f"a split trains on {trained} samples and reports {tested}, including these."]
    of_paths = " points of tool paths" if results[0].presentation.measured_sha256 else ""
    trains = f"a split trains on {trained} samples, validation included, and tests on {tested}"
    return [f"{trains}{of_paths}."]


def span_text(numbers: Iterable[int]) -> str:
    """Return "5", or "5 to 10" if numbers differ."""
    sizes = [*numbers]
    return " to ".join(map(str, sorted({min(sizes), max(sizes)})))


def number_notes(results: Sequence[FitResult]) -> list[str]:
    """Return a note with the mean diagnostics of a model's fits; none without diagnostics."""
    done = [result.diagnostics for result in results if result.status == "ok"]
    means = {
        key: np.mean([numbers[key] for numbers in done if key in numbers])
        for key in dict.fromkeys(key for numbers in done for key in numbers)
    }
    over = f" (means over {len(done)} splits)" if len(done) > 1 else ""
    text = ", ".join(f"{key} {mean:.4g}" for key, mean in means.items())
    return [f"{results[0].presentation.model}{over}: {text}."] if means else []


def outcome_notes(results: Sequence[FitResult]) -> list[str]:
    """Return notes on chosen options, intervals and warnings."""
    presentation, coverage = results[0].presentation, results[0].fit.coverage
    done = [result for result in results if result.status == "ok"]
    notes = [f"source domain: {presentation.source}."] if presentation.source else []
    choices = Counter(in_words(result.chosen) for result in done if result.chosen)
    if choices:
        choice_texts = "; ".join(f"{choice}{_times(n, done)}" for choice, n in choices.items())
        notes.append(f"options chosen by inner cross-validation: {choice_texts}.")
    if partly_labelled := [result for result in done if 0 < result.n_labels < result.n_train]:
        labels = span_text(result.n_labels for result in partly_labelled)
        of_all = span_text(result.n_train for result in partly_labelled)
        notes.append(f"trained on {labels} of {of_all} samples; the others choose the epoch.")
    if coverage is not None and any(r.prediction and r.prediction.interval for r in done):
        samples = span_text(result.calibration_samples for result in done)
        split_conformal = f"split-conformal, with {samples} calibration samples"
        kind = "the model's own" if samples == "0" else split_conformal
        notes.append(f"{percent(coverage)} intervals are {kind}.")
    messages = Counter(" ".join(text.split()) for result in results for text in result.warnings)
    notes += [f"warning{_times(n, results)}: {text}" for text, n in messages.items()]
    return [f"{presentation.model}: {note}" for note in notes]


def _times(n: int, results: Sequence[FitResult]) -> str:
    return f" ({n} of {len(results)} splits)" if len(results) > 1 else ""


def failure_lines(results: Iterable[FitResult]) -> list[str]:
    """Return a line per reason for missing results, with the models."""
    alike: dict[tuple[str, str], list[str]] = {}
    for result in results:
        if result.status != "ok":
            reason = result.status.upper(), " ".join(result.failure.split())
            alike.setdefault(reason, []).append(result.presentation.model)
    return [
        f"{status}: {first_few([*dict.fromkeys(models)])} ({counted(len(models), 'fit')}): {reason}"
        for (status, reason), models in alike.items()
    ]
