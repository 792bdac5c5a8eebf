"""Prepare every reader of user files with valid inputs and damage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
from fuzz.mutations import Mutator, damage_bytes, damage_text

from helpers.made_results import MadeResults
from helpers.quick_models import quick_model, twin_data
from helpers.robot_programs import DOCS, ROBOTS
from helpers.run_requests import planned
from helpers.shipped_descriptors import FOLDER
from stiff_apply.programs.frames import program_poses
from stiff_apply.programs.languages import read_program
from stiff_apply.tool_task import frame_matrix
from stiff_bench.api.model import load_model
from stiff_bench.paper.study_file import read_study
from stiff_bench.plan.fits import models_under
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import Registry, build_registry
from stiff_bench.store.database import FILE, read_data, read_manifests, read_results
from stiff_datasets.measured.data_card import parse_card, read_card
from stiff_datasets.measured.descriptors import croissant, describe, json_text
from stiff_datasets.measured.query_file import read_loads
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.table_reader import sample_table, write_table
from stiff_datasets.robots.shipped_robots import named_robot
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_datasets.twin.twin_file import read_constants
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import Robot


@dataclass(frozen=True)
class PreparedReader:
    """Hold a reader and its inputs.

    Attributes:
        path: file to which an input is written.
        valid: inputs that are accepted.
        read: the reader.
        damage: function that damages valid inputs.
        also_named: other files that a refusal may name.
    """

    path: Path
    valid: tuple[bytes, ...]
    read: Callable[[Path], object]
    damage: Mutator = damage_text
    also_named: tuple[str, ...] = ()


def _samples(
    folder: Path,
    name: str,
    read: Callable[[Path, Robot], object] = read_samples,
    damage: Mutator = damage_text,
) -> PreparedReader:
    data, path = twin_data(), folder / name
    write_table(path, [sample_table(data.samples.take(range(6)), data.robot)])
    valid = path.read_bytes()
    return PreparedReader(path, (valid,), lambda path: read(path, data.robot), damage)


def _card(folder: Path) -> PreparedReader:
    """Prepare a data card and its descriptors.

    A card with other facts counts as refused.
    """
    csv = _samples(folder, "carded.csv").path
    valid = (FOLDER / "fanuc_drilling.md").read_bytes()
    facts = parse_card(valid.decode(), csv)

    def read(path: Path) -> object:
        package = describe(csv)
        descriptors = json_text(croissant(package)), json_text(package)
        if read_card(csv) != facts:
            raise DataError(f"{path}: other facts")
        return descriptors

    return PreparedReader(csv.with_suffix(".md"), (valid,), read)


def _urdf(folder: Path) -> PreparedReader:
    robots = files("stiff_datasets.robots")
    valid = tuple((robots / f"{name}.urdf").read_bytes() for name in ("kr10_r1100_2", "ur5"))
    return PreparedReader(folder / "robot.urdf", valid, read_robot)


def _twin(folder: Path) -> PreparedReader:
    twins = files("stiff_datasets") / "twins"
    valid = tuple((twins / f"{name}.toml").read_bytes() for name in ("kr10_r1100_2", "ur5"))
    return PreparedReader(folder / "twin.toml", valid, lambda path: read_constants(path).robot())


GRID = b"""[mlp]
learning_rate = {low = 1e-4, high = 1e-2, log = true}
width = [64, 128]
activation = ["relu", "tanh"]

["sklearn:ensemble.RandomForestRegressor"]
n_estimators = [10, 20]
"""


def _grid(folder: Path) -> PreparedReader:
    models = planned(models=("mlp", "sklearn:ensemble.RandomForestRegressor")).models
    nested_protocol = build_registry().protocols["nested"]

    def read(path: Path) -> object:
        return models_under(
            Choice.of(nested_protocol, {"grid": str(path), "search": "optuna"}), models
        )

    return PreparedReader(folder / "grid.toml", (GRID,), read)


def _study(folder: Path) -> PreparedReader:
    valid = (files("stiff_studies") / "intervals.toml").read_bytes()
    read = partial(_planned_study, build_registry(), folder)
    return PreparedReader(folder / "study.toml", (valid,), read)


def _planned_study(registry: Registry, folder: Path, path: Path) -> object:
    return read_study(path).plans(registry, output=folder, command="")


def _results(folder: Path) -> PreparedReader:
    results = MadeResults(folder)
    results.add_run("run-1", results.add("model", [[0.1, 0.2, 0.3, 0.4]], coverage=0.9))
    path = folder / FILE
    valid = path.read_bytes()

    def read(_: Path) -> object:
        cells = read_results(folder)
        data = [read_data(folder, result.fit.data_sha256) for result in cells]
        return cells, read_manifests(folder), data

    return PreparedReader(path, (valid,), read, damage_bytes)


def _program(folder: Path, name: str) -> PreparedReader:
    """Prepare a robot program; a program with other targets counts as refused."""
    path, valid = folder / name, (DOCS / name).read_bytes()
    path.write_bytes(valid)
    robot = named_robot(ROBOTS[name]).robot()
    n_targets = len(read_program(path))
    tool = frame_matrix((-16.0, -51.0, 71.0, 0.0, 0.0, 0.0))
    tools = {"": tool} if name.endswith(".ls") else {}

    def read(path: Path) -> object:
        program = read_program(path)
        poses = program_poses(program, robot, tools=tools, workpieces={})
        if len(program) != n_targets or not np.isfinite(program.values[:, :6]).all():
            raise DataError(f"{path}: other targets")
        return poses

    return PreparedReader(path, (valid,), read)


MODELS = ("vjm", "mlp", "sklearn:linear_model.Ridge")  # compiled trees run unchecked, as docs say


def _models(folder: Path) -> PreparedReader:
    path, loads, output = (folder / n for n in ("model.stiff", "loads.csv", "predicted.csv"))
    valid = []
    for key in MODELS:
        quick_model(key).save(path)
        valid.append(path.read_bytes())
    _samples(folder, loads.name)

    def read(path: Path) -> object:
        output.unlink(missing_ok=True)
        return load_model(path).predict_file(loads, output)

    return PreparedReader(path, tuple(valid), read, damage_bytes, (loads.name, output.name))


READERS: dict[str, Callable[[Path], PreparedReader]] = {
    "measured CSV": partial(_samples, name="samples.csv"),
    "measured Parquet": partial(_samples, name="samples.parquet", damage=damage_bytes),
    "described CSV": partial(_samples, name="described.csv", read=describe),
    "data card": _card,
    "loads CSV": partial(_samples, name="loads.csv", read=read_loads),
    "URDF": _urdf,
    "twin TOML": _twin,
    "grid TOML": _grid,
    "study TOML": _study,
    "results": _results,
    "model files": _models,
    **{name: partial(_program, name=name) for name in ROBOTS},
}
