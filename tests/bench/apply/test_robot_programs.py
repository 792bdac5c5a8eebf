"""`compensate_program`: programs of four languages corrected in place, and refusals."""

from __future__ import annotations

import re
import shutil
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import stiffbench as sb
from helpers.command_line import bench_here
from helpers.robot_programs import DOCS, FILES, ROBOTS, poses_of_program, program_of_poses
from stiff_apply.robot_programs import compensate_program
from stiff_datasets.robots.shipped_robots import named_robot, shipped_chain
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    ModelError,
    StiffBenchWarning,
    StoreError,
)

DATA = {
    "kr10-r1100-2": ("kr10-twin", {}),
    "irb120-3-06": ("arm-family", {"robot": 0}),
    "lr-mate-200id": ("arm-family", {"robot": 2}),
    "ur5": ("ur5-twin", {}),
}
LOAD = (3.0, 4.0, -20.0)
FANUC_TOOL = (-16.0, -51.0, 71.0, 0.0, 0.0, 0.0)
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(E[+-]?\d+)?", re.IGNORECASE)


@cache
def model_of(robot: str):
    name, options = DATA[robot]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # J6 of the IRB 120 hardly turns
        return sb.make_model("vjm").fit(sb.load_dataset(name, **options))


def options_of(name: str) -> dict:
    return {"tool": FANUC_TOOL} if name.endswith(".ls") else {}


def regular_joints(robot, n: int) -> np.ndarray:
    """Return random joint positions, away from limits and singularities."""
    rng = np.random.default_rng(5)
    low, high = np.maximum(robot.lower, -np.pi) + 0.2, np.minimum(robot.upper, np.pi) - 0.2
    q = rng.uniform(low, high, (6 * n, 6))
    jacobian = robot.jacobian(q)
    jacobian[:, :3] /= 0.5
    return q[np.linalg.cond(jacobian) < 30.0][:n]


def pinocchio_tools(robot, q) -> tuple[np.ndarray, np.ndarray]:
    """Return TCP, mm, and tool rotation in the controller's world frame, by Pinocchio."""
    chain = shipped_chain(robot.name, tuple(robot.tcp_on_flange))
    data, places, turns = chain.model.createData(), [], []
    controller = robot.controller
    world = np.linalg.inv(controller.world)
    for row in q:
        pin.forwardKinematics(chain.model, data, row)
        last = world @ data.oMi[chain.model.njoints - 1].homogeneous
        places.append(1000.0 * (last @ np.r_[robot.tcp, 1.0])[:3])
        turns.append((last @ robot.flange @ controller.flange)[:3, :3])
    return np.array(places), np.array(turns)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_corrected_targets_of_random_orientation_are_the_commanded_poses(name, tmp_path):
    suffix, model = Path(name).suffix, model_of(ROBOTS[name])
    robot, n = model.fitted.robot_, 250  # 1,000 in four languages
    q = regular_joints(robot, n)
    lever = np.linalg.inv(robot.flange @ robot.controller.flange) @ np.r_[robot.tcp, 1.0]
    wanted_mm, turned = pinocchio_tools(robot, q)
    file = tmp_path / f"all{suffix}"
    file.write_text(program_of_poses(suffix, 1000.0 * lever[:3], wanted_mm, turned))
    options = {"load": LOAD, "start": np.degrees(q[0]), **options_of(name)}
    commands = compensate_program(model, file, tmp_path / f"new{suffix}", **options).targets
    good = commands.converged
    assert good.sum() > 0.95 * n
    place, rotation = poses_of_program(suffix, (tmp_path / f"new{suffix}").read_text())
    commanded, command_turn = pinocchio_tools(robot, commands.q)
    off = np.linalg.norm(place - commanded, axis=1)[good]
    assert off.max() < 1e-3
    turn = Rotation.from_matrix(rotation[good].transpose(0, 2, 1) @ command_turn[good])
    assert np.degrees(turn.magnitude()).max() < 1e-4
    wrench = np.tile([*LOAD, 0.0, 0.0, 0.0], (n, 1))
    deflection = 1000.0 * model.fitted.predict(commands.q, wrench)
    deflection = deflection @ robot.controller.world[:3, :3]
    assert np.linalg.norm(commanded + deflection - wanted_mm, axis=1)[good].max() < 2e-3
    assert np.linalg.norm(place - wanted_mm, axis=1)[~good].max(initial=0.0) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_only_the_numbers_of_targets_change(name, tmp_path):
    options = {"load": LOAD, "allow_steps": True, **options_of(name)}
    done = compensate_program(model_of(ROBOTS[name]), DOCS / name, tmp_path / name, **options)
    assert len(done.path.removed) == len(done.lines)
    for file in done.files:
        old, new = (path.read_bytes().decode() for path in (DOCS / file.name, file))
        assert NUMBER.sub("#", old) == NUMBER.sub("#", new)
        assert old != new


def krl(tmp_path: Path, body: str, name: str = "a.src") -> Path:
    frames = "$BASE={X 380,Y -60,Z 250,A 0,B 0,C 0}\n$TOOL={X 60,Y 0,Z 80,A 0,B 0,C 0}\n"
    file = tmp_path / name
    file.write_text(frames + "PTP {A1 0,A2 -90,A3 90,A4 0,A5 60,A6 0}\n" + body)
    return file


POSE = "{X 0,Y 0,Z 50,A 180,B 0,C 180}"


def test_a_written_status_and_turn_choose_the_configuration(tmp_path):
    joints = []
    for name, config in (("b.src", "S 2,T 2"), ("c.src", "S 6,T 18")):
        file = krl(tmp_path, f"PTP {POSE[:-1]},{config}}}\n")
        done = compensate_program(model_of("kr10-r1100-2"), file, tmp_path / name, load=LOAD)
        joints.append(done.targets.q[1])
        assert config[:3] in (tmp_path / name).read_text()
    assert joints[0][4] > 0.0 > joints[1][4]


def test_a_turn_that_the_correction_changes_is_rewritten(tmp_path):
    body = "PTP {X 100,Y 60,Z 50,A 180,B 0,C 180,S 2,T 2}\n"  # joints 1, 4 and 6 are zero
    file, model = krl(tmp_path, body), model_of("kr10-r1100-2")
    done = compensate_program(model, file, tmp_path / "b.src", load=(0, -40, -20))
    assert done.changed_configurations == (4,)
    turn = int(re.search(r"T (\d+)}", (tmp_path / "b.src").read_text())[1])
    angles = done.targets.q[1]
    assert turn == sum(1 << i for i in range(6) if angles[i] < 0.0) != 2


def test_loads_by_line_are_those_of_the_motions(tmp_path):
    file = krl(tmp_path, f"LIN {POSE}\nLIN {POSE}\n")
    loads = tmp_path / "loads.csv"
    loads.write_text("line,fx_N,fy_N,fz_N\n3,0,0,0\n4,0,0,-20\n5,0,0,-40\n")
    model = model_of("kr10-r1100-2")
    done = compensate_program(model, file, tmp_path / "b.src", loads=loads)
    removed = np.linalg.norm(done.path.compensation.removed, axis=1)
    assert removed[0] == 0.0
    assert removed[2] == pytest.approx(2.0 * removed[1], rel=1e-2)
    for text, part in (
        ("3,0,0,0\n4,0,0,-20\n", "no load for line 5"),
        ("3,0,0,0\n4,0,0,-20\n4,0,0,0\n5,0,0,0\n", "each line once"),
    ):
        loads.write_text("line,fx_N,fy_N,fz_N\n" + text)
        with pytest.raises(DataError, match=part):
            compensate_program(model, file, tmp_path / "c.src", loads=loads)
    with pytest.raises(ConfigError, match="needed once"):
        compensate_program(model, file, tmp_path / "c.src")


def test_a_load_in_the_tool_frame_turns_with_the_tool(tmp_path):
    file, model, targets = krl(tmp_path, f"LIN {POSE}\n"), model_of("kr10-r1100-2"), []
    # A 180, C 180: x backwards, z down
    for frame, load in (("world", (5, 0, 20)), ("tool", (-5, 0, -20))):
        done = compensate_program(model, file, tmp_path / f"{frame}.src", load=load, frame=frame)
        targets.append(done.targets.position[1])
    np.testing.assert_allclose(*targets, atol=1e-9)


def test_one_point_under_two_loads_is_left_or_stops(tmp_path):
    shutil.copy(DOCS / "pocket.dat", tmp_path / "a.dat")
    file = krl(tmp_path, "LIN XP1\nLIN XP1\n")
    loads = tmp_path / "loads.csv"
    loads.write_text("line,fx_N,fy_N,fz_N\n3,0,0,0\n4,0,0,-20\n5,0,0,-40\n")
    model = model_of("kr10-r1100-2")
    done = compensate_program(model, file, tmp_path / "b.src", loads=loads)
    assert [motion.line for motion in done.left_motions] == [4, 5]
    assert (tmp_path / "b.dat").read_bytes() == (tmp_path / "a.dat").read_bytes()
    with pytest.raises(ModelError, match="line 4"):
        compensate_program(model, file, tmp_path / "c.src", loads=loads, strict=True)
    assert not (tmp_path / "c.src").exists()


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("LIN {X 5000,Y 0,Z 0,A 0,B 0,C 0}", "out of reach"),
        ("LIN {X 545,Y 60,Z 155,A 0,B 90,C 0}", "singular"),
        (f"PTP {POSE[:-1]},S 0,T 0}}", "S 0, T 0; the pose is reached with S 2"),
    ],
)
def test_an_impossible_target_is_left_with_its_line_and_cause(tmp_path, body, reason):
    file, model = krl(tmp_path, body), model_of("kr10-r1100-2")
    done = compensate_program(model, file, tmp_path / "b.src", load=LOAD)
    (motion,) = done.left_motions
    assert motion.line == 4 and reason in motion.reason
    assert body in (tmp_path / "b.src").read_text()


def test_a_program_without_a_correctable_motion_is_refused_with_every_cause(tmp_path):
    file = tmp_path / "a.src"
    file.write_text("$BASE=$WORLD\nPTP XHOME\nLIN XP1\nLIN XHOME\n")
    causes = "lines 2, 4: .*XHOME is a variable; line 3: .*XP1 is a variable"
    with pytest.raises(ModelError, match=causes):
        compensate_program(model_of("kr10-r1100-2"), file, tmp_path / "b.src", load=LOAD)
    assert not (tmp_path / "b.src").exists()


def test_a_frame_that_is_not_in_the_program_is_given_by_number_or_listed(tmp_path):
    model = model_of("kr10-r1100-2")
    for body, option in (("BAS(#TOOL,1)", "tool 1="), ("$BASE=BASE_DATA[2]", "workpiece 2=")):
        file = krl(tmp_path, f"{body}\nLIN {POSE}\n", f"{option[:4]}.src")
        done = compensate_program(model, file, tmp_path / f"new{file.name}", load=LOAD)
        assert [motion.line for motion in done.left_motions] == [5]
        assert option in done.left_motions[0].reason
    words = {"load": LOAD, "workpiece": (380.0, -60.0, 250.0, 0.0, 0.0, 0.0)}
    done = compensate_program(model, file, tmp_path / "b.src", **words)
    file = krl(tmp_path, f"LIN {POSE}\n", "c.src")
    usual = compensate_program(model, file, tmp_path / "d.src", load=LOAD)
    np.testing.assert_allclose(done.targets.q, usual.targets.q, atol=1e-9)
    mixed = krl(tmp_path, f"BAS(#BASE,1)\nLIN {POSE}\nBAS(#BASE,2)\nLIN {POSE}\n")
    for wrong, message in (
        (file, "the program holds"),
        (mixed, r"line 7: BASE_DATA\[2\] is another frame"),
    ):
        with pytest.raises(ConfigError, match=message):
            compensate_program(model, wrong, tmp_path / "e.src", **words)
    frames_by_number = {1: words["workpiece"], 2: (380.0, -60.0, 300.0, 0.0, 0.0, 0.0)}
    done = compensate_program(
        model, mixed, tmp_path / "f.src", load=LOAD, workpiece=frames_by_number
    )
    heights = 1000.0 * done.targets.target[1:, 2]
    assert heights[1] - heights[0] == pytest.approx(50.0)


def test_a_step_between_corrected_and_left_motions_of_a_path_is_refused(tmp_path):
    model = model_of("kr10-r1100-2")
    file = krl(tmp_path, f"LIN {POSE}\nLIN XP1\nPTP XHOME\nLIN XP1\n")
    with pytest.raises(
        ModelError, match=r"line 4 is corrected, line 5 is not: LIN XP1: .*variable"
    ):
        compensate_program(model, file, tmp_path / "b.src", load=LOAD)
    assert not (tmp_path / "b.src").exists()
    done = compensate_program(model, file, tmp_path / "b.src", load=LOAD, allow_steps=True)
    assert [motion.line for motion in done.left_motions] == [5, 6, 7]
    ended = krl(tmp_path, f"LIN {POSE}\nPTP XHOME\nLIN XP1\n")  # a joint motion ends a path
    compensate_program(model, ended, tmp_path / "c.src", load=LOAD)
    loads = tmp_path / "loads.csv"
    loads.write_text("line,fx_N,fy_N,fz_N\n3,0,0,0\n4,0,0,-20\n5,0,0,0\n")
    compensate_program(model, file, tmp_path / "d.src", loads=loads)  # a load of zero, too


def test_a_path_goes_on_in_a_subprogram(tmp_path):
    body = f"LIN {POSE}\nSUB()\nEND\nDEF SUB()\nLIN XP1\nEND\n"
    with pytest.raises(ModelError, match="line 4 is corrected, line 8 is not"):
        compensate_program(
            model_of("kr10-r1100-2"), krl(tmp_path, body), tmp_path / "b.src", load=LOAD
        )


def test_a_left_motion_that_depends_on_a_corrected_target_is_a_step(tmp_path):
    shutil.copy(DOCS / "pocket.dat", tmp_path / "a.dat")
    body = f"LIN XP1\nPTP XHOME\nXP5=XP1:{POSE}\nLIN XP5\n"
    with pytest.raises(ModelError, match=r"line 4 is corrected, line 7 is not.*moves with line 4"):
        compensate_program(
            model_of("kr10-r1100-2"), krl(tmp_path, body), tmp_path / "b.src", load=LOAD
        )


CIRCLE = "{X 40,Y 40,Z 50,A 180,B 0,C 180},{X 80,Y 0,Z 50,A 180,B 0,C 180}"


def test_a_circle_is_corrected_with_its_helper_point(tmp_path):
    file = krl(tmp_path, f"LIN {POSE}\nCIRC {CIRCLE},CA 360\n")
    done = compensate_program(model_of("kr10-r1100-2"), file, tmp_path / "b.src", load=LOAD)
    assert done.lines == (3, 4, 5, 5) and not done.left_motions
    points = 1000.0 * done.targets.position[1:]
    centre = points[[0, 2]].mean(axis=0)
    radii = np.linalg.norm(points - centre, axis=1)
    np.testing.assert_allclose(radii, 40.0, atol=0.1)
    assert "CA 360" in (tmp_path / "b.src").read_text()


@pytest.mark.parametrize(
    ("body", "lines"),
    [
        (f"PTP {POSE}\nCIRC {CIRCLE.replace('X 40', 'X 4000')}\n", [4, 5]),  # helper out of reach
        (f"PTP XHOME\nCIRC {CIRCLE}\n", [4, 5]),  # unknown start
        (f"PTP {POSE}\nIF A THEN\nPTP XHOME\nENDIF\nCIRC {CIRCLE}\n", [6, 8]),  # two starts
        (f"PTP {POSE}\nCIRC_REL {{X 1}},{{X 2}}\n", [4, 5]),
    ],
)
def test_a_circle_is_left_with_all_its_points(tmp_path, body, lines):
    file = krl(tmp_path, body)
    done = compensate_program(model_of("kr10-r1100-2"), file, tmp_path / "b.src", load=LOAD)
    assert [motion.line for motion in done.left_motions] == lines
    text = (tmp_path / "b.src").read_text()
    assert all(file.read_text().splitlines()[line - 1] in text for line in lines)


def test_missing_numbers_of_a_target_are_inserted(tmp_path):
    file = krl(tmp_path, f"LIN {POSE}\nLIN {{X 40}} C_DIS\n")
    full = krl(tmp_path, f"LIN {POSE}\nLIN {POSE.replace('X 0', 'X 40')} C_DIS\n", "c.src")
    model, texts = model_of("kr10-r1100-2"), []
    for source, name in ((file, "b.src"), (full, "d.src")):
        compensate_program(model, source, tmp_path / name, load=LOAD)
        texts.append((tmp_path / name).read_text().splitlines()[-1])
    assert texts[0] == texts[1].replace(",A 180,B 0,C 180", "")


def test_a_relative_motion_between_corrected_targets_is_listed_without_a_step(tmp_path):
    file = krl(tmp_path, f"LIN {POSE}\nLIN_REL {{Z 5}}\nLIN {POSE}\n")
    done = compensate_program(model_of("kr10-r1100-2"), file, tmp_path / "b.src", load=LOAD)
    assert [motion.line for motion in done.left_motions] == [5]
    assert "LIN_REL {Z 5}" in (tmp_path / "b.src").read_text()


def test_external_axes_that_move_are_listed_and_may_be_held(tmp_path):
    poses = [POSE.replace("}", f",E1 {track}}}") for track in (0, 250, 250)]
    file = krl(tmp_path, "".join(f"LIN {pose}\n" for pose in poses))
    model = model_of("kr10-r1100-2")
    with pytest.raises(ModelError, match=r"lines 3-6: .*E1 is from 0 to 250"):
        compensate_program(model, file, tmp_path / "b.src", load=LOAD)
    held = {"hold": {"E1": 250.0}, "load": LOAD, "allow_steps": True}
    done = compensate_program(model, file, tmp_path / "c.src", **held)
    assert [motion.line for motion in done.left_motions] == [3, 4]
    with pytest.raises(ConfigError, match="E1=VALUE"):
        compensate_program(model, file, tmp_path / "d.src", load=LOAD, hold={"E9": 0.0})


def test_a_template_of_loads_has_each_motion_and_is_read_back(tmp_path):
    file, model = krl(tmp_path, f"LIN {POSE}\nPTP XHOME\n"), model_of("kr10-r1100-2")
    template = tmp_path / "loads.csv"
    first = compensate_program(model, file, tmp_path / "b.src", load=LOAD, loads_template=template)
    assert [row.split(",")[0] for row in template.read_text().splitlines()] == [
        "line",
        "3",
        "4",
        "5",
    ]
    second = compensate_program(model, file, tmp_path / "c.src", loads=template)
    np.testing.assert_array_equal(first.targets.position, second.targets.position)


def test_the_frame_of_the_load_is_named_and_turns_it(tmp_path):
    turned = f"$BASE={{X 380,Y -60,Z 250,A 90,B 0,C 0}}\nLIN {POSE}\n"
    file, model, targets = krl(tmp_path, turned), model_of("kr10-r1100-2"), []
    for frame, load in (("base", (40, 0, 0)), ("world", (0, 40, 0))):
        done = compensate_program(model, file, tmp_path / f"{frame}.src", load=load, frame=frame)
        targets.append(done.targets.position[1])
        assert f"frame of the loads: {frame}" in repr(done)
    np.testing.assert_allclose(*targets, atol=1e-9)
    with pytest.raises(ConfigError, match="world"):
        compensate_program(model, file, tmp_path / "c.src", load=LOAD, frame="user")


def test_a_spring_model_predicts_at_the_programs_own_tool(tmp_path):
    file = tmp_path / "a.src"
    file.write_text(
        "$BASE={X 380,Y -60,Z 250,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 150,A 0,B 0,C 0}\n"
        f"PTP {{A1 0,A2 -90,A3 90,A4 0,A5 60,A6 0}}\nLIN {POSE}\n"
    )
    model = model_of("kr10-r1100-2")
    done = compensate_program(model, file, tmp_path / "b.src", load=LOAD)
    robot, q = model.fitted.robot_, done.targets.q
    chain = robot.flange @ robot.controller.flange
    arm = replace(robot, tcp=(chain @ np.r_[0.0, 0.0, 0.15, 1.0])[:3])
    force = np.array(LOAD) @ robot.controller.world[:3, :3].T
    twists = arm.jacobian(q)
    torque = np.einsum("nij,i->nj", twists[:, :3], force)
    bent = np.einsum("nij,nj->ni", twists[:, :3], model.fitted.springs_.compliance * torque)
    np.testing.assert_allclose(arm.tcp_position(q) + bent, done.targets.target, atol=2e-6)
    assert "springs predict there" in repr(done)
    neighbours = sb.make_model("knn").fit(sb.load_dataset("kr10-twin"))
    with pytest.raises(DataError, match=r"TCP at 0,0,150 mm.*spring models"):
        compensate_program(neighbours, file, tmp_path / "c.src", load=LOAD)


def test_one_given_frame_belongs_to_the_frame_that_is_set(tmp_path):
    file = tmp_path / "a.src"
    joints = "PTP {A1 0,A2 -90,A3 90,A4 0,A5 60,A6 0}\n"
    file.write_text(f"$BASE={{X 380,Y -60,Z 250,A 0,B 0,C 0}}\n{joints}BAS(#TOOL,1)\nLIN {POSE}\n")
    model, tool = model_of("kr10-r1100-2"), (60.0, 0.0, 80.0, 0.0, 0.0, 0.0)
    done = compensate_program(model, file, tmp_path / "b.src", load=LOAD, tool=tool)
    assert [motion.line for motion in done.left_motions] == [2]
    assert "not set before (give --tool TOOL=" in done.left_motions[0].reason
    tools = {"TOOL": tool, 1: tool}
    done = compensate_program(model, file, tmp_path / "c.src", load=LOAD, tool=tools)
    assert not done.left_motions


def test_a_file_of_another_kind_or_that_exists_is_refused(tmp_path):
    model = model_of("kr10-r1100-2")
    with pytest.raises(ConfigError, match="use the extension of"):
        compensate_program(model, DOCS / "pocket.src", tmp_path / "b.mod", load=LOAD)
    (tmp_path / "b.dat").write_text("mine")
    with pytest.raises(StoreError, match=r"b.dat: exists"):
        compensate_program(model, DOCS / "pocket.src", tmp_path / "b.src", load=LOAD)
    assert not (tmp_path / "b.src").exists()


@pytest.mark.slow
def test_a_program_is_corrected_and_drawn_on_the_command_line(tmp_path):
    model_of("kr10-r1100-2").save(tmp_path / "my.stiff", cross_validate=False)
    words = ("path", "compensate", "--model", "my.stiff", "--program", str(DOCS / "pocket.src"))
    words = (*words, "--load", "0,20,-40", "--output")
    step = bench_here(*words, "new.src", cwd=tmp_path)
    assert step.returncode == 2 and not (tmp_path / "new.src").exists()
    assert "line 16 is corrected, line 17 is not" in step.stderr
    words = (*words[:-1], "--allow-steps", "--output")
    done = bench_here(*words, "new.src", "--figure", "new.png", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in (
        "beyond the training range",
        "9 of 9 targets corrected",
        "left as they were: 2 motions",
        "frame of the loads: world",
        "expected error, mean at left-out poses: ",
        "90 % interval, half width: ",
    ):
        assert part in done.stdout
    assert (tmp_path / "new.png").stat().st_size > 20_000
    for wrong, part in (
        ("--strict", "line 8: PTP XHOME"),
        ("--hold=A1=0", "--hold A1"),
    ):
        refused = bench_here(*words, "s.src", wrong, cwd=tmp_path)
        assert refused.returncode != 0 and part in refused.stderr
        assert not (tmp_path / "s.src").exists()


@pytest.mark.slow
def test_the_robot_carries_its_controller_through_a_model_file(tmp_path):
    model_of("lr-mate-200id").save(tmp_path / "my.stiff", cross_validate=False)
    robot = sb.load_model(tmp_path / "my.stiff").fitted.robot_
    shipped_controller = named_robot("lr-mate-200id").robot().controller
    assert robot.controller.j3_from_ground
    np.testing.assert_array_equal(robot.controller.flange, shipped_controller.flange)
