"""Compare the digital twin with the same balance solved in a Pinocchio loop."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.perf_case import ours_or_peer
from helpers.pinocchio_twin import elastic_pinocchio, torque_and_tcp
from stiff_datasets.twin.twin import TOLERANCE_NM, DigitalTwin
from stiff_datasets.twin.twin_file import shipped_constants, specimen_law
from stiff_protocols.contract.types import FloatArray

CONSTANTS = shipped_constants("kr10_r1100_2")
CHAIN = CONSTANTS.chain()
SAMPLES = {"stiffbench, 200 samples": 200, "stiffbench, 20,000 samples": 20_000}
LOOP = "Pinocchio loop"


def draw_samples(n: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(0)
    wrench = rng.normal(size=(n, 6)) * np.repeat([40.0, 4.0], 3)
    return rng.uniform(-1.5, 1.5, size=(n, 6)), wrench


def pinocchio_deflections(q: FloatArray, wrench: FloatArray) -> FloatArray:
    model, law = elastic_pinocchio(CHAIN), specimen_law(CONSTANTS, 0)
    data = model.createData()

    def loaded_tcp(pose: FloatArray, load: FloatArray) -> FloatArray:
        torque, change = np.zeros(model.nv), np.inf
        while change > TOLERANCE_NM:
            theta = law.angle(torque[:, None])[:, 0]
            new_torque, tcp, _ = torque_and_tcp(model, data, CHAIN.robot.tcp, pose, theta, load)
            torque, change = new_torque, np.abs(new_torque - torque).max()
        return tcp

    return np.array(
        [
            loaded_tcp(pose, load) - loaded_tcp(pose, np.zeros(6))
            for pose, load in zip(q, wrench, strict=True)
        ]
    )


@pytest.mark.benchmark(group="digital twin, deflections")
@pytest.mark.parametrize("who", [*SAMPLES, LOOP])
def test_deflections(benchmark, who):
    twin, n = DigitalTwin.in_world(CONSTANTS, 0, "clean"), SAMPLES.get(who, 200)
    way = pinocchio_deflections if who == LOOP else twin.truth
    np.testing.assert_allclose(
        way(*draw_samples(20)), twin.truth(*draw_samples(20)), rtol=0, atol=1e-13
    )
    ours_or_peer(benchmark, who, work=n, unit="sample")
    benchmark.pedantic(way, draw_samples(n), rounds=5, warmup_rounds=1)
