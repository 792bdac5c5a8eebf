"""Speed of the digital twin beside the same balance solved with Pinocchio, sample by sample.

Not part of the test run: `make bench-speed`.
"""

from __future__ import annotations

import numpy as np
import pytest
from pinocchio_twin import elastic_pinocchio, torque_and_tcp

from stiff_datasets.springs import SpringLaw
from stiff_datasets.twin import TOLERANCE_NM, DigitalTwin
from stiff_datasets.twins import shipped_constants

CONSTANTS = shipped_constants("kr10_r1100_2")
CHAIN = CONSTANTS.chain()
SAMPLES, PEER_SAMPLES = 20_000, 200


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(0)
    wrench = rng.normal(size=(SAMPLES, 6)) * np.repeat([40.0, 4.0], 3)
    return rng.uniform(-1.5, 1.5, size=(SAMPLES, 6)), wrench


def pinocchio_readings(q, wrench):
    model, law = elastic_pinocchio(CHAIN), SpringLaw(CONSTANTS.springs)
    data = model.createData()

    def balanced(pose, load):
        torque, change = np.zeros(model.nv), np.inf
        while change > TOLERANCE_NM:
            theta = law.angle(torque[:, None])[:, 0]
            found, tcp, _ = torque_and_tcp(model, data, CHAIN.tcp, pose, theta, load)
            torque, change = found, np.abs(found - torque).max()
        return tcp

    return np.array(
        [balanced(*one) - balanced(one[0], np.zeros(6)) for one in zip(q, wrench, strict=True)]
    )


def test_both_give_the_same_readings(samples):
    q, wrench = (part[:20] for part in samples)
    ours = DigitalTwin(CHAIN, CONSTANTS.springs).readings(q, wrench)
    np.testing.assert_allclose(ours, pinocchio_readings(q, wrench), rtol=0, atol=1e-13)


@pytest.mark.benchmark(group="twin, 200 samples")
@pytest.mark.parametrize("whose", ["ours", "pinocchio"])
def test_readings_of_a_measurement(benchmark, samples, whose):
    q, wrench = (part[:PEER_SAMPLES] for part in samples)
    ours = DigitalTwin(CHAIN, CONSTANTS.springs).readings
    benchmark(ours if whose == "ours" else pinocchio_readings, q, wrench)


@pytest.mark.benchmark(group="twin, 20,000 samples (ours alone)")
def test_readings_of_a_source(benchmark, samples):
    benchmark(DigitalTwin(CHAIN, CONSTANTS.springs).readings, *samples)
