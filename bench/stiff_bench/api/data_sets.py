"""Load data sets: shipped ones, files, arrays and DataFrames."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.api.robots import as_robot
from stiff_bench.parameter_types import Folder, Point
from stiff_bench.plan.fits import loaded
from stiff_bench.plan.options import (
    Choice,
    chosen,
    held_data,
    measured_file,
    parse_option,
)
from stiff_bench.plan.registry import Kind, registry
from stiff_bench.tables.units import counted
from stiff_bench.tables.writers import Text
from stiff_datasets.measured.drilled_holes import drilled_holes as drilled_holes
from stiff_datasets.measured.file_options import POSE_TOLERANCE, FileOptions
from stiff_protocols.contract.display import Screen, ShownObject
from stiff_protocols.contract.errors import ConfigError, DataError, warn
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import (
    SHOWN_ROWS,
    BenchmarkData,
    FloatArray,
    Robot,
    Samples,
)

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.figures.prepared_figure import Prepared


def choice_of(kind: Kind, word: str, options: Mapping[str, Any]) -> Choice[Any]:
    """Return the choice for a command line word, with more options."""
    choice = chosen({kind: (word,)}, (), registry())[kind][0]
    parsed = {
        name: parse_option(f"{name}={value!r}", choice.info.key, choice.cls, name, value)
        for name, value in options.items()
    }
    return replace(choice, params={**choice.params, **parsed})


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(ShownObject):
    """Samples with their robot and a name for tables.

    Attributes:
        choice: source of the data with its options.
    """

    choice: Choice[DatasetInfo]

    def __post_init__(self) -> None:
        """Raise ConfigError for a file, a table or arrays."""
        if not isinstance(self.choice, Choice):
            raise _no_dataset(self.choice)

    @classmethod
    def of_file(cls, file: Path | str, robot: str | Robot | None, options: FileOptions) -> Dataset:
        """Return the data set of a file, which is read at its first use; see `read_samples`."""
        if robot is None:
            raise ConfigError(f"{file}: name the measured robot: --urdf FILE.urdf or --robot NAME")
        return cls(measured_file(path_of(file), as_robot(robot), options))

    @classmethod
    def from_samples(
        cls,
        samples: Samples,
        robot: str | Robot,
        *,
        name: str = "own-data",
        pose_tolerance: float = POSE_TOLERANCE,
    ) -> Dataset:
        """Return a data set of arrays (SI units, see `Samples`).

        A `StiffBenchWarning` names poses of different `pose_id` whose joint positions differ by at
        most `pose_tolerance` (deg, and mm of prismatic joints): a split may separate them.

        Raises:
            ConfigError: the robot's name is unknown.
            DataError: samples and robot have different numbers of joints, or joint angles are in
                degrees. Rows count from 0.
        """
        from stiff_datasets.measured.sample_file import doubts_of_samples

        robot = as_robot(robot)
        dataset = cls(held_data(BenchmarkData(samples, robot), name))
        if in_degrees := degrees_text(samples.q, robot):
            raise DataError(f"{name}: {in_degrees}")
        for doubt in doubts_of_samples(samples, robot, pose_tolerance):
            warn(f"{name}: {doubt}")
        return dataset

    @classmethod
    def from_frame(
        cls,
        frame: DataFrame,
        robot: str | Robot,
        *,
        name: str = "own-data",
        no_torque: bool = False,
        pose_tolerance: float = POSE_TOLERANCE,
        register: bool = False,
        hook: Point | None = None,
    ) -> Dataset:
        """Return a data set of a table with the columns of a file (deg, N, N m, mm).

        Args:
            frame: table of samples.
            robot: measured robot: a shipped name or a `Robot`.
            name: name of the data set in tables.
            no_torque: see `read_samples`.
            pose_tolerance: see `read_samples`.
            register: see `read_samples`.
            hook: see `read_samples`.

        Raises:
            ConfigError: `frame` is not a DataFrame, or the robot's name is unknown.
            DataError: a column is missing, or a value is not valid. The message names row and
                column; rows count from 0, as in ``frame.iloc``.
        """
        from pandas import DataFrame

        from stiff_datasets.measured.sample_file import samples_of

        if not isinstance(frame, DataFrame):
            raise ConfigError(
                f"{type(frame).__name__} is not a DataFrame; use read_samples(file, robot=...) for "
                "a file, and Dataset.from_samples(samples, robot) for arrays"
            )
        robot = as_robot(robot)
        options = FileOptions(no_torque, None, pose_tolerance, register, hook)
        samples = samples_of(Path(name), frame, robot, "no data set was made", options)
        return cls(held_data(BenchmarkData(samples, robot), name))

    @property
    def name(self) -> str:
        """Return the key with the options that differ from their defaults."""
        return self.choice.name

    @cached_property
    def data(self) -> BenchmarkData:
        """Return samples and robot, the input of models."""
        return loaded(self.choice)

    @property
    def samples(self) -> Samples:
        """Return joint positions, wrenches and deflections, in SI units."""
        return self.data.samples

    @property
    def robot(self) -> Robot:
        """Return the robot."""
        return self.data.robot

    def frame(self) -> DataFrame:
        """Return the samples as a table with the columns of a file (deg, N, N m, mm)."""
        from stiff_datasets.measured.table_reader import sample_table

        return sample_table(self.samples, self.robot)

    @property
    def card(self) -> Text:
        """Return the data card in Markdown, "" for none; DataError: it cannot be read."""
        from stiff_bench.tables.dataset_facts import card_text

        return Text(card_text(self.choice.info.key, self.choice.info.card))

    def describe(self, output: Folder = Path("results/info")) -> Text:
        """Describe a data set and draw an overview.

        Args:
            output: folder for the picture, KEY.png.

        Raises:
            StoreError: the picture cannot be written.
        """
        from stiff_bench.tables.dataset_facts import dataset_info

        data, info, options = self.data, self.choice.info, self.choice.options_text
        name = f"{info.key} {options}".strip().replace("/", "_").replace(", ", "_")
        picture = Path(output) / f"{name.replace(' ', '_')}.png"
        make_folder(picture.parent)
        self.plot().save(picture)
        card = f"\n\n{self.card}" * bool(self.card)
        return Text(dataset_info(info, data, picture, options) + card)

    def export(self, output: Folder) -> Text:
        """Write a data set as CSV, URDF, data card and descriptors.

        Args:
            output: folder for the files; existing files are not overwritten.

        Raises:
            DataError: a file cannot represent the data; see `read_samples`.
            StoreError: a file exists, or cannot be written.
        """
        from stiff_bench.api.data_files import export_dataset

        return export_dataset(self.choice, self.data, Path(output))

    def __getitem__(self, rows: slice | int | Sequence[int] | Sequence[bool] | Any) -> Dataset:
        """Return the data set of some samples: a slice, row numbers or a mask, as in NumPy.

        It keeps kind and caveats; its name includes the selection. Select all rows of a pose: if
        rows of a pose are in training and test data, the test is too easy.

        Raises:
            ConfigError: `rows` is the name of a column.
            IndexError: a row does not exist, or the mask has another length.
        """
        data = self.data
        if isinstance(rows, str) or np.asarray(rows).dtype.kind == "U":
            raise ConfigError(
                f"{rows!r} does not choose samples; use .frame()[{rows!r}] for columns "
                "(deg, N, N m, mm)"
            )
        chosen = np.atleast_1d(np.arange(len(data.samples))[rows])
        bound_rows = {name: values[chosen] for name, values in data.bound_deflections.items()}
        part = replace(data, samples=data.samples.take(chosen), bound_deflections=bound_rows)
        text = _slice_text(rows) if isinstance(rows, slice) else counted(len(chosen), "row")
        info = replace(self.choice.info, published="", card="")
        return Dataset(held_data(part, f"{self.name}[{text}]", info))

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    if not TYPE_CHECKING:  # a type checker would accept every name

        def __getattr__(self, name: str) -> Any:
            """Name `frame` for what only a DataFrame has, such as `head`, and `samples` for `q`."""
            hint = ""
            if name in Samples.__dataclass_fields__:
                hint = f"; use .samples.{name} (SI units)"
            elif not name.startswith("_"):
                from pandas import DataFrame

                hint = f"; use .frame().{name}" if hasattr(DataFrame, name) else ""
            raise AttributeError(f"a Dataset has no {name!r}{hint}")

    def plot(self) -> Prepared:
        """Return the picture of its poses, load directions, deflections and joint torques."""
        from stiff_bench.figures.dataset_picture import dataset_picture

        info, options = self.choice.info, self.choice.options_text
        title = ", ".join(filter(None, (f"{info.key} ({info.kind})", options)))
        return dataset_picture(self.data, title)

    def view(self) -> Screen:
        """Return kind, robot, ranges and source; in a notebook also the first rows."""
        info, file = self.choice.info, self.choice.context.get("csv")
        facts = [
            ("what it is", "" if file else info.summary),
            *self.data.facts,
            ("source", str(file or info.reference)),
            ("licence", info.licence),
            *(("caveat", caveat) for caveat in info.caveats),
        ]
        head = self[:SHOWN_ROWS].frame()
        return Screen(
            f"Dataset {self.name} ({info.kind})",
            [(name, text) for name, text in facts if text],
            [*head],
            [[f"{x:.4g}" if isinstance(x, float) else str(x) for x in row] for row in head.values],
            in_text=False,
        )


def _slice_text(rows: slice) -> str:
    """Return a slice as text, such as "10:40"."""
    start, stop, step = (
        "" if bound is None else str(bound) for bound in (rows.start, rows.stop, rows.step)
    )
    return f"{start}:{stop}" + (f":{step}" if step else "")


def path_of(file: object) -> Path:
    """Return the path of a user's file; ConfigError: it is an object in place of a path."""
    if not isinstance(file, str | os.PathLike):
        raise ConfigError(
            f"{type(file).__name__} is not a file; give a path (a data set is written by "
            '.export(folder), a DataFrame by .to_csv("my.csv", index=False))'
        )
    return Path(file)


FARTHEST_TURN = 6.0 * np.pi
"""Three turns: farther joint angles are in degrees, unless the joint's limits allow them."""


def degrees_text(q: FloatArray, robot: Robot) -> str:
    """Return which of the joint angles `q`, (n, n_joints) rad, are in degrees; "" for none."""
    limits = np.fmax(np.abs(robot.lower), np.abs(robot.upper))
    farthest = np.fmax(FARTHEST_TURN, np.where(np.isfinite(limits), limits, 0.0))
    too_far = (np.abs(q) > farthest) & robot.turns
    if not too_far.any():
        return ""
    row, joint = (int(number) for number in np.argwhere(too_far)[0])
    return (
        f"row {row}, joint {robot.joint_names[joint]}: {q[row, joint]:g} rad, expected at most "
        f"{farthest[joint]:.3g} rad; angles in degrees? Convert them by numpy.radians(q)"
    )


def _no_dataset(data: object) -> ConfigError:
    return ConfigError(
        f"{type(data).__name__} is not a data set; use load_dataset(name), read_samples(file, "
        "robot=...), Dataset.from_frame(frame, robot) or Dataset.from_samples(samples, robot)"
    )


def as_dataset(data: object, robot: str | Robot | None = None) -> Dataset:
    """Return a data set, or make one from a DataFrame and its robot.

    Raises:
        ConfigError: `data` is not a data set, a DataFrame has no robot, or a data set has a second.
        DataError: a column is missing, or a value is not valid; see `Dataset.from_frame`.
    """
    from pandas import DataFrame

    if isinstance(data, DataFrame):
        if robot is None:
            raise ConfigError(
                "a DataFrame needs a robot; use Dataset.from_frame(frame, robot), or robot=... in "
                "fit"
            )
        return Dataset.from_frame(data, as_robot(robot))
    if not isinstance(data, Dataset | BenchmarkData):
        raise _no_dataset(data)
    if robot is not None:
        raise ConfigError("is part of the data set; only a DataFrame needs it", "robot")
    return data if isinstance(data, Dataset) else Dataset(held_data(data, "own-data"))


def load_dataset(name: str, **options: Any) -> Dataset:
    """Return a data set of stiffbench or of a plugin.

    Args:
        name: key, such as "kr10-twin", or key with options, such as "kr10-twin@specimen=3".
        options: options of the data set; `bench show NAME` lists them.

    Raises:
        ConfigError: the name or an option is unknown, or a value is wrong.
        DataError: the data set cannot be loaded.
    """
    if not isinstance(name, str):
        raise ConfigError(f"{type(name).__name__} is not the name of a data set")
    dataset = Dataset(choice_of("dataset", name, options))
    dataset.data  # noqa: B018  # raise errors here, not at the first use
    return dataset


def read_samples(
    file: Path | str,
    *,
    robot: str | Robot,
    no_torque: bool = False,
    sheet: str | None = None,
    pose_tolerance: float = POSE_TOLERANCE,
    register: bool = False,
    hook: Point | None = None,
) -> Dataset:
    """Read a file of measured samples.

    Args:
        file: CSV, Excel or Parquet file with the columns of `bench data validate`.
        robot: measured robot: a shipped name or a `Robot`; with your own tool
            ``load_robot("kr10-r1100-2", tcp=(0.0, 0.0, 0.1))``, m.
        no_torque: True if torques were not measured: their columns may be missing, or zero.
        sheet: sheet of an Excel file; None: the only sheet with a table.
        pose_tolerance: largest difference of joint positions within a pose, for rows without
            `pose_id`, deg, and mm of prismatic joints; poses of two names within this difference
            give a warning.
        register: True if positions are in a tracker's frame: deflections are turned to the base
            frame, by the unloaded positions and the joint angles.
        hook: where the loads `mass_kg` and `pull_N` act, frame of the last link, m; None: the TCP.

    Raises:
        ConfigError: `file` is not a path, the robot or the sheet is unknown, or `sheet` is
            missing for a file with several tables.
        DataError: the file or a value cannot be read; the message names row and column.
    """
    options = FileOptions(no_torque, sheet, pose_tolerance, register, hook)
    dataset = Dataset.of_file(file, robot, options)
    dataset.data  # noqa: B018  # raise errors here, not at the first use
    return dataset
