"""`bench data info`: facts against closed forms and Pinocchio, the spread rule, the picture."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

import stiffbench as sb
from helpers.made_robots import planar_arm
from helpers.made_samples import samples_with
from stiff_bench.figures.dataset_picture import dataset_picture
from stiff_bench.tables.dataset_facts import card_text, dataset_info, facts
from stiff_bench.tables.table import Quantity
from stiff_bench.tables.writers import plain_text
from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import BenchmarkData, Samples

AXES_OF = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def chain(kinds_and_axes, *, mass=0.0):
    """Return a robot with joints 1 m apart along x, link masses in the middle."""
    n = len(kinds_and_axes)
    return replace(
        planar_arm(n, AXES_OF["x"], mass),
        joint_types=tuple(kind for kind, _ in kinds_and_axes),
        axes=np.array([AXES_OF[axis] for _, axis in kinds_and_axes]),
        upper=np.full(n, np.inf),
        centres_of_mass=np.tile([0.5, 0.0, 0.0], (n, 1)),
    )


def made_data(robot, n, rng, **given):
    values = {
        "q": rng.uniform(-1.0, 1.0, size=(n, robot.n_joints)),
        "wrench": rng.normal(size=(n, 6)) * 50.0,
        "deflection": rng.normal(size=(n, 3)) * 1e-3,
    }
    return BenchmarkData(samples_with(**(values | given)), robot)


@pytest.fixture()
def planar():
    """Return three samples of an arm of two 1 m links, 2 kg each, that turn about y."""
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


def row(data, table, name):
    """Return the cells of a table's row after its name."""
    (matching_row,) = (cells[1:] for cells in facts(data)[table].rows if cells[0] == name)
    return matching_row


def ends(cells):
    return [None if cell is None else (cell.low, cell.high) for cell in cells]


def test_samples_poses_loads_and_groups_are_counted(planar):
    assert [
        row(planar, 0, name)[0] for name in ("samples", "poses", "loads per pose", "groups")
    ] == [3, 2, Quantity(low=1, high=2), "straight (1), bent (2)"]
    assert "loads per pose  1 to 2" in plain_text(facts(planar)[0])
    assert row(planar, 0, "sha256") == [planar.sha256]


def test_sizes_are_in_newtons_and_millimetres(planar):
    assert row(planar, 1, "|force| [N]") == [0.0, 10.0, 10.0, 20.0]  # least, median, mean, most
    assert row(planar, 1, "|torque| [N m]") == [0.0, 0.0, 1.0, 3.0]
    assert row(planar, 1, "|deflection| [mm]") == pytest.approx([0.0, 1.0, 2.0, 5.0])
    means = [row(planar, 1, f"|d{axis}| [mm]")[2] for axis in "xyz"]
    assert means == pytest.approx([1.0, 0.0, 5.0 / 3])


def test_joint_torques_of_a_planar_arm_are_force_times_lever(planar):
    # a force F down at x turns the arm by F x about y; the second sample adds a torque of 3 N m
    units, *first = row(planar, 3, "j1")
    assert units == "deg, N m"
    weight = 2.0 * 9.81
    of_weight = (round(weight * 1.5, 1), round(weight * 2.0, 1))
    assert ends(first) == [(0.0, 0.0), (-180.0, np.inf), (0.0, 23.0), of_weight]
    _, *second = row(planar, 3, "j2")
    assert ends(second) == [
        *((0.0, 90.0), (-180.0, np.inf), (0.0, 10.0), (0.0, round(weight * 0.5, 1)))
    ]
    assert "-0.0" not in plain_text(facts(planar)[3])


def test_a_sliding_joint_is_shown_in_millimetres_and_newtons(rng):
    robot = chain([("prismatic", "z"), ("revolute", "y")], mass=2.0)
    q = np.array([[0.1, 0.0], [-0.25, 0.0]])
    units, *sliding = row(made_data(robot, 2, rng, q=q, wrench=np.zeros((2, 6))), 3, "j1")
    assert units == "mm, N"
    assert ends(sliding) == [(-250.0, 100.0), (-3141.6, np.inf), (0.0, 0.0), (-39.2, -39.2)]


def test_a_robot_without_masses_has_a_note_instead_of_a_gravity_torque(rng):
    joints = facts(made_data(chain([("revolute", "y")] * 2), 3, rng))[3]
    assert [cells[-1] for cells in joints.rows] == [None] * 2
    assert "The robot has no masses" in joints.notes[0]


def around(axis, degrees, rng, n=4000):
    """Return directions spread evenly on a sphere within an angle of an axis."""
    z = rng.uniform(np.cos(np.deg2rad(degrees)), 1.0, size=n)
    angle = rng.uniform(0.0, 2.0 * np.pi, size=n)
    radius = np.sqrt(1.0 - z**2)
    return np.roll(np.stack([radius * np.cos(angle), radius * np.sin(angle), z], 1), axis + 1, 1)


def direction_facts(forces):
    """Return the shape of force directions, their mean length, and the shape about it."""
    data = made_data(chain([("revolute", "z")]), len(forces), np.random.default_rng(0))
    wrench = np.hstack([forces, np.zeros_like(forces)])
    data = BenchmarkData(replace(data.samples, wrench=wrench), data.robot)
    (way, _, mean), (about, *_) = (
        row(data, 2, name) for name in ("force directions", "forces about their mean")
    )
    return way, mean, about


def test_directions_along_one_line_are_one_way_or_both_ways(rng):
    line = np.outer(rng.uniform(1.0, 5.0, size=30), [1.0, 2.0, -2.0])
    assert direction_facts(line)[:2] == ("along a line", pytest.approx(1.0))
    line[::2] *= -1.0
    assert direction_facts(line)[:2] == ("along a line", pytest.approx(0.0, abs=1e-9))


@pytest.mark.parametrize(("degrees", "way"), [(22.0, "along a line"), (30.0, "in all directions")])
def test_a_cone_is_a_line_up_to_26_degrees(degrees, way, rng):
    for axis in range(3):
        assert direction_facts(around(axis, degrees, rng))[0] == way


def test_forces_between_two_points_lie_along_a_line_though_their_directions_fill_a_plane():
    ends = np.array([[100.0, 40.0, -20.0], [20.0, 5.0, -100.0]])  # source paper, Table 5
    share = np.linspace(0.0, 1.0, 5)[:, None]
    way, _, about = direction_facts((1.0 - share) * ends[0] + share * ends[1])
    assert (way, about) == ("in a plane", "along a line")


def test_facts_of_no_samples_are_refused(rng):
    with pytest.raises(DataError, match=r"robot 'planar' has no samples"):
        facts(made_data(chain([("revolute", "z")]), 0, rng))


@pytest.mark.slow
def test_the_picture_says_title_groups_and_that_zero_loads_have_no_direction(planar, tmp_path):
    path = tmp_path / "made.svg"
    dataset_picture(planar, "cost_$a^{ (simulated)").save(path)
    text = path.read_text(encoding="utf-8")
    title, groups = "cost_$a^{ (simulated)", ("straight", "bent")
    for words in (title, *groups, "downwards: 2", "upwards: 0", "base"):
        assert words in text


@pytest.mark.slow
def test_a_picture_is_made_of_any_chain_even_of_one_sample_without_load(rng, tmp_path):
    joints = chain([("revolute", "x"), ("prismatic", "y")])
    data = made_data(joints, 1, rng, wrench=np.zeros((1, 6)), deflection=np.zeros((1, 3)))
    path = tmp_path / "made.png"
    dataset_picture(data, "made (simulated)").save(path)
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    assert struct.unpack(">II", content[16:24]) == (1500, 1200)


@pytest.mark.slow
def test_a_large_cloud_is_thinned_with_a_note_in_the_picture(rng):
    data = made_data(chain([("revolute", "z")]), 4000, rng)
    figure = dataset_picture(data, "made (simulated)").draw()
    side, above, downwards, upwards = (
        sum(len(points.get_offsets()) for points in axes.collections) for axes in figure.axes[:4]
    )
    assert side == above == downwards + upwards == 3000
    for page in figure.subfigs[:2]:
        assert page.get_suptitle().endswith("(3,000 of 4,000 drawn)")


FANUC = DatasetInfo(
    key="fanuc-r2000ic",
    target=FanucR2000iC,
    kind="measured",
    summary="43 real deflections",
    reference="a card",
    caveats=("too few to rank.",),
    card="data/fanuc_r2000ic.md",
)


def test_a_card_that_is_not_there_is_named():
    with pytest.raises(DataError, match=r"'fanuc-r2000ic': card 'data/absent\.md'.*use a path"):
        card_text("fanuc-r2000ic", "data/absent.md")


def test_a_data_set_without_a_card_has_an_empty_one(twin):
    assert sb.load_dataset("fanuc-r2000ic").card.startswith("# Data card: fanuc-r2000ic")
    assert sb.Dataset.from_samples(twin.samples, twin.robot).card == ""


def test_info_holds_heading_facts_and_the_place_of_the_picture(tmp_path):
    data, picture = FANUC.target().load(), tmp_path / "fanuc.png"
    text = dataset_info(FANUC, data, picture)
    parts = (
        *("fanuc-r2000ic (measured): 43 real deflections", "reference: a card"),
        *("caveat: too few to rank.", data.sha256, plain_text(facts(data)[3])),
        f"picture: {picture}",
    )
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
