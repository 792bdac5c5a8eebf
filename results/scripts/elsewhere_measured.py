"""Was the tool measured elsewhere, loaded elsewhere, or does its mount deflect?

`python results/scripts/elsewhere_measured.py` prints the table of the FANUC's data card (a quarter
of a minute); with the word `paths`, errors of corrected tool paths if
the robot's card is right, and if it names a TCP that is 30 mm from the measured point (minutes).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator

import numpy as np
from tabulate import tabulate

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.experiment import TwinExperiment
from stiff_datasets.twin.kr10_twin import CALIBRATIONS
from stiff_datasets.twin.robot_twin import random_poses
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import TwinConstants, shipped_constants
from stiff_models.model_catalog import model_info
from stiff_models.physics.fitted_geometry import fitted_geometry, moved_twists, moved_wrench
from stiff_models.physics.full_vjm import spring_twists
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.types import PATH_GROUP, BenchmarkData, FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import unit_deflections
from stiff_protocols.splits.path_compensation import PathCompensation
from stiff_protocols.splits.random_splits import Holdout
from stiff_protocols.springs.identification import least_compliance

SPLITS = 15
MOUNTS = {
    "rigid": (),
    "flange: 3 slides, 3 turns": (("flange", False),),
    "flange: coupled": (("flange", True),),
    "base: 3 slides, 3 turns": (("base", False),),
    "base: coupled": (("base", True),),
    "flange and base: coupled": (("flange", True), ("base", True)),
}
"""Springs beside the 18 of the joints -> where they are, and whether slides and turns couple."""
POINTS = ("given", "tcp", "force")
FALSIFIED = {
    "right": (0.0, 0.0, 0.0),
    "x +30 mm": (0.03, 0.0, 0.0),
    "y +30 mm": (0.0, 0.03, 0.0),
    "z +30 mm": (0.0, 0.0, 0.03),
    "z -30 mm": (0.0, 0.0, -0.03),
}
"""The measured and loaded point from the card's TCP, last joint's frame, m."""
PATH_MODELS = ("vjm", "vjm-full", "vjm-multisegment", "bayes-springs")


def screws_of(coupled: bool) -> FloatArray:
    """Return (k, 6) screws of springs, slides first: 3 slides and 3 turns.

    Coupled, also the sums and differences of two of them: 36 screws.
    """
    if not coupled:
        return np.eye(6)
    grid = np.stack(np.meshgrid(*[(-1, 0, 1)] * 6, indexing="ij"), axis=-1).reshape(-1, 6)
    two = grid[(np.abs(grid).sum(axis=1) > 0) & (np.abs(grid).sum(axis=1) <= 2)]
    first = two[np.arange(len(two)), (two != 0).argmax(axis=1)]
    return np.asarray(two[first > 0], dtype=np.float64)


SCREW_LENGTH = 0.3
"""m of a slide that counts as 1 rad of a turn."""


def mount_twists(robot: Robot, q: FloatArray, place: str, coupled: bool) -> FloatArray:
    """Return (n, 6, k) twists of the TCP by unit motions of a mount's springs."""
    poses = robot.forward(q)
    if place == "base":
        frame, origin = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    else:
        frame = poses.rotation @ robot.flange[:3, :3]
        origin = poses.points[:, -2] + poses.rotation @ robot.flange[:3, 3]
    screws = screws_of(coupled)
    slide = np.einsum("nab,kb->nak", frame, SCREW_LENGTH * screws[:, :3])
    turn = np.einsum("nab,kb->nak", frame, screws[:, 3:])
    lever = poses.points[:, -1] - origin
    move = slide + np.cross(turn, lever[:, :, None], axis=1)
    return np.concatenate([move, turn], axis=1)


def mounts() -> Iterator[list[str]]:
    """Yield a line a mount: mean 3-D error with each point, and where it is fitted."""
    data = FanucR2000iC().load()
    robot, samples = data.robot, data.samples
    splits = Holdout().splits(samples, n_splits=SPLITS, seed=0)
    for name, mount in MOUNTS.items():

        def twists(
            loaded_samples: Samples, mount: tuple[tuple[str, bool], ...] = mount
        ) -> FloatArray:
            joint_twists = spring_twists(robot, loaded_samples.q, 3)
            other_twists = [mount_twists(robot, loaded_samples.q, *springs) for springs in mount]
            return np.concatenate([joint_twists, *other_twists], axis=2)

        line = [name]
        for point in POINTS:
            errors = []
            for split in splits:
                rows = np.sort(np.concatenate([split.train, split.validation]))
                train, test = samples.take(rows), samples.take(split.test)
                offset = np.zeros(3)
                if point != "given":
                    geometry = fitted_geometry(
                        train,
                        robot,
                        twists(train),
                        unit_deflections,
                        moves="tcp" if point == "tcp" else "force",
                    )
                    offset = geometry.point - geometry.given

                def regressor(
                    loaded_samples: Samples, point: str = point, offset: FloatArray = offset
                ) -> FloatArray:
                    lever = robot.forward(loaded_samples.q).rotation @ offset
                    moved, wrench = twists(loaded_samples), loaded_samples.wrench
                    if point == "tcp":
                        moved = moved_twists(moved, lever)
                    else:
                        wrench = moved_wrench(wrench, lever)
                    return unit_deflections(moved, wrench)

                matrix = regressor(train)
                compliance = least_compliance(
                    matrix.reshape(-1, matrix.shape[2]), train.deflection.reshape(-1)
                )
                residual = regressor(test) @ compliance - test.deflection
                errors.append(1e3 * np.linalg.norm(residual, axis=1).mean())
            line.append(f"{np.mean(errors):.3f}")
        yield line


def falsified(constants: TwinConstants, poses: Poses, offset: FloatArray) -> BenchmarkData:
    """Return a twin measured and loaded at a point `offset` [m] from the TCP of its card.

    The tool that paths are for is at the card's TCP, and so are its loads.
    """
    tool = DigitalTwin.in_world(constants, 0, "clean")
    x, y, z = constants.tcp_m + tool.description.flange[:3, :3].T @ offset
    elsewhere = constants.model_copy(update={"tcp_m": (x, y, z)})
    samples = TwinExperiment(elsewhere, specimen=0, seed=0).samples(poses)
    measured = BenchmarkData(samples, tool.description, under_load=tool.truth)
    return PathCompensation().prepared(measured)


def paths() -> Iterator[list[str]]:
    """Yield a line a twin and card: mean path error of each model, given and fitted."""
    kr10, ur5 = CALIBRATIONS[1], shipped_constants("ur5")
    twins = {
        "ur5": (ur5, random_poses(ur5, 151, 0)),
        "kr10, loads of all directions": (kr10.constants(), kr10.poses()),
    }
    protocol = PathCompensation()
    for name, (constants, poses) in twins.items():
        for card, offset in FALSIFIED.items():
            data = falsified(constants, poses, np.array(offset))
            is_path = data.samples.group == PATH_GROUP
            rows, train = np.flatnonzero(is_path), data.samples.take(np.flatnonzero(~is_path))
            points = data.samples.take(rows)
            line = [name, card]
            for key in PATH_MODELS:
                for tcp in ("given", "fit"):
                    model = model_info(key).load()(tcp=tcp).fit(train, robot=data.robot)
                    predictions = [model.predict_at_tcp]
                    predictions += [model.predict] if tcp == "fit" else []
                    error_texts = []
                    for predict in predictions:
                        q = protocol.commanded(predict, data.robot, points.q, points.wrench)
                        residual = points.deflection - protocol.scored(q, q, data, rows)
                        error_texts.append(f"{1e3 * np.linalg.norm(residual, axis=1).mean():.3f}")
                    line.append(" / ".join(error_texts))
            yield line


if __name__ == "__main__":
    warnings.simplefilter("ignore", StiffBenchWarning)
    if sys.argv[1:] == ["paths"]:
        headers = [
            f"{key} {tcp}" for key in PATH_MODELS for tcp in ("given", "fitted / not carried")
        ]
        print(
            tabulate(paths(), ["twin", "card", *headers], tablefmt="github", disable_numparse=True)
        )
    else:
        names = ["mount", "given", "TCP fitted", "force's point fitted"]
        print(tabulate(mounts(), names, tablefmt="github", disable_numparse=True))
