"""Check the contents of the simulated KR10's data sets."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

from stiff_datasets.twin.kr10_twin import (
    CALIBRATIONS,
    Kr10Twin,
    Kr10TwinMultiload,
    Kr10TwinOmni,
)
from stiff_datasets.twin.twin_file import specimen_law

PAYLOAD_N = 10.0 * 9.81
KEYS = {
    "kr10-twin": Kr10Twin,
    "kr10-twin-omni": Kr10TwinOmni,
    "kr10-twin-multiload": Kr10TwinMultiload,
}
VARIANTS = [(key, number) for key in KEYS for number in CALIBRATIONS]


@pytest.fixture(scope="module")
def data():
    return {(key, number): KEYS[key](calibration=number).load() for key, number in VARIANTS}


@pytest.mark.slow
@pytest.mark.parametrize(("key", "number"), VARIANTS)
def test_it_holds_the_151_planned_poses_with_its_number_of_loads(data, key, number):
    samples, loads = data[key, number].samples, 5 if "multi" in key else 1
    assert len(samples) == 151 * loads and len(set(samples.pose_id)) == 151
    assert len(np.unique(samples.q, axis=0)) == 151  # a pose under two names would be a leak
    assert (samples.group == "joint-space").sum() == 61 * loads
    assert (samples.group == "cartesian").sum() == 90 * loads
    assert set(samples.load_id) == {str(i + 1) for i in range(loads)}
    for name in set(samples.pose_id):
        assert (samples.q[samples.pose_id == name] == samples.q[samples.pose_id == name][0]).all()
    # the sensor's noise may read 0.2 N more than the payload
    assert np.linalg.norm(samples.wrench[:, :3], axis=1).max() < PAYLOAD_N + 0.2
    size_mm = np.linalg.norm(samples.deflection, axis=1) * 1000  # as the paper reports
    assert 0.3 < np.median(size_mm) < 3.0 and size_mm.max() < 10.0
    card = (files("stiff_datasets") / "data" / "kr10_twin.md").read_text(encoding="utf-8")
    assert f"| `{key}` | {number} | `{data[key, number].sha256}` |" in card


def test_a_ropes_torque_is_at_right_angles_to_its_force():
    wrench = Kr10TwinOmni().load().samples.wrench
    along = (wrench[:, :3] * wrench[:, 3:]).sum(axis=1) / np.linalg.norm(wrench[:, :3], axis=1)
    assert np.abs(along).max() < 0.02  # sensor noise


@pytest.mark.slow
@pytest.mark.parametrize("key", KEYS)
def test_specimens_and_seeds_differ_and_the_same_words_give_the_same_bytes(data, key):
    variants = [{}, {"specimen": 1}, {"specimen": 9}, {"seed": 1}]
    hashes = [KEYS[key](**variant).load().sha256 for variant in variants]
    assert hashes[0] == data[key, 1].sha256  # the default calibration
    assert len(set(hashes)) == len(variants)


def slope_changes(compliance):
    """Return what the gears' first slopes are softer than their last, without the structure."""
    first, _, last = np.array(compliance)[..., ::3, 0].swapaxes(0, 1)
    return first - last


@pytest.mark.parametrize("number", CALIBRATIONS)
def test_specimens_differ_by_manufacturing_scatter_not_more(number):
    constants = CALIBRATIONS[number].constants()
    nominal, *drawn = (specimen_law(constants, number).compliance for number in range(10))
    # of the gears: the structure has one compliance at all torques
    scatter = np.log(slope_changes(drawn) / slope_changes([nominal])).std()
    assert constants.scatter.gear / 1.5 < scatter < constants.scatter.gear * 1.5
