"""What the `bench data` commands do."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiff_bench.data_tools.info import dataset_info
from stiff_bench.data_tools.picture import DEFLECTION, save_picture
from stiff_bench.plan.options import Choice
from stiff_bench.plan.request import loaded
from stiff_bench.plan.words import RobotWords, parse_tcp
from stiff_bench.run.progress import display
from stiff_bench.tables.published import published_stiffness
from stiff_bench.tables.render import plain_text
from stiff_bench.tables.table import Cell, Column, Table
from stiff_datasets.measured.identifiability import REFERENCE_COMPLIANCE, regressor
from stiff_datasets.measured.registered import register
from stiff_datasets.measured.validate import render_report, validate
from stiff_datasets.planning.plan import (
    FORCE_SHARE,
    Criterion,
    candidate_plan,
    check_plan_file,
    chosen_plan,
    paper_plan,
    write_plan,
)
from stiff_datasets.planning.plan_gain import PlanGain, plan_gain
from stiff_datasets.robots.shipped import DEFAULT_ROBOT, named_robot
from stiff_datasets.twin.constants import (
    TwinConstants,
    read_constants,
    shipped_constants,
    shipped_twins,
)
from stiff_datasets.twin.effects import parse_effects
from stiff_datasets.twin.simulate import simulate
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.plugin import STIFFNESS, DatasetInfo
from stiff_protocols.contract.types import FloatArray, Robot

PAPER_POSES = 151  # as many as the paper measured
FEWEST_CANDIDATES, CANDIDATES_A_POSE = 2000, 10


def show_info(choice: Choice[DatasetInfo], folder: Path) -> str:
    """Return the text of `bench data info` after drawing the picture in `folder`."""
    data, key = loaded(choice), choice.info.key
    options = choice.options_text
    name = f"{key} {options}".strip().replace("/", "_").replace(", ", "_").replace(" ", "_")
    picture = folder / f"{name}.png"
    make_folder(folder)
    title = ", ".join(filter(None, (f"{key} ({choice.info.label})", options)))
    task = choice.info.task
    quantity = DEFLECTION if task == STIFFNESS else f"The {task} (no load is applied)"
    save_picture(data, title, picture, quantity)
    return dataset_info(choice.info, data, picture, options)


def write_measurement_plan(
    *,
    robot: RobotWords,
    poses: int | None,
    criterion: Criterion | None,
    candidates: int | None,
    payload: float | None,
    clearance: float,
    seed: int,
    output: Path,
) -> str:
    """Write a plan and return what it gains over random plans; None: not given.

    Raises:
        ConfigError: an option is wrong, or the payload is unknown.
        StoreError: the file cannot be written, or exists.
    """
    check_plan_file(output)
    arm, chain, known_payload = robot.read()
    payload = known_payload if payload is None else payload
    if payload is None:
        raise ConfigError(f"the payload of {arm.name} is not known; give --payload KG")
    n_poses = poses or PAPER_POSES
    n_candidates = candidates or max(FEWEST_CANDIDATES, CANDIDATES_A_POSE * n_poses)
    with display():
        pool = candidate_plan(
            chain, n_candidates, seed=seed, payload_kg=payload, clearance=clearance
        )
        if poses is None and criterion is None and robot.is_papers:
            name, plan = "the paper's plan", paper_plan(chain, payload, seed, clearance)
        else:
            criterion = criterion or "d-optimal"
            name = f"chosen, {criterion}"
            plan = chosen_plan(chain, pool, n_poses, criterion=criterion)
    gain = plan_gain(
        regressor(chain, plan.q, plan.wrench),
        regressor(chain, pool.q, pool.wrench),
        arm.joint_names,
        reference_compliance=_reference(robot, arm),
        seed=seed,
    )
    write_plan(output, plan, arm)
    size = np.linalg.norm(plan.wrench[0, :3])
    notes = [
        "",
        f"D-efficiency {gain.efficiency:.2f} relative to the mean random plan, "
        f"{gain.efficiency_over_best:.2f} relative to the best one"
        + ("." if gain.efficiency >= 1.0 else ": worse than random poses."),
        "Checked: joint limits, the arm's centre line against base column and ground. Not checked: "
        "shape of links and tool, surroundings. Approach each pose slowly.",
        "Replace the suggested wrench by the actual one and fill in dx_mm, dy_mm, dz_mm; then: "
        f"bench data validate {output}{robot.text}",
    ]
    unseen = [joint for joint in arm.joint_names if joint not in gain.joints]
    if unseen:
        notes.append(f"Not identifiable with this TCP: {', '.join(unseen)}.")
    return (
        f"{output}: {len(plan.q)} poses of {arm.name}, one suggested force each "
        f"({size:.1f} N at the TCP, {FORCE_SHARE:.0%} of the payload)\n\n"
        + plain_text(_gain_table(name, gain, notes, with_errors=robot.is_papers))
    )


def _reference(words: RobotWords, robot: Robot) -> float | FloatArray:
    """Return the joint compliances that errors are relative to, rad/(N m)."""
    if not words.is_papers:
        return REFERENCE_COMPLIANCE
    published = published_stiffness()
    return np.array([1.0 / published[joint] for joint in robot.joint_names])


def _gain_table(name: str, gain: PlanGain, notes: Sequence[str], *, with_errors: bool) -> Table:
    """Return a plan beside random ones; errors are relative to stiffnesses that must be known."""
    judged = (gain.plan, gain.random_mean, gain.random_best)
    rows: list[list[Cell]] = [
        ["condition number", *(each.condition for each in judged)],
        ["worst joint's standard error [%]", *(100.0 * each.worst_error for each in judged)],
        ["log det of information", *(each.log_det for each in judged)],
    ]
    if not with_errors:
        del rows[1]
    names = (name, f"mean of {gain.n_random} random", "best random")
    return Table("", [Column("", "text"), *(Column(n, format=".2f") for n in names)], rows, notes)


def validation(path: Path, words: RobotWords, no_torque: bool) -> tuple[str, int]:
    """Return the report on a measured file, and 0: ok, 1: suspicious, 2: invalid."""
    report = validate(path, words.read()[1], no_torque=no_torque)
    taken = "" if words.given else f"\nRobot: {DEFAULT_ROBOT}, the default (--robot, --urdf)."
    return render_report(report).rstrip() + taken, ("ok", "suspicious", "invalid").index(
        report.verdict
    )


def write_simulation(*, twin: str, samples: int, output: Path, effects: str, **options: Any) -> str:
    """Write simulated samples, with the options of `simulate`; return how many, and how fast."""
    asked, start = parse_effects(effects), time.perf_counter()
    with display():
        simulate(output, _constants(twin), samples, effects=asked, **options)
    seconds = time.perf_counter() - start
    return (
        f"{output}: {samples} SIMULATED samples of {twin}, specimen {options['specimen']}, in "
        f"{seconds:.1f} s ({samples / seconds:.0f} samples/s)"
    )


def _constants(twin: str) -> TwinConstants:
    """Read a shipped twin's constants or those of a TOML file."""
    shipped = shipped_twins()
    if twin in shipped:
        return shipped_constants(shipped[twin])
    if not twin.endswith(".toml"):
        raise ConfigError(f"--twin {twin!r} (valid: {', '.join(shipped)}, or FILE.toml)")
    return read_constants(Path(twin))


def register_file(key: str, csv: Path, urdf: Path | None, tcp: str, no_torque: bool) -> str:
    """Register a measurement and return what is odd in it and what to do with it."""
    words = RobotWords(None, urdf, tcp)
    default = named_robot(DEFAULT_ROBOT).tcp if urdf is None else (0.0, 0.0, 0.0)
    place = register(key, csv, urdf, parse_tcp(tcp) if tcp else default, no_torque=no_torque)
    report = validate(csv, words.read()[1], no_torque=no_torque)
    odd = [f"warning: {finding.message}" for finding in report.warnings]
    done = f"{key}: {csv} registered in {place}; use it with: bench run --dataset {key}"
    return "\n".join([*odd, done])
