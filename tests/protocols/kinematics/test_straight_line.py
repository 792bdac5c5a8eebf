"""Check formulas that are compiled to programs on arrays."""

from __future__ import annotations

import numpy as np

from stiff_protocols.kinematics.straight_line import Program, half_angle, tape_with


def test_cosine_and_sine_by_the_half_angle_are_as_exact_as_rounding(rng):
    tape, ((angle,),) = tape_with(1)
    program = Program.of(tape, half_angle(angle))
    turns = np.arange(-8, 9) * np.pi / 4
    near_half_turns = np.pi * (1 + 1e-9 * rng.normal(size=100))
    angles = np.concatenate([rng.uniform(-10, 10, size=10_000), turns, near_half_turns])
    out = np.empty((2, len(angles)))
    program.run([angles[:, None]], out)
    np.testing.assert_allclose(out, [np.cos(angles), np.sin(angles)], rtol=0, atol=6e-16)
