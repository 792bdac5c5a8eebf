"""The digital twin beside the same balance solved with Pinocchio, sample by sample."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from pinocchio_twin import elastic_pinocchio, torque_and_tcp

from perf_case import ours, peer
from stiff_datasets.twin.constants import shipped_constants
from stiff_datasets.twin.springs import SpringLaw
from stiff_datasets.twin.twin import TOLERANCE_NM, DigitalTwin
from stiff_protocols.contract.types import FloatArray

CONSTANTS = shipped_constants("kr10_r1100_2")
CHAIN = CONSTANTS.chain()
GROUP = "digital twin, readings"
SAMPLES, FEW = 20_000, 200


def drawn(n: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(0)
    wrench = rng.normal(size=(n, 6)) * np.repeat([40.0, 4.0], 3)
    return rng.uniform(-1.5, 1.5, size=(n, 6)), wrench


def pinocchio_loop() -> Callable[[FloatArray, FloatArray], FloatArray]:
    model, law = elastic_pinocchio(CHAIN), SpringLaw(CONSTANTS.springs)
    data = model.createData()

    def balanced(pose: FloatArray, load: FloatArray) -> FloatArray:
        torque, change = np.zeros(model.nv), np.inf
        while change > TOLERANCE_NM:
            theta = law.angle(torque[:, None])[:, 0]
            found, tcp, _ = torque_and_tcp(model, data, CHAIN.tcp, pose, theta, load)
            torque, change = found, np.abs(found - torque).max()
        return tcp

    def readings(q: FloatArray, wrench: FloatArray) -> FloatArray:
        return np.array(
            [balanced(*one) - balanced(one[0], np.zeros(6)) for one in zip(q, wrench, strict=True)]
        )

    return readings


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("n", [FEW, SAMPLES])
def test_our_readings(benchmark, n):
    ours(benchmark, f"stiffbench, {n:,} samples", work=n, unit="sample")
    readings = DigitalTwin(CHAIN, CONSTANTS.springs).readings
    benchmark.pedantic(readings, drawn(n), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group=GROUP)
def test_pinocchios_readings(benchmark):
    found, readings = DigitalTwin(CHAIN, CONSTANTS.springs).readings(*drawn(20)), pinocchio_loop()
    np.testing.assert_allclose(found, readings(*drawn(20)), rtol=0, atol=1e-13)
    peer(benchmark, "Pinocchio loop", work=FEW, unit="sample")
    benchmark.pedantic(readings, drawn(FEW), rounds=5, warmup_rounds=1)
