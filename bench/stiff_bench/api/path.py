"""Tool paths: an example to begin with, and commands that correct one for the deflection."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from stiff_bench.api.model import Model, blamed_on
from stiff_bench.console import say
from stiff_bench.plan.words import RobotWords
from stiff_bench.run.progress import display
from stiff_bench.tables.picture_file import check_suffix
from stiff_datasets.measured.extrapolation import RowsBeyond
from stiff_datasets.measured.path_file import (
    LoadFrame,
    PathTable,
    corrected_table,
    overview,
    path_problems,
    path_table,
    tool_of,
    write_path,
)
from stiff_datasets.measured.sample_checks import Problem, problems_error
from stiff_datasets.measured.sample_files import (
    MM_PER_M,
    Sheet,
    file_units,
    read_sheets,
    write_table,
)
from stiff_protocols.contract.errors import ConfigError, ModelError, StiffBenchWarning, unknown_name
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.types import FloatArray, IntArray, Interval, Robot
from stiff_protocols.paths.compensation import MAX_ITERATIONS, TOLERANCE_M, Compensation, compensate
from stiff_protocols.paths.example import drivable_path
from stiff_protocols.paths.inverse import Branch, refuse_redundant
from stiff_protocols.paths.path import SHAPES

if TYPE_CHECKING:
    from pandas import DataFrame

BLOCK = 2_000
"""Points that are read, corrected and written at once; progress is shown after each block."""


@dataclass(frozen=True, eq=False)
class CorrectedPath:
    """A path and the commands that put the loaded tool on it; its file has more columns.

    Attributes:
        name: of the path.
        found: points, commands and predicted deflections.
        interval: of the deflections at the commands; None where none was asked for.
    """

    name: str
    found: Compensation
    interval: Interval | None

    @property
    def error_before(self) -> FloatArray:
        """(n,) predicted distance from the path without correction, m."""
        return np.asarray(np.linalg.norm(self.found.before, axis=1))

    @property
    def error_after(self) -> FloatArray:
        """(n,) predicted distance from the path with the commands, m."""
        return np.asarray(np.linalg.norm(self.found.after, axis=1))

    def __repr__(self) -> str:
        """Return how many points were corrected, and the predicted errors."""
        before, after = MM_PER_M * self.error_before, MM_PER_M * self.error_after
        done = int(self.found.converged.sum())
        return (
            f"{done} of {len(before)} points corrected; predicted path error before "
            f"{before.mean():.4g} mm mean, {before.max():.4g} mm largest, after "
            f"{after.mean():.2g} mm mean, {after.max():.2g} mm largest"
        )


def example_path(
    shape: str,
    output: Path | str,
    *,
    size: float = 200.0,
    points: int = 401,
    load: Sequence[float] | None = None,
    robot: str | None = None,
    urdf: Path | str | None = None,
    tcp: Sequence[float] | None = None,
) -> str:
    """Write a path in front of a robot that it can drive, and return what was written.

    Args:
        shape: "square", "circle", "line" or "iso9283", horizontal.
        output: a new file.
        size: edge, diameter or length; of iso9283 the edge of the cube, mm.
        points: number of points.
        load: (6,) process load, N and N m, base frame; None: a quarter of the payload downwards.
        robot: name of a shipped robot; None, without `urdf`: the KR10.
        urdf: of another robot.
        tcp: (3,) tool centre point in the frame of the last link, m.

    Raises:
        ConfigError: there is no such shape or robot, or the load is needed.
        DataError: no place was found where the robot can drive the path.
        StoreError: the file cannot be written, or exists.
    """
    output = Path(output)
    check_new_file(output)
    if shape not in SHAPES:
        raise unknown_name("shape", shape, SHAPES)
    arm, _, payload = RobotWords(robot, urdf, tcp).read()
    if load is None:
        if payload is None:
            raise ConfigError(f"of {arm.name} is not known; give one, in N and N m", "load")
        load = (0.0, 0.0, -0.25 * payload * STANDARD_GRAVITY, 0.0, 0.0, 0.0)
    path = drivable_path(arm, shape, size / MM_PER_M, points, wrench=load)
    write_path(output, path, tool_of(arm, None))
    return f"{output}: {shape} of {points} points for {arm.name}, base frame"


def compensate_path(
    model: Model,
    path: Path | str,
    output: Path | str,
    *,
    tool: Sequence[float] | None = None,
    frame: Sequence[float] | None = None,
    load: Sequence[float] | None = None,
    load_frame: LoadFrame = "base",
    start: Sequence[float] | None = None,
    tolerance: float = MM_PER_M * TOLERANCE_M,
    iterations: int = MAX_ITERATIONS,
    on_failure: Literal["stop", "keep"] = "stop",
    coverage: float | None = None,
    figure: Path | str | None = None,
) -> CorrectedPath:
    """Correct a path for the deflection that a model predicts, and write the commands.

    The command p_cmd is the fixed point of p_cmd = p - d(q(p_cmd), w): with it, the loaded tool is
    predicted to be at p. The orientation is held, along one configuration of the arm.

    Args:
        model: fitted.
        path: file of the points, see "Correct a tool path" in the docs.
        output: a new file.
        tool: x, y, z [mm], a, b, c [deg] of the tool in the frame of the robot description's last
            link; None: the model's TCP with the orientation of that link.
        frame: x, y, z [mm], a, b, c [deg] of the path's frame in the base frame; None: the base.
        load: (6,) process load at every point, N and N m, for a file without loads.
        load_frame: "base" or "tool", in which loads are expressed.
        start: (n_joints,) joint positions near the first point, deg or mm, which choose the
            configuration; None: the one that is nearest to the training poses.
        tolerance: remaining predicted error at which a point is done, mm.
        iterations: predictions of a point at most.
        on_failure: "stop" with an error at a point that cannot be corrected, or "keep" it
            uncorrected and warn.
        coverage: of intervals that are written, too (0..1); None: none are.
        figure: a new picture of the path and its errors.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the model has no intervals.
        DataError: the path cannot be read, or not be driven.
        ModelError: a point cannot be corrected.
        StoreError: a file cannot be written, or exists.
    """
    for kind, word, valid in (
        ("load frame", load_frame, ("base", "tool")),
        ("on-failure", on_failure, ("stop", "keep")),
    ):
        if word not in valid:
            raise unknown_name(kind, word, valid)
    output = Path(output)
    model.check_fitted()
    check_new_file(output)
    if figure is not None:
        check_suffix(Path(figure))
        check_new_file(Path(figure))
    fitted, robot = model.fitted, model.fitted.robot_
    model.check_coverage(coverage)
    refuse_redundant(robot)
    path, known = Path(path), model.training_range
    sheet, n = overview(path, BLOCK)
    read = partial(
        path_table,
        robot=robot,
        tool=tool_of(robot, tool),
        load=load,
        load_frame=load_frame,
        frame=frame,
    )
    about = read(sheet)
    for oddity in about.oddities:
        say(f"warning: {oddity}")
    seed = _seed(about, robot, start)
    seen = RowsBeyond(known, robot)
    parts: list[Compensation] = []
    intervals: list[Interval] = []
    lines: list[IntArray] = []

    def predict(at: FloatArray, wrench: FloatArray) -> FloatArray:
        with blamed_on(model.file):
            return np.asarray(fitted.predict(at, wrench))

    def left(found: Compensation, rows: IntArray) -> str:
        """Say how many points were not corrected, and why not the first; "" where all were."""
        if found.converged.all():
            return ""
        first = np.argmin(found.converged)
        problem = Problem(
            f"{found.problem[first]} after {found.iterations[first]} iterations, contraction "
            f"{found.contraction[first]:.3g}",
            f"below 1, and {tolerance:g} mm within {iterations} iterations",
            int(rows[first]),
            about.pose_columns,
        )
        number = int((~found.converged).sum())
        return f"{path}: {number} of {n} points cannot be corrected, first {problem}"

    def corrected(sheets: Iterable[Sheet]) -> Iterator[DataFrame]:
        branch = Branch(robot, seed)
        if seed is None and about.q is None:
            near = None if known is None else 0.5 * (known.lower + known.upper)
            branch = Branch.along(robot, about.some, near)
        for sheet in sheets:
            table = read(sheet, about=about)
            driven, wrench = branch.driven(table.path, table.q), table.path.wrench
            if problems := path_problems(table, robot, driven):
                raise problems_error(path, problems, "mend this one first")
            found = compensate(
                predict,
                robot,
                table.path,
                driven.q,
                tolerance_m=tolerance / MM_PER_M,
                max_iterations=iterations,
            )
            if on_failure == "stop" and (text := left(found, table.lines)):
                raise ModelError(f"{text}; on-failure keep leaves such points uncorrected")
            if coverage is not None:
                with blamed_on(model.file):
                    intervals.append(fitted.predict_interval(found.q, wrench, coverage))
            parts.append(found)
            lines.append(table.lines)
            extrapolates = seen.of(found.q, wrench)
            yield corrected_table(table, robot, found, extrapolates, *intervals[-1:])
            if seen.n_rows < n:
                report("points corrected", seen.n_rows, n)

    with display(), closing(read_sheets(path, BLOCK)) as sheets:
        write_table(output, corrected(sheets))
    found, interval = Compensation.joined(parts), None
    if coverage is not None:
        lower, upper = ([getattr(one, end) for one in intervals] for end in ("lower", "upper"))
        interval = Interval(np.concatenate(lower), np.concatenate(upper), coverage)
    if figure is not None:
        from stiff_bench.figures.path import path_picture

        path_picture(about.path.name, found, interval).save(Path(figure))
    if not seen.ends[1, -2:].any():
        say(f"warning: {path}: every load is zero, so there is nothing to correct")
    for warning, column in (
        (left(found, np.concatenate(lines)), "uncorrected"),
        (seen.warning, "extrapolates"),
    ):
        if warning:
            warnings.warn(f"{warning}; see the column {column}", StiffBenchWarning, stacklevel=2)
    return CorrectedPath(about.path.name, found, interval)


def _seed(about: PathTable, robot: Robot, start: Sequence[float] | None) -> FloatArray | None:
    """Return the (n_joints,) joint positions, rad or m, that were asked for to begin with."""
    if start is None:
        return None
    if about.q is not None:
        raise ConfigError("the path has joint angles, which choose the configuration", "start")
    if len(start) != robot.n_joints:
        raise ConfigError(
            f"{len(start)} joint positions (valid: the {robot.n_joints} of {robot.name})", "start"
        )
    return np.asarray(start) / file_units(robot)
