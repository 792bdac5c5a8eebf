"""What the `bench data` commands do."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tabulate import tabulate

from stiff_bench.data_tools.info import dataset_info, picture_quantity, picture_title
from stiff_bench.data_tools.picture import save_picture
from stiff_bench.plan.options import Choice
from stiff_bench.plan.request import loaded
from stiff_bench.plan.words import RobotWords, parse_tcp
from stiff_bench.run.progress import display
from stiff_bench.tables.published import published_stiffness
from stiff_datasets.measured.identifiability import REFERENCE_COMPLIANCE, regressor
from stiff_datasets.measured.registered import register
from stiff_datasets.measured.validate import render_report, validate
from stiff_datasets.planning.loads import LoadKind
from stiff_datasets.planning.plan import (
    FORCE_SHARE,
    Criterion,
    MeasurementPlan,
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
from stiff_datasets.twin.simulate import simulate
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import FloatArray, Robot

PAPER_POSES = 151  # as many as the paper measured
_ERRORS_SAID = (
    "Standard errors are of a joint's compliance, for a tracker that repeats 0.01 mm, relative to "
    "the paper's stiffnesses."
)
FEWEST_CANDIDATES, CANDIDATES_A_POSE = 2000, 10


@dataclass(frozen=True, kw_only=True)
class PlanWords:
    """The options of `bench data plan`; None: not given."""

    robot: RobotWords
    poses: int | None
    criterion: Criterion | None
    candidates: int | None
    payload: float | None
    clearance: float
    seed: int
    output: Path


def show_info(choice: Choice[DatasetInfo], folder: Path) -> str:
    """Return the text of `bench data info` after drawing the picture in `folder`."""
    data, key = loaded(choice), choice.info.key
    options = choice.options_text
    name = f"{key} {options}".strip().replace("/", "_").replace(", ", "_").replace(" ", "_")
    picture = folder / f"{name}.png"
    make_folder(folder)
    title = picture_title(choice.info) + (f", {options}" if options else "")
    save_picture(data, title, picture, picture_quantity(choice.info))
    return dataset_info(choice.info, data, picture, options)


def write_measurement_plan(words: PlanWords) -> str:
    """Write a plan and return what it gains over random plans.

    Raises:
        ConfigError: an option is wrong, or the payload is unknown.
        StoreError: the file cannot be written, or exists.
    """
    check_plan_file(words.output)
    robot, chain, known_payload = words.robot.read()
    payload = known_payload if words.payload is None else words.payload
    if payload is None:
        raise ConfigError(f"the payload of {robot.name} is not known; give --payload KG")
    n_poses = words.poses or PAPER_POSES
    n_candidates = words.candidates or max(FEWEST_CANDIDATES, CANDIDATES_A_POSE * n_poses)
    with display():
        pool = candidate_plan(
            chain, n_candidates, seed=words.seed, payload_kg=payload, clearance=words.clearance
        )
        if words.poses is None and words.criterion is None and words.robot.is_papers:
            name, plan = "the paper's plan", paper_plan(chain, payload, words.seed, words.clearance)
        else:
            criterion = words.criterion or "d-optimal"
            name = f"chosen, {criterion}"
            plan = chosen_plan(chain, pool, n_poses, criterion=criterion)
    gain = plan_gain(
        regressor(chain, plan.q, plan.wrench),
        regressor(chain, pool.q, pool.wrench),
        robot.joint_names,
        reference_compliance=_reference(words.robot, robot),
        seed=words.seed,
    )
    write_plan(words.output, plan, robot)
    return _plan_text(words, name, plan, robot, gain)


def _reference(words: RobotWords, robot: Robot) -> float | FloatArray:
    """Return the joint compliances that errors are relative to, rad/(N m)."""
    if not words.is_papers:
        return REFERENCE_COMPLIANCE
    published = published_stiffness()
    return np.array([1.0 / published[joint] for joint in robot.joint_names])


def _plan_text(
    words: PlanWords, name: str, plan: MeasurementPlan, robot: Robot, gain: PlanGain
) -> str:
    columns = (gain.plan, gain.random_mean, gain.random_best)
    errors = [f"{each.worst_error:.2%}" for each in columns]
    rows = [
        ["condition number", *(f"{each.condition:.2f}" for each in columns)],
        *([["worst joint's standard error", *errors]] if words.robot.is_papers else []),
        ["log det of information", *(f"{each.log_det:.2f}" for each in columns)],
    ]
    headers = ["", name, f"mean of {gain.n_random} random", "best random"]
    size = np.linalg.norm(plan.wrench[0, :3])
    force = f"{size:.1f} N at the TCP, {FORCE_SHARE:.0%} of the payload"
    lines = [
        f"{words.output}: {len(plan.q)} poses of {robot.name}, one suggested force each ({force})",
        "",
        tabulate(rows, headers=headers, colalign=["left", *["right"] * 3], disable_numparse=True),
        "",
        f"Measured once, it tells as much as {gain.efficiency:.2f} mean random plans of its size "
        f"({gain.efficiency_over_best:.2f} of the best random one)"
        + ("." if gain.efficiency >= 1.0 else ": LESS than random poses."),
        *([_ERRORS_SAID] if words.robot.is_papers else []),
        "Checked: joint limits, the arm's centre line against base column and ground. Not checked: "
        "the shape of links and tool, and what stands around the robot. Go to each pose slowly.",
        "Measure the wrench that really acts, replace the suggested one by it, and fill in "
        f"dx_mm, dy_mm, dz_mm; then: bench data validate {words.output}{words.robot.text}",
    ]
    unseen = [joint for joint in robot.joint_names if joint not in gain.joints]
    if unseen:
        lines.append(f"No pose and force with this TCP identifies: {', '.join(unseen)}.")
    return "\n".join(lines)


def validation(path: Path, words: RobotWords, no_torque: bool) -> tuple[str, int]:
    """Return the report on a measured file, and 0: ok, 1: suspicious, 2: invalid."""
    report = validate(path, words.read()[1], no_torque=no_torque)
    taken = "" if words.given else f"\nNo robot was named: {DEFAULT_ROBOT} was taken."
    return render_report(report).rstrip() + taken, ("ok", "suspicious", "invalid").index(
        report.verdict
    )


def write_simulation(
    *,
    twin: str,
    samples: int,
    loads: LoadKind,
    loads_per_pose: int,
    specimen: int,
    seed: int,
    output: Path,
) -> str:
    """Write simulated samples and return how many, and how fast."""
    start = time.perf_counter()
    with display():
        simulate(
            output,
            _constants(twin),
            samples,
            loads=loads,
            loads_per_pose=loads_per_pose,
            specimen=specimen,
            seed=seed,
        )
    seconds = time.perf_counter() - start
    return (
        f"{output}: {samples} SIMULATED samples of {twin}, specimen {specimen}, in {seconds:.1f} s "
        f"({samples / seconds:.0f} samples/s)"
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
