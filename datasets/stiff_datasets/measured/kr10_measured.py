"""`kr10-measured`: the place for a user's own KR10 measurement, which is registered once.

stiffbench ships no such measurement, and none is public. What is registered is in ``datasets.toml``
in the folder of the user (see `home`). Heavy imports stay in the functions that need them, so that
a list of data sets can ask `missing` at no cost.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs

from stiff_datasets.measured.file_options import DEFAULTS, POSE_TOLERANCE, FileOptions
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError, unknown_name
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import make_folder, read_toml, written_whole

if TYPE_CHECKING:
    from stiff_protocols.contract.types import BenchmarkData

VARIABLE = "STIFFBENCH_HOME"
"""Environment variable that names another folder."""
KR10_MEASURED, SHIPPED_ROBOT = "kr10-measured", "kr10_r1100_2"
"""The one key that a measurement can be registered under, and its robot where no URDF is."""
COMMAND = f"bench data register {KR10_MEASURED} FILE.csv"


def home() -> Path:
    """Return the folder of the user; it need not exist yet.

    Raises:
        DataError: the variable names a user who does not exist.
    """
    named = os.environ.get(VARIABLE)
    try:
        return Path(named).expanduser() if named else platformdirs.user_data_path("stiffbench")
    except RuntimeError as error:
        raise DataError(f"{VARIABLE}={named}: {error}") from error


def registry_file() -> Path:
    """Return the file that holds every registration; it need not exist yet."""
    return home() / "datasets.toml"


@dataclass(frozen=True)
class Registration:
    """A table of the file of registrations.

    Attributes:
        csv: the file of samples (see `sample_file.read_samples`).
        tcp: (3,) tool centre point in the frame of the URDF's last link, m.
        sha256: of the samples as they were registered.
        urdf: the robot's file; "": the shipped one.
        urdf_sha256: of the URDF; "" where it is the shipped robot.
        tip: last link of the chain in the URDF; "": the end of the longest chain.
        no_torque, sheet, pose_tolerance: see `FileOptions`; sheet "": the only one with a table.
    """

    csv: str
    tcp: tuple[float, float, float]
    sha256: str
    urdf: str = ""
    urdf_sha256: str = ""
    tip: str = ""
    no_torque: bool = False
    sheet: str = ""
    pose_tolerance: float = POSE_TOLERANCE

    @property
    def options(self) -> FileOptions:
        """What is not in the file of samples."""
        return FileOptions(self.no_torque, self.sheet or None, self.pose_tolerance)

    def read(self) -> BenchmarkData:
        """Read the files, whatever their checksums.

        Raises:
            DataError: see `sample_file.read_samples`.
        """
        from stiff_datasets.measured.sample_file import MeasuredData
        from stiff_datasets.robots.shipped_robots import shipped_robot
        from stiff_datasets.robots.urdf_reader import read_robot

        if self.urdf:
            robot = read_robot(Path(self.urdf), tcp=self.tcp, tip=self.tip or None)
        else:
            robot = shipped_robot(SHIPPED_ROBOT, tcp=self.tcp)
        return MeasuredData(csv=Path(self.csv), robot=robot, options=self.options).load()


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
        DataError: the data cannot be read (see `sample_file.read_samples`), or the file of
            registrations is damaged; nothing is written then.
        StoreError: the file of registrations cannot be written.
    """
    if key != KR10_MEASURED:
        raise unknown_name("data set to register", key, (KR10_MEASURED,))
    require("a registration", "tomli_w")
    import tomli_w

    from stiff_datasets.measured.sample_columns import SIMULATED_GROUP

    path = registry_file()
    tables = _tables(path)
    csv, urdf = csv.absolute(), urdf.absolute() if urdf else None
    entry = Registration(
        csv=str(csv),
        tcp=tcp,
        sha256=_sha256(csv),
        urdf=str(urdf or ""),
        urdf_sha256=_sha256(urdf) if urdf else "",
        tip=tip or "",
        no_torque=options.no_torque,
        sheet=options.sheet or "",
        pose_tolerance=options.pose_tolerance,
    )
    if SIMULATED_GROUP in entry.read().samples.group:
        raise DataError(
            f"{csv}: has rows of the group {SIMULATED_GROUP!r}, written by a simulation"
        )
    try:
        make_folder(path.parent)
    except StoreError as error:
        raise DataError(f"{error}; name another folder in the variable {VARIABLE}") from error
    tables[key] = asdict(entry)
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
    if table is None:
        return None
    from pydantic import TypeAdapter, ValidationError

    try:
        entry = TypeAdapter(Registration).validate_python(table)
        FileOptions(pose_tolerance=entry.pose_tolerance)
    except (ValidationError, ConfigError) as error:
        problems = error.errors() if isinstance(error, ValidationError) else []
        wrong = "; ".join(f"{'.'.join(map(str, p['loc']))}: {p['msg']}" for p in problems)
        raise DataError(
            f"{path}: table [{KR10_MEASURED}]: {wrong or error}; register again: {COMMAND}"
        ) from error
    return entry


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
        for file, registered in ((entry.csv, entry.sha256), (entry.urdf, entry.urdf_sha256)):
            if file and (checksum := _sha256(Path(file))) != registered:
                raise DataError(
                    f"{file}: sha256 {checksum}, registered {registered}: the file has changed; "
                    f"register it again: {COMMAND}"
                )
        return entry.read()


def _present() -> Registration:
    entry = registration()
    if entry is None:
        raise DataError(f"no file registered: {COMMAND}")
    for file in filter(None, (entry.csv, entry.urdf)):
        if not Path(file).is_file():
            raise DataError(f"{file}: the registered file is gone: {COMMAND}")
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
