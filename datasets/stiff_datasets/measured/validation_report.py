"""Report on a file of measured samples: errors, warnings and facts."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Literal

import numpy as np

from stiff_datasets.measured.anomalies import (
    FEWEST_SAMPLES,
    Finding,
    duplicate_findings,
    external_axis_findings,
    fact,
    range_findings,
    repeat_findings,
    warning,
)
from stiff_datasets.measured.data_card import DataCard, read_card
from stiff_datasets.measured.diagnosis import (
    MIN_GAIN_SE,
    UNUSUAL_RATIO,
    Diagnosis,
    Fit,
    diagnose,
    has_negative_compliance,
    relative_compliance,
    rms_of_all,
)
from stiff_datasets.measured.fault_hypotheses import Reading, compliances, reading
from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_datasets.measured.outliers_and_drift import (
    MAX_LISTED,
    Change,
    find_change,
    find_outliers,
    left_out_rms,
    outlier_findings,
)
from stiff_datasets.measured.row_checks import (
    LIMIT_TOLERANCE,
    NO_TORQUE_HINT,
    Problem,
)
from stiff_datasets.measured.sample_columns import (
    LOADED_COLUMNS,
    MM_PER_M,
    file_units,
    is_planned,
    joint_columns,
)
from stiff_datasets.measured.sample_file import (
    SMALL_UNITS,
    USUAL_DEFLECTION_MM,
    CheckedSamples,
    check_sheet,
)
from stiff_datasets.measured.table_reader import Sheet, read_sheet
from stiff_datasets.measured.unloaded_positions import Comparison, compare_positions, in_mm
from stiff_protocols.contract.display import Screen, printable, row_ranges
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.training_range import in_smallest_arcs
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import unit_deflections
from stiff_protocols.springs.identification import Identified, identify, typical_joints
from stiff_protocols.springs.unseen_joints import unseen_joints_texts

MIN_USUAL_EXPLAINED = 0.85
"""Share of the squared deflection; the shipped data sets have 0.93 and more."""
LOAD_UNIT_FACTORS = {
    "the forces and torques in kg and kg m": STANDARD_GRAVITY,
    "the forces in kN": 1000.0,
}
DEFLECTION_UNIT_FACTORS = {"m": 1 / 1000, "inch": 1 / 25.4, "cm": 1 / 10, **SMALL_UNITS}
"""Possible units of a file -> factor by which they raise the apparent compliance."""
UNIT_TOLERANCE = 2.2
"""Units within this factor of the best are named, too: the shipped robots have 0.6 to 1.9 times the
usual compliance (`relative_compliance`)."""
MAX_TIES_SHOWN = 2
RESIDUALS_SHOWN = 5
MIN_CURVE_POSES, MAX_CURVE_SAMPLES = 10, 200
MAX_TEXT_WIDTH = 100
"""Characters of a line of the report, unless the terminal is narrower."""


@dataclass(frozen=True)
class ValidationReport:
    """The findings in a file.

    Attributes:
        path: the file.
        errors: reasons why the file cannot be used, and a mistake that would explain them.
        warnings: findings to check, and notes.
        facts: content of the file.
    """

    path: Path
    errors: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    facts: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Literal["ok", "suspicious", "invalid"]:
        """Verdict: unusable with errors, suspicious with warnings to check, else ok."""
        if self.errors:
            return "invalid"
        is_suspicious = any(finding.level == "warning" for finding in self.warnings)
        return "suspicious" if is_suspicious else "ok"

    def __repr__(self) -> str:
        """Return the report as plain text; the first line is the verdict."""
        lines = [
            _verdict(self),
            *_section("Errors", self.errors),
            *_section("Warnings", self.warnings),
            *_section("Facts", self.facts),
        ]
        return printable("\n".join(lines))

    def _repr_html_(self) -> str:
        problems = (*self.errors, *self.warnings)
        texts = [(finding.level, finding.message + _rows_text(finding)) for finding in problems]
        facts = [finding.message.partition(": ")[::2] for finding in self.facts]
        return Screen(_verdict(self), [*texts, *facts]).html()


IdentifyParts = Callable[[Samples, Robot], tuple[FloatArray, Mapping[str, str]]]
"""Returns (n, 3) errors [m] of a better model than linear springs at samples left out, or NaN, and
facts on the parts of robot and rig that it identified."""


def validate(
    source: Path | Sheet,
    robot: Robot,
    options: FileOptions = DEFAULTS,
    identify_parts: IdentifyParts | None = None,
) -> ValidationReport:
    """Check a file or a table of measured samples.

    Args:
        source: the file; Parquet or Excel if it ends in .parquet or .xlsx, else CSV. Or a table.
        robot: the measured robot.
        options: options of the file. A data card FILE.md next to it may also state that no torques
            were measured.
        identify_parts: errors of a model of many parts, and facts on them; None: no such facts. It
            is called for 10 poses or more and at most 200 samples.

    Raises:
        ConfigError: the file does not have the sheet, or has several with tables and none is named.
    """
    path, card = (source.path, DataCard()) if isinstance(source, Sheet) else (source, None)
    try:
        card = card or read_card(path)
        sheet = source if isinstance(source, Sheet) else read_sheet(path, options.sheet)
        checked = check_sheet(sheet, robot, options)
    except DataError as error:
        message = str(error).removeprefix(f"{path}: ")
        return ValidationReport(path, (Finding("error", message),))
    samples, lines = checked.samples, checked.sheet.lines
    unfilled = [warning(str(checked.unfilled))] if checked.unfilled else []
    errors = [*_error_findings(checked.problems)]
    if samples is None and not errors:
        errors, unfilled = [replace(finding, level="error") for finding in unfilled], []
    if samples is None or errors:
        geometry = _geometry(checked, robot)
        causes = [geometry.text] if geometry and geometry.text else []
        if not (geometry and geometry.is_undone):  # positions show more than springs
            causes.append(_likely_cause(checked, robot))
        errors.extend(Finding("error", message) for message in filter(None, causes))
        return ValidationReport(path, tuple(errors), tuple(unfilled))
    if samples.directions.size:
        no_torque = options.no_torque or card.no_torque
        jacobian = robot.jacobian(samples.q)
        columns = samples.read(unit_deflections(jacobian, samples.wrench, samples.levers))
        findings = [
            *_file_findings(checked, sheet, samples, robot, card, no_torque),
            *_reading_findings(samples, robot, columns),
        ]
        if columns.any():
            findings += _part_facts(samples, robot, identify_parts, lines)
        return _report(path, findings)
    corrected, arm, geometry = samples, robot, _geometry(checked, robot)
    if geometry:
        arm, deflection = geometry.robot, samples.deflection
        deflection = geometry.frame.to_base(deflection) if geometry.frame else deflection
        corrected = replace(samples, q=geometry.q, deflection=deflection)
    data = reading(arm, corrected.q, corrected.wrench, corrected.deflection)
    planned = is_planned(samples.group)  # with suggested forces at the TCP
    no_torque = options.no_torque or card.no_torque or planned
    torques_missing = not no_torque and not data.torque.any()
    diagnosis = diagnose(corrected, arm, may_fit=not torques_missing)
    change = _likely_change(data, lines, samples.order, diagnosis)
    if change:
        deflection = corrected.deflection - change.offset
        data = replace(data, deflection=deflection)
        undone = replace(corrected, deflection=deflection)
        diagnosis = diagnose(undone, arm, may_fit=not torques_missing)
    if torques_missing and not _is_poorly_explained(diagnosis.given):
        diagnosis = Diagnosis(diagnosis.given)  # the missing torques are the mistake
    pose = np.asarray(np.unique(samples.pose_id, return_inverse=True)[1])
    findings = [
        *_file_findings(checked, sheet, samples, robot, card, no_torque),
        *repeat_findings(samples, robot, lines),
        *(_position_findings(geometry, lines) if geometry else []),
        *([warning(change.text, change.rows)] if change else []),
        *(
            _spring_findings(data, pose, diagnosis, lines, planned)
            if data.regressor().any()
            else ()
        ),
    ]
    if not diagnosis.best and data.regressor().any():
        findings += _part_facts(corrected, arm, identify_parts, lines)
    return _report(path, findings)


def _report(path: Path, findings: Sequence[Finding]) -> ValidationReport:
    """Return the report on a file without errors."""
    warnings, facts = (
        tuple(finding for finding in findings if finding.level in levels)
        for levels in (("warning", "note"), ("fact",))
    )
    return ValidationReport(path, warnings=warnings, facts=facts)


def _file_findings(
    checked: CheckedSamples,
    sheet: Sheet,
    samples: Samples,
    robot: Robot,
    card: DataCard,
    no_torque: bool,
) -> Iterator[Finding]:
    """Yield findings on the file, its columns and its rows; no spring is compared."""
    lines, unused = checked.sheet.lines, checked.sheet.unused_text
    noise = f"{card.instrument_noise * MM_PER_M:.3g} mm per deflection (from the data card)"
    if checked.unfilled:
        yield warning(str(checked.unfilled))
    yield from (fact("read as", note) for note in checked.sheet.notes)
    if unused:
        yield fact("columns not used", unused)
    yield from external_axis_findings(sheet, checked.sheet.unused, robot, lines)
    yield from _content_findings(samples, robot, no_torque)
    yield from map(warning, filter(None, (robot.mass_doubt, robot.limit_doubt)))
    if card.instrument_noise:
        yield fact("instrument noise", noise)
    if checked.outside_limits:
        yield Finding("note", checked.outside_limits)
    yield from duplicate_findings(samples, robot, checked.pose_doubts, lines)
    yield from range_findings(samples, lines)


def _part_facts(
    samples: Samples, robot: Robot, identify_parts: IdentifyParts | None, lines: IntArray
) -> list[Finding]:
    """Return facts on a model of many parts; [] for few poses, many samples or no model."""
    n_poses = len(np.unique(samples.pose_id))
    if not identify_parts or n_poses < MIN_CURVE_POSES or len(samples) > MAX_CURVE_SAMPLES:
        return []
    errors, parts = identify_parts(samples, robot)
    facts = [fact(name, text) for name, text in parts.items()]
    return [*_curve_facts(samples, errors, lines), *facts]


def _reading_findings(samples: Samples, robot: Robot, columns: FloatArray) -> Iterator[Finding]:
    """Yield findings on samples with one to three numbers along directions of their own.

    `columns` (n, m, n_joints) are the readings [m] by each joint's spring at unit compliance.
    Mistakes are not diagnosed: hardly one of them shows in single numbers.
    """
    if not columns.any():
        yield warning("no wrench turns any joint")
        return
    is_read, seen = samples.is_read, (samples.directions, samples.levers)
    yield from map(warning, unseen_joints_texts(robot, samples.q, samples.wrench, *seen))
    rows, readings = columns[is_read], samples.values[is_read]
    identified = identify(rows, readings, typical_joints(robot), samples.pose_of_number)
    yield from _stiffness_facts(robot, identified, identified.compliance)


def _geometry(checked: CheckedSamples, robot: Robot) -> Comparison | None:
    """Compare unloaded positions with forward kinematics; None: the file has none."""
    if checked.samples is None or checked.positions is None:
        return None
    samples = checked.samples
    comparison = compare_positions(checked.positions, samples.q, robot)
    if comparison.frame and LOADED_COLUMNS[0] not in checked.sheet.cells:
        # deflections of their own may have the base's axes
        turned = comparison.frame.to_base(samples.deflection)
        arm = comparison.robot, comparison.q, samples.wrench
        given_rms, turned_rms = (
            rms_of_all(reading(*arm, deflection)) for deflection in (samples.deflection, turned)
        )
        if given_rms < turned_rms:
            text = comparison.text.partition("; --register")[0]
            text += "; the deflections look as if they had the base's axes already"
            comparison = replace(comparison, frame=None, text=text)
    return comparison if len(comparison.measured) else None


def _position_findings(geometry: Comparison, lines: IntArray) -> Iterator[Finding]:
    """State how far unloaded positions are from forward kinematics, and the rows that are far."""
    distance = geometry.distance
    if geometry.text:
        yield warning(f"{geometry.text} (undone below)" if geometry.is_undone else geometry.text)
    shift = ", ".join(f"{length:.4g}" for length in geometry.shift.round(5) + 0.0)
    shifted = f", in a frame shifted by ({shift}) m, which changes no deflection"
    yield fact(
        "unloaded positions",
        f"{in_mm(np.median(distance))} (median) from forward kinematics, at most "
        f"{in_mm(distance.max())}{shifted if geometry.shift.any() else ''}",
    )
    is_far = np.isin(geometry.measured, geometry.far_rows)
    if is_far.any() and (geometry.is_undone or not geometry.text):
        far = np.flatnonzero(is_far)[np.argsort(-distance[is_far])]
        listed = ", ".join(
            f"row {lines[geometry.measured[i]]} by {in_mm(distance[i])}" for i in far[:MAX_LISTED]
        )
        more = f", and {len(far) - MAX_LISTED} more rows" if len(far) > MAX_LISTED else ""
        yield warning(
            f"unloaded positions far from the forward kinematics of the joint angles: {listed}"
            f"{more}",
            lines[geometry.far_rows],
        )


def _likely_cause(checked: CheckedSamples, robot: Robot) -> str:
    """Return a mistake that would explain the errors of a file; "" for none."""
    samples, lines = checked.samples, checked.sheet.lines
    if samples is None:
        return ""
    beyond = np.maximum(robot.lower - samples.q, samples.q - robot.upper) * file_units(robot)
    joints_only = bool((beyond > LIMIT_TOLERANCE).any())
    diagnosis = diagnose(samples, robot, joints_only=joints_only)
    if diagnosis.best:
        return _mistake_text(diagnosis)
    problem_rows = [problem.row for problem in checked.problems if problem.row is not None]
    correct_samples = np.flatnonzero(~np.isin(lines, problem_rows))
    if joints_only or not len(correct_samples):
        return ""
    samples = samples.take(correct_samples)
    data = reading(robot, samples.q, samples.wrench, samples.deflection)
    return _unit_message(data, compliances(data))


def _likely_change(
    data: Reading, lines: IntArray, order: FloatArray, diagnosis: Diagnosis
) -> Change | None:
    """Find a drift or a jump that explains more than the diagnosed mistake.

    It is sought in the (n,) `order` that the file states, else in the order of its rows.
    """
    if not data.regressor().any():
        return None
    rows = np.argsort(order, kind="stable") if order.size else np.arange(len(lines))
    change = find_change(data.take(rows), lines[rows], find_outliers(data).odd[rows])
    if change:
        offset = np.empty_like(change.offset)
        offset[rows] = change.offset
        change = replace(change, offset=offset)
    if change and diagnosis.best:
        undone = diagnosis.best.reading
        return change if change.rms < left_out_rms(undone, find_outliers(undone).odd) else None
    return change


def _error_findings(problems: Sequence[Problem]) -> Iterator[Finding]:
    """Combine equal problems of a column: one finding for an empty column."""
    groups: dict[tuple[str | None, str], list[Problem]] = {}
    for problem in problems:
        groups.setdefault((problem.column, problem.valid), []).append(problem)
    for (column, valid), equal_problems in groups.items():
        rows = tuple(problem.row for problem in equal_problems if problem.row is not None)
        others_text = (
            " and others" if len({problem.value for problem in equal_problems}) > 1 else ""
        )
        joint_message = (
            f"column {column}: {equal_problems[0].value!r}{others_text}, expected {valid}"
        )
        yield Finding("error", joint_message if len(rows) > 1 else str(equal_problems[0]), rows)


def _content_findings(samples: Samples, robot: Robot, no_torque: bool) -> Iterator[Finding]:
    tcp = ", ".join(f"{length:g}" for length in robot.tcp_on_flange)
    held = f"{', '.join(robot.held)} held, " if robot.held else ""
    yield fact("robot", f"{robot.name}, {held}TCP ({tcp}) m in the frame of its last link")
    n_poses, n = len(set(samples.pose_id)), len(samples)
    loads = "one load" if n_poses == n else f"{n / n_poses:.3g} loads"
    loads = f"{n_poses} poses, {loads} per pose" + " on average" * (n_poses < n)
    groups, counts = np.unique(samples.group, return_counts=True)
    few = f"; fewer than {FEWEST_SAMPLES} hardly tell methods apart" if n < FEWEST_SAMPLES else ""
    yield fact("samples", f"{n}, {loads}{few}")
    yield fact("groups", ", ".join(f"{g} ({c})" for g, c in zip(groups, counts, strict=True)))
    yield fact("force", f"{_range_text(samples.wrench[:, :3])} N")
    if samples.wrench[:, 3:].any():
        yield fact("torque", f"{_range_text(samples.wrench[:, 3:])} N m")
    else:
        yield fact("torque", "all zero, so the load is taken to act at the TCP")
        if not samples.wrench.any():
            yield warning("every wrench is zero, so no stiffness can be identified")
        elif not no_torque:
            yield warning(
                "every torque is zero, which is right only if each force acted at the TCP; "
                f"{NO_TORQUE_HINT}"
            )
    yield fact("deflection", f"{_range_text(samples.deflection * MM_PER_M)} mm")
    if samples.after.size:
        stays = np.linalg.norm(samples.after, axis=1) * MM_PER_M
        yield fact("after the load", f"{stays.mean():.3g} mm stay, at most {stays.max():.3g} mm")
    units = file_units(robot)
    q = in_smallest_arcs(samples.q, robot) * units
    for i, column in enumerate(joint_columns(robot)):
        unit = column.rpartition("_")[2]
        limits = f"{robot.lower[i] * units[i]:.4g} to {robot.upper[i] * units[i]:.4g}"
        used = f"{q[:, i].min():.4g} to {q[:, i].max():.4g} {unit}"
        yield fact(f"joint {robot.joint_names[i]}", f"{used} (limits {limits})")


def _identified(data: Reading, pose: IntArray) -> Identified:
    """Identify joint springs like the virtual joint model; `pose` (n,) numbers the poses."""
    matrix, typical = data.regressor(), typical_joints(data.robot)
    flat = matrix.reshape(-1, matrix.shape[2])
    return identify(flat, data.deflection.reshape(-1), typical, np.repeat(pose, 3))


def _spring_findings(
    data: Reading, pose: IntArray, diagnosis: Diagnosis, lines: IntArray, planned: bool
) -> Iterator[Finding]:
    """Compare the data with joint springs: mistakes, stiffnesses, outliers.

    What planned poses cannot tell is a note.
    """
    given, best = diagnosis.given, diagnosis.best
    if best:
        yield warning(_mistake_text(diagnosis))
    elif _is_poorly_explained(given):
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
    outliers = find_outliers(data)
    usual_data, usual_pose = data, pose
    if not best:  # otherwise every row is wrong
        usual_data, usual_pose = data.take(~outliers.odd), pose[~outliers.odd]
    residual = data.deflection - data.regressor() @ compliances(usual_data)
    compliance = _identified(usual_data, usual_pose).compliance
    yield from _stiffness_facts(data.robot, identified, compliance)
    if not best:  # otherwise they would be effects of the mistake
        is_rigid = has_negative_compliance(usual_data) & (compliances(usual_data) == 0.0)
        vague_joints = [*compress(names, ~identified.is_identified & ~is_rigid)]
        if vague_joints:
            yield Finding(
                "note" if planned else "warning",
                f"the stiffness of joint{'s' * (len(vague_joints) > 1)} {', '.join(vague_joints)} "
                "cannot be identified: the samples do not distinguish it from noise or "
                "another joint; models use the prior's",
            )
        if is_rigid.any():
            yield warning(f"infinite or negative stiffness: {', '.join(compress(names, is_rigid))}")
        if message := _unit_message(data, compliance):
            yield warning(message)
    yield fact("largest residuals", _largest_residuals(residual, lines))
    if not best:
        yield from outlier_findings(lines, outliers)


def _stiffness_facts(
    robot: Robot, identified: Identified, compliance: FloatArray
) -> Iterator[Finding]:
    """Yield facts on what is identifiable, and on (n_joints,) compliances [rad/(N m), m/N]."""
    names, is_known = robot.joint_names, identified.is_identified
    condition = f", condition number {identified.condition:.3g}" if is_known.all() else ""
    yield fact("identifiable", f"rank {identified.rank} of {len(names)} joint springs{condition}")
    stiffness = [
        f"{name} {1.0 / joint_compliance:.2g}" if joint_compliance else f"{name} inf"
        for name, joint_compliance in zip(names, compliance, strict=True)
    ]
    yield fact("k [Nm/rad, N/m]", ", ".join(compress(stiffness, is_known)) or "none")
    if not is_known.all():
        yield fact("k of the prior", ", ".join(compress(stiffness, ~is_known)))


def _curve_facts(samples: Samples, errors: FloatArray, lines: IntArray) -> list[Finding]:
    """Return facts on springs with curves; they show errors that linear springs hide."""
    if not np.isfinite(errors).all() or not samples.deflection.any():
        return []
    size = np.linalg.norm(errors, axis=1)  # m
    explained = 1.0 - float((size**2).sum() / (samples.deflection**2).sum())
    rms = float(np.sqrt(np.mean(size**2))) * MM_PER_M
    return [
        fact(
            "springs with curves",
            f"{explained:.1%} explained, cross-validated (bayes-springs); residual {rms:.3g} mm "
            "RMS",
        ),
        fact("their largest residuals", _largest_residuals(errors, lines)),
    ]


def _largest_residuals(residual: FloatArray, lines: IntArray) -> str:
    """Return the rows of the longest of (n, 3) residuals, m."""
    size_mm = np.linalg.norm(residual, axis=1) * MM_PER_M
    worst = np.argsort(-size_mm)[:RESIDUALS_SHOWN]
    listed = ", ".join(f"row {lines[i]} {size_mm[i]:.3g}" for i in worst)
    return f"{listed} mm (median {np.median(size_mm):.3g})"


def _is_poorly_explained(given: Fit) -> bool:
    """Test if the explained share is significantly below `MIN_USUAL_EXPLAINED`."""
    allowed = (1.0 - MIN_USUAL_EXPLAINED) * (given.reading.deflection**2).sum(axis=1)
    excess = given.squares - allowed  # (n,)
    return bool(excess.sum() > MIN_GAIN_SE * np.sqrt(len(excess)) * excess.std())


def _mistake_text(diagnosis: Diagnosis) -> str:
    given, best = diagnosis.compared, diagnosis.best
    assert given and best
    more = f"; as well: {'; '.join(diagnosis.ties[:MAX_TIES_SHOWN])}" if diagnosis.ties else ""
    more += "" if given is diagnosis.given else ", by springs about all axes"
    return (
        f"{best.text}: explained {given.explained:.1%} -> {best.explained:.1%}, residual "
        f"{given.rms * MM_PER_M:.3g} -> {best.rms * MM_PER_M:.3g} mm RMS{more}"
    )


def _elsewhere_text(fits: Sequence[Fit]) -> str:
    """Return the sentence on another TCP or point of the force; see `Diagnosis`."""
    given, *elsewhere = fits
    residuals = "; ".join(f"{fit.text}: {fit.rms * MM_PER_M:.3g} mm" for fit in elsewhere)
    return (
        "is the TCP or the force's point elsewhere? Springs about all axes leave "
        f"{given.rms * MM_PER_M:.3g} mm RMS, cross-validated; in the flange frame {residuals}. "
        "Check where the tool was measured and loaded, and whether its mount is stiff; models fit "
        "the point with tcp=fit or lever=fit"
    )


def _unit_message(data: Reading, compliance: FloatArray) -> str:
    """Name likely units if the stiffnesses are unusual: a wrong unit scales all of them.

    "" if they are usual, or if the usual ones are not known.
    """
    factor = relative_compliance(data, compliance)
    if factor == 0.0 or 1.0 / UNUSUAL_RATIO < factor < UNUSUAL_RATIO:
        return ""
    size_mm = float(np.median(np.linalg.norm(data.deflection, axis=1))) * MM_PER_M
    low, high = USUAL_DEFLECTION_MM
    loads = LOAD_UNIT_FACTORS if low < size_mm < high else {}
    lengths = {name: n for name, n in DEFLECTION_UNIT_FACTORS.items() if low < size_mm / n < high}
    units = loads | lengths
    units_by_fit = sorted(units, key=lambda name: abs(np.log(units[name] / factor)))
    near_units = [
        name for name in units_by_fit if 1 / UNIT_TOLERANCE < units[name] / factor < UNIT_TOLERANCE
    ]
    near_units = near_units or units_by_fit[:2]
    parts = [name for name in near_units if name in loads]
    in_lengths = " or ".join(name for name in near_units if name in lengths)
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
        items = [("-", finding.message + _rows_text(finding)) for finding in findings]
    else:
        parts = (finding.message.partition(": ") for finding in findings)
        items = [(name, value) for name, _, value in parts]
    width = max(len(head) for head, _ in items)
    text_width = min(MAX_TEXT_WIDTH, shutil.get_terminal_size((MAX_TEXT_WIDTH, 24)).columns)
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


def _rows_text(finding: Finding) -> str:
    """Return the rows of a finding as text; "" if the message names them."""
    rows = finding.rows
    if not rows or f"row {rows[0]}" in finding.message:
        return ""
    return f" (row{'s' * (len(rows) > 1)} {row_ranges(rows)})"


def _range_text(vectors: FloatArray) -> str:
    size = np.linalg.norm(vectors, axis=1)
    return f"{size.min():.4g} to {size.max():.4g}"
