"""Check bending links against a cantilever's closed form and a frame's stiffness matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_robots import planar_arm
from stiff_datasets.twin.beams import SHEAR_COEFFICIENT, Beams, Tube
from stiff_datasets.twin.constants import shipped_constants, specimen_beams

E, NU = 7.0e10, 0.33
G = E / (2.0 * (1.0 + NU))
BEAM = shipped_constants("kr10_beam")


@pytest.fixture()
def beams():
    return specimen_beams(BEAM, BEAM.robot(), 0, must_bend=False)


@pytest.fixture()
def poses(rng):
    return rng.uniform(-1.5, 1.5, size=(6, 6))


def cantilever(length, tube):
    """Return the beams of one joint at the origin with a tube along x."""
    robot = replace(planar_arm(1, (0.0, 0.0, 1.0)), tcp=np.array([length, 0.0, 0.0]))
    return Beams(robot, (tube, tube), np.full(2, E), NU)


def compliances(beams, q):
    """Return the TCP's deflections under unit wrenches, (n, 6, 6)."""
    columns = [beams.displacement(q, np.tile(unit, (len(q), 1))) for unit in np.eye(6)]
    return np.stack(columns, axis=2)


def test_a_cantilever_deflects_as_timoshenkos_closed_form_says():
    length, tube = 0.8, Tube(outer_m=0.1, wall_m=0.01)
    area = np.pi * (0.05**2 - 0.04**2)
    inertia = np.pi / 4 * (0.05**4 - 0.04**4)
    compliance = compliances(cantilever(length, tube), np.zeros((1, 1)))[0]
    sideways = length**3 / (3 * E * inertia) + length / (SHEAR_COEFFICIENT * G * area)
    expected = np.diag([length / (E * area), sideways, sideways, *[length / (E * inertia)] * 3])
    expected[3, 3] = length / (G * 2 * inertia)
    turn = length**2 / (2 * E * inertia)
    expected[1, 5] = expected[5, 1] = turn  # a force along y turns the end about z
    expected[2, 4] = expected[4, 2] = -turn
    np.testing.assert_allclose(compliance, expected, rtol=1e-12, atol=1e-20)
    turned_compliance = compliances(cantilever(length, tube), np.array([[np.pi / 2]]))[0]
    assert turned_compliance[1, 1] == pytest.approx(length / (E * area))


def test_the_robot_deflects_as_its_assembled_stiffness_matrix_says(beams, poses):
    for q, compliance in zip(poses, compliances(beams, poses), strict=True):
        np.testing.assert_allclose(compliance, frame_compliance(beams, q), rtol=1e-9, atol=1e-16)


def frame_compliance(beams, q):
    """Return the compliance of a frame's last node from its element stiffness matrices."""
    ends = np.concatenate([np.zeros((1, 3)), beams.robot.forward(q[None]).points[0]])
    segments = np.diff(ends, axis=0)
    beam_numbers = np.flatnonzero(np.linalg.norm(segments, axis=1))  # the UR5's base has no length
    n = len(beam_numbers) + 1
    stiffness = np.zeros((6 * n, 6 * n))
    clamp = np.minimum(beams.foundation, 1e14)
    stiffness[:6, :6] += np.diag(np.repeat(clamp, 3))
    for i, number in enumerate(beam_numbers):
        segment, tube = segments[number], beams.tubes[number]
        length = np.linalg.norm(segment)
        element = element_stiffness(length, tube, beams.modulus[number])
        across = np.linalg.svd(segment[None])[2][1]
        along = segment / length
        turn = np.kron(np.eye(4), np.stack([along, across, np.cross(along, across)]))
        block = slice(6 * i, 6 * i + 12)
        stiffness[block, block] += turn.T @ element @ turn
    return np.linalg.inv(stiffness)[-6:, -6:]


def element_stiffness(length, tube, modulus):
    """Return the (12, 12) matrix of a Timoshenko beam along x (Przemieniecki 1968, eq. 5.116)."""
    bending, shear = modulus * tube.second_moment, modulus / (2.0 * (1.0 + NU))
    phi = 12 * bending / (SHEAR_COEFFICIENT * shear * tube.area * length**2)
    k = np.zeros((12, 12))
    k[np.ix_([0, 6], [0, 6])] = modulus * tube.area / length * np.array([[1, -1], [-1, 1]])
    k[np.ix_([3, 9], [3, 9])] = (
        shear * 2 * tube.second_moment / length * np.array([[1, -1], [-1, 1]])
    )
    for rows, sign in (([1, 5, 7, 11], 1.0), ([2, 4, 8, 10], -1.0)):
        side, near, far = 6 * length * sign, (4 + phi) * length**2, (2 - phi) * length**2
        k[np.ix_(rows, rows)] = (
            bending
            / (length**3 * (1 + phi))
            * np.array(
                [
                    [12, side, -12, side],
                    [side, near, -side, far],
                    [-12, -side, 12, -side],
                    [side, far, -side, near],
                ]
            )
        )
    return k
