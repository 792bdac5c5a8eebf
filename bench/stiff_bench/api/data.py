"""Data sets to fit, predict and compare on: shipped ones, files, arrays and DataFrames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiff_bench.plan.options import Choice, parse_option
from stiff_bench.plan.registry import Kind, Registry, build_registry
from stiff_bench.plan.request import loaded
from stiff_bench.plan.words import RobotWords, chosen, measured_file
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples

if TYPE_CHECKING:
    from pandas import DataFrame


@cache
def registry() -> Registry:
    """Return the models, data sets and protocols that can be named, plugins' among them."""
    return build_registry()


def use_plugin(file: Path | str) -> None:
    """Import a file that defines MODELS, DATASETS or PROTOCOLS, so that they can be named.

    Raises:
        ConfigError: it cannot be imported, or a key is taken.
    """
    registry().add_file(Path(file))


def choice_of(kind: Kind, word: str, options: Mapping[str, Any]) -> Choice[Any]:
    """Return what a word of the command line stands for, with more options.

    Raises:
        ConfigError: the word or an option is unknown, or a value is wrong.
    """
    choice = chosen({kind: (word,)}, (), registry())[kind][0]
    parsed = {
        name: parse_option(f"{name}={value!r}", choice.info.key, choice.cls, name, str(value))
        for name, value in options.items()
    }
    return replace(choice, params={**choice.params, **parsed})


class HeldData:
    """A data set that is in memory."""

    def __init__(self, *, data: BenchmarkData) -> None:
        """Store it."""
        self.data = data

    def load(self) -> BenchmarkData:
        """Return it."""
        return self.data


@dataclass(frozen=True, eq=False)
class Dataset:
    """Samples, the robot that they belong to, and the name that tables give them.

    Attributes:
        choice: what loads it, with its options.
    """

    choice: Choice[DatasetInfo]

    @classmethod
    def from_samples(cls, samples: Samples, robot: Robot, *, name: str = "own-data") -> Dataset:
        """Return a data set of arrays (SI units, see `Samples`).

        Raises:
            DataError: samples and robot have different numbers of joints.
        """
        info = DatasetInfo(
            key=name, target=HeldData, kind="user's data", summary="samples from memory"
        )
        data = BenchmarkData(samples, robot)
        return cls(Choice(info, HeldData, {}, {"data": data}))

    @classmethod
    def from_frame(cls, frame: DataFrame, robot: Robot, *, name: str = "own-data") -> Dataset:
        """Return a data set of a table with the columns of a file (deg, N, N m, mm).

        Raises:
            DataError: a column is missing, or a value cannot be; the message names row and column.
        """
        from stiff_datasets.measured.measured import samples_of

        samples = samples_of(Path(name), frame, robot, "no data set was made")
        return cls.from_samples(samples, robot, name=name)

    @property
    def name(self) -> str:
        """Key with the options that differ from their defaults."""
        return self.choice.name

    @cached_property
    def data(self) -> BenchmarkData:
        """What models get: samples and robot."""
        return loaded(self.choice)

    @property
    def samples(self) -> Samples:
        """Joint positions, wrenches and deflections, in SI units."""
        return self.data.samples

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.data.robot

    def frame(self) -> DataFrame:
        """Return the samples as a table with the columns of a file (deg, N, N m, mm)."""
        from stiff_datasets.measured.sample_files import sample_table

        return sample_table(self.samples, self.robot)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def __repr__(self) -> str:
        """Name it, its samples and its robot."""
        return f"Dataset {self.name} ({self.choice.info.label})\n{self.samples!r}\n{self.robot!r}"


def load_dataset(name: str, **options: Any) -> Dataset:
    """Return a shipped data set, or a plugin's.

    Args:
        name: its key, such as "kr10-twin", or a word with options, "kr10-twin@specimen=3".
        options: of it; `bench show NAME` lists them.

    Raises:
        ConfigError: the name or an option is unknown, or a value is wrong.
        DataError: it cannot be loaded.
    """
    dataset = Dataset(choice_of("dataset", name, options))
    dataset.data  # noqa: B018  # so that what is wrong is said here
    return dataset


def read_samples(
    file: Path | str,
    *,
    urdf: Path | str | None = None,
    robot: str | Robot | None = None,
    tcp: Sequence[float] | None = None,
) -> Dataset:
    """Read a file of measured samples.

    Args:
        file: CSV or Parquet; its columns are those of `bench data validate`.
        urdf: of the robot that was measured.
        robot: in its place, the name of a shipped robot, or a `Robot`.
        tcp: (3,) tool centre point in the frame of the last link, m; None: the shipped robot's, or
            the origin with `urdf`.

    Raises:
        ConfigError: there is no robot, or there are two.
        DataError: a file cannot be read, or a value cannot be; the message names row and column.
    """
    if isinstance(robot, Robot):
        if urdf is not None or tcp is not None:
            raise ConfigError("robot is a Robot: it has its own geometry, leave out urdf and tcp")
        known = robot
    else:
        if (urdf is None) == (robot is None):
            raise ConfigError("give the robot: one of urdf=... and robot=...")
        place = "" if tcp is None else ",".join(map(str, tcp))
        known = RobotWords(robot, None if urdf is None else Path(urdf), place).read()[0]
    dataset = Dataset(measured_file(Path(file), known))
    dataset.data  # noqa: B018
    return dataset
