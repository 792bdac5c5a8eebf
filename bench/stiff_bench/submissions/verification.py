"""Verify a submission without running its code in this process."""

from __future__ import annotations

import random
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from stiff_bench.paper.study_file import Study
from stiff_bench.plan.cells import CellTask
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.cell import fit_input, reference_values
from stiff_bench.store.names import Variant
from stiff_bench.submissions.card import read_card
from stiff_bench.submissions.published_results import Place, place_of
from stiff_bench.submissions.record import Record, record_metrics
from stiff_bench.submissions.refit import Request, recompute, study_tasks
from stiff_bench.submissions.submission import (
    CARD,
    RECORDS,
    Outcome,
    Submission,
    read_manifest,
    read_records,
    wrong_files,
)
from stiff_bench.tables.units import MM, counted, first_few
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import TRUTHS, FloatArray, Prediction

METRIC_TOLERANCE = 1e-9
"""Largest relative difference of a metric that is rounding."""
SAME_MM = 1e-6
"""Largest difference between predictions that is rounding, mm."""
REFIT_TOLERANCE = 0.1
"""Largest RMS difference between predictions, relative to the RMS error, that another processor
may explain: networks round differently there."""
MAX_BETTER = 0.03
"""Largest share by which the stated mean 3-D error may be lower than the one of the code: other
rounding makes predictions different, not better."""
MIN_NOISE_RATIO = 0.6
"""Smallest RMS error relative to the instrument's noise; the noise is in every test label, so that
even the true robot scores about 1."""
MAX_NOISE_Z = 4.0
"""Largest z value of the agreement between predictions and the noise of the test labels."""
MIN_POSES = 20
"""For that z value."""
MIN_REFITS = 2
DEFAULT_SHARE = 0.1
"""Share of the fits that are computed again."""

Status = Literal["ok", "failed", "not verified"]


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Attributes:
        status: "failed" refuses the submission.
        subject: subject of the check in one or two words.
        text: result or reason.
    """

    status: Status
    subject: str
    text: str

    def __str__(self) -> str:
        """Return the check as a line of text."""
        return f"{self.status:<12}  {self.subject}: {self.text}"


@dataclass(frozen=True)
class Refits:
    """The choice and the limits of the fits to compute again.

    Attributes:
        seed: seed of the choice.
        share: share of all fits; at least two fits are chosen.
        timeout_s, memory_bytes: limits per fit.
        jobs: number of parallel fits.
    """

    seed: int
    share: float = DEFAULT_SHARE
    timeout_s: float = 600.0
    memory_bytes: int = 4 * 2**30
    jobs: int = 1


def outcome_of(checks: Sequence[Check]) -> Outcome:
    """Return the outcome of all checks."""
    statuses = {check.subject: check.status for check in checks}
    if "failed" in statuses.values():
        return "refused"
    return "verified" if statuses.get("code") == "ok" else "reported"


def verify(folder: Path, study: Study, refits: Refits) -> Iterator[Check]:
    """Yield each check of a submission, until one fails.

    Raises:
        ConfigError: the folder holds no submission.
    """
    manifest = read_manifest(folder)
    if problems := wrong_files(folder, manifest):
        yield Check("failed", "files", first_few(problems))
        return
    n_files = counted(len(manifest.files), "file")
    yield Check("ok", "files", f"{n_files} with the hashes of the manifest")
    try:
        submission = Submission(
            folder, manifest, read_card(folder / CARD), read_records(folder / RECORDS)
        )
    except StiffBenchError as error:
        yield Check("failed", "schema", str(error))
        return
    key = Variant.of_word(submission.card.model).key
    if Variant.of_word(manifest.model).key != key:
        yield Check("failed", "schema", f"the card is of {key}, the manifest of {manifest.model}")
        return
    n_records = counted(len(submission.records), "record")
    yield Check("ok", "schema", f"card and {n_records} are complete")
    if manifest.study != study.name:
        yield Check("failed", "study", f"{manifest.study}, not {study.name}")
        return
    tasks = {
        place_of(task.cell, task.presentation): task
        for task in study_tasks(study, manifest.scope, REFERENCE_MODEL, build_registry())
    }
    for check in (check_splits, check_metrics, check_labels):
        checked = check(submission, tasks)
        yield checked
        if checked.status == "failed":
            return
    yield from check_code(submission, study, refits)
    yield Check("not verified", "cost", "fit times and memory are of the submitter's machine")
    claims = f"tuned on: {submission.card.tuned_on}; hardware: {submission.card.hardware}"
    yield Check("not verified", "card", claims)


def place_of_record(record: Record) -> Place:
    """Return the split of the study that a record belongs to."""
    return record.dataset, record.protocol, record.condition, record.seed, record.split_index


def check_splits(submission: Submission, tasks: Mapping[Place, CellTask]) -> Check:
    """Check that the records are the fits of the study: data, rows, seeds and model."""
    problems: list[str] = []
    counts = Counter(map(place_of_record, submission.records))
    problems += [f"{place}: {n} records" for place, n in counts.items() if n > 1]
    problems += [f"{place}: not in the study" for place in counts if place not in tasks]
    problems += [f"{place}: no record" for place in tasks if place not in counts]
    versions = {record.model_version for record in submission.records}
    if len(versions) > 1:
        problems.append(f"records of {len(versions)} versions of the model")
    for record in submission.records:
        if (task := tasks.get(place_of_record(record))) is not None:
            reason = _difference(record, submission.manifest.model, task)
            problems += [f"{record.place_text}: {reason}"] if reason else []
    if problems:
        return Check("failed", "splits", first_few(problems))
    n_fits = counted(len(tasks), "fit")
    version = f"study {submission.manifest.study}, {submission.manifest.scope}"
    return Check("ok", "splits", f"data, rows and seeds of {n_fits} are as in the {version}")


def _difference(record: Record, model: str, task: CellTask) -> str:
    """Return why a record is not of a fit of the study; "": it is."""
    rows, samples = task.split.reported, task.data.samples
    if record.status != "ok":
        return f"the fit {record.status}: {record.failure}"
    if record.model != model:
        return f"of the model {record.model}, not {model}"
    if record.data_sha256 != task.cell.data_sha256:
        return "other data"
    if record.split_sha256 != task.cell.split_sha256 or record.rows != rows.tolist():
        return "other rows than in the split"
    if len(record.predicted_mm) != len(rows) or len(record.measured_mm) != len(rows):
        return f"{len(record.predicted_mm)} predictions for {len(rows)} rows"
    if not np.allclose(record.measured, samples.deflection[rows], rtol=0.0, atol=1e-12):
        return "other measured deflections than in the data"
    if record.n_train != len(task.training_rows):
        return f"{record.n_train} training samples, not {len(task.training_rows)}"
    return ""


def check_metrics(submission: Submission, tasks: Mapping[Place, CellTask]) -> Check:
    """Check the metrics: recomputed from the predictions and the deflections of the data."""
    problems = []
    for record in submission.records:
        metrics = record_metrics(_prediction(record, tasks[place_of_record(record)]))
        names = sorted(metrics.keys() | record.metrics.keys())
        for name in names:
            value, stated = metrics.get(name, np.nan), record.metrics.get(name, np.nan)
            if not np.isclose(value, stated, rtol=METRIC_TOLERANCE, atol=METRIC_TOLERANCE):
                problems.append(f"{record.place_text}: {name} is {value:.6g}, not {stated:.6g}")
                break
    if problems:
        return Check("failed", "metrics", first_few(problems))
    return Check("ok", "metrics", "recomputed from the predictions, the same")


def _prediction(record: Record, task: CellTask) -> Prediction:
    """Return the predictions of a record with the deflections of the data."""
    rows, bounds = task.split.reported, task.data.bound_deflections
    return Prediction(
        rows=rows,
        predicted=record.predicted,
        measured=task.data.samples.deflection[rows],
        reference=reference_values(task, fit_input(task)),
        bound_deflections={name: bounds[name][rows] for name in TRUTHS if name in bounds},
    )


def check_labels(submission: Submission, tasks: Mapping[Place, CellTask]) -> Check:
    """Check that the predictions are independent of the noise of the test labels.

    The noise is known of simulated data. An honest model cannot predict it. So its RMS error is
    not below the RMS noise, and the cosine between its deviation from the truth and the noise is
    zero on average over poses. Copied labels agree with the noise, also if they are mixed with a
    model's predictions.
    """
    cosines: dict[tuple[str, str], float] = defaultdict(float)
    problems, unknown = [], set[str]()
    for record in submission.records:
        task = tasks[place_of_record(record)]
        rows, samples = task.split.reported, task.data.samples
        if "noise" not in task.data.bound_deflections:
            unknown.add(record.dataset)
            continue
        truth = task.data.bound_deflections["noise"][rows]
        noise, deviation = samples.deflection[rows] - truth, record.predicted - truth
        ratio = _rms(deviation - noise) / _rms(noise)
        if ratio < MIN_NOISE_RATIO:
            problems.append(
                f"{record.place_text}: RMS error is {ratio:.2f} of the instrument noise, which no "
                f"model reaches without the test labels (at least {MIN_NOISE_RATIO:g})"
            )
        lengths = np.linalg.norm(deviation, axis=1) * np.linalg.norm(noise, axis=1)
        products = (deviation * noise).sum(axis=1)
        row_cosines = np.divide(products, lengths, out=np.zeros(len(rows)), where=lengths > 0.0)
        for pose, cosine in zip(samples.pose_id[rows], row_cosines, strict=True):
            cosines[record.data_sha256, str(pose)] += float(cosine)
    per_pose = np.array([*cosines.values()])  # the noise of a pose is the same in all splits
    z = float(per_pose.sum() / np.sqrt((per_pose**2).sum())) if per_pose.any() else 0.0
    if len(per_pose) >= MIN_POSES and z > MAX_NOISE_Z:
        problems.append(
            f"predictions agree with the noise of the test labels: z = {z:.1f} over "
            f"{counted(len(per_pose), 'pose')} (at most {MAX_NOISE_Z:g})"
        )
    if problems:
        return Check("failed", "labels", first_few(problems))
    if not len(per_pose):
        return Check("not verified", "labels", "the noise of these data is unknown")
    except_for = f"; unknown of {first_few(sorted(unknown))}" if unknown else ""
    text = f"predictions are independent of the noise of the test labels (z = {z:.1f}){except_for}"
    return Check("ok", "labels", text)


def _rms(errors: FloatArray) -> float:
    """Return the root mean square length of (n, 3) vectors."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def check_code(submission: Submission, study: Study, refits: Refits) -> Iterator[Check]:
    """Check a random part of the fits: computed again from the code, in other processes."""
    records = sorted(submission.records, key=place_of_record)
    number = min(len(records), max(MIN_REFITS, round(refits.share * len(records))))
    chosen = random.Random(refits.seed).sample(records, number)
    which = f"{number} of {counted(len(records), 'fit')} (seed {refits.seed})"
    with tempfile.TemporaryDirectory(prefix="bench-verify-") as folder:
        request = Request(
            study=study.word,
            scope=submission.manifest.scope,
            model=submission.manifest.model,
            plugin=submission.plugin.resolve(),
            places=[place_of_record(record) for record in chosen],
            output=Path(folder) / "runs",
            timeout_s=refits.timeout_s,
            memory_bytes=refits.memory_bytes,
            jobs=refits.jobs,
        )
        try:
            results = recompute(request)
        except StiffBenchError as error:
            yield Check("failed", "code", f"{which} could not be computed again: {error}")
            return
    yield from compare_fits(chosen, results, which)
    n_left = len(records) - len(chosen)
    if n_left:
        text = f"{n_left} were not computed again, so their path errors are as stated"
        yield Check("not verified", "other fits", text)


def compare_fits(
    records: Sequence[Record], results: Sequence[CellResult], which: str
) -> Iterator[Check]:
    """Yield the check of fits that were computed again: predictions, path errors and version."""
    computed = {place_of(result.cell, result.presentation): result for result in results}
    problems, skipped, rounded = list[str](), list[str](), list[float]()
    stated_mm, computed_mm = 0.0, 0.0
    for record in records:
        result = computed.get(place_of_record(record))
        if result is not None and result.status == "skipped":
            skipped.append(result.failure)
            continue
        reason, difference = _refit_difference(record, result)
        if reason:
            problems.append(f"{record.place_text}: {reason}")
        elif result is not None:
            stated_mm += record.metrics["norm_mm"]
            computed_mm += Record.of(result, {}).metrics["norm_mm"]
            rounded += [difference] if difference else []
    better = 1.0 - stated_mm / computed_mm if computed_mm else 0.0
    if better > MAX_BETTER:
        problems.append(
            f"the stated 3-D error is {better:.0%} lower than the error of the code (at most "
            f"{MAX_BETTER:.0%})"
        )
    if problems:
        yield Check("failed", "code", f"{which} computed again: {first_few(problems)}")
    elif skipped:
        yield Check("not verified", "code", f"cannot be run here: {first_few([*set(skipped)])}")
    else:
        same = "same predictions and path errors"
        close = f"same within {REFIT_TOLERANCE:.0%} of the RMS error"
        yield Check("ok", "code", f"{which} computed again: {close if rounded else same}")
        if rounded:
            text = f"of predictions up to {max(rounded):.2g} mm apart (another processor?)"
            yield Check("not verified", "last digits", text)


def _refit_difference(record: Record, result: CellResult | None) -> tuple[str, float]:
    """Return why a fit differs ("": it does not), and the largest difference in mm beyond rounding.

    Stated path errors may differ as much as predictions do.
    """
    if result is None or result.prediction is None:
        return ("no result" if result is None else f"failed: {result.failure}"), 0.0
    if result.cell.model_version != record.model_version:
        return "the records were computed with other code", 0.0
    predicted = result.prediction.predicted
    if predicted.shape != record.predicted.shape:
        return "another number of predictions", 0.0
    computed = Record.of(result, {})
    difference = np.abs(predicted - record.predicted)
    relative = _rms(predicted - record.predicted) / _rms(predicted - record.measured)
    largest = MM * float(difference.max())
    if largest > SAME_MM and not relative <= REFIT_TOLERANCE:
        return f"predictions differ by up to {largest:.2g} mm, {relative:.0%} of the RMS error", 0.0
    stated, path_error = record.path_error_mm, computed.path_error_mm
    if (stated is None) != (path_error is None):
        return f"path error {path_error}, not {stated} mm", 0.0
    if stated is not None and path_error is not None:
        apart = abs(path_error - stated)
        if apart > SAME_MM and apart > REFIT_TOLERANCE * path_error:
            return f"path error {path_error:.4g} mm, not {stated:.4g} mm", 0.0
        largest = max(largest, apart)
    return "", largest if largest > SAME_MM else 0.0
