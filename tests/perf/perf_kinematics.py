"""Deflections of the linear VJM beside those that kinematics libraries give.

In a batch, of one sample, and on the paper's source domain: 21,280 poses with five
wrenches each. And inverse kinematics along a path.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import torch

from helpers.made_samples import samples_with
from helpers.perf_case import OURS, needed, ours_or_peer
from helpers.quick_models import twin_data
from stiff_datasets.robots.shipped_robots import shipped_chain, shipped_robot
from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.transfer.source_domain import simulate, source_design
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.kinematics.serial_chain import REACHED_M, REACHED_RAD
from stiff_protocols.paths.inverse import follow
from stiff_protocols.paths.path import ToolPath, shaped

ROBOT, TCP = "kr10_r1100_2", (0.06, 0.0, 0.08)
SAMPLES, FEW = 106_400, 4_000
NANOMETRE = 1e-9
COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
PINOCCHIO, ALONE = "Pinocchio loop", "Pinocchio, arrays in, array out"
A_SAMPLE, A_POSE = "Pinocchio, every sample", "Pinocchio, every pose"
WRITTEN_OUT = "stiffbench, poses and wrenches written out"
ROUNDS = 8
READY, PATH_POINTS = np.radians([0.0, -90.0, 90.0, 0.0, 60.0, 0.0]), 10_000

Samples = tuple[FloatArray, FloatArray]
Way = Callable[[FloatArray, FloatArray], FloatArray]


SHIPPED = shipped_robot(ROBOT, tcp=TCP)  # one robot: a program is written once for it


def our_way(q: FloatArray, wrench: FloatArray) -> FloatArray:
    return SHIPPED.joint_deflection(COMPLIANCE, q, wrench)


def drawn(n: int, seed: int = 0) -> Samples:
    rng = np.random.default_rng(seed)
    wrench = rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)
    return rng.uniform(-1.5, 1.5, size=(n, 6)), wrench


def product(rows: FloatArray, wrench: FloatArray) -> FloatArray:
    """The VJM's product of many Jacobians (n, 6, 6), as NumPy does it fastest."""
    turn = (wrench[:, None] @ rows) * COMPLIANCE
    return (rows[:, :3] @ turn.transpose(0, 2, 1))[:, :, 0]


def pinocchio_jacobian() -> Callable[[FloatArray], FloatArray]:
    """Pinocchio's fastest single call."""
    chain = shipped_chain(ROBOT, tcp=TCP)
    model, at_tcp = chain.model.copy(), pin.SE3(np.eye(3), chain.tcp)
    frame = model.addFrame(pin.Frame("perf_tcp", model.nv, 0, at_tcp, pin.FrameType.OP_FRAME))
    data = model.createData()
    return lambda q: pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)


def pinocchio_rows() -> Callable[[FloatArray], FloatArray]:
    call = pinocchio_jacobian()

    def way(q: FloatArray) -> FloatArray:
        rows = np.empty((len(q), 6, q.shape[1]))
        for i, position in enumerate(q):
            rows[i] = call(position)
        return rows

    return way


def pinocchio_product_of_all() -> Way:
    rows = pinocchio_rows()
    return lambda q, wrench: product(rows(q), wrench)


def pinocchio_one() -> Way:
    """One sample as lean as NumPy's calls allow; every call returns the same array."""
    call, turn, deflection = pinocchio_jacobian(), np.empty(6), np.empty(3)

    def way(q: FloatArray, wrench: FloatArray) -> FloatArray:
        rows = call(q)
        wrench.dot(rows, out=turn)  # the method: np.dot first asks whose function it is to call
        np.multiply(turn, COMPLIANCE, out=turn)
        return rows[:3].dot(turn, out=deflection)

    return way


def casadi_map() -> Way:
    """A symbolic Function of one sample, mapped."""
    ca = needed("casadi", "CasADi map")
    q, wrench = ca.SX.sym("q", 6), ca.SX.sym("w", 6)
    rotation, origin = ca.SX.eye(3), ca.SX.zeros(3)
    axes, origins = [], []
    for joint, placement in enumerate(SHIPPED.placements):
        origin = origin + rotation @ ca.sparsify(ca.DM(placement[:3, 3]))
        rotation = rotation @ ca.sparsify(ca.DM(placement[:3, :3]))
        cross = ca.sparsify(ca.DM(np.cross(SHIPPED.axes[joint], np.eye(3)).T))
        axes.append(rotation @ ca.sparsify(ca.DM(SHIPPED.axes[joint])))
        origins.append(origin)
        sine, versine = ca.sin(q[joint]), 1 - ca.cos(q[joint])
        rotation = rotation @ (ca.DM.eye(3) + sine * cross + versine * (cross @ cross))
    tip = origin + rotation @ ca.sparsify(ca.DM(SHIPPED.tcp))
    moves = [ca.cross(axis, tip - start) for axis, start in zip(axes, origins, strict=True)]
    jacobian = ca.vertcat(ca.horzcat(*moves), ca.horzcat(*axes))
    one = jacobian[:3, :] @ (ca.DM(COMPLIANCE) * (jacobian.T @ wrench))
    function = ca.Function("deflection", [q, wrench], [one])

    @lru_cache
    def mapped(n: int) -> Any:
        return function.map(n).buffer()  # without CasADi's own matrices: faster than its call

    def way(q: FloatArray, wrench: FloatArray) -> FloatArray:
        (buffer, evaluate), deflection = mapped(len(q)), np.empty((len(q), 3))
        buffer.set_arg(0, memoryview(q))
        buffer.set_arg(1, memoryview(wrench))
        buffer.set_res(0, memoryview(deflection))
        evaluate()
        return deflection

    return way


def mujoco_loop() -> Way:
    mujoco = needed("mujoco", "MuJoCo loop")
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for placement, axis in zip(SHIPPED.placements, SHIPPED.axes, strict=True):
        turn = pin.Quaternion(placement[:3, :3].copy())
        body = body.add_body(pos=placement[:3, 3], quat=[turn.w, turn.x, turn.y, turn.z])
        body.mass, body.inertia, body.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
        body.add_joint(axis=axis)
    site = body.add_site(pos=SHIPPED.tcp)
    model = spec.compile()
    data, number, rows = mujoco.MjData(model), site.id, np.zeros((6, 6))

    def way(q: FloatArray, wrench: FloatArray) -> FloatArray:
        found = np.empty((len(q), 6, 6))
        for i, position in enumerate(q):
            data.qpos[:] = position
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, rows[:3], rows[3:], number)
            found[i] = rows
        return product(found, wrench)

    return way


def pytorch_kinematics_batch() -> Way:
    pk = needed("pytorch_kinematics", "pytorch_kinematics batched")
    urdf = files("stiff_datasets") / "robots" / f"{ROBOT}.urdf"
    chain = pk.build_serial_chain_from_urdf(urdf.read_bytes(), "flange").to(dtype=torch.float64)
    tcp = torch.tensor([TCP], dtype=torch.float64)

    def way(q: FloatArray, wrench: FloatArray) -> FloatArray:
        rows = chain.jacobian(torch.from_numpy(q), locations=tcp.expand(len(q), 3))
        return product(rows.numpy(), wrench)

    return way


def roboticstoolbox_loop() -> Way:
    rtb = needed("roboticstoolbox", "roboticstoolbox loop")
    chain = rtb.ETS()
    for placement, axis in zip(SHIPPED.placements, SHIPPED.axes, strict=True):
        x_axis = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
        aligned = np.eye(4)  # so that the joint turns about z
        aligned[:3, :3] = np.column_stack([x_axis, np.cross(axis, x_axis), axis])
        chain = chain * rtb.ET.SE3(placement @ aligned) * rtb.ET.Rz() * rtb.ET.SE3(aligned.T)
    tool = np.eye(4)
    tool[:3, 3] = SHIPPED.tcp
    chain = chain * rtb.ET.SE3(tool)
    return lambda q, wrench: product(np.stack([chain.jacob0(one) for one in q]), wrench)


PEERS: dict[str, tuple[Callable[[], Way], int]] = {
    PINOCCHIO: (pinocchio_product_of_all, SAMPLES),
    "CasADi map": (casadi_map, SAMPLES),
    "MuJoCo loop": (mujoco_loop, FEW),
    "pytorch_kinematics batched": (pytorch_kinematics_batch, FEW),
    "roboticstoolbox loop": (roboticstoolbox_loop, FEW),
}


@pytest.mark.benchmark(group="VJM deflection, random samples")
@pytest.mark.parametrize("who", [OURS, *PEERS])
def test_deflections(benchmark, who):
    make, n = PEERS.get(who, (lambda: our_way, SAMPLES))
    way = make()
    # pytorch_kinematics reads a URDF's numbers in float32
    np.testing.assert_allclose(way(*drawn(50)), our_way(*drawn(50)), rtol=0, atol=NANOMETRE)
    at_least = {PINOCCHIO: 15.0, "CasADi map": 2.0}
    ours_or_peer(benchmark, who, at_least, work=n, unit="sample")
    benchmark.pedantic(way, drawn(n), rounds=ROUNDS, warmup_rounds=1)


@pytest.mark.benchmark(group="Jacobian, random samples")
@pytest.mark.parametrize("who", [OURS, PINOCCHIO])
def test_jacobians(benchmark, who):
    ways = {OURS: SHIPPED.jacobian, PINOCCHIO: pinocchio_rows()}
    q, _ = drawn(SAMPLES)
    np.testing.assert_allclose(*(way(q[:50]) for way in ways.values()), atol=1e-13)
    ours_or_peer(benchmark, who, work=SAMPLES, unit="sample")
    benchmark.pedantic(ways[who], (q,), rounds=ROUNDS, warmup_rounds=1)


def peak_mb(call: Callable[[], Any]) -> tuple[Any, float]:
    """A call's result, and the most memory that it took beside it, MB."""
    tracemalloc.start()
    result = call()
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return result, (peak - held) / 1e6


@pytest.mark.benchmark(group="VJM deflection, one sample")
@pytest.mark.parametrize("who", ["stiffbench, predict of one row", ALONE])
def test_a_single_prediction(benchmark, who):
    q, wrench = drawn(100)
    model = VirtualJointModel().fit(samples_with(q, wrench, our_way(q, wrench)), robot=SHIPPED)
    way, which = (pinocchio_one(), 0) if who == ALONE else (model.predict, slice(1))
    case = q[which], wrench[which]
    np.testing.assert_allclose(way(*case).ravel(), our_way(q, wrench)[0], rtol=1e-6)
    ours_or_peer(benchmark, who)
    iterations = 2_000 if who == ALONE else 200
    benchmark.pedantic(way, case, rounds=ROUNDS, iterations=iterations, warmup_rounds=1)


@pytest.mark.benchmark(group="VJM source domain, 21,280 poses x 5 wrenches")
@pytest.mark.parametrize("who", [OURS, A_POSE, A_SAMPLE])
def test_source(benchmark, who):
    twin, jacobians = twin_data(), pinocchio_rows()
    design = source_design("paper", "paper", twin.robot, twin.samples, 0)
    domain = simulate(twin.robot, COMPLIANCE, design)

    def every_pose() -> FloatArray:
        rows = jacobians(design.q)
        torque = (design.wrench @ rows) * COMPLIANCE  # (poses, wrenches, joints)
        return rows[:, None, :3] * torque[:, :, None]

    way: Callable[[], FloatArray] = {
        OURS: lambda: simulate(twin.robot, COMPLIANCE, design).parts,
        A_POSE: every_pose,
        A_SAMPLE: lambda: product(jacobians(domain.q), domain.wrench),
    }[who]
    found = way()
    truth = domain.deflection if who == A_SAMPLE else domain.parts.reshape(-1, 3)
    if who != A_SAMPLE:
        found = found.reshape(domain.parts.shape).reshape(-1, 3)
    np.testing.assert_allclose(found.reshape(-1, 3), truth, rtol=0, atol=1e-15)
    targets = {A_SAMPLE: 2.0} if who == OURS else {}
    ours_or_peer(benchmark, who, targets)
    benchmark.pedantic(way, rounds=10, warmup_rounds=2)


def iso_path() -> ToolPath:
    """10,000 points through the test points of ISO 9283, in a cube of 200 mm before the robot."""
    stands = SHIPPED.forward(READY[None])
    (rotation,), centre = stands.rotation, stands.points[0, -1]
    return shaped("iso9283", centre, 0.2, PATH_POINTS, rotation=rotation, wrench=np.zeros(6))


def pinocchio_newton(path: ToolPath) -> FloatArray:
    """Newton's method point by point, each from the one before, to the same tolerance."""
    chain = shipped_chain(ROBOT, tcp=TCP)
    model, at_tcp = chain.model.copy(), pin.SE3(np.eye(3), chain.tcp)
    frame = model.addFrame(pin.Frame("perf_tcp", model.nv, 0, at_tcp, pin.FrameType.OP_FRAME))
    data, q, found = model.createData(), READY.copy(), np.empty((len(path), model.nv))
    for row in range(len(path)):
        wanted = pin.SE3(path.rotation[row], path.position[row])
        while True:
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[frame].actInv(wanted)).vector
            if max(error[:3] @ error[:3], error[3:] @ error[3:]) <= REACHED_M**2:
                break
            q = q + np.linalg.solve(pin.computeFrameJacobian(model, data, q, frame), error)
        found[row] = q
    return found


@pytest.mark.benchmark(group="Inverse kinematics along a path of 10,000 points")
@pytest.mark.parametrize("who", [OURS, PINOCCHIO])
def test_inverse(benchmark, who):
    path = iso_path()
    way: Callable[[ToolPath], FloatArray] = {
        OURS: lambda path: follow(SHIPPED, path.position, path.rotation, READY).q,
        PINOCCHIO: pinocchio_newton,
    }[who]
    some = path.take(slice(500))
    found, truth = way(some), pinocchio_newton(some)
    np.testing.assert_allclose(found, truth, rtol=0, atol=100 * REACHED_RAD)
    ours_or_peer(benchmark, who, {PINOCCHIO: 1.2}, work=PATH_POINTS, unit="point")
    benchmark.pedantic(way, (path,), rounds=ROUNDS, warmup_rounds=1)
