"""A data set as it would be if an experimenter had been off by a little: TCP, forces, registration.

A mistake of a measurement is in all of its samples, whichever a model learns from or is tested on.
Each function draws one data set from a random generator and changes what the experimenter has
wrong, and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stiff_protocols.contract.types import BenchmarkData, FloatArray

Draw = Callable[[BenchmarkData, np.random.Generator], BenchmarkData]
"""Data set, random numbers -> the data set with one draw of a mistake."""


@dataclass(frozen=True)
class Perturbations:
    """How large the mistakes of a measurement are; 0: there is none.

    Attributes:
        tcp_m: distance of the TCP from where the robot description has it, m.
        force: standard deviation of each component of a force, as a share of the force's norm;
            likewise of a torque.
        turn_rad: angle between the measuring device's frame and the robot's base frame, rad.
        shift_m: length of what is added to every deflection, m.
    """

    tcp_m: float = 0.0
    force: float = 0.0
    turn_rad: float = 0.0
    shift_m: float = 0.0

    def mistakes(self) -> dict[str, Draw]:
        """Return what each mistake is, with its size, -> how it is drawn; none of size 0."""
        turn_deg = math.degrees(self.turn_rad)
        sizes_and_draws = {
            f"TCP off by {1e3 * self.tcp_m:g} mm": (self.tcp_m, self.moved_tcp),
            f"force noise of {100.0 * self.force:g} %": (self.force, self.noisy_wrench),
            f"registration turned by {turn_deg:g} deg": (self.turn_rad, self.turned_deflection),
            f"deflections shifted by {1e3 * self.shift_m:g} mm": (
                self.shift_m,
                self.shifted_deflection,
            ),
        }
        return {name: draw for name, (size, draw) in sizes_and_draws.items() if size > 0.0}

    def moved_tcp(self, data: BenchmarkData, rng: np.random.Generator) -> BenchmarkData:
        """Return the samples with a robot whose TCP is elsewhere on its flange.

        The file's numbers stay: the wrench is taken to act at the TCP that is wrong, and the
        deflection to be of it.
        """
        tcp = data.robot.tcp + self.tcp_m * direction(rng)
        return BenchmarkData(data.samples, replace(data.robot, tcp=tcp))

    def noisy_wrench(self, data: BenchmarkData, rng: np.random.Generator) -> BenchmarkData:
        """Return the samples with Gaussian noise on the wrenches, another in each sample."""
        wrench = data.samples.wrench.reshape(-1, 2, 3)
        norms = np.linalg.norm(wrench, axis=2, keepdims=True)  # (n, 2, 1) N, N m
        noisy = wrench + self.force * norms * rng.standard_normal(wrench.shape)
        samples = replace(data.samples, wrench=noisy.reshape(-1, 6))
        return BenchmarkData(samples, data.robot)

    def turned_deflection(self, data: BenchmarkData, rng: np.random.Generator) -> BenchmarkData:
        """Return the deflections in a frame that is turned about a random axis."""
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_rotvec(self.turn_rad * direction(rng)).as_matrix()
        samples = replace(data.samples, deflection=data.samples.deflection @ turn.T)
        return BenchmarkData(samples, data.robot)

    def shifted_deflection(self, data: BenchmarkData, rng: np.random.Generator) -> BenchmarkData:
        """Return the deflections with a constant in a random direction added.

        As where the device's frame moved between the unloaded and the loaded readings. What is off
        in both cancels.
        """
        deflection = data.samples.deflection + self.shift_m * direction(rng)
        return BenchmarkData(replace(data.samples, deflection=deflection), data.robot)


def direction(rng: np.random.Generator) -> FloatArray:
    """Return a (3,) unit vector of random direction."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))
