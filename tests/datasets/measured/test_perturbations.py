"""What an experimenter has wrong: it changes what it should, by its size, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from stiff_datasets.measured.perturbations import Perturbations
from stiff_protocols.contract.types import BenchmarkData

ALL = Perturbations(tcp_m=0.5e-3, force=0.02, turn_rad=2e-3, shift_m=5e-5)


def test_a_tcp_that_is_off_moves_as_pinocchio_says(kr10_chain, twin, rng):
    wrong = Perturbations(tcp_m=0.5e-3).moved_tcp(twin, rng)
    assert wrong.samples is twin.samples
    off = wrong.robot.tcp - twin.robot.tcp
    assert np.linalg.norm(off) == pytest.approx(0.5e-3)
    model, q = kr10_chain.model, twin.samples.q[:20]
    state = model.createData()
    last = model.njoints - 1
    expected = []
    for angles in q:
        pin.forwardKinematics(model, state, angles)
        expected.append(state.oMi[last].act(kr10_chain.tcp + off))
    np.testing.assert_allclose(wrong.robot.tcp_position(q), expected, atol=1e-12)


def test_force_noise_is_a_share_of_each_samples_force_and_of_its_torque(twin, rng):
    samples = replace(twin.samples, wrench=np.tile([30.0, 0.0, 40.0, 0.0, 2.0, 0.0], (151, 1)))
    data = BenchmarkData(samples, twin.robot)
    noisy = Perturbations(force=0.02).noisy_wrench(data, rng)
    error = noisy.samples.wrench - samples.wrench
    np.testing.assert_allclose(error.std(axis=0), [1.0, 1.0, 1.0, 0.04, 0.04, 0.04], rtol=0.25)
    assert (noisy.samples.deflection == samples.deflection).all() and noisy.robot is twin.robot


def test_a_load_without_torque_has_none_with_noise(twin, rng):
    wrench = twin.samples.wrench * [1, 1, 1, 0, 0, 0]
    data = BenchmarkData(replace(twin.samples, wrench=wrench), twin.robot)
    assert not ALL.noisy_wrench(data, rng).samples.wrench[:, 3:].any()


def test_a_wrong_registration_turns_every_deflection_alike_and_keeps_its_length(twin, rng):
    before = twin.samples.deflection
    after = Perturbations(turn_rad=0.01).turned_deflection(twin, rng).samples.deflection
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))
    turn = np.linalg.lstsq(before, after)[0]
    assert np.arccos((np.trace(turn) - 1.0) / 2.0) == pytest.approx(0.01)


def test_a_shift_adds_one_constant_to_all_deflections(twin, rng):
    after = Perturbations(shift_m=5e-5).shifted_deflection(twin, rng).samples.deflection
    shift = after - twin.samples.deflection
    np.testing.assert_allclose(shift, np.tile(shift[0], (len(shift), 1)), atol=1e-15)
    assert np.linalg.norm(shift[0]) == pytest.approx(5e-5)


@pytest.mark.parametrize("name", ALL.mistakes())
def test_a_mistake_is_another_in_each_draw_and_the_same_with_the_same_seed(twin, name):
    draw = ALL.mistakes()[name]
    first, other, again = (draw(twin, np.random.default_rng(seed)).sha256 for seed in (1, 2, 1))
    assert first == again != other and twin.sha256 not in (first, other)


def test_a_mistake_of_no_size_changes_no_number_and_is_left_out(twin, rng):
    nothing = Perturbations()
    assert nothing.mistakes() == {}
    for draw in (
        nothing.moved_tcp,
        nothing.noisy_wrench,
        nothing.turned_deflection,
        nothing.shifted_deflection,
    ):
        assert draw(twin, rng).sha256 == twin.sha256
