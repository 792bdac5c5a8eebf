"""The report on a file of measured samples: what is wrong, what to look at, what it holds."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Literal

import numpy as np

from stiff_datasets.measured.data_card import read_card
from stiff_datasets.measured.diagnosis import (
    CLEARLY,
    UNUSUAL,
    Diagnosis,
    Fit,
    clearly_negative,
    diagnose,
    softness,
)
from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_datasets.measured.mistakes import Reading, compliances, reading
from stiff_datasets.measured.odd_rows import (
    FEWEST_SAMPLES,
    Finding,
    duplicate_findings,
    external_axis_findings,
    fact,
    range_findings,
    repeat_findings,
    warning,
)
from stiff_datasets.measured.outliers_and_drift import (
    Change,
    find_change,
    find_outliers,
    left_out_rms,
    outlier_findings,
)
from stiff_datasets.measured.row_checks import LIMIT_SLACK, NO_TORQUE_HINT, Problem, row_ranges
from stiff_datasets.measured.sample_columns import MM_PER_M, file_units, joint_columns
from stiff_datasets.measured.sample_file import (
    SMALL_UNITS,
    USUAL_DEFLECTION_MM,
    CheckedSamples,
    check_sheet,
)
from stiff_datasets.measured.sheet_files import read_sheet
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.screen import Screen
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples
from stiff_protocols.springs.identification import Identified, identify, typical_joints

EXPLAINS_LITTLE = 0.85
"""Share of the squared deflection; the data sets that are shipped have 0.93 and more."""
LOAD_UNITS = {
    "the forces and torques in kg and kg m": STANDARD_GRAVITY,
    "the forces in kN": 1000.0,
}
DEFLECTION_UNITS = {"m": 1 / 1000, "inch": 1 / 25.4, "cm": 1 / 10, **SMALL_UNITS}
"""Units in which a file may be -> how many times as compliant as it is they make a robot look."""
SAME_UNIT = 2.2
"""Units within this factor of the one that fits best are named, too: the shipped robots are 0.6 to
1.9 times as compliant as `softness` takes for usual."""
TIES_SHOWN = 2
LARGEST_SHOWN = 5
FEWEST_CURVE_POSES, MOST_CURVE_SAMPLES = 10, 200
WIDEST_TEXT = 100
"""Characters of a line of the report, where the terminal is not narrower."""


@dataclass(frozen=True)
class ValidationReport:
    """The findings in a file.

    Attributes:
        path: the file.
        errors: why it cannot be used, and a mistake that would explain them.
        warnings: what to look at.
        facts: what it holds.
    """

    path: Path
    errors: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    facts: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Literal["ok", "suspicious", "invalid"]:
        """Whether the file can be used, and should be."""
        if self.errors:
            return "invalid"
        return "suspicious" if self.warnings else "ok"

    def __repr__(self) -> str:
        """Return the report as plain text; the first line is the verdict."""
        lines = [
            _verdict(self),
            *_section("Errors", self.errors),
            *_section("Warnings", self.warnings),
            *_section("Facts", self.facts),
        ]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        problems = (*self.errors, *self.warnings)
        texts = [(finding.level, finding.message + _rows(finding)) for finding in problems]
        facts = [finding.message.partition(": ")[::2] for finding in self.facts]
        return Screen(_verdict(self), [*texts, *facts]).html()


LeftOutErrors = Callable[[Samples, Robot], FloatArray]
"""Returns (n, 3) errors [m] of a better model than linear springs at samples left out; or NaN."""


def validate(
    path: Path,
    robot: Robot,
    options: FileOptions = DEFAULTS,
    left_out_errors: LeftOutErrors | None = None,
) -> ValidationReport:
    """Check a file of measured samples.

    Args:
        path: the file; Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: that was measured.
        options: what is not in the file; a data card FILE.md next to it may say, too, that no
            torques were measured.
        left_out_errors: of springs with curves, for facts; None: there are none. It is called for
            10 poses or more and at most 200 samples.

    Raises:
        ConfigError: the file has no such sheet, or several with tables and none is asked for.
    """
    try:
        card = read_card(path)
        sheet = read_sheet(path, options.sheet)
        checked = check_sheet(sheet, robot, options)
    except DataError as error:
        message = str(error).removeprefix(f"{path}: ")
        return ValidationReport(path, (Finding("error", message),))
    samples, lines = checked.samples, checked.sheet.lines
    unfilled = [warning(str(checked.unfilled))] if checked.unfilled else []
    errors = [*_error_findings(checked.problems)]
    if samples is None and not errors:
        errors, unfilled = [replace(each, level="error") for each in unfilled], []
    if samples is None or errors:
        if message := _likely_cause(checked, robot):
            errors.append(Finding("error", message))
        return ValidationReport(path, tuple(errors), tuple(unfilled))
    data = reading(robot, samples.q, samples.wrench, samples.deflection)
    no_torque = options.no_torque or card.no_torque
    torques_missing = not no_torque and not data.torque.any()
    diagnosis = diagnose(samples, robot, may_fit=not torques_missing)
    change = _likely_change(data, lines, diagnosis)
    if change:
        deflection = samples.deflection - change.offset
        data = replace(data, deflection=deflection)
        undone = replace(samples, deflection=deflection)
        diagnosis = diagnose(undone, robot, may_fit=not torques_missing)
    if torques_missing and not _explains_little(diagnosis.given):
        diagnosis = Diagnosis(diagnosis.given)  # that is mistake enough
    pose = np.asarray(np.unique(samples.pose_id, return_inverse=True)[1])
    unused = ", ".join(checked.sheet.unused)
    noise = f"{card.instrument_noise * MM_PER_M:.3g} mm a deflection, as the data card states"
    found = [
        *unfilled,
        *(fact("read as", note) for note in checked.sheet.notes),
        *([fact("columns not used", unused)] if unused else []),
        *external_axis_findings(sheet, checked.sheet.unused, robot, lines),
        *_content_findings(samples, robot, no_torque),
        *([fact("instrument noise", noise)] if card.instrument_noise else []),
        *duplicate_findings(samples, checked.near_poses, lines),
        *range_findings(samples, lines),
        *repeat_findings(samples, robot, lines),
        *([warning(change.text, change.rows)] if change else []),
        *(_spring_findings(data, pose, diagnosis, lines) if data.regressor().any() else ()),
    ]
    is_affordable = FEWEST_CURVE_POSES <= len(np.unique(pose)) and len(pose) <= MOST_CURVE_SAMPLES
    if left_out_errors and is_affordable and not diagnosis.best and data.regressor().any():
        found.extend(_curve_facts(samples, left_out_errors(samples, robot), lines))
    warnings, facts = (
        tuple(each for each in found if each.level == level) for level in ("warning", "fact")
    )
    return ValidationReport(path, warnings=warnings, facts=facts)


def _likely_cause(checked: CheckedSamples, robot: Robot) -> str:
    """Return a mistake that would explain the errors of a file, "" for none."""
    samples, lines = checked.samples, checked.sheet.lines
    if samples is None:
        return ""
    beyond = np.maximum(robot.lower - samples.q, samples.q - robot.upper) * file_units(robot)
    joints_only = bool((beyond > LIMIT_SLACK).any())
    likely = diagnose(samples, robot, joints_only=joints_only)
    if likely.best:
        return _named(likely)
    wrong = [problem.row for problem in checked.problems if problem.row is not None]
    right = np.flatnonzero(~np.isin(lines, wrong))
    if joints_only or not len(right):
        return ""
    samples = samples.take(right)
    data = reading(robot, samples.q, samples.wrench, samples.deflection)
    return _unit_message(data, compliances(data))


def _likely_change(data: Reading, lines: IntArray, diagnosis: Diagnosis) -> Change | None:
    """Find a drift or a jump that explains more than the mistake of the diagnosis."""
    if not data.regressor().any():
        return None
    change = find_change(data, lines, find_outliers(data).odd)
    if change and diagnosis.best:
        undone = diagnosis.best.reading
        return change if change.rms < left_out_rms(undone, find_outliers(undone).odd) else None
    return change


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


def _content_findings(samples: Samples, robot: Robot, no_torque: bool) -> Iterator[Finding]:
    tcp = ", ".join(f"{length:g}" for length in robot.tcp_on_flange)
    yield fact("robot", f"{robot.name}, TCP ({tcp}) m in the frame of its last link")
    n_poses, n = len(set(samples.pose_id)), len(samples)
    loads = "one load" if n_poses == n else f"{n / n_poses:.3g} loads"
    loads = f"{n_poses} poses, {loads} per pose" + " on average" * (n_poses < n)
    groups, counts = np.unique(samples.group, return_counts=True)
    few = f"; fewer than {FEWEST_SAMPLES} hardly tell methods apart" if n < FEWEST_SAMPLES else ""
    yield fact("samples", f"{n}, {loads}{few}")
    yield fact("groups", ", ".join(f"{g} ({c})" for g, c in zip(groups, counts, strict=True)))
    yield fact("force", f"{_range(samples.wrench[:, :3])} N")
    if samples.wrench[:, 3:].any():
        yield fact("torque", f"{_range(samples.wrench[:, 3:])} N m")
    else:
        yield fact("torque", "all zero, so the load is taken to act at the TCP")
        if not samples.wrench.any():
            yield warning("every wrench is zero, so no stiffness can be identified")
        elif not no_torque:
            yield warning(
                "every torque is zero, which is right only if each force acted at the TCP; "
                f"{NO_TORQUE_HINT}"
            )
    yield fact("deflection", f"{_range(samples.deflection * MM_PER_M)} mm")
    units, q = file_units(robot), samples.q * file_units(robot)
    for i, column in enumerate(joint_columns(robot)):
        unit = column.rpartition("_")[2]
        limits = f"{robot.lower[i] * units[i]:.4g} to {robot.upper[i] * units[i]:.4g}"
        used = f"{q[:, i].min():.4g} to {q[:, i].max():.4g} {unit}"
        yield fact(f"joint {robot.joint_names[i]}", f"{used} (limits {limits})")


def _identified(data: Reading, pose: IntArray) -> Identified:
    """Identify joint springs as the virtual joint model does; `pose` (n,) numbers the poses."""
    matrix, typical = data.regressor(), typical_joints(data.robot)
    flat = matrix.reshape(-1, matrix.shape[2])
    return identify(flat, data.deflection.reshape(-1), typical, np.repeat(pose, 3))


def _spring_findings(
    data: Reading, pose: IntArray, diagnosis: Diagnosis, lines: IntArray
) -> Iterator[Finding]:
    """Compare the data with joint springs: mistakes, stiffnesses, outliers."""
    given, best = diagnosis.given, diagnosis.best
    if best:
        yield warning(_named(diagnosis))
    elif _explains_little(given):
        yield warning(
            f"joint springs explain only {given.explained:.0%} of the squared deflection, and none "
            "of the mistakes that were tried explains much more; check the robot, units, joint "
            "angles, TCP and frames"
        )
    if diagnosis.elsewhere:
        yield warning(_elsewhere_text(diagnosis.elsewhere))
    yield fact(
        "joint springs",
        f"{given.explained:.1%} of squared deflection explained, cross-validated; residual "
        f"{given.rms * MM_PER_M:.3g} mm RMS",
    )
    names = data.robot.joint_names
    identified = _identified(data, pose)
    unknown = [*compress(names, ~identified.known)]
    condition = "" if unknown else f", condition number {identified.condition:.3g}"
    yield fact("identifiable", f"rank {identified.rank} of {len(names)} joint springs{condition}")
    outliers = find_outliers(data)
    usual, usual_pose = data, pose
    if not best:  # else every row is wrong
        usual, usual_pose = data.take(~outliers.odd), pose[~outliers.odd]
    residual = data.deflection - data.regressor() @ compliances(usual)
    compliance = _identified(usual, usual_pose).compliance
    stiffness = [
        f"{name} {1.0 / each:.2g}" if each else f"{name} inf"
        for name, each in zip(names, compliance, strict=True)
    ]
    yield fact("k [Nm/rad, N/m]", ", ".join(compress(stiffness, identified.known)) or "none")
    if unknown:
        yield fact("k of the prior", ", ".join(compress(stiffness, ~identified.known)))
    if not best:  # else these would be its effects
        rigid = clearly_negative(usual) & (compliances(usual) == 0.0)
        vague = [*compress(names, ~identified.known & ~rigid)]
        if vague:
            yield warning(
                f"the stiffness of joint{'s' * (len(vague) > 1)} {', '.join(vague)} cannot be "
                "identified: the samples do not tell it from noise or from another joint; models "
                "take the prior's"
            )
        if rigid.any():
            yield warning(f"infinite or negative stiffness: {', '.join(compress(names, rigid))}")
        if message := _unit_message(data, compliance):
            yield warning(message)
    yield fact("largest residuals", _largest(residual, lines))
    if not best:
        yield from outlier_findings(lines, outliers)


def _curve_facts(samples: Samples, errors: FloatArray, lines: IntArray) -> list[Finding]:
    """Return what springs with curves leave; they show errors that linear springs hide."""
    if not np.isfinite(errors).all() or not samples.deflection.any():
        return []
    size = np.linalg.norm(errors, axis=1)  # m
    explained = 1.0 - float((size**2).sum() / (samples.deflection**2).sum())
    rms = float(np.sqrt(np.mean(size**2))) * MM_PER_M
    return [
        fact(
            "springs with curves",
            f"{explained:.1%} explained, cross-validated (gp-springs); residual {rms:.3g} mm RMS",
        ),
        fact("their largest residuals", _largest(errors, lines)),
    ]


def _largest(residual: FloatArray, lines: IntArray) -> str:
    """Return the rows of the longest of (n, 3) residuals, m."""
    size_mm = np.linalg.norm(residual, axis=1) * MM_PER_M
    worst = np.argsort(-size_mm)[:LARGEST_SHOWN]
    listed = ", ".join(f"row {lines[i]} {size_mm[i]:.3g}" for i in worst)
    return f"{listed} mm (median {np.median(size_mm):.3g})"


def _explains_little(given: Fit) -> bool:
    """Whether the share that is explained is below `EXPLAINS_LITTLE`, and not by chance."""
    allowed = (1.0 - EXPLAINS_LITTLE) * (given.reading.deflection**2).sum(axis=1)
    excess = given.squares - allowed  # (n,)
    return bool(excess.sum() > CLEARLY * np.sqrt(len(excess)) * excess.std())


def _named(diagnosis: Diagnosis) -> str:
    given, best = diagnosis.given, diagnosis.best
    assert best
    more = f"; as well: {'; '.join(diagnosis.ties[:TIES_SHOWN])}" if diagnosis.ties else ""
    return (
        f"{best.text}: explained {given.explained:.1%} -> {best.explained:.1%}, residual "
        f"{given.rms * MM_PER_M:.3g} -> {best.rms * MM_PER_M:.3g} mm RMS{more}"
    )


def _elsewhere_text(fits: Sequence[Fit]) -> str:
    """Return the sentence about a TCP or a force's point that is elsewhere; see `Diagnosis`."""
    given, *elsewhere = fits
    residuals = "; ".join(f"{fit.text}: {fit.rms * MM_PER_M:.3g} mm" for fit in elsewhere)
    return (
        "is the TCP or the force's point elsewhere? Springs about all axes leave "
        f"{given.rms * MM_PER_M:.3g} mm RMS, cross-validated; in the flange frame {residuals}. "
        "Check where the tool was measured and loaded, and whether its mount is stiff; models fit "
        "the point with tcp=fit or lever=fit"
    )


def _unit_message(data: Reading, compliance: FloatArray) -> str:
    """Compare the stiffnesses with what is usual: a wrong unit scales them all alike.

    "" if they are usual, or if nothing says what is.
    """
    factor = softness(data, compliance)
    if factor == 0.0 or 1.0 / UNUSUAL < factor < UNUSUAL:
        return ""
    size_mm = float(np.median(np.linalg.norm(data.deflection, axis=1))) * MM_PER_M
    low, high = USUAL_DEFLECTION_MM
    loads = LOAD_UNITS if low < size_mm < high else {}
    lengths = {name: n for name, n in DEFLECTION_UNITS.items() if low < size_mm / n < high}
    units = loads | lengths
    likely = sorted(units, key=lambda name: abs(np.log(units[name] / factor)))
    near = [name for name in likely if 1 / SAME_UNIT < units[name] / factor < SAME_UNIT]
    near = near or likely[:2]
    parts = [name for name in near if name in loads]
    in_lengths = " or ".join(name for name in near if name in lengths)
    parts += [f"the deflections in {in_lengths}"] if in_lengths else []
    named = ", or ".join(parts) or "the units right"
    return (
        f"the joints look {float(f'{max(factor, 1 / factor):.2g}'):g} times as "
        f"{'compliant' if factor > 1 else 'stiff'} as is usual for such an arm; are {named}?"
    )


def _verdict(report: ValidationReport) -> str:
    kind, n = "error", sum(max(1, len(error.rows)) for error in report.errors)
    if not n:
        kind, n = "warning", len(report.warnings)
    counted = f", {n} {kind}{'s' * (n > 1)}" if n else ""
    return f"{report.path}: {report.verdict}{counted}"


def _section(title: str, findings: Sequence[Finding]) -> list[str]:
    if not findings:
        return []
    if title != "Facts":
        items = [("-", finding.message + _rows(finding)) for finding in findings]
    else:
        parts = (finding.message.partition(": ") for finding in findings)
        items = [(name, value) for name, _, value in parts]
    width = max(len(head) for head, _ in items)
    text_width = min(WIDEST_TEXT, shutil.get_terminal_size((WIDEST_TEXT, 24)).columns)
    lines = ["", title]
    for head, text in items:
        start = f"  {head:<{width}} "
        lines += textwrap.wrap(
            text,
            text_width,
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
    return f" (row{'s' * (len(rows) > 1)} {row_ranges(rows)})"


def _range(vectors: FloatArray) -> str:
    size = np.linalg.norm(vectors, axis=1)
    return f"{size.min():.4g} to {size.max():.4g}"
