"""Register and read a user's own KR10 measurement, the data set `kr10-measured`.

stiffbench ships no such measurement, and none is public. The registration is in ``datasets.toml``
in the user's folder (see `home`). Large packages are imported only in the functions that need them,
so that a list of data sets calls `missing` at no cost.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs

from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_protocols.contract.errors import ConfigError, DataError, unknown_name
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import make_folder, read_toml, written_whole

if TYPE_CHECKING:
    from stiff_protocols.contract.types import BenchmarkData

VARIABLE = "STIFFBENCH_HOME"
"""Environment variable for another folder."""
KR10_MEASURED, SHIPPED_ROBOT = "kr10-measured", "kr10_r1100_2"
"""The only key of a registration, and its robot without a URDF."""
COMMAND = f"bench data register FILE.csv --dataset {KR10_MEASURED}"


def home() -> Path:
    """Return the user's folder; it need not exist yet.

    Raises:
        DataError: the variable refers to a user who does not exist.
    """
    folder_name = os.environ.get(VARIABLE)
    try:
        return (
            Path(folder_name).expanduser()
            if folder_name
            else platformdirs.user_data_path("stiffbench")
        )
    except RuntimeError as error:
        raise DataError(f"{VARIABLE}={folder_name}: {error}") from error


def registry_file() -> Path:
    """Return the file of registrations; it need not exist yet."""
    return home() / "datasets.toml"


@dataclass(frozen=True, kw_only=True)
class Registration(FileOptions):
    """A table in the file of registrations.

    Attributes:
        csv: the file of samples (see `sample_file.read_samples`).
        tcp: (3,) tool centre point in the frame of the URDF's last link, m.
        urdf: the robot's file; None: the shipped one.
        tip: last link of the chain in the URDF; None: the end of the longest chain.
        base: first link of the chain; None: the URDF's first link.
        hold: joints of the chain that do not move, deg or mm by name or number.
    """

    csv: str
    tcp: tuple[float, float, float]
    urdf: str | None = None
    tip: str | None = None
    base: str | None = None
    hold: dict[str, float | None] | None = None

    def read(self) -> BenchmarkData:
        """Read the files.

        Raises:
            DataError: see `sample_file.read_samples`.
        """
        from stiff_datasets.measured.sample_file import MeasuredData
        from stiff_datasets.robots.shipped_robots import shipped_robot
        from stiff_datasets.robots.urdf_reader import read_robot

        if self.urdf:
            of_urdf = {"tip": self.tip, "base": self.base, "hold": self.hold}
            robot = read_robot(Path(self.urdf), tcp=self.tcp, **of_urdf)
        else:
            robot = shipped_robot(SHIPPED_ROBOT, tcp=self.tcp)
        return MeasuredData(csv=Path(self.csv), robot=robot, options=self).load()


def register(
    key: str,
    csv: Path,
    urdf: Path | None,
    tcp: tuple[float, float, float],
    options: FileOptions = DEFAULTS,
    **of_urdf: Any,
) -> Path:
    """Read and register a measurement, and return the file of registrations.

    An earlier registration is replaced. Arguments except the key are attributes of `Registration`.

    Raises:
        ConfigError: nothing can be registered under the key, or tomli-w is not installed.
        DataError: the data cannot be read (see `sample_file.read_samples`), or the file of
            registrations is corrupt; then nothing is written.
        StoreError: the file of registrations cannot be written.
    """
    if key != KR10_MEASURED:
        raise unknown_name("data set to register", key, (KR10_MEASURED,))
    require("a registration", "tomli_w")
    import tomli_w

    from stiff_datasets.measured.data_card import read_card
    from stiff_datasets.measured.sample_columns import SIMULATED_GROUP

    path = registry_file()
    tables = read_toml(path) if path.exists() else {}
    entry = Registration(
        csv=str(csv.absolute()),
        tcp=tcp,
        urdf=str(urdf.absolute()) if urdf else None,
        **of_urdf,
        **asdict(options),
    )
    if SIMULATED_GROUP in entry.read().samples.group:
        raise DataError(
            f"{csv}: has rows of the group {SIMULATED_GROUP!r}, written by a simulation"
        )
    if read_card(csv).kind == "simulated":
        raise DataError(f"{csv}: its data card says SIMULATED; only a measurement is registered")
    make_folder(path.parent)
    tables[key] = {name: value for name, value in asdict(entry).items() if value is not None}
    with written_whole(path) as temporary:
        temporary.write_bytes(tomli_w.dumps(tables).encode())
    return path


def registration() -> Registration:
    """Return the registration.

    Raises:
        DataError: nothing is registered, the file of registrations is corrupt, or a registered file
            does not exist any more.
    """
    path = registry_file()
    table = read_toml(path).get(KR10_MEASURED) if path.exists() else None
    if table is None:
        raise DataError(f"no file registered: {COMMAND}")
    from pydantic import TypeAdapter, ValidationError

    try:
        entry = TypeAdapter(Registration).validate_python(table)
        Registration(**table)  # fails for unknown keys
    except (ValidationError, TypeError, ConfigError) as error:
        problems = error.errors() if isinstance(error, ValidationError) else []
        problem_texts = "; ".join(
            f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}, not {problem['input']!r}"
            for problem in problems
        )
        reason = (
            f"{path}: table [{KR10_MEASURED}]: {problem_texts or error}; register again: {COMMAND}"
        )
        raise DataError(reason) from error
    for file in filter(None, (entry.csv, entry.urdf)):
        if not Path(file).is_file():
            raise DataError(f"{file}: the registered file is gone: {COMMAND}")
    return entry


def missing() -> str:
    """Return "" when a file is registered, else a short reason."""
    try:
        registration()
    except DataError as error:
        return str(error)
    return ""


class Kr10Measured:
    """The user's own measurement of a KUKA KR10 R1100-2."""

    def load(self) -> BenchmarkData:
        """Read the registered files.

        Raises:
            DataError: nothing is registered, or the file does not exist any more.
        """
        return registration().read()
