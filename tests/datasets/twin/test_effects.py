"""Check each effect that the rough twin adds to the default one."""

from __future__ import annotations

import itertools
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.dataset_catalog import DATASETS
from stiff_datasets.planning.loads import stream
from stiff_datasets.twin.constants import read_constants, shipped_constants, specimen_springs
from stiff_datasets.twin.kr10_twin import (
    Kr10Twin,
    Kr10TwinBeam,
    Kr10TwinMultiload,
    Kr10TwinOmni,
    Kr10TwinRough,
)
from stiff_datasets.twin.robot_twin import ArmFamily, RobotTwin, Ur5Twin
from stiff_datasets.twin.spring_law import SpringLaw
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_effects import EFFECTS, Instruments, real_robot
from stiff_protocols.contract.errors import ConfigError, DataError

CONSTANTS = shipped_constants("kr10_rough")
LOAD = np.array([60.0, 20.0, -60.0, 3.0, -4.0, 2.0])
STOPS = 4000
TWINS = [Kr10Twin, Kr10TwinOmni, Kr10TwinMultiload, Kr10TwinRough, Ur5Twin, ArmFamily]


def own_twin(tmp_path, name, old="", new=""):
    """Return the constants of a user's file: a shipped file with one change."""
    source = (files("stiff_datasets") / "twins" / f"{name}.toml").read_text(encoding="utf-8")
    assert old in source
    path = tmp_path / "my.toml"
    path.write_text(source.replace(old, new, 1), encoding="utf-8")
    return read_constants(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hysterisis", "'hysterisis'.*did you mean.*hysteresis"),
        ("links,none", "'none'"),
        ("links,links", "once"),
        ("", "''"),
    ],
)
def test_an_unknown_effect_is_named_with_the_valid_ones(text, message):
    with pytest.raises(ConfigError, match=message):
        Kr10TwinRough(effects=text)


def test_each_effect_changes_the_measurement_and_none_is_the_default_twins_physics():
    texts = ["none", *(",".join(EFFECTS[: i + 1]) for i in range(len(EFFECTS)))]
    datasets = [Kr10TwinRough(effects=text).load() for text in texts]
    for data, next_data in itertools.pairwise(datasets):
        difference = data.samples.deflection - next_data.samples.deflection
        assert np.abs(difference).max() > 5e-6 or not np.array_equal(
            data.samples.wrench, next_data.samples.wrench
        )
    assert Kr10TwinRough().load().sha256 == datasets[-1].sha256
    q, wrench = datasets[0].samples.q, datasets[0].samples.wrench
    twin = DigitalTwin(CONSTANTS.robot(), specimen_springs(CONSTANTS, 0))
    np.testing.assert_allclose(
        datasets[0].bound_deflections["oracle"], twin.readings(q, wrench), atol=1e-12
    )


def stop_angle(law, path):
    """Return theta [rad] along a torque path [N m] by Prandtl's stops.

    Their weights give the tanh of `SpringLaw` from rest; Masing's rule follows from them.
    """
    half, torque = law._half_lost_motion[0, 0], law._lost_motion_torque[0, 0]
    edges = np.linspace(0.0, 8.0 * torque, STOPS + 1)
    slope = half / torque / np.cosh(edges / torque) ** 2  # of half * tanh(tau / torque)
    radius, weight = (edges[:-1] + edges[1:]) / 2, slope[:-1] - slope[1:]
    last_torque, angles = path[0], []
    state = -radius  # the torque has fallen for long: a turning point
    for tau in path:
        state = np.clip(state + tau - last_torque, -radius, radius)
        last_torque = tau
        angles.append((weight * state).sum())
    return np.array(angles)


def test_lost_motion_follows_masings_rule_and_the_order_of_loads_does_not_matter():
    law = SpringLaw(specimen_springs(CONSTANTS, 0)[1:2])
    preload, loads = 40.0, (25.0, 3.0, 60.0)
    path = np.array([preload] + [tau for load in loads for tau in (preload + load, preload)])
    angles = stop_angle(law, path)
    np.testing.assert_allclose(angles[::2], angles[0], atol=1e-12)  # unloaded: back where it was
    begin = np.full((3, 1), preload)
    elastic = [law.angle(np.full((3, 1), preload + x), np.full((3, 1), preload + x)) for x in loads]
    masing = [law.angle(np.full((3, 1), preload + x), begin) for x in loads]
    lost = np.array([m[0, 0] - e[0, 0] for m, e in zip(masing, elastic, strict=True)])
    np.testing.assert_allclose(angles[1::2] - angles[0], lost, rtol=2e-3)
    backwards = stop_angle(law, np.concatenate([path[:1], path[1:][::-1], path[:1]]))
    assert sorted(np.round(backwards, 10)) == sorted(np.round([*angles, angles[0]], 10))


def test_a_pose_loaded_alone_or_among_others_in_any_order_reads_the_same(kr10, rng):
    twin = DigitalTwin(kr10, specimen_springs(CONSTANTS, 0), hysteresis=True)
    q = np.repeat(rng.uniform(-1.5, 1.5, size=(1, 6)), 5, axis=0)
    wrench = LOAD * rng.uniform(-1, 1, size=(5, 1))
    order = rng.permutation(5)
    readings, shuffled_readings = twin.readings(q, wrench), twin.readings(q, wrench[order])
    np.testing.assert_allclose(shuffled_readings, readings[order], rtol=0, atol=1e-14)
    single_reading = twin.readings(q[:1], wrench[:1])
    np.testing.assert_allclose(single_reading, readings[:1], rtol=0, atol=1e-14)


def test_the_real_robot_is_off_by_the_stated_sizes(kr10):
    real = real_robot(kr10, CONSTANTS.errors, stream("test"))
    for nominal, actual in zip(kr10.placements, real.placements, strict=True):
        offset = np.linalg.inv(nominal) @ actual
        assert np.linalg.norm(offset[:3, 3]) == pytest.approx(3e-4)
        assert np.linalg.norm(pin.log3(offset[:3, :3])) == pytest.approx(5e-4)
    np.testing.assert_allclose(np.abs(real.masses / kr10.masses - 1.0), 0.1)
    assert np.linalg.norm(real.tcp - kr10.tcp) == pytest.approx(3e-4)
    at_zero = np.zeros((1, 6))
    moved = real.tcp_position(at_zero) - kr10.tcp_position(at_zero)
    assert 1e-4 < np.linalg.norm(moved) < 3e-3


def test_the_force_sensor_is_turned_by_one_degree_and_its_gain_is_off_by_three_per_cent(rng):
    wrench = rng.normal(size=(50, 6))
    for specimen in (0, 5):
        sensor = Instruments.of(CONSTANTS, specimen, EFFECTS)
        reading = sensor.sensor_wrench(wrench)
        np.testing.assert_allclose(sensor.true_wrench(reading), wrench, atol=1e-14)
        for part in (slice(0, 3), slice(3, 6)):
            gain = np.linalg.norm(reading[:, part], axis=1) / np.linalg.norm(
                wrench[:, part], axis=1
            )
            np.testing.assert_allclose(np.abs(gain - 1.0), 0.03)
        assert np.rad2deg(np.linalg.norm(pin.log3(sensor.force_frame))) == pytest.approx(
            1.0, rel=1e-5
        )
        assert np.linalg.norm(pin.log3(sensor.tracker_frame)) == pytest.approx(5e-4)
    exact = Instruments.of(CONSTANTS, 3, ())
    np.testing.assert_array_equal(exact.sensor_wrench(wrench), wrench)


def test_the_oracle_knows_all_but_the_noise():
    data = Kr10TwinRough().load()
    error = np.abs(data.bound_deflections["oracle"] - data.samples.deflection).mean()
    noise = np.abs(data.bound_deflections["noise"] - data.samples.deflection).mean()
    assert noise <= 1.05 * error < 3e-5
    assert (
        data.sha256 == replace(data, bound_deflections={}).sha256
    )  # the hash is of the models' data only


def test_links_that_shall_bend_need_sections(tmp_path):
    own_twin(tmp_path, "ur5")
    path = tmp_path / "my.toml"
    path.write_text(path.read_text().partition("[beams]")[0])
    for options in ({"effects": "links"}, {"physics": "rigid"}):
        with pytest.raises(DataError, match=r"my\.toml: no table \[beams\].*(links|rigid)"):
            RobotTwin(constants=path, poses=2, **options).load()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("wall_m = 0.006\n\n", "wall_m = 0.2\n\n", r"segment.1.*wall_m 0.2 is more than half"),
        ("[[beams.segment]] # A1 to A2\nouter_m = 0.2\nwall_m = 0.006\n", "", r"6 tables .*7"),
    ],
)
def test_impossible_constants_are_named(tmp_path, old, new, message):
    with pytest.raises(DataError, match=message):
        own_twin(tmp_path, "kr10_rough", old, new).chain()


def test_a_robot_without_masses_makes_no_twin(tmp_path):
    urdf = (files("stiff_datasets") / "robots" / "ur5.urdf").read_text(encoding="utf-8")
    bare = "".join(part.split("</inertial>")[-1] for part in urdf.split("<inertial>"))
    (tmp_path / "bare.urdf").write_text(bare, encoding="utf-8")
    constants = own_twin(tmp_path, "ur5", 'urdf = "ur5"', 'urdf = "bare.urdf"')
    with pytest.raises(DataError, match=r"my\.toml: no link of bare\.urdf has a mass"):
        constants.chain()


@pytest.mark.parametrize("twin_class", TWINS)
def test_rigid_bearings_keep_poses_and_loads_and_change_the_deflections(twin_class):
    tilting, rigid = twin_class().load(), twin_class(physics="rigid").load()
    for name in ("q", "wrench", "pose_id"):
        np.testing.assert_array_equal(getattr(rigid.samples, name), getattr(tilting.samples, name))
    distance = np.linalg.norm(rigid.samples.deflection - tilting.samples.deflection, axis=1)
    assert np.median(distance) > 2e-5
    error = np.abs(rigid.bound_deflections["oracle"] - rigid.samples.deflection)
    assert np.median(error) < 2e-5  # the oracle bends, too
    card = card_of(twin_class)
    assert f"`{tilting.sha256}`" in card and f"`{rigid.sha256}`" in card


def card_of(cls):
    """Return the text of a data set's card."""
    info = next(info for info in DATASETS if info.target.endswith(f":{cls.__name__}"))
    return (files("stiff_datasets") / info.card).read_text(encoding="utf-8")


def test_the_card_of_the_beams_states_the_hash_of_its_data():
    assert f"`{Kr10TwinBeam().load().sha256}`" in card_of(Kr10TwinBeam)
