"""Model bending links: Timoshenko beams between the joints, on an elastic base.

Each segment from one joint to the next is a straight round tube, clamped at its start. The chain
is statically determinate, so every segment carries the load at the TCP. The TCP's displacement is
the sum of the segments' contributions. This is matrix structural analysis in compliance form (J. S.
Przemieniecki, Theory of Matrix Structural Analysis, 1968, chapter 5) with the undeformed geometry.

SI: N, N m, m, rad, Pa.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from pydantic import Field, model_validator

from stiff_datasets.twin.spring_law import TomlTable
from stiff_protocols.contract.types import FloatArray, Robot

SHEAR_COEFFICIENT = 0.5
"""Coefficient of a round tube with a thin wall (G. R. Cowper, J. Appl. Mech. 33, 1966)."""

Diameter = Annotated[float, Ge(1e-3), Le(2.0), Field(allow_inf_nan=False)]  # m; mm would be larger


class Tube(TomlTable):
    """The section of a segment.

    Attributes:
        outer_m: diameter.
        wall_m: thickness.
    """

    outer_m: Diameter
    wall_m: Diameter

    @model_validator(mode="after")
    def _hollow(self) -> Tube:
        if 2.0 * self.wall_m > self.outer_m:
            raise ValueError(
                f"wall_m {self.wall_m:g} is more than half of outer_m {self.outer_m:g}"
            )
        return self

    @property
    def area(self) -> float:
        """Area of the section, m2."""
        return np.pi / 4.0 * (self.outer_m**2 - (self.outer_m - 2.0 * self.wall_m) ** 2)

    @property
    def second_moment(self) -> float:
        """Second moment about a diameter, m4; the polar moment is twice as large."""
        return np.pi / 64.0 * (self.outer_m**4 - (self.outer_m - 2.0 * self.wall_m) ** 4)


@dataclass(frozen=True)
class Beams:
    """The elastic structure of a robot.

    Attributes:
        robot: its geometry.
        tubes: n_joints + 1 sections, one per segment: from the base to the first joint, from joint
            to joint, from the last joint to the TCP. A segment without length is rigid.
        modulus: (n_segments,) Young's modulus, Pa.
        poisson: Poisson's ratio of the material.
        foundation: stiffness of the base's foundation, N/m and N m/rad in every direction.
    """

    robot: Robot
    tubes: tuple[Tube, ...]
    modulus: FloatArray
    poisson: float
    foundation: tuple[float, float] = (np.inf, np.inf)

    def displacement(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the TCP's displacement by the links, with locked joints.

        Args:
            q: (n, n_joints) joint angles, rad.
            wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.

        Returns:
            (n, 6) displacement [m], then rotation [rad], base frame.
        """
        points = self.robot.forward(q).points  # (n, n_joints + 1, 3)
        ends = np.concatenate([np.zeros((len(points), 1, 3)), points], axis=1)
        force, moment_at_tcp, tcp = wrench[:, :3], wrench[:, 3:], points[:, -1]
        per_newton, per_newton_metre = 1.0 / np.array(self.foundation)
        rotation = per_newton_metre * (moment_at_tcp + np.cross(tcp, force))
        shift = per_newton * force + np.cross(rotation, tcp)
        for i in range(len(self.tubes)):
            lever = tcp - ends[:, i + 1]
            moment = moment_at_tcp + np.cross(lever, force)
            tip_shift, tip_rotation = self._tip(i, ends[:, i + 1] - ends[:, i], force, moment)
            shift = shift + tip_shift + np.cross(tip_rotation, lever)
            rotation = rotation + tip_rotation
        return np.hstack([shift, rotation])

    def _tip(
        self, number: int, segment: FloatArray, force: FloatArray, moment: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) displacement [m] and rotation [rad] of a cantilever's end."""
        length = np.linalg.norm(segment, axis=1, keepdims=True)
        direction = segment / np.where(length > 0.0, length, 1.0)
        area, second_moment = self.tubes[number].area, self.tubes[number].second_moment
        modulus = self.modulus[number]
        shear_modulus = modulus / (2.0 * (1.0 + self.poisson))
        axial_force, axial_moment = (
            direction * np.einsum("na,na->n", direction, load)[:, None] for load in (force, moment)
        )
        bending = modulus * second_moment
        shear = SHEAR_COEFFICIENT * shear_modulus * area
        displacement = (
            length / (modulus * area) * axial_force
            + (length**3 / (3.0 * bending) + length / shear) * (force - axial_force)
            + length**2 / (2.0 * bending) * np.cross(moment, direction)
        )
        rotation = (
            length / (2.0 * shear_modulus * second_moment) * axial_moment
            + length / bending * (moment - axial_moment)
            + length**2 / (2.0 * bending) * np.cross(direction, force)
        )
        return displacement, rotation
