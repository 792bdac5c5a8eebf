"""Export a data set as CSV, URDF, data card and descriptors."""

from __future__ import annotations

import shutil
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiff_datasets.measured.card_text import tcp_option
from stiff_datasets.measured.descriptors import (
    DescribedFile,
    describe,
    descriptor_files,
    write_descriptors,
)
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.sheet_files import sample_table, write_table
from stiff_datasets.robots.urdf_reader import read_robot
from stiff_protocols.contract.errors import StiffBenchWarning, StoreError
from stiff_protocols.contract.files import check_new_file, make_folder
from stiff_protocols.contract.types import BenchmarkData


@dataclass(frozen=True, eq=False)
class ExportedFiles:
    """The files of an exported data set.

    Attributes:
        paths: CSV, data card, URDF, Croissant, data package.
        described: the CSV file with the content of its descriptors.
        sha256: hash of samples and robot after reading the files.
        n_rounded: number of joint positions that read back as the next floating-point number.
    """

    paths: tuple[Path, ...]
    described: DescribedFile
    sha256: str
    n_rounded: int


def export(
    data: BenchmarkData, folder: Path, stem: str, urdf: str, card: Callable[[str, str], str]
) -> ExportedFiles:
    """Write the files of a data set, all or none, and read them back.

    Args:
        data: samples and robot.
        folder: created if it does not exist.
        stem: name of the files without extension.
        urdf: text of the robot's description.
        card: returns the text of the data card from the options for the robot of the files, and the
            hash of samples and robot after reading the files.

    Raises:
        DataError: the data are invalid in a file; see `read_samples`.
        StoreError: a file exists, or cannot be written.
    """
    names = [f"{stem}{ending}" for ending in (".csv", ".md", ".urdf")]
    csv = folder / names[0]
    paths = (*(folder / name for name in names), *descriptor_files(csv))
    is_new_folder = not folder.exists()
    make_folder(folder)
    try:
        for path in paths:
            check_new_file(path)
        with _temporary_folder(folder) as temporary_name:
            temporary_folder = Path(temporary_name)
            write_table(temporary_folder / names[0], [sample_table(data.samples, data.robot)])
            (temporary_folder / names[2]).write_text(urdf, encoding="utf-8")
            robot = read_robot(temporary_folder / names[2], tcp=data.robot.tcp_on_flange.tolist())
            robot_options = f"--urdf {names[2]} {tcp_option(data.robot.tcp_on_flange)}"
            (temporary_folder / names[1]).write_text(card(robot_options, ""), encoding="utf-8")
            with warnings.catch_warnings():  # the data set's own reader gave them
                warnings.simplefilter("ignore", StiffBenchWarning)
                samples = read_samples(temporary_folder / names[0], robot)
            sha256 = BenchmarkData(samples, robot).sha256
            (temporary_folder / names[1]).write_text(card(robot_options, sha256), encoding="utf-8")
            described = describe(temporary_folder / names[0], robot)
            write_descriptors(described)
            _move(temporary_folder, paths)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        if is_new_folder and not any(folder.iterdir()):
            folder.rmdir()
    n_rounded = int(np.count_nonzero(samples.q != data.samples.q))
    return ExportedFiles(paths, described, sha256, n_rounded)


def _temporary_folder(folder: Path) -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix=".export-", dir=folder)


def _move(source_folder: Path, paths: tuple[Path, ...]) -> None:
    """Move all finished files to their folder, or none."""
    moved: list[Path] = []
    try:
        for path in paths:
            shutil.move(source_folder / path.name, path)
            moved.append(path)
    except BaseException:
        for path in moved:
            path.unlink(missing_ok=True)
        raise
