"""Draw robots that no model has met: kinematics, masses, gears, bearings and links from a seed.

Proportions, masses and sizes are near the ten arms of `arm-family`: assumptions. Gears
are chosen like theirs, by the joints' largest static torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_datasets.planning.loads import stream
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.effects import World, direction
from stiff_datasets.twin.elastic_chain import ElasticChain
from stiff_datasets.twin.gears import CATALOGUE, CYCLOIDAL, STRAIN_WAVE, GearKind
from stiff_datasets.twin.robot_twin import HEAVIEST, HookTwin
from stiff_datasets.twin.twin_file import BeamsTable, JointTable, Tube, TwinConstants
from stiff_protocols.contract.robot import STANDARD_GRAVITY
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot

FRESH_ARM = "fresh-arm-"
"""Begin of the names of these arms; the seed follows."""
PAYLOADS_KG = (3.0, 300.0)
REACH_M, LONGEST_REACH_M, REACH_SCATTER = 0.36, 2.6, 0.15
"""Reach to the wrist over the root of the payload in kg, its limit, and its scatter."""
MASS_KG, MASS_SCATTER = 50.0, 0.2
"""Moving mass over the reach [m] to the power 2.5, and its scatter."""
LINK_MASSES = (0.42, 0.23, 0.18, 0.1, 0.05, 0.02)  # shares
LIMITS_DEG = (
    *((160.0, 180.0, 160.0, 180.0), (60.0, 95.0, 110.0, 155.0), (120.0, 160.0, 70.0, 90.0)),
    *((180.0, 200.0, 180.0, 200.0), (110.0, 135.0, 110.0, 135.0), (270.0, 400.0, 270.0, 400.0)),
)
"""Ranges of each joint's lower and upper limit, without signs."""
OFFSET_SHARE = 0.2
"""Share of arms whose wrist axes do not meet, and of arms whose shoulder stands to the side."""
STRUCTURE, LARGE_TILTING = 4.0, ((10.0, 3.0), (50.0, 4.0), (np.inf, 5.0))
"""Structure over the gear's middle slope; payload up to which a tilting ratio is usual."""
TUBES, WALLS = (0.22, 0.2, 0.14, 0.12, 0.1, 0.08, 0.06), (0.06, 0.045)
"""Height of the tubes over the reach; wall over height of arms below and above `HEAVY_KG`."""
ALUMINIUM, CAST_IRON, HEAVY_KG = (7.0e10, 0.33), (1.1e11, 0.26), 50.0
CYCLOIDAL_KG, CYCLOIDAL_WRIST_KG = 10.0, 50.0
"""Payloads from which the first three joints, and all, have cycloidal gears."""
MIDDLE_SLOPE = 0.9  # of a cycloidal gear's rigidity
CLEARANCE = 0.18  # of the reach
TORQUE_POSES = 100


def fresh_arm(seed: int) -> TwinConstants:
    """Draw a robot; the seed determines it."""
    rng = stream("fresh arm", seed)
    payload = float(np.exp(rng.uniform(*np.log(PAYLOADS_KG))))
    reach = min(REACH_M * np.sqrt(payload), LONGEST_REACH_M)
    reach *= float(np.exp(REACH_SCATTER * rng.normal()))
    robot = _robot(seed, payload, reach, rng)
    hook = np.cbrt(payload) * rng.uniform(0.03, 0.06) * direction(rng)
    joints = []
    for torque, is_wrist in zip(
        _static_torques(robot, payload, hook, rng), [False] * 3 + [True] * 3, strict=True
    ):
        least = CYCLOIDAL_WRIST_KG if is_wrist else CYCLOIDAL_KG
        kind = CYCLOIDAL if payload >= least else STRAIN_WAVE
        joints.append(_joint(kind, torque, payload, rng))
    is_heavy = payload >= HEAVY_KG
    modulus, poisson = CAST_IRON if is_heavy else ALUMINIUM
    heights = reach * np.array(TUBES) * np.exp(0.1 * rng.normal(size=len(TUBES)))
    tubes = tuple(Tube(outer_m=height, wall_m=WALLS[is_heavy] * height) for height in heights)
    return TwinConstants.of_robot(
        robot,
        payload_kg=payload,
        hook_m=tuple(hook.tolist()),
        clearance_m=CLEARANCE * reach,
        joint=tuple(joints),
        beams=BeamsTable(modulus_Pa=modulus, poisson=poisson, segment=tubes),
    )


def _robot(seed: int, payload: float, reach: float, rng: np.random.Generator) -> Robot:
    """Return the rigid robot: at zero its upper arm stands and its forearm points along x."""
    shoulder, upper_arm = reach * rng.uniform(0.0, 0.15), rng.uniform(0.4, 0.55)
    stretched = reach - shoulder
    side = reach * rng.uniform(0.0, 0.1) * (rng.random() < OFFSET_SHARE)
    forearm = (1.0 - upper_arm) * stretched
    before_wrist = forearm * rng.uniform(0.3, 0.7)
    wrist_offset = reach * rng.uniform(0.02, 0.05) * (rng.random() < OFFSET_SHARE)
    offsets = np.array(
        [
            [0.0, 0.0, reach * rng.uniform(0.22, 0.4)],
            [shoulder, side, 0.0],
            [0.0, 0.0, upper_arm * stretched],
            [before_wrist, 0.0, reach * rng.uniform(-0.02, 0.08)],
            [forearm - before_wrist, 0.0, 0.0],
            [reach * rng.uniform(0.04, 0.09), 0.0, -wrist_offset],
        ]
    )
    flange_length = reach * rng.uniform(0.01, 0.03)
    signs = np.r_[1.0, 1.0, rng.choice([-1.0, 1.0], 4)]
    axes = signs[:, None] * np.eye(3)[[2, 1, 1, 0, 1, 0]]
    low, high = np.deg2rad([(rng.uniform(a, b), rng.uniform(c, d)) for a, b, c, d in LIMITS_DEG]).T
    masses = np.array(LINK_MASSES) * np.exp(0.15 * rng.normal(size=6))
    masses *= MASS_KG * reach**2.5 * np.exp(MASS_SCATTER * rng.normal()) / masses.sum()
    ends = np.vstack([offsets[1:], [flange_length, 0.0, 0.0]])
    placements = np.tile(np.eye(4), (6, 1, 1))
    placements[:, :3, 3] = offsets
    flange = np.eye(4)  # its z axis points out of the arm
    flange[:3, :3] = np.eye(3)[:, [1, 2, 0]]
    flange[:3, 3] = flange_length, 0.0, 0.0
    tool = np.cbrt(payload) * np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.02, 0.08)])
    return Robot(
        name=f"{FRESH_ARM}{seed}",
        joint_names=tuple(f"J{i}" for i in range(1, 7)),
        joint_types=("revolute",) * 6,
        placements=placements,
        axes=axes,
        lower=np.where(signs > 0.0, -low, -high),
        upper=np.where(signs > 0.0, high, low),
        masses=masses,
        centres_of_mass=ends * rng.uniform(0.3, 0.6, (6, 1)),
        tcp=flange[:3, :3] @ tool + flange[:3, 3],
        flange=flange,
    )


def _static_torques(
    robot: Robot, payload: float, hook: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return (6,) largest torques [N m] by the weights and the payload in any direction."""
    q = reachable_poses(robot, TORQUE_POSES, rng, 0.0)
    still, none = np.zeros((18, len(q))), np.zeros((6, len(q)))
    weight = np.abs(ElasticChain(robot).statics(q.T, still, none)[0][::3])
    poses = robot.forward(q)
    axes = np.einsum("njab,jb->nja", poses.rotations, robot.axes)
    lever = (poses.points[:, -1] + poses.rotation @ hook)[:, None] - poses.points[:, :-1]
    arm = np.linalg.norm(np.cross(axes, lever), axis=2).T
    return np.asarray((weight + payload * STANDARD_GRAVITY * arm).max(axis=1))


def _joint(kind: GearKind, torque: float, payload: float, rng: np.random.Generator) -> JointTable:
    """Return a joint with the gear of that kind whose rated torque is nearest."""
    gears = {name: gear for name, gear in CATALOGUE.items() if gear.kind == kind}
    name = min(gears, key=lambda name: abs(np.log(gears[name].rated_Nm / torque)))
    slope = gears[name].slopes_Nm_per_rad[1] * (MIDDLE_SLOPE if kind == CYCLOIDAL else 1.0)
    usual = next(ratio for limit, ratio in LARGE_TILTING if payload < limit)
    stiff, tilted = np.exp(0.3 * rng.normal(size=2))
    return JointTable(
        gear=name,
        structure_Nm_per_rad=STRUCTURE * stiff * slope,
        tilting_ratio=float(np.clip(usual * tilted, 1.0, 8.0)),
    )


@dataclass(kw_only=True, eq=False)
class FreshArms(HookTwin):
    """The twin of an arm that the seed draws, pulled with up to 80 % of its payload.

    Attributes:
        seed: draws the arm, too.
    """

    world: World = "all"

    def load(self) -> BenchmarkData:
        """Simulate the measurement."""
        return self.planned(fresh_arm(self.seed), HEAVIEST)
