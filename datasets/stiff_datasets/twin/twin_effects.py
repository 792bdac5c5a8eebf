"""Define four effects of real measurements that the default twin does not have.

``hysteresis``
    Lost motion has a memory. The robot is measured unloaded, then loaded, and unloaded again
    before the next load, so the order of a pose's loads does not matter. Each joint is at a
    turning point before the load (Masing's rule, see `spring_law.py`; assumption).
``links``
    Base, links and tool bend (`beams.py`; sections in the twin's file). With `physics=rigid` they
    always bend.
``kinematics``
    Robot, TCP and masses deviate from the description that models get, and the tracker's frame
    deviates from the robot's base.
``sensor``
    The force sensor's frame is turned and its gain is wrong, and the tracker has heavy tails.

The twin's `Errors` give the sizes of the last two; the specimen determines their directions.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from stiff_datasets.planning.loads import stream
from stiff_datasets.twin.constants import Errors, Noise, TwinConstants
from stiff_datasets.twin.effects import direction
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.types import FloatArray, Robot

HYSTERESIS, LINKS, KINEMATICS, SENSOR = "hysteresis", "links", "kinematics", "sensor"
EFFECTS = (HYSTERESIS, LINKS, KINEMATICS, SENSOR)
ALL_EFFECTS, NO_EFFECTS = ",".join(EFFECTS), "none"


def parse_effects(text: str) -> tuple[str, ...]:
    """Return the effects in a text, separated by commas; "none": no effect.

    Raises:
        ConfigError: the text names an unknown effect.
    """
    words = [word.strip() for word in text.split(",")]
    if words == [NO_EFFECTS]:
        return ()
    for word in words:
        if word not in EFFECTS:
            raise unknown_name("effect", word, (*EFFECTS, NO_EFFECTS))
    if len(set(words)) < len(words):
        raise ConfigError(f"effects {text!r}: name each of them once")
    return tuple(name for name in EFFECTS if name in words)


def real_robot(robot: Robot, errors: Errors, rng: np.random.Generator) -> Robot:
    """Return the real robot, which deviates from its description `robot`."""
    placements, masses = robot.placements.copy(), robot.masses.copy()
    for joint in range(robot.n_joints):
        turn, shift = errors.turn_rad * direction(rng), errors.place_m * direction(rng)
        error_placement = pin.SE3(pin.exp3(turn), shift)
        placements[joint] = (pin.SE3(placements[joint]) * error_placement).homogeneous
        masses[joint] *= 1.0 + errors.mass * rng.choice([-1.0, 1.0])
    tcp = robot.tcp + errors.tcp_m * direction(rng)
    return replace(robot, placements=placements, masses=masses, tcp=tcp)


@dataclass(frozen=True, eq=False)
class Instruments:
    """A tracker and a force sensor, with their systematic errors.

    Attributes:
        noise: noise of their readings.
        force_gain: (2,) gain of force and torque; 1: exact.
        force_frame: (3, 3) turns a true force or torque into the sensor's frame.
        tracker_frame: (3, 3) turns a true displacement into the tracker's frame.
    """

    noise: Noise
    force_gain: FloatArray
    force_frame: FloatArray
    tracker_frame: FloatArray

    @classmethod
    def of(cls, constants: TwinConstants, specimen: int, effects: Collection[str]) -> Instruments:
        """Return the instruments of a specimen."""
        rng, errors = stream("instruments", constants.name, specimen), constants.errors
        noise, registration, misalignment = constants.noise, direction(rng), direction(rng)
        gain = 1.0 + errors.force_gain * rng.choice([-1.0, 1.0], size=2)
        if SENSOR in effects:
            noise = noise.model_copy(update={"tracker_m": errors.tracker_m, "tail": errors.tail})
        return cls(
            noise,
            gain if SENSOR in effects else np.ones(2),
            pin.exp3(errors.force_frame_rad * misalignment * (SENSOR in effects)),
            pin.exp3(errors.registration_rad * registration * (KINEMATICS in effects)),
        )

    def sensor_wrench(self, wrench: FloatArray) -> FloatArray:
        """Return the sensor's reading of (n, 6) `wrench`, without noise."""
        parts = wrench.reshape(-1, 2, 3) @ self.force_frame.T
        return np.asarray((parts * self.force_gain[:, None]).reshape(-1, 6))

    def true_wrench(self, sensor_wrench: FloatArray) -> FloatArray:
        """Return the true (n, 6) wrench of the sensor's reading `sensor_wrench`."""
        parts = sensor_wrench.reshape(-1, 2, 3) / self.force_gain[:, None]
        return np.asarray((parts @ self.force_frame).reshape(-1, 6))

    def tracker_deflection(self, deflection: FloatArray) -> FloatArray:
        """Return the tracker's reading of (n, 3) `deflection`, without noise."""
        return np.asarray(deflection @ self.tracker_frame.T)
