"""Formulas that become programs on arrays."""

from __future__ import annotations

import numpy as np

from stiff_protocols.kinematics.straight_line import Program, half_angle, tape_with


def test_a_step_is_written_once_and_a_change_of_sign_never():
    tape, (pair,) = tape_with(2)
    a, b = pair
    results = [a * b - 1.0, -(a * b) + 1.0, (-a) * (-b) - 1.0]
    written = [function for function, _ in tape.steps]
    assert written == [np.multiply, np.subtract, np.subtract]  # a b - 1 and 1 - a b
    assert results[0].number == results[2].number


def test_steps_that_no_result_needs_are_left_out():
    tape, (pair,) = tape_with(2)
    unused = pair[0] * pair[1]
    assert len(Program.of(tape, [pair[0] + pair[1]]).steps) == 1
    assert len(Program.of(tape, [unused]).steps) == 1


def test_cosine_and_sine_by_the_half_angle_are_as_exact_as_rounding(rng):
    tape, ((angle,),) = tape_with(1)
    program = Program.of(tape, half_angle(angle))
    turns = np.arange(-8, 9) * np.pi / 4
    near_half_turns = np.pi * (1 + 1e-9 * rng.normal(size=100))
    angles = np.concatenate([rng.uniform(-10, 10, size=10_000), turns, near_half_turns])
    out = np.empty((2, len(angles)))
    program.run([angles[:, None]], out)
    np.testing.assert_allclose(out, [np.cos(angles), np.sin(angles)], rtol=0, atol=6e-16)
