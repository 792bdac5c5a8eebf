"""Tool paths: an example to begin with, and commands that correct one for the deflection."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from stiff_bench.api.model import Model
from stiff_bench.api.path_correction import (
    CorrectedPath,
    Correction,
    held_along,
    held_positions,
    start_positions,
)
from stiff_bench.api.robots import as_robot, payload_of
from stiff_bench.console import say
from stiff_bench.run.progress import display
from stiff_bench.tables.picture_file import check_suffix
from stiff_datasets.measured.path_file import LoadFrame, read_path, tool_of, write_path
from stiff_datasets.measured.sample_columns import MM_PER_M
from stiff_datasets.measured.sheet_files import write_table
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning, unknown_name
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import STANDARD_GRAVITY, Robot
from stiff_protocols.paths.compensation import MAX_ITERATIONS, TOLERANCE_M
from stiff_protocols.paths.example import drivable_path
from stiff_protocols.paths.path import SHAPES


def example_path(
    shape: str,
    output: Path | str,
    *,
    size: float = 200.0,
    points: int = 401,
    load: Sequence[float] | None = None,
    robot: str | Robot | None = None,
    hold: Mapping[str, float | None] | None = None,
) -> str:
    """Write a path in front of a robot that it can drive, and return what was written.

    Args:
        shape: "square", "circle", "line" or "iso9283", horizontal.
        output: a new file.
        size: edge, diameter or length; of iso9283 the edge of the cube, mm.
        points: number of points.
        load: (6,) process load, N and N m, base frame; None: a quarter of the payload downwards.
        robot: that drives it: the name of a shipped one, or a `Robot`; None: the KR10.
        hold: of a robot with more than six joints: name or number of each other one -> deg or mm at
            which it is held.

    Raises:
        ConfigError: the shape, robot or joint is unknown, or the load or a held joint is needed.
        DataError: no place was found where the robot can drive the path.
        StoreError: the file cannot be written, or exists.
    """
    output = Path(output)
    check_new_file(output)
    if shape not in SHAPES:
        raise unknown_name("shape", shape, SHAPES)
    arm = as_robot(robot)
    if load is None:
        if (payload := payload_of(arm)) is None:
            raise ConfigError(f"of {arm.name} is not known; give one, in N and N m", "load")
        load = (0.0, 0.0, -0.25 * payload * STANDARD_GRAVITY, 0.0, 0.0, 0.0)
    held = held_positions(arm, hold or {})
    path = drivable_path(arm, shape, size / MM_PER_M, points, wrench=load, held=held)
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
    hold: Mapping[str, float | None] | None = None,
    tolerance: float = MM_PER_M * TOLERANCE_M,
    iterations: int = MAX_ITERATIONS,
    on_failure: Literal["stop", "keep"] = "stop",
    coverage: float | None = None,
    sheet: str | None = None,
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
        hold: of a robot with more than six joints: name or number of each other one -> deg or mm at
            which it is held along the path; None: where `start` or the path's own joint angles have
            it.
        tolerance: remaining predicted error at which a point is done, mm.
        iterations: predictions of a point at most.
        on_failure: "stop" with an error at a point that cannot be corrected, or "keep" it
            uncorrected and warn.
        coverage: of intervals that are written, too (0..1); None: none are.
        sheet: of an Excel file; None: the only one that holds a table.
        figure: a new picture of the path and its errors.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the coverage needs more training poses.
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
    file, output, hold = Path(path), Path(output), hold or {}
    model.check_fitted()
    check_new_file(output)
    if figure is not None:
        check_suffix(Path(figure))
        check_new_file(Path(figure))
    model.check_coverage(coverage)
    arm = model.fitted.robot_
    seed = start_positions(arm, start)
    table = read_path(
        file,
        arm,
        tool_of(arm, tool),
        sheet_name=sheet,
        load=load,
        load_frame=load_frame,
        frame=frame,
    )
    for oddity in table.oddities:
        say(f"warning: {oddity}")
    correction = Correction(
        *(file, model, table, seed),
        held=held_along(arm, hold, seed, table),
        tolerance=tolerance,
        iterations=iterations,
        stops=on_failure == "stop",
        coverage=coverage,
    )
    with display():
        write_table(output, correction.tables())
    corrected = correction.corrected()
    for oddity in correction.oddities():
        say(f"warning: {oddity}")
    for warning in correction.warnings(corrected.found):
        warnings.warn(warning, StiffBenchWarning, stacklevel=2)
    if figure is not None:
        from stiff_bench.figures.corrected_path import path_picture

        picture = path_picture(corrected.name, corrected.found, corrected.interval)
        picture.save(Path(figure))
    return corrected
