"""The digital twin's statics by Pinocchio: a reference for tests and for speed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from stiff_datasets.robots.urdf_reader import joint_type_and_axis


def elastic_pinocchio(chain):
    """Return the robot in Pinocchio, with two more revolute joints after every joint."""
    rigid, elastic = chain.model, pin.Model()
    parent = 0
    for joint in range(1, rigid.njoints):
        joint_type, axis = joint_type_and_axis(rigid, joint)
        first = np.linalg.svd(axis[None])[2][1]
        placement = rigid.jointPlacements[joint]
        for name, direction in zip("tab", (axis, first, np.cross(axis, first)), strict=True):
            kind = pin.JointModelRevoluteUnaligned(direction)
            if name == "t" and joint_type == "prismatic":
                kind = pin.JointModelPrismaticUnaligned(direction)
            parent = elastic.addJoint(parent, kind, placement, f"{joint}{name}")
            placement = pin.SE3.Identity()
        elastic.appendBodyToJoint(parent, rigid.inertias[joint], pin.SE3.Identity())
    return elastic


def pinocchio_torque(chain, q, theta, wrench):
    """Return J^T w - g of the deformed robot, its TCP and its Jacobian, by Pinocchio."""
    model = elastic_pinocchio(chain)
    return torque_and_tcp(model, model.createData(), chain.robot.tcp, q, theta, wrench)


def torque_and_tcp(model, data, tcp_offset, q, theta, wrench):
    x = theta.copy()
    x[::3] += q
    gravity = pin.computeGeneralizedGravity(model, data, x)
    pin.computeJointJacobians(model, data, x)
    last, tcp = model.njoints - 1, pin.SE3(np.eye(3), tcp_offset)
    rows = pin.getFrameJacobian(model, data, last, tcp, pin.LOCAL_WORLD_ALIGNED)
    return rows.T @ wrench - gravity, data.oMi[last].act(tcp_offset), rows
