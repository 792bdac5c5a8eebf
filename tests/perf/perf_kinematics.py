"""Deflections of the linear VJM beside those that kinematics libraries give: batch, stream, one."""

from __future__ import annotations

import itertools
import tracemalloc
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import torch

from made_samples import samples_with
from perf_case import figure, needed, ours, peer
from stiff_datasets.robots.robot import shipped_chain, shipped_robot
from stiff_models.physics.kinematics import deflections, jacobian, joint_deflection
from stiff_models.physics.straight_line import CHUNK
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.types import FloatArray

ROBOT, TCP = "kr10_r1100_2", (0.06, 0.0, 0.08)
SAMPLES, FEW = 106_400, 4_000
STREAMED, STREAMED_SLOWLY = 10_000_000, 100_000_000
STREAM_CHUNK = 16 * CHUNK
NANOMETRE = 1e-9
COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
DEFLECTION = "VJM deflection, random samples"
JACOBIAN = "Jacobian, random samples"
STREAM = "VJM deflection, stream"
LATENCY = "VJM deflection, one sample"
ROUNDS, STREAM_ROUNDS = 8, 3

Samples = tuple[FloatArray, FloatArray]
Way = Callable[[FloatArray, FloatArray], FloatArray]


SHIPPED = shipped_robot(ROBOT, tcp=TCP)  # one robot: a program is written once for it


def our_way(q: FloatArray, wrench: FloatArray) -> FloatArray:
    return joint_deflection(SHIPPED, COMPLIANCE, q, wrench)


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


def pinocchio_product_of_each() -> Way:
    one = pinocchio_one()

    def way(q: FloatArray, wrench: FloatArray) -> FloatArray:
        deflection = np.empty((len(q), 3))
        for i, position in enumerate(q):
            deflection[i] = one(position, wrench[i])
        return deflection

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
    "Pinocchio loop": (pinocchio_product_of_all, SAMPLES),
    "Pinocchio loop, product of each": (pinocchio_product_of_each, SAMPLES),
    "CasADi map": (casadi_map, SAMPLES),
    "MuJoCo loop": (mujoco_loop, FEW),
    "pytorch_kinematics batched": (pytorch_kinematics_batch, FEW),
    "roboticstoolbox loop": (roboticstoolbox_loop, FEW),
}
AT_LEAST = {"Pinocchio loop": 15.0, "Pinocchio loop, product of each": 15.0, "CasADi map": 2.0}


@pytest.mark.benchmark(group=DEFLECTION)
def test_our_deflections(benchmark):
    ours(benchmark, work=SAMPLES, unit="sample", at_least=AT_LEAST)
    benchmark.pedantic(our_way, drawn(SAMPLES), rounds=ROUNDS, warmup_rounds=1)


@pytest.mark.benchmark(group=DEFLECTION)
@pytest.mark.parametrize("name", PEERS)
def test_a_peers_deflections(benchmark, name):
    make, n = PEERS[name]
    way = make()
    # pytorch_kinematics reads a URDF's numbers in float32
    np.testing.assert_allclose(way(*drawn(50)), our_way(*drawn(50)), rtol=0, atol=NANOMETRE)
    peer(benchmark, name, work=n, unit="sample")
    benchmark.pedantic(way, drawn(n), rounds=ROUNDS, warmup_rounds=1)


@pytest.mark.benchmark(group=JACOBIAN)
def test_our_jacobians(benchmark):
    ours(benchmark, work=SAMPLES, unit="sample")
    benchmark.pedantic(jacobian, (SHIPPED, drawn(SAMPLES)[0]), rounds=ROUNDS, warmup_rounds=1)


@pytest.mark.benchmark(group=JACOBIAN)
def test_pinocchios_jacobians(benchmark):
    q, rows = drawn(SAMPLES)[0], pinocchio_rows()
    np.testing.assert_allclose(rows(q[:50]), jacobian(SHIPPED, q[:50]), atol=1e-13)
    peer(benchmark, "Pinocchio loop", work=SAMPLES, unit="sample")
    benchmark.pedantic(rows, (q,), rounds=ROUNDS, warmup_rounds=1)


def streamed(n_chunks: int) -> FloatArray:
    """The sum of all deflections; one chunk again and again, so that drawing costs no time."""
    chunk, ones, total = drawn(STREAM_CHUNK), np.ones(STREAM_CHUNK), np.zeros(3)
    for part in deflections(SHIPPED, COMPLIANCE, itertools.repeat(chunk, n_chunks)):
        total += ones @ part
    return total


@pytest.mark.benchmark(group=STREAM)
def test_the_same_samples_at_once(benchmark):
    peer(benchmark, "at once", work=SAMPLES, unit="sample")
    benchmark.pedantic(our_way, drawn(SAMPLES), rounds=STREAM_ROUNDS, warmup_rounds=1)


@pytest.mark.benchmark(group=STREAM)
@pytest.mark.parametrize("n", [STREAMED, pytest.param(STREAMED_SLOWLY, marks=pytest.mark.slow)])
def test_a_stream_of_deflections(benchmark, n):
    n_chunks = n // STREAM_CHUNK
    once = our_way(*drawn(STREAM_CHUNK)).sum(axis=0)
    np.testing.assert_allclose(streamed(3), 3 * once, rtol=1e-9)
    name = f"stream of {n / 1e6:.0f} million"
    work = n_chunks * STREAM_CHUNK
    ours(benchmark, name, work=work, unit="sample", at_least={"at once": 0.9})
    for share in (10, 1):  # what grows with the stream would show
        peak = peak_mb(lambda share=share: streamed(n_chunks // share))
        figure(benchmark, f"peak of {n / share / 1e6:.0f} million", peak, "MB", at_most=40.0)
    benchmark.pedantic(streamed, (n_chunks,), rounds=STREAM_ROUNDS, warmup_rounds=0)


def peak_mb(call: Callable[[], object]) -> float:
    tracemalloc.start()
    call()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 1e6


@pytest.mark.benchmark(group=LATENCY)
def test_our_single_prediction(benchmark):
    ours(benchmark, "stiffbench, predict of one row")
    q, wrench = drawn(100)
    model = VirtualJointModel().fit(samples_with(q, wrench, our_way(q, wrench)), robot=SHIPPED)
    benchmark.pedantic(model.predict, drawn(1), rounds=ROUNDS, iterations=200, warmup_rounds=1)


@pytest.mark.benchmark(group=LATENCY)
def test_pinocchios_single_prediction(benchmark):
    (q,), (wrench,), one = *drawn(1), pinocchio_one()
    np.testing.assert_allclose(one(q, wrench), our_way(*drawn(1))[0], rtol=1e-6)
    peer(benchmark, "Pinocchio, arrays in, array out")
    benchmark.pedantic(one, (q, wrench), rounds=ROUNDS, iterations=2_000, warmup_rounds=1)
