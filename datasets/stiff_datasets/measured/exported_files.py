"""A data set as files that others can use: CSV, URDF, data card and descriptors."""

from __future__ import annotations

import shutil
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiff_datasets.measured.card_text import tcp_words
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
        described: the CSV file as its descriptors have it.
        sha256: hash of samples and robot as they are read from the files.
        n_rounded: number of joint positions that read back as the next floating-point number.
    """

    paths: tuple[Path, ...]
    described: DescribedFile
    sha256: str
    n_rounded: int


def export(
    data: BenchmarkData, folder: Path, stem: str, urdf: str, card: Callable[[str, str], str]
) -> ExportedFiles:
    """Write a data set's files into a folder, all of them or none, and read them back.

    Args:
        data: samples and robot.
        folder: is made if it is not there.
        stem: name of the files without ending.
        urdf: text of the robot's description.
        card: returns the text of the data card; it gets the options that name the robot of the
            files, and the hash of samples and robot as they are read from the files.

    Raises:
        DataError: the data are such as no file may hold; see `read_samples`.
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
        with _temporary_folder(folder) as place:
            there = Path(place)
            write_table(there / names[0], [sample_table(data.samples, data.robot)])
            (there / names[2]).write_text(urdf, encoding="utf-8")
            robot = read_robot(there / names[2], tcp=data.robot.tcp_on_flange.tolist())
            words = f"--urdf {names[2]} --tcp {tcp_words(data)}"
            (there / names[1]).write_text(card(words, ""), encoding="utf-8")
            with warnings.catch_warnings():  # of the data set, which its own reader gave
                warnings.simplefilter("ignore", StiffBenchWarning)
                samples = read_samples(there / names[0], robot)
            sha256 = BenchmarkData(samples, robot).sha256
            (there / names[1]).write_text(card(words, sha256), encoding="utf-8")
            described = describe(there / names[0], robot)
            write_descriptors(described)
            _move(there, paths)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        if is_new_folder and not any(folder.iterdir()):
            folder.rmdir()
    n_rounded = int(np.count_nonzero(samples.q != data.samples.q))
    return ExportedFiles(paths, described, sha256, n_rounded)


def _temporary_folder(folder: Path) -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix=".export-", dir=folder)


def _move(place: Path, paths: tuple[Path, ...]) -> None:
    """Move finished files to their places, or none of them."""
    moved: list[Path] = []
    try:
        for path in paths:
            shutil.move(place / path.name, path)
            moved.append(path)
    except BaseException:
        for path in moved:
            path.unlink(missing_ok=True)
        raise
