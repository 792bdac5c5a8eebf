"""`ur5-pose-error`: MEASURED pose errors of an unloaded UR5 (card: data/ur5_pose_error.md).

No stiffness data: no load is applied, the wrench is zero and `deflection` holds the pose error.
The files are not shipped; `fetch` gets them. Heavy imports stay in the functions that need them,
so that a list of data sets can ask `missing` at no cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from stiff_datasets.measured.registered import home, make_folder
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import written_whole

if TYPE_CHECKING:
    from stiff_protocols.contract.types import BenchmarkData

COMMIT = "759068d85a8b95183cd71ff96d9dfc5173bc57fc"
BASE_URL = f"https://raw.githubusercontent.com/pauljac7700/serial_robots_datasets/{COMMIT}/"
PAGE = f"https://github.com/pauljac7700/serial_robots_datasets/tree/{COMMIT}/UR5"
SOURCE_FOLDER = "UR5"
"""Folder of the source that holds the files."""

TCP = (0.0, 0.0, 0.031)
"""m, flange frame; not stated by the source, found from its targets (data card)."""

FETCH = "bench data fetch ur5-pose-error"
BY_HAND = f"get both files of {PAGE} by hand and run: {FETCH} --from DIR"
JOINT_COLUMNS = [f"joint_{i}" for i in range(1, 7)]  # deg
ERROR_COLUMNS = ["x_dif", "y_dif", "z_dif"]  # mm, measured minus target position


@dataclass(frozen=True)
class SourceFile:
    """One published file: the group its poses form, its name and its checksum."""

    group: str
    name: str
    sha256: str


FILES = (
    SourceFile(
        "grid",
        "3D_UR5_uncalibrated_grid_cleaned.csv",
        "3de63c38b4338a1fb23437a9c6ecb7e0441a9e132fc055544619b8c580f767c0",
    ),
    SourceFile(
        "random",
        "3D_UR5_uncalibrated_random_cleaned.csv",
        "3cd7a4aae072f9757ce9bd156e7470cc8caa89d8af9164c07390953ae808095a",
    ),
)


def folder() -> Path:
    """Return where the fetched files lie."""
    return home() / "ur5_pose_error"


def missing() -> str:
    """Return "" when every file is there, else a short reason."""
    there = all((folder() / file.name).is_file() for file in FILES)
    return "" if there else f"not fetched: {FETCH}"


def fetch(source: Path | None = None, *, base_url: str = BASE_URL) -> tuple[Path, ...]:
    """Put the source's files into `folder`; what is there and right is left alone.

    Args:
        source: a folder that holds the files, itself or in its folder UR5; None: download them.
        base_url: where to download from, with a slash at its end.

    Returns:
        The files in `folder`.

    Raises:
        DataError: a file is missing, cannot be read or downloaded, or has another checksum;
            nothing is written then.
        ConfigError: a file is to be downloaded, and pooch is not installed.
        StoreError: a file cannot be written.
    """
    wanted = [file for file in FILES if not _is_right(folder() / file.name, file)]
    contents = [
        _download(file, base_url) if source is None else _read_from(source, file) for file in wanted
    ]
    make_folder(folder())
    for file, content in zip(wanted, contents, strict=True):
        with written_whole(folder() / file.name) as temporary:
            temporary.write_bytes(content)
    return tuple(folder() / file.name for file in FILES)


class Ur5PoseError:
    """The fetched measurement."""

    def load(self) -> BenchmarkData:
        """Read the fetched files.

        Raises:
            DataError: a file is not fetched or not the one the data card describes.
        """
        import numpy as np
        import pandas as pd

        from stiff_datasets.robots.robot import shipped_robot
        from stiff_protocols.contract.types import BenchmarkData, Samples

        tables = [pd.read_csv(BytesIO(_fetched(file))).assign(group=file.group) for file in FILES]
        table = pd.concat(tables, ignore_index=True)
        samples = Samples(
            q=np.deg2rad(table[JOINT_COLUMNS].to_numpy(dtype=float)),
            wrench=np.zeros((len(table), 6)),
            deflection=table[ERROR_COLUMNS].to_numpy(dtype=float) / 1000.0,
            pose_id=(table["group"] + "-" + table["step_order"].astype(str)).to_numpy(dtype=str),
            load_id=np.full(len(table), "unloaded"),
            group=table["group"].to_numpy(dtype=str),
        )
        return BenchmarkData(samples, shipped_robot("ur5", tcp=TCP))


def _fetched(file: SourceFile) -> bytes:
    path = folder() / file.name
    if (content := _content(path)) is None:
        raise DataError(f"{path}: not fetched; run: {FETCH}")
    return _checked(content, str(path), file, f"run: {FETCH}")


def _is_right(path: Path, file: SourceFile) -> bool:
    try:
        return sha256(path.read_bytes()).hexdigest() == file.sha256
    except OSError:
        return False


def _download(file: SourceFile, base_url: str) -> bytes:
    require("a download", "pooch")
    import pooch  # type: ignore[import-untyped]

    url = f"{base_url}{SOURCE_FOLDER}/{file.name}"
    content = BytesIO()
    try:
        # the files are small; a stream would stay open after an error
        pooch.HTTPDownloader(progressbar=False, stream=False)(url, content, None)
    except OSError as error:  # every error of requests is one
        reason = " ".join(str(error).split())
        raise DataError(f"{url}: cannot be downloaded; {BY_HAND} ({reason})") from error
    return _checked(content.getvalue(), url, file, BY_HAND)


def _read_from(source: Path, file: SourceFile) -> bytes:
    places = (source / SOURCE_FOLDER / file.name, source / file.name)
    for path in places:
        if (content := _content(path)) is not None:
            return _checked(content, str(path), file, BY_HAND)
    raise DataError(f"{places[1]}: no such file, nor {places[0]}; {BY_HAND}")


def _content(path: Path) -> bytes | None:
    """Return what a file holds; None where there is none."""
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error


def _checked(content: bytes, where: str, file: SourceFile, advice: str) -> bytes:
    found = sha256(content).hexdigest()
    if found != file.sha256:
        raise DataError(f"{where}: sha256 {found}, expected {file.sha256}; {advice}")
    return content
