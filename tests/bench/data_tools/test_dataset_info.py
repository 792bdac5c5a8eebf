"""`bench data info`: facts against closed forms and Pinocchio, the spread rule, the picture."""

from __future__ import annotations

import struct
import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest

from stiff_bench.data_tools.info import (
    about_mean,
    dataset_info,
    directions,
    facts,
    picture_title,
    render_facts,
)
from stiff_bench.data_tools.picture import save_picture
from stiff_bench.store.samples import load_torque
from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.robots.robot import load_robot, read_chain
from stiff_models.physics.kinematics import gravity_torque
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
AXES_OF = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def chain(kinds_and_axes, *, mass=0.0, name="made"):
    """A robot whose joints lie 1 m apart along x, each link's mass in the middle."""
    n = len(kinds_and_axes)
    placements = np.tile(np.eye(4), (n, 1, 1))
    placements[1:, 0, 3] = 1.0
    return Robot(
        name=name,
        joint_names=tuple(f"j{i + 1}" for i in range(n)),
        joint_types=tuple(kind for kind, _ in kinds_and_axes),
        placements=placements,
        axes=np.array([AXES_OF[axis] for _, axis in kinds_and_axes]),
        lower=np.full(n, -np.pi),
        upper=np.full(n, np.inf),
        masses=np.full(n, mass),
        centres_of_mass=np.tile([0.5, 0.0, 0.0], (n, 1)),
        tcp=np.array([1.0, 0.0, 0.0]),
    )


def made_data(robot, n, rng, **given):
    values = {
        "q": rng.uniform(-1.0, 1.0, size=(n, robot.n_joints)),
        "wrench": rng.normal(size=(n, 6)) * 50.0,
        "deflection": rng.normal(size=(n, 3)) * 1e-3,
        "pose_id": np.array([f"P{i}" for i in range(n)]),
        "load_id": np.full(n, "1"),
        "group": np.full(n, "all"),
    }
    return BenchmarkData(Samples(**(values | given)), robot)


@pytest.fixture()
def planar():
    """Three samples of an arm of two 1 m links that turn downwards (about y), 2 kg each."""
    return BenchmarkData(
        Samples(
            q=np.array([[0.0, 0.0], [0.0, np.pi / 2], [0.0, np.pi / 2]]),
            wrench=np.array(
                [[0.0, 0.0, -10.0, 0.0, 0.0, 0.0], [0.0, 0.0, -20.0, 0.0, 3.0, 0.0], [0.0] * 6]
            ),
            deflection=np.array([[0.0, 0.0, -1e-3], [3e-3, 0.0, -4e-3], [0.0] * 3]),
            pose_id=np.array(["A", "B", "B"]),
            load_id=np.array(["1", "1", "2"]),
            group=np.array(["straight", "bent", "bent"]),
        ),
        chain([("revolute", "y"), ("revolute", "y")], mass=2.0),
    )


def test_samples_poses_loads_and_groups_are_counted(planar):
    found = facts(planar)
    assert (found.n_samples, found.n_poses, found.loads_a_pose) == (3, 2, (1, 2))
    assert found.groups == (("straight", 1), ("bent", 2))
    assert found.sha256 == planar.sha256


def test_magnitudes_of_loads_and_deflections_are_those_of_the_hand_made_samples(planar):
    found = facts(planar)
    sizes = found.sizes  # least, median, mean, most
    assert sizes.loc["|force|"].tolist() == [0.0, 10.0, 10.0, 20.0]
    assert sizes.loc["|torque|"].tolist() == [0.0, 0.0, 1.0, 3.0]
    assert sizes.loc["|deflection|", ["median", "max"]].tolist() == pytest.approx([1e-3, 5e-3])
    means = sizes.loc[["|dx|", "|dy|", "|dz|"], "mean"].tolist()
    assert means == pytest.approx([1e-3, 0.0, 5e-3 / 3])


def test_joint_torques_of_a_planar_arm_are_force_times_lever(planar):
    # a force F down at x turns the arm by F x about y; the second sample adds a torque of 3 N m
    joints = facts(planar).joints
    assert joints["position_low"].tolist() == [0.0, 0.0]
    assert joints["position_high"].tolist() == pytest.approx([0.0, np.pi / 2])
    assert joints["load_low"].tolist() == pytest.approx([0.0, 0.0])
    assert joints["load_high"].tolist() == pytest.approx([23.0, 10.0])
    weight = 2.0 * 9.81
    assert joints["gravity_high"].tolist() == pytest.approx([weight * 2.0, weight * 0.5])
    assert joints["gravity_low"].tolist() == pytest.approx([weight * 1.5, 0.0], abs=1e-12)


SLIDING_ARM = (
    '<robot name="sliding"><link name="l0"/>'
    '<joint name="a" type="prismatic"><parent link="l0"/><child link="l1"/>'
    '<origin xyz="0.1 0.2 0.3" rpy="0.3 -0.5 0.7"/><axis xyz="0 0.6 0.8"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    '<link name="l1"><inertial><origin xyz="0.1 0 0.2"/><mass value="3"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
    '<joint name="b" type="revolute"><parent link="l1"/><child link="l2"/>'
    '<origin xyz="0.4 0 0.1" rpy="1.1 0.2 0"/><axis xyz="1 0 0"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    '<link name="l2"><inertial><origin xyz="0.2 0.3 0"/><mass value="2"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>'
)


def test_statics_of_a_sliding_and_turning_arm_equal_pinocchios(tmp_path, rng):
    urdf = tmp_path / "sliding.urdf"
    urdf.write_text(SLIDING_ARM)
    tcp = (0.1, -0.2, 0.3)
    robot, truth = load_robot(urdf, tcp=tcp), read_chain(urdf, tcp=tcp)
    assert robot.joint_types == ("prismatic", "revolute")
    model, data = truth.model, truth.model.createData()
    q = rng.uniform(-1.0, 1.0, size=(20, 2))
    gravity, position = gravity_torque(robot, q), robot.tcp_position(q)
    for pose, torque, tip in zip(q, gravity, position, strict=True):
        expected = -pin.computeGeneralizedGravity(model, data, pose)
        np.testing.assert_allclose(torque, expected, atol=1e-12)
        pin.forwardKinematics(model, data, pose)
        np.testing.assert_allclose(tip, data.oMi[2].act(truth.tcp), atol=1e-12)


def test_load_torque_does_the_work_of_the_wrench(kr10, rng):
    # virtual work: tau . dq = F . dx for a pure force, dx by central differences
    data = made_data(kr10, 5, rng)
    force = np.array(data.samples.wrench)
    force[:, 3:] = 0.0
    data = BenchmarkData(replace(data.samples, wrench=force), kr10)
    step, q = 1e-6, data.samples.q
    for joint in range(6):
        turn = step * np.eye(6)[joint]
        moved = (kr10.tcp_position(q + turn) - kr10.tcp_position(q - turn)) / (2 * step)
        work = (moved * force[:, :3]).sum(axis=1)
        np.testing.assert_allclose(load_torque(data)[:, joint], work, atol=1e-6)


def around(axis, degrees, rng, n=4000):
    """Directions spread evenly within an angle of an axis, over the sphere's surface."""
    z = rng.uniform(np.cos(np.deg2rad(degrees)), 1.0, size=n)
    angle = rng.uniform(0.0, 2.0 * np.pi, size=n)
    radius = np.sqrt(1.0 - z**2)
    return np.roll(np.stack([radius * np.cos(angle), radius * np.sin(angle), z], 1), axis + 1, 1)


def test_directions_of_one_line_are_told_one_way_from_both_ways(rng):
    line = np.outer(rng.uniform(1.0, 5.0, size=30), [1.0, 2.0, -2.0])
    assert directions(line).text == "along a line, one way"
    assert directions(line).shares == pytest.approx((1.0, 0.0, 0.0))
    assert directions(line).resultant == pytest.approx(1.0)
    line[::2] *= -1.0
    assert directions(line).text == "along a line, both ways"
    assert directions(line).resultant == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("degrees", "text"),
    [
        (22.0, "along a line, one way"),
        (30.0, "over one side of the sphere"),
        (90.0, "over one side of the sphere"),
        (180.0, "over the whole sphere"),
    ],
)
def test_a_cone_is_a_line_up_to_26_degrees_and_the_sphere_when_it_closes(degrees, text, rng):
    for axis in range(3):
        assert directions(around(axis, degrees, rng)).text == text


def test_directions_in_a_plane_are_told_on_one_side_from_all_round(rng):
    def fan(degrees, thickness=0.0):
        angle = np.deg2rad(rng.uniform(0.0, degrees, size=4000))
        height = rng.uniform(-1.0, 1.0, size=4000) * np.sin(np.deg2rad(thickness))
        flat = np.sqrt(1.0 - height**2)
        return np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], axis=1)

    assert directions(fan(360.0)).text == "in a plane, all round"
    assert directions(fan(180.0)).text == "in a plane, on one side"
    assert directions(fan(360.0, thickness=20.0)).text == "in a plane, all round"
    assert directions(fan(360.0, thickness=26.0)).text == "over the whole sphere"


def test_the_size_of_a_load_does_not_change_how_directions_lie_and_zeros_are_left_out(rng):
    force = rng.normal(size=(50, 3))
    scaled = np.vstack([force * rng.uniform(0.1, 100.0, size=(50, 1)), np.zeros((10, 3))])
    assert directions(scaled).shares == pytest.approx(directions(force).shares)
    assert directions(np.zeros((4, 3))).text == "none"


def test_forces_between_two_points_lie_along_a_line_though_their_directions_fill_a_plane():
    ends = np.array([[100.0, 40.0, -20.0], [20.0, 5.0, -100.0]])  # source paper, Table 5
    share = np.linspace(0.0, 1.0, 5)[:, None]
    force = (1.0 - share) * ends[0] + share * ends[1]
    assert about_mean(force).text == "along a line"
    assert directions(force).text == "in a plane, on one side"
    assert about_mean(np.tile(ends[0], (5, 1))).text == "all the same"


def test_rendered_facts_are_in_degrees_millimetres_and_newtons(planar):
    text = render_facts(facts(planar))
    assert "loads a pose  1 .. 2" in text
    assert "straight (1), bent (2)" in text
    assert planar.sha256 in text
    (deflection,) = (line for line in text.splitlines() if line.startswith("|deflection|"))
    assert deflection.split() == ["|deflection|", "0.000", "1.000", "2.000", "5.000", "mm"]
    (second,) = (line for line in text.splitlines() if line.startswith("j2"))
    assert second.split() == "j2 0.0 .. 90.0 -180 .. inf deg 0.0 .. 10.0 0.0 .. 9.8 N m".split()
    assert "-0.0" not in text


def test_a_sliding_joint_is_told_in_millimetres_and_newtons(rng):
    robot = chain([("prismatic", "z"), ("revolute", "y")], mass=2.0)
    q = np.array([[0.1, 0.0], [-0.25, 0.0]])
    text = render_facts(facts(made_data(robot, 2, rng, q=q, wrench=np.zeros((2, 6)))))
    (sliding,) = (line for line in text.splitlines() if line.startswith("j1"))
    expected = "j1 -250.0 .. 100.0 -3142 .. inf mm 0.0 .. 0.0 -39.2 .. -39.2 N"
    assert sliding.split() == expected.split()


def test_a_robot_without_masses_says_so_instead_of_a_gravity_torque():
    data = FanucR2000iC().load()
    found = facts(data)
    assert found.joints[["gravity_low", "gravity_high"]].isna().all(axis=None)
    assert found.sizes.loc["|torque|", "max"] == 0.0
    assert found.spreads["torque directions"].text == "none"
    assert "The robot has no masses" in render_facts(found)


def test_more_than_a_thousand_samples_are_told_too(rng):
    text = render_facts(facts(made_data(chain([("revolute", "z")]), 1200, rng)))
    assert "samples       1200" in text


def test_facts_of_no_samples_are_refused(rng):
    with pytest.raises(DataError, match=r"robot 'made' has no samples"):
        facts(made_data(chain([("revolute", "z")]), 0, rng))


def png_size(path):
    content = path.read_bytes()
    assert content.startswith(PNG_SIGNATURE)
    return struct.unpack(">II", content[16:24])


def test_the_picture_is_a_png_of_10_by_8_inch_at_150_dots(planar, tmp_path):
    path = tmp_path / "made.png"
    save_picture(planar, "made (simulated)", path)
    assert png_size(path) == (1500, 1200)
    assert [file.name for file in tmp_path.iterdir()] == ["made.png"]


@pytest.mark.parametrize(("suffix", "start"), [(".pdf", b"%PDF-"), (".SVG", b"<?xml")])
def test_the_suffix_chooses_the_format_and_the_same_data_give_the_same_file(
    suffix, start, planar, tmp_path
):
    contents = []
    for name in ("first", "second"):
        path = tmp_path / f"{name}{suffix}"
        save_picture(planar, "made (simulated)", path)
        contents.append(path.read_bytes())
    assert contents[0].startswith(start)
    assert contents[0] == contents[1]


@pytest.mark.parametrize("name", ["made.jpg", "made"])
def test_another_suffix_is_refused_and_the_valid_ones_are_named(name, planar, tmp_path):
    with pytest.raises(ConfigError, match=r"made.*\(valid: \.png, \.pdf, \.svg\)"):
        save_picture(planar, "made", tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_picture_in_a_missing_folder_is_refused(planar, tmp_path):
    with pytest.raises(StoreError, match="cannot be written"):
        save_picture(planar, "made", tmp_path / "absent" / "made.png")


def test_the_picture_says_title_groups_and_that_zero_loads_have_no_direction(planar, tmp_path):
    path = tmp_path / "made.svg"
    save_picture(planar, "made (simulated)", path)
    text = path.read_text(encoding="utf-8")
    written = [line for line in text.splitlines() if line.strip().startswith("<!--")]
    for words in ("made (simulated)", "straight", "bent", "downwards: 2", "upwards: 0", "base"):
        assert any(words in line for line in written), words


def test_a_name_with_a_dollar_sign_is_drawn_as_it_is_written(planar, tmp_path):
    path = tmp_path / "made.svg"
    save_picture(planar, "cost_$a^{ (measured)", path)
    assert "cost_$a^{ (measured)" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("n_joints", [1, 2, 7])
def test_a_picture_is_made_of_any_chain_even_of_one_sample_without_load(n_joints, rng, tmp_path):
    joints = [("prismatic" if i == 1 else "revolute", "xyz"[i % 3]) for i in range(n_joints)]
    data = made_data(chain(joints), 1, rng, wrench=np.zeros((1, 6)), deflection=np.zeros((1, 3)))
    path = tmp_path / "made.png"
    save_picture(data, "made (simulated)", path)
    assert png_size(path) == (1500, 1200)


@pytest.mark.parametrize(("largest", "logarithmic"), [(20.0, False), (500.0, True)])
def test_torques_of_different_magnitude_are_drawn_on_a_logarithmic_axis(
    largest, logarithmic, rng, tmp_path
):
    robot = chain([("revolute", "x"), ("revolute", "y")])  # at q = 0 they feel tx and ty alone
    wrench = np.array([[0.0, 0.0, 0.0, largest, 2.0, 0.0]])
    path = tmp_path / "made.svg"
    save_picture(made_data(robot, 1, rng, q=np.zeros((1, 2)), wrench=wrench), "made", path)
    assert ("log beyond ±1" in path.read_text(encoding="utf-8")) == logarithmic


def test_a_large_cloud_is_thinned_and_the_picture_says_so(rng, tmp_path):
    path = tmp_path / "large.svg"
    save_picture(made_data(chain([("revolute", "z")]), 100_000, rng), "large", path)
    text = path.read_text(encoding="utf-8")
    assert "(3,000 of 100,000 drawn)" in text
    assert len(text) < 1_500_000


def test_matplotlib_is_imported_only_when_a_picture_is_made():
    code = "import sys, stiff_bench.data_tools.info, stiff_bench.data_tools.picture as picture\n"
    code += "print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@dataclass(frozen=True, kw_only=True)
class CardedInfo(DatasetInfo):
    card: str = ""


def info_of(card):
    return CardedInfo(
        key="fanuc-r2000ic",
        target="stiff_datasets.measured.fanuc_r2000ic:FanucR2000iC",
        kind="measured",
        summary="43 real deflections",
        reference="a card",
        caveats=("too few to rank.",),
        card=card,
    )


def test_info_holds_heading_facts_card_and_the_place_of_the_picture(tmp_path):
    data, picture = FanucR2000iC().load(), tmp_path / "fanuc.png"
    text = dataset_info(info_of("data/fanuc_r2000ic.md"), data, picture)
    parts = (
        "fanuc-r2000ic (measured): 43 real deflections",
        "reference: a card",
        "caveat: too few to rank.",
        render_facts(facts(data)),
        "# Data card: fanuc-r2000ic",
        f"picture: {picture}",
    )
    places = [text.index(part) for part in parts]
    assert places == sorted(places)


def test_info_without_card_and_picture_names_neither():
    text = dataset_info(info_of(""), FanucR2000iC().load(), None)
    assert "picture" not in text and "# Data card" not in text


def test_a_card_that_is_not_there_is_named():
    with pytest.raises(DataError, match=r"'fanuc-r2000ic': card 'data/absent\.md'.*expected"):
        dataset_info(info_of("data/absent.md"), FanucR2000iC().load(), None)


def test_the_pictures_title_says_whether_anything_was_measured():
    assert picture_title(info_of("")) == "fanuc-r2000ic (measured)"
