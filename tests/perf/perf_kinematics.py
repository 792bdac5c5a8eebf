"""Compare VJM deflections, inverse kinematics and a map with Pinocchio."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from helpers.perf_case import OURS, ours_or_peer
from stiff_apply.workspace import plane_grid, reached_poses
from stiff_datasets.robots.shipped_robots import shipped_chain, shipped_robot
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.kinematics.serial_chain import REACHED_M, REACHED_RAD
from stiff_protocols.paths.inverse import follow
from stiff_protocols.paths.path import ToolPath, shaped

ROBOT, TCP = "kr10_r1100_2", (0.06, 0.0, 0.08)
SAMPLES = 106_400
NANOMETRE = 1e-9
COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
PINOCCHIO = "Pinocchio loop"
ROUNDS = 8
MAP_REGION = np.array([[0.6, 0.9], [0.0, 0.0], [0.4, 0.7]])
"""Ends of a map along x, y and z [m]. The KR10 reaches all its points with the tool down."""
READY, PATH_POINTS = np.radians([0.0, -90.0, 90.0, 0.0, 60.0, 0.0]), 10_000

DOWN = np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])

Samples = tuple[FloatArray, FloatArray]
Way = Callable[[FloatArray, FloatArray], FloatArray]


SHIPPED = shipped_robot(ROBOT, tcp=TCP)  # one robot: its program is compiled once


def our_way(q: FloatArray, wrench: FloatArray) -> FloatArray:
    return SHIPPED.joint_deflection(COMPLIANCE, q, wrench)


def draw_samples(n: int, seed: int = 0) -> Samples:
    rng = np.random.default_rng(seed)
    wrench = rng.normal(size=(n, 6)) * np.repeat([60.0, 5.0], 3)
    return rng.uniform(-1.5, 1.5, size=(n, 6)), wrench


def pinocchio_loop() -> Way:
    """Return Pinocchio's fastest single call in a loop over samples."""
    chain = shipped_chain(ROBOT, TCP)
    model, at_tcp = chain.model.copy(), pin.SE3(np.eye(3), chain.robot.tcp)
    frame = model.addFrame(pin.Frame("perf_tcp", model.nv, 0, at_tcp, pin.FrameType.OP_FRAME))
    data, world = model.createData(), pin.LOCAL_WORLD_ALIGNED

    def way(q: FloatArray, wrench: FloatArray) -> FloatArray:
        rows = np.empty((len(q), 6, q.shape[1]))
        for i, position in enumerate(q):
            rows[i] = pin.computeFrameJacobian(model, data, position, frame, world)
        turn = (wrench[:, None] @ rows) * COMPLIANCE
        return (rows[:, :3] @ turn.transpose(0, 2, 1))[:, :, 0]

    return way


@pytest.mark.benchmark(group="VJM deflection, random samples")
@pytest.mark.parametrize("who", [OURS, PINOCCHIO])
def test_deflections(benchmark, who):
    way = pinocchio_loop() if who == PINOCCHIO else our_way
    np.testing.assert_allclose(
        way(*draw_samples(50)), our_way(*draw_samples(50)), rtol=0, atol=NANOMETRE
    )
    ours_or_peer(benchmark, who, {PINOCCHIO: 15.0}, work=SAMPLES, unit="sample")
    benchmark.pedantic(way, draw_samples(SAMPLES), rounds=ROUNDS, warmup_rounds=1)


def iso_path() -> ToolPath:
    """Return 10,000 points through ISO 9283's test points, in a 200 mm cube."""
    frames = SHIPPED.forward(READY[None])
    (rotation,), centre = frames.rotation, frames.points[0, -1]
    return shaped("iso9283", centre, 0.2, PATH_POINTS, rotation=rotation, wrench=np.zeros(6))


def pinocchio_newton(path: ToolPath) -> FloatArray:
    """Solve point by point with Newton's method, to the same tolerance."""
    chain = shipped_chain(ROBOT, TCP)
    model, at_tcp = chain.model.copy(), pin.SE3(np.eye(3), chain.robot.tcp)
    frame = model.addFrame(pin.Frame("perf_tcp", model.nv, 0, at_tcp, pin.FrameType.OP_FRAME))
    data, q, solutions = model.createData(), READY.copy(), np.empty((len(path), model.nv))
    for row in range(len(path)):
        target = pin.SE3(path.rotation[row], path.position[row])
        while True:
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[frame].actInv(target)).vector
            if max(error[:3] @ error[:3], error[3:] @ error[3:]) <= REACHED_M**2:
                break
            q = q + np.linalg.solve(pin.computeFrameJacobian(model, data, q, frame), error)
        solutions[row] = q
    return solutions


@pytest.mark.benchmark(group="Inverse kinematics along a path of 10,000 points")
@pytest.mark.parametrize("who", [OURS, PINOCCHIO])
def test_inverse(benchmark, who):
    path = iso_path()
    way: Callable[[ToolPath], FloatArray] = {
        OURS: lambda path: follow(SHIPPED, path.position, path.rotation, READY).q,
        PINOCCHIO: pinocchio_newton,
    }[who]
    short_path = path.take(slice(500))
    solution, truth = way(short_path), pinocchio_newton(short_path)
    np.testing.assert_allclose(solution, truth, rtol=0, atol=100 * REACHED_RAD)
    ours_or_peer(benchmark, who, {PINOCCHIO: 1.2}, work=PATH_POINTS, unit="point")
    benchmark.pedantic(way, (path,), rounds=ROUNDS, warmup_rounds=1)


LOAD = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])


TRAINED = TrainingRange(READY, READY, 100.0, 0.0, READY[None], LOAD[None] / 100.0)
TOOL_DOWN = SHIPPED.forward(DOWN[None]).rotation[0]


def our_map(points: FloatArray) -> FloatArray:
    """Return each point's deflection in the one of eight configurations nearest to training."""
    q, blank = reached_poses(SHIPPED, points, TOOL_DOWN, TRAINED)
    q, size = q[blank == ""], np.full(blank.size, np.nan)
    wrench = np.tile(LOAD, (len(q), 1))
    size[blank.ravel() == ""] = np.linalg.norm(our_way(q, wrench), axis=1)
    TRAINED.extrapolates(q, wrench)
    return size


def pinocchio_map(points: FloatArray) -> FloatArray:
    """Return each point's deflection in the configuration of the point before."""
    rows = points.copy()
    rows[1::2] = rows[1::2, ::-1]
    flat = rows.reshape(-1, 3)
    rotations = np.tile(TOOL_DOWN, (len(flat), 1, 1))
    wrench = np.tile(LOAD, (len(flat), 1))
    q = pinocchio_newton(ToolPath("map", flat, rotations, wrench))
    size = np.linalg.norm(pinocchio_loop()(q, wrench), axis=1).reshape(points.shape[:2])
    size[1::2] = size[1::2, ::-1]
    return np.asarray(size.ravel())


@pytest.mark.benchmark(group="Stiffness map of 10,000 points")
@pytest.mark.parametrize("who", [OURS, PINOCCHIO])
def test_map(benchmark, who):
    points = plane_grid("xz", 0.0, MAP_REGION, 100)
    coarse = plane_grid("xz", 0.0, MAP_REGION, 12)
    way = {OURS: our_map, PINOCCHIO: pinocchio_map}[who]
    np.testing.assert_allclose(way(coarse), pinocchio_map(coarse), rtol=1e-6)
    ours_or_peer(benchmark, who, {PINOCCHIO: 0.3}, work=PATH_POINTS, unit="point")
    benchmark.pedantic(way, (points,), rounds=3, warmup_rounds=1)
