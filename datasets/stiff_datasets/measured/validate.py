"""The report on a file of measured samples: what is wrong, what to look at, what it holds."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiff_datasets.measured.data_checks import (
    Finding,
    Lines,
    duplicate_findings,
    fact,
    outlier_findings,
    range_findings,
    repeat_findings,
    residuals_and_outliers,
    warning,
)
from stiff_datasets.measured.frame_check import BetterReading, better_reading, squared_residuals
from stiff_datasets.measured.identifiability import identifiability, regressor
from stiff_datasets.measured.measured import check_file
from stiff_datasets.measured.sample_checks import Problem
from stiff_datasets.measured.sample_files import MM_PER_M, file_units, joint_columns
from stiff_datasets.robots.robot import ChainModel, robot_of
from stiff_protocols.contract.errors import DataError, ModelError
from stiff_protocols.contract.interfaces import ReportsDiagnostics, StiffnessModel
from stiff_protocols.contract.types import FloatArray, Robot, Samples

EXPLAINS_LITTLE = 0.85
"""Share of the squared deflection; joint springs explain 0.95 of the FANUC measurement and at least
0.94 of ten specimens each of the shipped twins."""
ROWS_SHOWN = 10
TIES_SHOWN = 3
MISSES_SHOWN = 5
WIDTH = 100


@dataclass(frozen=True)
class ValidationReport:
    """What was found in a file.

    Attributes:
        path: the file.
        errors: why it cannot be used; if there are any, nothing else was looked at.
        warnings: what to look at.
        facts: what it holds.
    """

    path: Path
    errors: tuple[Finding, ...]
    warnings: tuple[Finding, ...]
    facts: tuple[Finding, ...]


def validate(path: Path, chain: ChainModel, model: StiffnessModel) -> ValidationReport:
    """Check a file of measured samples.

    Args:
        path: the file; Parquet if it ends in .parquet, else CSV.
        chain: the robot that was measured.
        model: a reference model, not fitted, such as the linear virtual joint model; it is fitted
            again and again.
    """
    robot = robot_of(chain)
    try:
        checked = check_file(path, robot)
    except DataError as error:
        message = str(error).removeprefix(f"{path}: ")
        return ValidationReport(path, (Finding("error", message),), (), ())
    if checked.samples is None:
        return ValidationReport(path, tuple(_error_findings(checked.problems)), (), ())
    samples, lines = checked.samples, checked.rows
    found = [
        *_content_findings(samples, robot),
        *duplicate_findings(samples, robot, lines),
        *range_findings(samples, lines),
        *repeat_findings(samples, robot, lines),
        *_identifiability_findings(samples, chain),
        *_model_findings(samples, robot, lines, model),
    ]
    return ValidationReport(
        path,
        errors=(),
        warnings=tuple(each for each in found if each.level == "warning"),
        facts=tuple(each for each in found if each.level == "fact"),
    )


def _error_findings(problems: Sequence[Problem]) -> Iterator[Finding]:
    """Gather what is wrong in the same way in one column: one finding for an empty column."""
    groups: dict[tuple[str | None, str], list[Problem]] = {}
    for problem in problems:
        groups.setdefault((problem.column, problem.valid), []).append(problem)
    for (column, valid), alike in groups.items():
        rows = tuple(problem.row for problem in alike if problem.row is not None)
        others = " and others" if len({problem.value for problem in alike}) > 1 else ""
        together = f"column {column}: {alike[0].value!r}{others}, expected {valid}"
        yield Finding("error", together if len(rows) > 1 else str(alike[0]), rows)


def render_report(report: ValidationReport) -> str:
    """Return the report as plain text; the first line is the verdict."""
    sections = [
        _section("Errors", report.errors),
        _section("Warnings", report.warnings),
        _section("Facts", report.facts),
    ]
    if report.errors:
        sections.append(["Nothing else was looked at; mend the errors first."])
    lines = [
        _verdict(report),
        *(line for section in sections if section for line in ["", *section]),
    ]
    return "\n".join(lines) + "\n"


def _content_findings(samples: Samples, robot: Robot) -> Iterator[Finding]:
    tcp = ", ".join(f"{length:g}" for length in robot.tcp)
    yield fact("robot", f"{robot.name}, TCP ({tcp}) m in its last joint's frame")
    n_poses, n = len(set(samples.pose_id)), len(samples)
    loads = f"{n_poses} poses, " + (
        "one load a pose" if n_poses == n else f"{n / n_poses:.3g} loads a pose on average"
    )
    groups, counts = np.unique(samples.group, return_counts=True)
    yield fact("samples", f"{n}, {loads}")
    yield fact("groups", ", ".join(f"{g} ({c})" for g, c in zip(groups, counts, strict=True)))
    yield fact("force", f"{_range(samples.wrench[:, :3])} N")
    if samples.wrench[:, 3:].any():
        yield fact("torque", f"{_range(samples.wrench[:, 3:])} N m")
    else:
        yield fact("torque", "all zero, so the load is taken to act at the TCP")
    yield fact("deflection", f"{_range(samples.deflection * MM_PER_M)} mm")
    units, q = file_units(robot), samples.q * file_units(robot)
    for i, column in enumerate(joint_columns(robot)):
        unit = column.rpartition("_")[2]
        limits = f"{robot.lower[i] * units[i]:.4g} to {robot.upper[i] * units[i]:.4g}"
        used = f"{q[:, i].min():.4g} to {q[:, i].max():.4g} {unit}"
        yield fact(f"joint {robot.joint_names[i]}", f"{used} (limits {limits})")


def _identifiability_findings(samples: Samples, chain: ChainModel) -> Iterator[Finding]:
    if not samples.wrench.any():
        return
    names = tuple(chain.model.names)[1:]
    found = identifiability(regressor(chain, samples.q, samples.wrench), names)
    if found.unidentifiable:
        yield warning(
            f"the stiffness of joint {', '.join(found.unidentifiable)} cannot be identified: the "
            "loads do not turn it, or not apart from another joint",
        )
    condition = f", condition number {found.condition:.3g}" if found.rank == len(names) else ""
    yield fact("identifiable", f"rank {found.rank} of {len(names)} joint springs{condition}")


def _model_findings(
    samples: Samples, robot: Robot, lines: Lines, model: StiffnessModel
) -> Iterator[Finding]:
    """Compare the data with the reference model: frame of the wrench, fit, outliers."""
    try:
        better = better_reading(samples, robot, model)
        if better:  # every row is wrong, so none is an outlier
            residual_mm = squared_residuals(samples, robot, model, samples.wrench) ** 0.5 * MM_PER_M
            odd = np.zeros(len(samples), dtype=bool)
        else:
            residual_mm, odd = residuals_and_outliers(samples, robot, model)
    except ModelError as error:
        yield warning(f"the reference model cannot be fitted: {error}")
        return
    if better:
        yield warning(_better_in_words(better))
    squares = (residual_mm[~odd] ** 2).sum()
    measured = ((samples.deflection[~odd] * MM_PER_M) ** 2).sum()
    explained = max(1.0 - squares / measured, 0.0) if measured else 0.0
    rms_mm = np.sqrt(squares / (~odd).sum())
    without = ", outliers left out" if odd.any() else ""
    yield fact(
        "joint springs",
        f"{explained:.1%} of the squared deflection explained, residual {rms_mm:.3g} mm RMS"
        f"{without}",
    )
    if explained < EXPLAINS_LITTLE and not better:
        yield warning(
            f"joint springs explain only {explained:.0%} of the squared deflection, and no other "
            "sign or frame of the wrench explains much more; check units, joint angles, TCP and "
            "the frame of the deflection",
        )
    worst = np.argsort(-residual_mm)[:MISSES_SHOWN]
    listed = ", ".join(f"row {lines[i]} {residual_mm[i]:.3g}" for i in worst)
    yield fact("largest misses", f"{listed} mm (median {np.median(residual_mm):.3g})")
    if isinstance(model, ReportsDiagnostics):
        yield _springs(model)
    yield from outlier_findings(lines, residual_mm, odd)


def _springs(model: ReportsDiagnostics) -> Finding:
    """Return the joint stiffnesses that were identified: an engineer sees a wrong unit in them."""
    told, units = [], []
    for key, value in model.diagnostics_.items():
        if key.startswith("stiffness "):
            name, _, unit = key.removeprefix("stiffness ").rstrip("]").partition(" [")
            told.append(f"{name} {value:.2g}")
            units.append(unit)
    return fact(f"k [{'/'.join(dict.fromkeys(units))}]", ", ".join(told))


def _better_in_words(better: BetterReading) -> str:
    ties = ""
    if better.ties:
        more = len(better.ties) - TIES_SHOWN
        ties = "; these data cannot tell that from: " + "; ".join(better.ties[:TIES_SHOWN])
        ties += f"; and {more} more" if more > 0 else ""
    rms_mm, given_mm = better.rms * MM_PER_M, better.rms_as_given * MM_PER_M
    return (
        f"wrong frame or sign? The data fit much better as {better.name}: residual {rms_mm:.3g} mm "
        f"RMS instead of {given_mm:.3g} mm{ties}"
    )


def _verdict(report: ValidationReport) -> str:
    n_errors = sum(max(1, len(error.rows)) for error in report.errors)
    n_warnings = len(report.warnings)
    if n_errors:
        return f"{report.path}: NOT valid, {n_errors} error{'s' * (n_errors > 1)}"
    counted = f", {n_warnings} warning{'s' * (n_warnings > 1)}" if n_warnings else ""
    return f"{report.path}: valid{counted}"


def _section(title: str, findings: Sequence[Finding]) -> list[str]:
    if not findings:
        return []
    if title != "Facts":
        items = [("-", finding.message + _rows(finding)) for finding in findings]
    else:
        parts = (finding.message.partition(": ") for finding in findings)
        items = [(name, value) for name, _, value in parts]
    width = max(len(head) for head, _ in items)
    lines = [title]
    for head, text in items:
        start = f"  {head:<{width}} "
        lines += textwrap.wrap(
            text,
            WIDTH,
            initial_indent=start,
            subsequent_indent=" " * len(start),
            break_long_words=False,
            break_on_hyphens=False,
        )
    return lines


def _rows(finding: Finding) -> str:
    """Say in which rows, unless the message does; rows that follow each other as "2-152"."""
    rows = finding.rows
    if not rows or f"row {rows[0]}" in finding.message:
        return ""
    runs: list[list[int]] = []
    for row in rows:
        if runs and row == runs[-1][-1] + 1:
            runs[-1][1:] = [row]
        else:
            runs.append([row])
    listed = ", ".join("-".join(map(str, run)) for run in runs[:ROWS_SHOWN])
    hidden = len(rows) - sum(run[-1] - run[0] + 1 for run in runs[:ROWS_SHOWN])
    more = f" and {hidden} more" if hidden else ""
    return f" (row{'s' * (len(rows) > 1)} {listed}{more})"


def _range(vectors: FloatArray) -> str:
    size = np.linalg.norm(vectors, axis=1)
    return f"{size.min():.4g} to {size.max():.4g}"
