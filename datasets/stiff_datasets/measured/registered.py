"""Files that a user registered: `kr10-measured` is the place for one's own KR10 measurement.

stiffbench ships no such measurement, and none is public. What is registered stands in
``datasets.toml`` in the folder of the user (see `home`), one table a key. Heavy imports stay in the
functions that need them, so that a list of data sets can ask `missing` at no cost.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs

from stiff_datasets.measured.file_options import DEFAULTS, POSE_TOLERANCE, FileOptions
from stiff_protocols.contract import files
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError, unknown_name
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import read_toml, written_whole

if TYPE_CHECKING:
    from stiff_protocols.contract.types import BenchmarkData


VARIABLE = "STIFFBENCH_HOME"
"""Environment variable that names another folder."""


def home() -> Path:
    """Return the folder; it need not exist yet.

    Raises:
        DataError: the variable names a user who does not exist.
    """
    named = os.environ.get(VARIABLE)
    try:
        return Path(named).expanduser() if named else platformdirs.user_data_path("stiffbench")
    except RuntimeError as error:
        raise DataError(f"{VARIABLE}={named}: {error}") from error


def make_folder(folder: Path) -> None:
    """Make a folder at or below `home`, with its parents.

    Raises:
        DataError: it cannot be made.
    """
    try:
        files.make_folder(folder)
    except StoreError as error:
        raise DataError(
            f"{error}; name another folder in the environment variable {VARIABLE}"
        ) from error


KR10_MEASURED, SHIPPED_ROBOT = "kr10-measured", "kr10_r1100_2"
"""The one key that a measurement can be registered under, and its robot where no URDF is."""
COMMAND = f"bench data register {KR10_MEASURED} FILE.csv"

_LONGEST_M = 1e3
"""What no length of a tool reaches, so that the number can be a float."""


@dataclass(frozen=True)
class Registration:
    """Registered files.

    Attributes:
        csv: the samples, in the schema of `stiff_datasets.measured.measured`.
        urdf: the robot; None: the shipped one.
        tcp: (3,) tool centre point in the frame of the URDF's last link, m.
        sha256: of the CSV as it was registered.
        urdf_sha256: of the URDF; "" where it is the shipped robot.
        options: what is not in the CSV.
        tip: last link of the chain in the URDF; None: the end of the longest chain.
    """

    csv: Path
    urdf: Path | None
    tcp: tuple[float, float, float]
    sha256: str
    urdf_sha256: str
    options: FileOptions = DEFAULTS
    tip: str | None = None

    def read(self) -> BenchmarkData:
        """Read the files, whatever their checksum.

        Raises:
            DataError: see `stiff_datasets.measured.measured.read_samples`.
        """
        from stiff_datasets.measured.measured import MeasuredData
        from stiff_datasets.robots.shipped_robots import shipped_robot
        from stiff_datasets.robots.urdf_reader import load_robot

        if self.urdf is not None:
            robot = load_robot(self.urdf, tcp=self.tcp, tip=self.tip)
        else:
            robot = shipped_robot(SHIPPED_ROBOT, tcp=self.tcp)
        return MeasuredData(csv=self.csv, robot=robot, options=self.options).load()


def registry_file() -> Path:
    """Return the file that holds every registration; it need not exist yet."""
    return home() / "datasets.toml"


def register(
    key: str,
    csv: Path,
    urdf: Path | None,
    tcp: tuple[float, float, float],
    tip: str | None = None,
    options: FileOptions = DEFAULTS,
) -> Path:
    """Register a measurement after reading it, and return the file that holds every registration.

    An earlier one is replaced. Arguments except the key are the attributes of `Registration`.

    Raises:
        ConfigError: nothing can be registered under the key, or tomli-w is not installed.
        DataError: the data cannot be read (see `read_samples`), or the file of registrations is
            damaged; nothing is written then.
        StoreError: the file of registrations cannot be written.
    """
    if key != KR10_MEASURED:
        raise unknown_name("data set to register", key, (KR10_MEASURED,))
    require("a registration", "tomli_w")
    import tomli_w

    from stiff_datasets.measured.sample_files import SIMULATED_GROUP

    path = registry_file()
    tables = _tables(path)
    csv, urdf = csv.absolute(), urdf.absolute() if urdf else None
    of_urdf = _sha256(urdf) if urdf else ""
    entry = Registration(csv, urdf, tcp, _sha256(csv), of_urdf, options, tip)
    if SIMULATED_GROUP in entry.read().samples.group:
        raise DataError(
            f"{csv}: has rows of the group {SIMULATED_GROUP!r}, written by a simulation"
        )
    tables[key] = {
        "csv": str(csv),
        "urdf": str(urdf or ""),  # empty: the shipped robot
        "tcp": [float(length) for length in tcp],
        "tip": tip or "",
        "sha256": entry.sha256,
        "urdf_sha256": of_urdf,
        "no_torque": options.no_torque,
        "sheet": options.sheet or "",  # empty: the only one that holds a table
        "pose_tolerance": options.pose_tolerance,
    }
    make_folder(path.parent)
    with written_whole(path) as temporary:
        temporary.write_bytes(tomli_w.dumps(tables).encode())
    return path


def registration() -> Registration | None:
    """Return what is registered, None for nothing.

    Raises:
        DataError: the file of registrations is damaged.
    """
    path = registry_file()
    table = _tables(path).get(KR10_MEASURED)
    match table:
        case None:
            return None
        case {
            "csv": str(csv),
            "urdf": str(urdf),
            "tcp": [float() | int() as x, float() | int() as y, float() | int() as z],
            "sha256": str(checksum),
            "urdf_sha256": str(of_urdf),
        } if all(abs(length) < _LONGEST_M for length in (x, y, z)):
            tcp = (float(x), float(y), float(z))
            place = Path(urdf) if urdf else None
            options, tip = _options(path, table), table.get("tip") or None
            return Registration(Path(csv), place, tcp, checksum, of_urdf, options, tip)
    raise DataError(
        f"{path}: table [{KR10_MEASURED}] is {table!r}, expected csv, urdf (empty: the shipped "
        "robot), tcp (three lengths in m), sha256 and urdf_sha256; register again: " + COMMAND
    )


def _options(path: Path, table: dict[str, Any]) -> FileOptions:
    """Return the options of a registration; an older one has fewer."""
    tolerance = table.get("pose_tolerance", POSE_TOLERANCE)
    try:
        return FileOptions(
            no_torque=table.get("no_torque", False) is True,
            sheet=str(table.get("sheet", "")) or None,
            pose_tolerance=float(tolerance),
        )
    except (TypeError, ValueError, ConfigError) as error:
        raise DataError(
            f"{path}: table [{KR10_MEASURED}]: pose_tolerance {tolerance!r}: {error}; register "
            f"again: {COMMAND}"
        ) from error


def missing() -> str:
    """Return "" when a file is registered, else a short reason."""
    try:
        _present()
    except DataError as error:
        return str(error)
    return ""


class Kr10Measured:
    """The user's own measurement of a KUKA KR10 R1100-2."""

    def load(self) -> BenchmarkData:
        """Read the registered files.

        Raises:
            DataError: nothing is registered, the file is gone, or it has changed since.
        """
        entry = _present()
        for path, registered in ((entry.csv, entry.sha256), (entry.urdf, entry.urdf_sha256)):
            if path is not None and (checksum := _sha256(path)) != registered:
                raise DataError(
                    f"{path}: sha256 {checksum}, registered {registered}: the file has changed; "
                    f"register it again: {COMMAND}"
                )
        return entry.read()


def _present() -> Registration:
    entry = registration()
    if entry is None:
        raise DataError(f"no file registered: {COMMAND}")
    for path in filter(None, (entry.csv, entry.urdf)):
        if not path.is_file():
            raise DataError(f"{path}: the registered file is gone: {COMMAND}")
    return entry


def _sha256(path: Path) -> str:
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error


def _tables(path: Path) -> dict[str, Any]:
    """Return every table of the file; none without a file."""
    try:
        return read_toml(path) if path.exists() else {}
    except DataError as error:
        raise DataError(f"{error}; correct or delete the file") from error
