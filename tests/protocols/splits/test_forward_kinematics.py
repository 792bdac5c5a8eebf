"""The TCP's position against Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.forward_kinematics import tcp_position
from stiff_protocols.contract.types import Robot


def pinocchio_positions(model, tcp, q):
    """One Pinocchio call a sample: the independent truth."""
    data = model.createData()
    found = []
    for position in q:
        pin.forwardKinematics(model, data, position)
        found.append(data.oMi[model.njoints - 1].act(np.asarray(tcp)))
    return np.stack(found)


def random_chain(rng, kinds):
    """A robot with these kinds of joint, and Pinocchio's model of it."""
    model, joint = pin.Model(), 0
    placements, axes = [], []
    for number, kind in enumerate(kinds):
        placement, axis = pin.exp6(rng.normal(size=6)), rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        unaligned = {
            "revolute": pin.JointModelRevoluteUnaligned,
            "prismatic": pin.JointModelPrismaticUnaligned,
        }[kind]
        joint = model.addJoint(joint, unaligned(axis), placement, f"j{number}")
        placements.append(placement.homogeneous)
        axes.append(axis)
    n = len(kinds)
    robot = Robot(
        name="random",
        joint_names=tuple(f"j{number}" for number in range(n)),
        joint_types=tuple(kinds),
        placements=np.stack(placements),
        axes=np.stack(axes),
        lower=np.full(n, -3.0),
        upper=np.full(n, 3.0),
        masses=np.ones(n),
        centres_of_mass=np.zeros((n, 3)),
        tcp=rng.normal(size=3),
    )
    return robot, model


def test_tcp_positions_equal_pinocchios_on_random_poses_of_the_kr10(kr10, kr10_chain, rng):
    q = rng.uniform(kr10.lower, kr10.upper, size=(200, 6))
    truth = pinocchio_positions(kr10_chain.model, kr10_chain.tcp, q)
    np.testing.assert_allclose(tcp_position(kr10, q), truth, atol=1e-12)


@pytest.mark.parametrize(
    "kinds",
    [
        ("revolute",),
        ("prismatic",),
        ("revolute", "prismatic", "revolute"),
        ("prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute", "revolute"),
    ],
)
def test_tcp_positions_equal_pinocchios_on_chains_that_turn_and_slide(kinds, rng):
    robot, model = random_chain(rng, kinds)
    q = rng.uniform(-3.0, 3.0, size=(50, len(kinds)))
    truth = pinocchio_positions(model, robot.tcp, q)
    np.testing.assert_allclose(tcp_position(robot, q), truth, atol=1e-12)


def test_wrong_number_of_joint_angles_is_refused(kr10):
    with pytest.raises(DataError, match=r"\(2, 5\), expected \(n, 6\)"):
        tcp_position(kr10, np.zeros((2, 5)))
