"""Formulas that become programs on arrays."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_models.physics.straight_line import CHUNK, Program, half_angle, tape_with


def formula(a, b, angle, cos_sin):
    """Every operation, every sign, constants on both sides, and results that read results."""
    cosine, sine = cos_sin(-angle)
    first = -(a * b) + 2.0 * sine - 3.0 * -cosine
    second = 1.0 - first * first - (-a + -b)
    third = -(2.0 / (1.0 + a * a)) + (-a + 4.0) - (b - 0.5)
    return [first, second, third, -first, 7.0, a, -2.0 - b, first + second]


def truth(a, b, angle):
    return np.broadcast_arrays(*formula(a, b, angle, lambda x: (np.cos(x), np.sin(x))))


@pytest.mark.parametrize("n", [0, 1, 5, CHUNK, 2 * CHUNK + 3])
def test_a_program_computes_its_formula_in_chunks(n, rng):
    tape, (pair, (angle,)) = tape_with(2, 1)
    program = Program.of(tape, formula(*pair, angle, half_angle))
    columns, angles = rng.normal(size=(n, 2)), rng.uniform(-9, 9, size=(n, 1))
    out = np.empty((8, n))
    program.run([columns, angles], out)
    np.testing.assert_allclose(out, truth(*columns.T, angles[:, 0]), atol=1e-13)


def test_a_step_is_written_once_and_a_change_of_sign_never():
    tape, (pair,) = tape_with(2)
    a, b = pair
    results = [a * b - 1.0, -(a * b) + 1.0, (-a) * (-b) - 1.0]
    assert [step.name for step in tape.steps] == ["*", "-", "-"]  # a b - 1 and 1 - a b
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
