"""The folder of a submission: what it holds, how it is written and read.

::

    card.toml           the model and its authors
    code/               the plugin file and the files that it imports
    records.jsonl       a record per fit: metrics, predictions, hashes
    environment.json    versions and machines
    manifest.json       study, model, and the SHA-256 of every file

It holds text only: nothing in it is run or unpickled to read it.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from stiff_bench.submissions.card import Card, describe_problem, read_card
from stiff_bench.submissions.export import export_records
from stiff_bench.submissions.record import Record, Sha256
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.source_code import imported_files

CARD, CODE, RECORDS = "card.toml", "code", "records.jsonl"
ENVIRONMENT, MANIFEST, VERIFICATION = "environment.json", "manifest.json", "verification.json"
LARGEST_BYTES = 100 * 2**20
"""Size limit of a file in a submission."""
Scope = Literal["lite", "full"]
Content = TypeVar("Content", bound=BaseModel)
Outcome = Literal["verified", "reported", "refused"]


class Manifest(BaseModel):
    """Study, model and files of a submission.

    Attributes:
        format: version of this schema.
        stiffbench: version that made it.
        study: name of the study.
        scope: "lite" or "full".
        model: name of the model, with its options.
        created: UTC, ISO 8601.
        files: path in the folder -> SHA-256 of every other file.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal[1] = 1
    stiffbench: str
    study: Annotated[str, Field(pattern=r"^[\w-]+$")]
    scope: Scope
    model: str
    created: str
    files: Mapping[str, Sha256]


class Verification(BaseModel):
    """The outcome of `bench verify --write`.

    Attributes:
        format: version of this schema.
        outcome: "verified", or "reported": the code could not be run.
        manifest_sha256: of the manifest that was verified, which has the hash of every file.
        stiffbench, date: version that verified it, and when.
        seed: of the choice of fits that were computed again.
        checks: lines of the output.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal[1] = 1
    outcome: Outcome
    manifest_sha256: Sha256
    stiffbench: str
    date: str
    seed: int
    checks: list[str]


@dataclass(frozen=True)
class Submission:
    """A submission that was read but not verified.

    Attributes:
        folder: folder of the submission.
        manifest, card, records: its files.
    """

    folder: Path
    manifest: Manifest
    card: Card
    records: Sequence[Record]

    @property
    def plugin(self) -> Path:
        """Return the path of the plugin file."""
        return self.folder / CODE / self.card.plugin


def write_submission(
    folder: Path,
    card_file: Path,
    records: Sequence[Record],
    environment: Mapping[str, object],
    manifest: Manifest,
) -> Submission:
    """Write a new folder, whole or not at all, and return what is in it.

    Args:
        folder: that does not exist yet.
        card_file: the card; the plugin is next to it.
        records: a fit each.
        environment: of the runs.
        manifest: without files.

    Raises:
        StoreError: the folder exists or cannot be written, or a file of the plugin cannot be read.
    """
    make_folder(folder.parent)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        shutil.copyfile(card_file, temporary / CARD)
        _copy_code(card_file.parent / read_card(card_file).plugin, temporary / CODE)
        export_records(records, temporary / RECORDS, "jsonl")
        _write_json(temporary / ENVIRONMENT, environment)
        hashes = {name: file_sha256(path) for name, path in _files(temporary)}
        content = manifest.model_copy(update={"files": hashes}).model_dump(mode="json")
        _write_json(temporary / MANIFEST, content)
        temporary.chmod(0o755)
        temporary.rename(folder)
    except OSError as error:
        reason = error.strerror or error
        raise StoreError(f"{folder}: cannot be written: {reason}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return read_submission(folder)


def check_output(folder: Path) -> None:
    """Check before the fits that the folder of a submission is new."""
    if folder.exists():
        raise StoreError(f"{folder}: already exists; give another name, or delete it first")


def _copy_code(plugin: Path, folder: Path) -> None:
    """Copy a plugin with the files and packages next to it that it imports."""
    for file in sorted(imported_files(plugin)):
        target = folder / file.relative_to(plugin.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)


def _write_json(path: Path, content: Mapping[str, object]) -> None:
    text = json.dumps(content, indent=2, sort_keys=True, ensure_ascii=False)
    path.write_text(f"{text}\n", encoding="utf-8")


def _files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield every file of a folder with its path in there."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() or path.is_symlink():
            yield path.relative_to(folder).as_posix(), path


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a submission.

    Raises:
        ConfigError: the folder holds none.
        DataError: it is wrong.
    """
    path = folder / MANIFEST
    if not path.is_file() or path.is_symlink():
        raise ConfigError(f"{folder}: no {MANIFEST} in it (use a folder of `bench submit`)")
    return _validated(Manifest, path, path.read_bytes())


def wrong_files(folder: Path, manifest: Manifest) -> list[str]:
    """Return each file that is missing, changed, too large, a link or not in the manifest."""
    problems = []
    there = dict(_files(folder))
    for name in (MANIFEST, VERIFICATION):
        there.pop(name, None)
    for name in sorted({*there, *manifest.files}):
        path = there.get(name)
        if path is None:
            problems.append(f"{name} is missing")
        elif path.is_symlink():
            problems.append(f"{name} is a link")
        elif name not in manifest.files:
            problems.append(f"{name} is not in {MANIFEST}")
        elif path.stat().st_size > LARGEST_BYTES:
            problems.append(f"{name} is larger than {LARGEST_BYTES // 2**20} MiB")
        elif file_sha256(path) != manifest.files[name]:
            problems.append(f"{name} was changed")
    return problems


def read_submission(folder: Path) -> Submission:
    """Read a submission.

    Raises:
        ConfigError: the folder holds none, or its card is wrong.
        DataError: a record is wrong.
    """
    manifest = read_manifest(folder)
    return Submission(folder, manifest, read_card(folder / CARD), read_records(folder / RECORDS))


def read_records(path: Path) -> list[Record]:
    """Read records, one per line.

    Raises:
        DataError: a line does not follow the schema.
    """
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    return [
        _validated(Record, path, line, f"line {number}: ")
        for number, line in enumerate(lines, start=1)
    ]


def _validated(model: type[Content], path: Path, text: bytes, where: str = "") -> Content:
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        raise DataError(f"{path}: {where}{describe_problem(error, model)}") from None


def read_verification(folder: Path) -> Verification | None:
    """Return the outcome that is stored with a submission; None: none of its present files."""
    path = folder / VERIFICATION
    if not path.is_file():
        return None
    verification = _validated(Verification, path, path.read_bytes())
    current = verification.manifest_sha256 == file_sha256(folder / MANIFEST)
    return verification if current else None


def write_verification(folder: Path, verification: Verification) -> None:
    """Store the outcome with the submission."""
    _write_json(folder / VERIFICATION, verification.model_dump(mode="json"))
