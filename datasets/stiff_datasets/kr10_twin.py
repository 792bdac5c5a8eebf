"""`kr10-twin`: 151 poses of a SIMULATED KUKA KR10 R1100-2, one load a pose.

Nothing here was measured. Every constant of the simulation stands in this file with its source
or the word "assumption". Catalogue means the strain-wave gear figures of the manufacturer,
recalled from memory except for size 32's slopes, and so an assumption too.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge

from stiff_datasets.poses import cartesian_poses, joint_space_poses
from stiff_datasets.robots.robot import shipped_chain, shipped_robot
from stiff_datasets.twin import DigitalTwin, GearSize, JointSprings
from stiff_protocols.types import BenchmarkData, FloatArray, Samples

TCP = (0.06, 0.0, 0.08)
"""m, flange frame; assumption: 80 mm in front of the flange and 60 mm off its axis, because with
the TCP on the axis of A6 that joint could not be identified from translations."""

HOOK = (0.06, 0.04, 0.07)
"""m, from the TCP, frame of the last joint; assumption: a lever of 0.1 m turns 100 N into the
10 N m that the source paper's Table 5 has."""

GEARS = {  # catalogue; rated torques: assumption
    14: GearSize((0.47e4, 0.61e4, 0.71e4), (2.0, 6.9), 7.8),
    17: GearSize((1.0e4, 1.4e4, 1.6e4), (3.9, 12.0), 24.0),
    20: GearSize((1.6e4, 2.5e4, 2.9e4), (7.0, 25.0), 40.0),
    25: GearSize((3.1e4, 5.0e4, 5.7e4), (14.0, 48.0), 67.0),
    32: GearSize((6.7e4, 11.0e4, 12.0e4), (29.0, 108.0), 137.0),
}


TILTING_RATIO = 8.0
"""Tilting stiffness against the gear's K2; assumption: the stiff end of the 1 to 8 times that
published identifications give (a softer bearing behind A4 would soften the identified A3)."""

LOST_MOTION = 1.0 * np.pi / 180.0 / 60.0
"""rad, full width: about 1 arcmin; assumption."""


def _joint(gear_size: int, structure: float) -> JointSprings:
    gear = GEARS[gear_size]
    tilting = TILTING_RATIO * gear.slopes[1]
    return JointSprings(gear, structure, (tilting, tilting), LOST_MOTION)


# Gear sizes: the paper's identified k1..k3 (5.0..6.3e4 N m/rad) fit sizes 25 to 32; the wrist's
# sizes are an assumption. Structure in series [N m/rad]: assumption, chosen by hand so that the
# linear VJM identifies stiffnesses of the order of the paper's Table 3; k4 and k6 there are softer
# than the smallest gear, so they hold other compliance.
SPRINGS = (
    _joint(32, 1.0e6),  # A1
    _joint(32, 1.6e5),  # A2
    _joint(32, 1.0e6),  # A3
    _joint(20, 3.2e3),  # A4
    _joint(17, 3.0e4),  # A5
    _joint(14, 1.4e3),  # A6
)

FORCE_LINE = np.array([[100.0, 40.0, -20.0], [20.0, 5.0, -100.0]])
"""N: first and last force of the paper's Table 5; the loads lie along the line between them."""
FORCE_SCATTER = 5.0  # N a component, standard deviation; assumption
LARGEST_FORCE = 10.0 * 9.81  # N; the robot's payload of 10 kg

# Noise, as standard deviations. Tracker: repeatability of 0.01 mm, once for the loaded and once
# for the unloaded reading. Force sensor: the 0.04 N and 0.002 N m of its data sheet.
TRACKER_NOISE = 1e-5  # m a reading and axis
FORCE_NOISE = 0.04  # N
TORQUE_NOISE = 0.002  # N m

# What a log would hold; coarser than rounding errors, so that machines agree on the data's hash.
_DECIMALS_DEG, _DECIMALS_N, _DECIMALS_NM, _DECIMALS_MM = 4, 3, 5, 5


class Kr10Twin:
    """The 151 planned poses on the digital twin.

    Attributes:
        seed: draws the loads and the noise; the robot itself does not depend on it.
    """

    def __init__(self, *, seed: Annotated[int, Ge(0)] = 0) -> None:
        """Store the seed."""
        self.seed = seed

    def load(self) -> BenchmarkData:
        """Simulate the measurement (about a second)."""
        chain = shipped_chain("kr10_r1100_2", tcp=TCP)
        joint_space, cartesian = joint_space_poses(), cartesian_poses(chain)
        poses = np.concatenate([joint_space, cartesian])
        q = np.deg2rad(np.rad2deg(poses).round(_DECIMALS_DEG))
        loads, noise = (np.random.default_rng([self.seed, stream]) for stream in (1, 2))
        force = draw_forces(len(q), loads)
        twin = DigitalTwin(chain, SPRINGS)
        wrench = np.hstack([force, hook_torques(twin, q, force)])
        deflection = np.stack([twin.reading(*sample) for sample in zip(q, wrench, strict=True)])
        return BenchmarkData(
            samples=Samples(
                q=q,
                wrench=_recorded_wrench(wrench, noise),
                deflection=_recorded_deflection(deflection, noise),
                pose_id=np.array(
                    [f"J{i + 1:02d}" for i in range(len(joint_space))]
                    + [f"C{i + 1:02d}" for i in range(len(cartesian))]
                ),
                load_id=np.full(len(q), "1"),
                group=np.repeat(["joint-space", "cartesian"], [len(joint_space), len(cartesian)]),
            ),
            robot=shipped_robot("kr10_r1100_2", tcp=TCP),
        )


def draw_forces(n: int, rng: np.random.Generator) -> FloatArray:
    """Return (n, 3) forces [N] along the line of Table 5 with scatter, within the payload."""
    share = rng.uniform(size=(n, 1))
    force = (1.0 - share) * FORCE_LINE[0] + share * FORCE_LINE[1]
    force += rng.normal(scale=FORCE_SCATTER, size=(n, 3))
    size = np.linalg.norm(force, axis=1, keepdims=True)
    return np.asarray(force * np.minimum(1.0, LARGEST_FORCE / size))


def hook_torques(twin: DigitalTwin, q: FloatArray, force: FloatArray) -> FloatArray:
    """Return (n, 3) torques at the TCP [N m], base frame, of forces that pull at the hook."""
    levers = np.stack([twin.tool_rotation(pose) @ np.array(HOOK) for pose in q])
    return np.cross(levers, force)


def _recorded_wrench(wrench: FloatArray, rng: np.random.Generator) -> FloatArray:
    noisy = wrench + rng.normal(size=wrench.shape) * np.repeat([FORCE_NOISE, TORQUE_NOISE], 3)
    return np.hstack([noisy[:, :3].round(_DECIMALS_N), noisy[:, 3:].round(_DECIMALS_NM)])


def _recorded_deflection(deflection: FloatArray, rng: np.random.Generator) -> FloatArray:
    readings = rng.normal(scale=TRACKER_NOISE, size=(2, *deflection.shape))
    measured_mm = (deflection + readings[0] - readings[1]) * 1000.0
    return np.asarray(measured_mm.round(_DECIMALS_MM) / 1000.0)
