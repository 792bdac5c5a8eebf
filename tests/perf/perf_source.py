"""The paper's source domain, 21,280 poses with five wrenches each, beside Pinocchio."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pinocchio as pin
import pytest

from perf_case import figure, ours, peer
from stiff_datasets.kr10_twin import Kr10Twin
from stiff_datasets.robots.robot import shipped_chain
from stiff_models.source import SourceDesign, design_deflection, simulate, source_design
from stiff_protocols.types import FloatArray, Robot

COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
GROUP = "VJM source domain, 21,280 poses x 5 wrenches"
A_SAMPLE, A_POSE = "Pinocchio, every sample", "Pinocchio, every pose"
Case = tuple[Robot, SourceDesign]


@pytest.fixture(scope="module")
def case() -> Case:
    twin = Kr10Twin().load()
    return twin.robot, source_design("paper", "paper", twin.robot, twin.samples, 0)


def our_deflection(robot: Robot, design: SourceDesign) -> FloatArray:
    return design_deflection(robot, COMPLIANCE, design)


def our_domain(robot: Robot, design: SourceDesign) -> FloatArray:
    return simulate(robot, COMPLIANCE, design).deflection


def rows_of(tcp: FloatArray, q: FloatArray) -> FloatArray:
    chain = shipped_chain("kr10_r1100_2", tcp=(0.0, 0.0, 0.0))
    model = chain.model.copy()
    at_tcp = pin.SE3(np.eye(3), tcp)
    frame = model.addFrame(pin.Frame("perf_tcp", model.nv, 0, at_tcp, pin.FrameType.OP_FRAME))
    data, rows = model.createData(), np.empty((len(q), 6, 6))
    for i, position in enumerate(q):
        rows[i] = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL_WORLD_ALIGNED)
    return rows


def every_sample(robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
    rows = rows_of(robot.tcp, q)
    turn = (wrench[:, None] @ rows) * COMPLIANCE
    return (rows[:, :3] @ turn.transpose(0, 2, 1))[:, :, 0]


def every_pose(robot: Robot, design: SourceDesign) -> FloatArray:
    rows = rows_of(robot.tcp, design.q)
    return ((design.wrench @ rows) * COMPLIANCE) @ rows[:, :3].transpose(0, 2, 1)


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("what", ["stiffbench", "stiffbench, poses and wrenches written out"])
def test_our_source(benchmark, case, what):
    call = our_deflection if what == "stiffbench" else our_domain
    tracemalloc.start()
    result = call(*case)
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    figure(benchmark, "memory beside the result", (peak - held) / 1e6, "MB", at_most=40.0)
    assert result.size == 3 * 106_400
    targets = {A_SAMPLE: 100.0, A_POSE: 10.0} if what == "stiffbench" else {}
    ours(benchmark, what, at_least=targets)
    benchmark.pedantic(call, case, rounds=30, warmup_rounds=2)


@pytest.mark.benchmark(group=GROUP)
def test_pinocchio_every_pose(benchmark, case):
    np.testing.assert_allclose(every_pose(*case), our_deflection(*case), rtol=0, atol=1e-15)
    peer(benchmark, A_POSE)
    benchmark.pedantic(every_pose, case, rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group=GROUP)
def test_pinocchio_every_sample(benchmark, case):
    robot, design = case
    domain = simulate(robot, COMPLIANCE, design)
    found = every_sample(robot, domain.q[:500], domain.wrench[:500])
    np.testing.assert_allclose(found, domain.deflection[:500], rtol=0, atol=1e-15)
    peer(benchmark, A_SAMPLE)
    benchmark.pedantic(every_sample, (robot, domain.q, domain.wrench), rounds=4, warmup_rounds=1)
