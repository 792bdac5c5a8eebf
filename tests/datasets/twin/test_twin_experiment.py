"""What the instruments of a simulated experiment add."""

from __future__ import annotations

import numpy as np

from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.constants import Noise, shipped_constants, specimen_springs
from stiff_datasets.twin.twin import TwinExperiment, recorded_deflection, recorded_wrench

CONSTANTS = shipped_constants("kr10_r1100_2")
REPEATS = 10_000


def test_noise_has_the_data_sheets_size_over_10000_repeats(rng):
    noise = Noise()
    wrench = recorded_wrench(np.zeros((REPEATS, 6)), noise, rng)
    np.testing.assert_allclose(wrench[:, :3].std(axis=0), 0.04, rtol=0.03)
    np.testing.assert_allclose(wrench[:, 3:].std(axis=0), 0.002, rtol=0.03)
    deflection = recorded_deflection(np.zeros((REPEATS, 3)), noise, rng)
    # one reading with the load, one without, 0.01 mm each
    np.testing.assert_allclose(deflection.std(axis=0), np.sqrt(2) * 1e-5, rtol=0.03)
    for readings in (wrench, deflection):
        assert np.abs(readings.mean(axis=0) / readings.std(axis=0)).max() < 0.04


def test_data_sets_that_share_a_seed_share_no_random_numbers():
    names = np.arange(50).astype(str)
    poses = Poses(np.zeros((50, 6)), names, names)
    variants = [
        TwinExperiment(constants, loads="omni", specimen=specimen, seed=0, loads_per_pose=loads)
        for constants, specimen, loads in (
            (CONSTANTS, 0, 1),
            (CONSTANTS, 1, 1),
            (CONSTANTS, 0, 5),
            (shipped_constants("ur5"), 0, 1),
        )
    ]
    forces, noises = [], []
    for variant in variants:
        force = variant.wrenches(np.zeros((50, 6)))[:, :3]
        forces.append(force / np.linalg.norm(force, axis=1, keepdims=True))
        still = np.zeros((len(variant.logged_q(poses)), 3))
        noises.append(variant.recorded(poses, np.zeros((len(still), 6)), still).deflection[:50])
    for numbers in (forces, noises):
        for i, one in enumerate(numbers):
            for other in numbers[:i]:
                assert np.abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.3
    factors = [
        [drawn.structure / spring.structure for drawn, spring in zip(found, nominal, strict=True)]
        for found, nominal in (
            (specimen_springs(constants, 3), constants.springs)
            for constants in (CONSTANTS, shipped_constants("ur5"))
        )
    ]
    assert not np.isclose(*factors).any()  # specimens of two robots
