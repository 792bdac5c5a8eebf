"""Check the frozen values: their shapes, read-only arrays and hashes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_samples import samples_with
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BenchmarkData, Samples


def make(**changes) -> Samples:
    fields = {"q": np.zeros((2, 6)), "wrench": np.ones((2, 6)), "deflection": np.ones((2, 3))}
    return samples_with(**(fields | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wrench": np.ones((2, 3))}, r"wrench has shape \(2, 3\), expected 2x6"),
        ({"deflection": np.ones((3, 3))}, r"deflection has shape \(3, 3\), expected 2x3"),
        ({"q": np.full((2, 6), np.nan)}, r"q\[0, 0\] is nan"),
        ({"pose_id": np.array(["a"])}, r"pose_id has shape \(1,\)"),
        ({"instrument_noise": -1e-5}, r"instrument_noise is -1e-05 m"),
        ({"instrument_noise": np.nan}, r"instrument_noise is nan m"),
        ({"order": [1.0]}, r"order has shape \(1,\), expected 2"),
        ({"approach": np.full((2, 6), 0.5)}, "approach holds other numbers"),
        ({"approach": np.ones((2, 3))}, "approach has shape"),
        ({"after": np.full((2, 3), np.nan)}, "after.* is nan"),
        ({"directions": np.full((2, 1, 3), 1.0)}, "length is not 1"),
        ({"directions": np.eye(3)[[[0], [1]]]}, "a part outside its directions"),
        ({"directions": np.eye(3)[[[0, 0], [0, 1]]]}, "several numbers along one direction"),
        ({"levers": np.ones((2, 3))}, "levers without directions"),
        ({"levers": np.ones((2, 6)), "directions": np.tile(np.eye(3), (2, 1, 1))}, "levers has"),
    ],
)
def test_wrong_shapes_and_values_are_refused_by_name(changes, message):
    with pytest.raises(DataError, match=message):
        make(**changes)


def test_samples_are_read_only_copies_whose_rows_stay_together():
    q = np.zeros((2, 6))
    samples = make(q=q)
    q[0, 0] = 1.0
    assert samples.q[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        samples.deflection[0, 0] = 1.0
    row = make(deflection=np.arange(6.0).reshape(2, 3)).take(np.array([1]))
    assert row.pose_id.tolist() == ["1"]
    assert row.deflection.tolist() == [[3.0, 4.0, 5.0]]


def test_the_hash_of_data_changes_with_any_number_name_or_robot(kr10):
    base = BenchmarkData(make(), kr10).sha256
    assert BenchmarkData(make(), kr10).sha256 == base
    changed_samples = [
        make(deflection=np.ones((2, 3)) * (1 + 1e-15)),
        make(group=np.array(["g", "h"])),
    ]
    assert all(BenchmarkData(samples, kr10).sha256 != base for samples in changed_samples)
    assert BenchmarkData(make(), replace(kr10, tcp=[0.0, 0.0, 0.1])).sha256 != base
    assert BenchmarkData(make(), replace(kr10, flange=np.eye(4)[[1, 2, 0, 3]])).sha256 == base


def test_the_noise_of_the_instrument_stays_with_the_samples_and_is_hashed_where_it_is_stated(kr10):
    noisy_samples, plain_samples = make(instrument_noise=2e-5), make()
    rows = np.array([1])
    assert (
        noisy_samples.take(rows).instrument_noise == 2e-5
        and plain_samples.take(rows).instrument_noise == 0
    )
    assert Samples.together(plain_samples, noisy_samples).instrument_noise == 2e-5
    hashes = {BenchmarkData(samples, kr10).sha256 for samples in (noisy_samples, plain_samples)}
    assert len(hashes) == 2
    assert BenchmarkData(replace(noisy_samples, instrument_noise=0.0), kr10).sha256 in hashes
    assert BenchmarkData(make(instrument_noise=np.float64(2e-5)), kr10).sha256 in hashes


STATED = {
    "order": np.array([2.0, 1.0]),
    "approach": np.array([[1.0, -1.0, 0.0, 1.0, 1.0, -1.0]] * 2),
    "after": np.full((2, 3), 1e-6),
    "directions": np.tile(np.eye(3), (2, 1, 1)),
}


@pytest.mark.parametrize("name", STATED)
def test_what_a_file_may_state_is_hashed_where_it_is_stated_and_stays_with_its_rows(name, kr10):
    plain, stated = make(), make(**{name: STATED[name]})
    assert BenchmarkData(stated, kr10).sha256 != BenchmarkData(plain, kr10).sha256
    assert getattr(plain, name).size == 0 and name not in plain.columns
    row = stated.take(np.array([1]))
    np.testing.assert_array_equal(getattr(row, name), STATED[name][1:])
    np.testing.assert_array_equal(
        getattr(Samples.together(row, stated), name), STATED[name][[1, 0, 1]]
    )


def test_samples_together_state_what_each_of_them_states():
    stated, nothing = make(**STATED), make().take(np.array([], dtype=int))
    assert set(STATED) <= {*Samples.together(nothing, stated).columns}
    without = replace(make(), directions=STATED["directions"])
    assert Samples.together(stated, without).order.size == 0
    np.testing.assert_array_equal(Samples.together(stated, make()).values[2:], make().deflection)


def test_levers_stay_with_their_rows_and_are_hashed_and_other_rows_were_read_at_the_tcp(kr10):
    at_tcp = make(directions=STATED["directions"])
    samples = replace(at_tcp, levers=[[0.1, 0.0, 0.0], [0.0, 0.2, 0.0]])
    assert BenchmarkData(samples, kr10).sha256 != BenchmarkData(at_tcp, kr10).sha256
    with pytest.raises(DataError, match="of the TCP"):
        BenchmarkData(samples, kr10, {"truth": np.zeros((2, 3))})
    assert samples.take(np.array([1])).levers.tolist() == [[0.0, 0.2, 0.0]]
    for other_part in (at_tcp, make()):  # two or three numbers a row
        np.testing.assert_array_equal(
            Samples.together(other_part, samples).levers, [*np.zeros((2, 3)), *samples.levers]
        )


def test_a_reading_along_one_direction_is_its_value_along_it(rng):
    directions = rng.normal(size=(2, 1, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    values = np.array([[1e-3], [-2e-3]])
    samples = make(deflection=values * directions[:, 0], directions=directions)
    np.testing.assert_allclose(samples.values, values)
    np.testing.assert_array_equal(make().values, make().deflection)
    np.testing.assert_allclose(
        samples.seen(np.ones((2, 3))), samples.read(np.ones((2, 3))) * directions[:, 0]
    )


def test_rows_may_have_one_two_or_three_numbers():
    upwards, three = np.array([[[0.0, 0.0, 1.0]]] * 2), make()
    samples = Samples.together(
        make(deflection=make().deflection * [0, 0, 1], directions=upwards), three
    )
    assert samples.is_read.sum(axis=1).tolist() == [1, 1, 3, 3]
    assert samples.pose_of_number.shape == (8,)
    np.testing.assert_array_equal(samples.values[samples.is_read][2:], three.deflection.ravel())
    with pytest.raises(DataError, match="without a number"):
        make(deflection=np.zeros((2, 3)), directions=np.zeros((2, 1, 3)))


def test_samples_of_another_number_of_joints_do_not_fit_a_robot(kr10):
    with pytest.raises(DataError, match="samples have 5 joint angles, robot 'kr10_r1100_2' has 6"):
        BenchmarkData(make(q=np.zeros((2, 5))), kr10)


def test_robot_samples_and_both_together_print_in_twelve_lines_of_a_screens_width(twin):
    for thing in (twin.robot, twin.samples, twin):
        lines = repr(thing).splitlines()
        assert len(lines) <= 12
        assert max(map(len, lines)) <= 100
