"""The paper's source domain, 21,280 poses with five wrenches each, beside Pinocchio."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from perf_case import figure, ours, peer
from stiff_datasets.robots.robot import shipped_chain
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.transfer.source import SourceDesign, design_deflection, simulate, source_design
from stiff_protocols.contract.types import FloatArray, Robot

COMPLIANCE = 1 / np.array([50.9e3, 63.4e3, 50.3e3, 2.27e3, 8.89e3, 1.39e3])
GROUP = "VJM source domain, 21,280 poses x 5 wrenches"
A_SAMPLE, A_POSE = "Pinocchio, every sample", "Pinocchio, every pose"
ROUNDS = 10
Case = tuple[Robot, SourceDesign]
Jacobians = Callable[[FloatArray], FloatArray]


@pytest.fixture(scope="module")
def case() -> Case:
    twin = Kr10Twin().load()
    return twin.robot, source_design("paper", "paper", twin.robot, twin.samples, 0)


def our_deflection(robot: Robot, design: SourceDesign) -> FloatArray:
    return design_deflection(robot, COMPLIANCE, design)


def our_domain(robot: Robot, design: SourceDesign) -> FloatArray:
    return simulate(robot, COMPLIANCE, design).deflection


@pytest.fixture(scope="module")
def jacobians(case) -> Jacobians:
    """Pinocchio's of many poses."""
    chain = shipped_chain("kr10_r1100_2", tcp=(0.0, 0.0, 0.0))
    model, at_tcp = chain.model.copy(), pin.SE3(np.eye(3), case[0].tcp)
    frame = model.addFrame(pin.Frame("perf_tcp", model.nv, 0, at_tcp, pin.FrameType.OP_FRAME))
    data = model.createData()

    def of_each(q: FloatArray) -> FloatArray:
        rows = np.empty((len(q), 6, 6))
        for i, one in enumerate(q):
            rows[i] = pin.computeFrameJacobian(model, data, one, frame, pin.LOCAL_WORLD_ALIGNED)
        return rows

    return of_each


def every_sample(jacobians: Jacobians, q: FloatArray, wrench: FloatArray) -> FloatArray:
    rows = jacobians(q)
    turn = (wrench[:, None] @ rows) * COMPLIANCE
    return (rows[:, :3] @ turn.transpose(0, 2, 1))[:, :, 0]


def every_pose(jacobians: Jacobians, design: SourceDesign) -> FloatArray:
    rows = jacobians(design.q)
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
    benchmark.pedantic(call, case, rounds=ROUNDS, warmup_rounds=2)


@pytest.mark.benchmark(group=GROUP)
def test_pinocchio_every_pose(benchmark, case, jacobians):
    arguments = jacobians, case[1]
    np.testing.assert_allclose(every_pose(*arguments), our_deflection(*case), rtol=0, atol=1e-15)
    peer(benchmark, A_POSE)
    benchmark.pedantic(every_pose, arguments, rounds=ROUNDS, warmup_rounds=2)


@pytest.mark.benchmark(group=GROUP)
def test_pinocchio_every_sample(benchmark, case, jacobians):
    robot, design = case
    domain = simulate(robot, COMPLIANCE, design)
    found = every_sample(jacobians, domain.q[:500], domain.wrench[:500])
    np.testing.assert_allclose(found, domain.deflection[:500], rtol=0, atol=1e-15)
    peer(benchmark, A_SAMPLE)
    arguments = jacobians, domain.q, domain.wrench
    benchmark.pedantic(every_sample, arguments, rounds=ROUNDS, warmup_rounds=2)
