"""Check robots read from URDF against published positions and torques, and refused files."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from helpers.made_robots import arm_lines, tree_urdf
from stiff_datasets.robots.shipped_robots import shipped_robots
from stiff_datasets.robots.urdf_reader import read_chain, read_robot
from stiff_protocols.contract.errors import DataError, StiffBenchWarning


def joint(parent="base", child="l1", kind="revolute", inside=""):
    return (
        f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'{inside}<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        f'<link name="{child}"/>'
    )


def urdf(tmp_path, body):
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r"><link name="base"/>{body}</robot>')
    return path


@pytest.mark.parametrize(
    ("q_deg", "flange_mm", "torque"),
    [
        ((0, 0, 0, 0, 0, 0), (1190, 0, 425), (140.3, 32.2)),
        ((0, -90, 90, 0, 0, 0), (630, 0, 985), (31.4, 32.2)),
    ],
)
def test_the_kr10s_flange_and_its_weight_on_a2_and_a3_are_as_published(
    kr10_chain, q_deg, flange_mm, torque
):
    model, q = kr10_chain.model, np.deg2rad(np.array(q_deg, dtype=float))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    flange = data.oMf[model.getFrameId("flange")]
    np.testing.assert_allclose(flange.translation * 1000, flange_mm, atol=1e-9)
    if q_deg == (0,) * 6:  # tool z along the base's x
        np.testing.assert_allclose(flange.rotation[:, 2], [1, 0, 0], atol=1e-12)
    gravity = pin.computeGeneralizedGravity(model, data, q)
    np.testing.assert_allclose(np.abs(gravity[1:3]), torque, atol=0.05)


def test_the_kr10_has_its_data_sheets_limits_and_masses_and_the_default_tcp(kr10):
    np.testing.assert_allclose(np.rad2deg(kr10.lower), [-170, -190, -120, -185, -120, -350])
    np.testing.assert_allclose(np.rad2deg(kr10.upper), [170, 45, 156, 185, 120, 350])
    np.testing.assert_allclose(kr10.masses, [8.416, 17.8369, 6.075, 5.1624, 1.6128, 0.734])
    assert kr10.joint_names == ("A1", "A2", "A3", "A4", "A5", "A6")
    # the TCP: 80 mm before the flange, 60 mm off its axis; x is forward in the last joint's frame
    assert (kr10.tcp[0], np.hypot(*kr10.tcp[1:])) == pytest.approx((0.08, 0.06))


def limited(tmp_path, low, high, kind="revolute"):
    limits = f'lower="{low}" upper="{high}"'
    return urdf(tmp_path, joint(kind=kind).replace('lower="-1" upper="1"', limits))


@pytest.mark.parametrize(
    ("low", "high"), [(-170, 170), (-190.5, 45), (0, 360), (-720, -10), (-3.14, 180), (-60, 1e9)]
)
def test_limits_in_degrees_are_refused_with_what_to_write(tmp_path, low, high):
    with pytest.raises(DataError, match=rf"joint to_l1 {low:g}\.\..*write degrees as rad"):
        read_robot(limited(tmp_path, low, high))


@pytest.mark.parametrize(("low", "high"), [(-45, 45), (-47.12, 47.12), (-12.6, 1)])
def test_limits_of_some_turns_are_read_with_a_question(tmp_path, low, high):
    with pytest.warns(StiffBenchWarning, match=rf"joint to_l1 {low:g}\.\..* in degrees\?"):
        assert read_robot(limited(tmp_path, low, high)).upper[0] == high


@pytest.mark.parametrize(("low", "high"), [(-12.5, 12.5), (-2 * np.pi, 2 * np.pi), (-9.42, 9.42)])
def test_limits_of_two_turns_are_read_as_they_are(tmp_path, low, high):
    robot = read_robot(limited(tmp_path, low, high))
    assert (robot.lower[0], robot.upper[0]) == (low, high)


@pytest.mark.parametrize("limit", [1e3, 6283.2, 1e16, 1.7e308])
def test_limits_that_stand_for_none_count_as_none(tmp_path, limit):
    chain = read_chain(limited(tmp_path, -limit, limit))
    assert chain.robot.upper[0] == np.inf == -chain.robot.lower[0]
    assert any("count as none: to_l1" in note for note in chain.notes)


def test_slides_and_joints_off_the_chain_may_have_large_limits(tmp_path):
    assert read_robot(limited(tmp_path, 0, 60, kind="prismatic")).upper[0] == 60.0
    off_chain = joint("l1", "l2") + joint("l1", "jaw").replace('lower="-1"', 'lower="-170"')
    assert read_robot(urdf(tmp_path, joint() + off_chain), tip="l2").n_joints == 2


@pytest.mark.parametrize("shipped", shipped_robots().values(), ids=lambda info: info.urdf)
@pytest.mark.parametrize("tcp", [None, (-0.06, 0.0, 0.08)])
def test_a_robot_gives_its_tcp_back_in_the_frame_in_which_people_give_it(shipped, tcp):
    assert tuple(shipped.robot(tcp).tcp_on_flange) == (tcp or shipped.tcp)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("", "no moving joint"),
        (joint(kind="spherical"), r"\(URDF\): Joint \[to_l1\] has no known type \[spherical\]$"),
        (joint(kind="floating"), "6 degrees of freedom"),
        (
            joint().replace('lower="-1"', 'lower="2"'),
            r"joint 'to_l1' has limits 2..1; expected lower below upper",
        ),
        (
            joint() + joint("l1", "l2", inside='<mimic joint="to_l3"/>'),
            "joint 'to_l2' on the chain to 'l2' is a mimic joint, which follows 'to_l3'",
        ),
        (joint() + joint("l1", "l2").replace("to_l2", "to_l1"), "joint 'to_l1' is not unique"),
        (joint().replace("to_l1", "universe"), "joint 'universe'"),
        (joint(kind="prismatic").replace('"-1"', '"0"').replace('"1"', '"0"'), "limits 0..0"),
        # what would end the parser's stack or the memory
        (
            joint("base", "A") + joint("A", "B") + joint("B", "A"),
            "link 'A' is the child of 2 joints",
        ),
        # what Pinocchio takes and no robot has
        (joint().replace("0 0 1", "0 0 0"), "unit length"),
        (joint().replace("0 0 1", "1e308 0 1e308"), "unit length"),
        (joint(inside='<origin xyz="nan 0 0"/>'), ""),
    ],
    ids=lambda text: text[:40],
)
def test_what_is_no_serial_chain_is_refused(tmp_path, body, message):
    with pytest.raises(DataError, match=rf"r(obot\.urdf)?: .*{message}"):
        read_robot(urdf(tmp_path, body))


@pytest.mark.parametrize("tcp", [(80.0, 0.0, 60.0), (np.nan, 0.0, 0.0), (0.0, 0.0)])
def test_a_tcp_in_millimetres_or_with_gaps_is_refused(tmp_path, tcp):
    with pytest.raises(DataError, match="in m"):
        read_robot(urdf(tmp_path, joint()), tcp=tcp)


@pytest.mark.parametrize(
    ("name", "message"),
    [("x.urdf", "not a robot description"), ("absent", "cannot read")],
)
def test_a_file_that_is_no_urdf_or_is_missing_is_refused(tmp_path, name, message):
    (tmp_path / "x.urdf").write_text("<notrobot/>")
    with pytest.raises(DataError, match=f"{name}: {message}"):
        read_chain(tmp_path / name)


WEIGHT = '<link name="l1"><inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" '
WEIGHT += 'ixy="0" ixz="0" iyz="0"/></inertial></link>'


@pytest.mark.parametrize(
    ("mass", "message"),
    [("8,4", "mass .8,4. is not a float.*link|Link .l1."), ("nan", "nan"), ("-1", "masses are")],
)
def test_a_mass_that_is_none_does_not_leave_the_link_weightless(tmp_path, mass, message):
    body = joint().replace('<link name="l1"/>', WEIGHT.format(mass))
    with pytest.raises(DataError, match=rf"robot\.urdf: .*{message}"):
        read_robot(urdf(tmp_path, body))


def weighing_arm(tmp_path, factor):
    """Return the file of an arm with links of 20 kg, in kg / `factor`."""
    path = tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 6))
    path.write_text(path.read_text().replace('mass value="1"', f'mass value="{20.0 * factor}"'))
    return path


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "grams"), (0.001, "tonnes")])
def test_masses_in_another_unit_are_asked_about_whoever_reads_them(tmp_path, factor, unit):
    path = weighing_arm(tmp_path, factor)
    with pytest.warns(StiffBenchWarning, match=rf"arm\.urdf: .* {120.0 * factor:.8g} kg.*{unit}"):
        robot = read_robot(path)
    assert unit in robot.mass_doubt


def test_usual_masses_cause_no_question(tmp_path):
    assert read_robot(weighing_arm(tmp_path, 1.0)).mass_doubt == ""
    assert not any(shipped.robot().mass_doubt for shipped in shipped_robots().values())
