"""Check the ten arms' URDF files against the public descriptions they come from."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.robots.shipped_robots import shipped_chain

ANGLES_DEG = [(0, 0, 0, 0, 0, 0), (10, -20, 30, 40, 50, 60), (-35, -60, 20, -110, -45, 130)]
FLANGES = """
# ros-industrial/abb_experimental 20b9cf86, abb_irb120_support/urdf/irb120_3_58_macro.xacro
irb120_3_06 374 0 630  245.42519 79.27508 510.5658  29.66613 37.63104 692.13138
# ros-industrial/staubli_experimental 256a71ac, staubli_tx60_support/urdf/tx60_macro.xacro
tx60 0 20 1045  -6.59052 54.14645 989.97975  -346.24486 323.63992 806.27288
# ros-industrial/fanuc 8fee5e30, fanuc_lrmate200id_support/urdf/lrmate200id_macro.xacro
lr_mate_200id 465 0 695  114.04185 60.10865 988.78959  -150.80112 170.48485 890.05709
# ros-industrial/motoman 433be15f, motoman_gp12_support/urdf/gp12_macro.xacro
gp12 895 0 1264  187.95712 83.14191 1732.75795  -350.25171 326.36485 1495.84261
# kroshu/kuka_robot_descriptions 7766e92a, kuka_cybertech_support/urdf/kr16_r1610_2_macro.xacro
kr16_r1610_2 1748 0 670  1607.23976 -359.89973 715.25956  928.25241 525.86192 1772.62848
# ros-industrial/fanuc 8fee5e30, fanuc_m20ib_support/urdf/m20ib25_macro.xacro
m20ib_25 1040 0 1675  213.93921 87.72326 2327.14549  -525.67962 449.20079 2049.0325
# ros-industrial/abb_experimental 20b9cf86, abb_irb4600_support/urdf/irb4600_40_255_macro.xacro
irb4600_40_255 1580 0 1765  1124.21945 265.73022 1382.68534  199.88434 -30.45398 2029.24755
# kroshu/kuka_robot_descriptions 7766e92a, kuka_iontec_support/urdf/kr70_r2100_macro.xacro
kr70_r2100 2285 0 625  2089.2498 -460.89111 621.34981  1307.16937 765.22532 2099.1623
# ros-industrial/motoman 433be15f, motoman_gp180_support/urdf/gp180_macro.xacro
gp180 1775 0 2100  454.55031 192.64948 3057.54884  -552.87004 569.63467 2649.61498
# kroshu/kuka_robot_descriptions 7766e92a, kuka_quantec_support/urdf/kr240_r2900_2_macro.xacro
kr240_r2900_2 3140 0 760  2882.18895 -628.20768 842.64263  1756.7762 1035.42964 2751.05164
"""
"""Position of frame tool0 of each public description at `ANGLES_DEG`, base frame, mm. Computed by
Pinocchio from the description's own joints (origins, turns and axes), without our files."""
FLANGES_MM = {
    name: np.array(numbers, dtype=float).reshape(3, 3)
    for name, *numbers in (line.split() for line in FLANGES.split("\n") if line and line[0] != "#")
}


@pytest.mark.parametrize("name", FLANGES_MM)
def test_an_arms_flange_stands_where_the_public_description_puts_it(name):
    robot = shipped_chain(name, (0, 0, 0)).robot
    positions = robot.tcp_position(np.deg2rad(np.array(ANGLES_DEG, dtype=float)))
    np.testing.assert_allclose(positions, FLANGES_MM[name] / 1000, atol=1e-6)


@pytest.mark.parametrize("name", FLANGES_MM)
def test_an_arm_has_masses_inside_its_links_limits_and_151_poses_of_its_own(name):
    chain = shipped_chain(name, (0, 0, 0.1))
    robot = chain.robot
    assert (robot.masses > 0).all() and (robot.lower < robot.upper).all()
    assert (np.rad2deg(robot.upper - robot.lower) < 1000).all()  # larger if deg were read as rad
    # the tool points where the last joint's axis does, or opposite
    across = np.cross(robot.flange[:3, 2], robot.axes[-1])
    np.testing.assert_allclose(across, 0.0, atol=1e-12)
    frames = robot.forward(np.zeros((1, 6)))
    elbow, wrist = frames.points[0, 2], frames.points[0, 4]
    centres = (
        frames.points[0, :-1] + (frames.rotations[0] @ robot.centres_of_mass[..., None])[..., 0]
    )
    along = (centres - elbow) @ (wrist - elbow) / np.linalg.norm(wrist - elbow) ** 2
    assert (along[3:] > 0.3).all() and (along < 1.5).all()  # the forearm weighs beyond the elbow
    for joint in range(1, 7):
        moments = np.linalg.eigvalsh(chain.model.inertias[joint].inertia)
        assert moments[0] > 0 and moments[2] <= moments[:2].sum() * (1 + 1e-9)
    q = reachable_poses(robot, 151, stream("test", name))
    assert ((q >= robot.lower) & (q <= robot.upper)).all()
