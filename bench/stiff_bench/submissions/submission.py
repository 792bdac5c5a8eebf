"""The folder of a submission: a card and code, and nothing else.

::

    card.toml           the model and its authors
    code/               the plugin file and the files that it imports

Nothing in it is run to read it. Every number about it is computed by `verification`.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.submissions.card import Card, read_card
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.source_code import imported_files

CARD, CODE = "card.toml", "code"
MOST_FILES, LARGEST_BYTES = 50, 5 * 2**20
"""Limits of the number of files and of the size of each."""
FOLDER_NAME = re.compile(r"[A-Za-z_]\w{0,99}")
FILE_NAME = re.compile(r"\w{1,100}\.(py|json|csv|npy|npz)")


@dataclass(frozen=True)
class Submission:
    """A submission whose files were checked; its code was not run.

    Attributes:
        folder: folder of the submission.
        card: the model and its authors.
        sha256: of names and contents of all files.
    """

    folder: Path
    card: Card
    sha256: str

    @property
    def code(self) -> Path:
        """Return the folder with the code."""
        return self.folder / CODE


def pack_submission(card_file: Path, plugin: Path, folder: Path) -> Submission:
    """Write a new folder, whole or not at all, and return what is in it.

    Args:
        card_file: the card.
        plugin: file that the card names; the files next to it that it imports are copied, too.
        folder: that does not exist yet.

    Raises:
        ConfigError: the card or a file is wrong.
        StoreError: the folder exists or cannot be written, or a file of the plugin cannot be read.
    """
    card = read_card(card_file)
    if plugin.name != card.plugin:
        raise ConfigError(f"{plugin}: the card names {card.plugin} (valid: this file)", "plugin")
    if (plugin.parent / "__init__.py").exists():
        raise ConfigError(f"{plugin}: is part of a package; give a file outside of packages")
    if folder.exists():
        raise StoreError(f"{folder}: already exists; give another name, or delete it first")
    make_folder(folder.parent)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        shutil.copyfile(card_file, temporary / CARD)
        for file in sorted(imported_files(plugin)):
            target = temporary / CODE / file.relative_to(plugin.parent)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
        read_submission(temporary)
        temporary.chmod(0o755)
        temporary.rename(folder)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return read_submission(folder)


def read_submission(folder: Path) -> Submission:
    """Read a submission.

    Raises:
        ConfigError: the folder holds none, a file is wrong or does not belong there, or the card is
            wrong.
    """
    digest, files = hashlib.sha256(), dict[str, Path]()
    for name, path in _entries(folder):
        files[name] = path
        if len(files) > MOST_FILES:
            raise ConfigError(f"{folder}: more than {MOST_FILES} files (valid: fewer)")
        digest.update(f"{name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    if CARD not in files:
        raise ConfigError(f"{folder}: no {CARD} in it (use a folder of `bench submit`)")
    card = read_card(folder / CARD)
    if f"{CODE}/{card.plugin}" not in files:
        raise ConfigError(f"{folder}: no {CODE}/{card.plugin}, which {CARD} names")
    return Submission(folder, card, digest.hexdigest())


def _entries(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield each file with its name in the folder; ConfigError for what does not belong there."""
    if not folder.is_dir() or folder.is_symlink():
        raise ConfigError(f"{folder}: is not a folder (use a folder of `bench submit`)")
    queue = [folder]
    while queue:
        for path in sorted(queue.pop().iterdir()):
            name, status = path.relative_to(folder).as_posix(), path.lstat()
            at_top = path.parent == folder
            if stat.S_ISDIR(status.st_mode):
                if not (name == CODE if at_top else FOLDER_NAME.fullmatch(path.name)):
                    raise ConfigError(f"{folder}: folder {name!r} (valid: {CODE}/ and packages)")
                queue.append(path)
                continue
            if not stat.S_ISREG(status.st_mode):
                raise ConfigError(f"{folder}: {name!r} is not a regular file (valid: a file)")
            if not (name == CARD if at_top else FILE_NAME.fullmatch(path.name)):
                valid = f"{CARD}, and .py, .json, .csv, .npy, .npz in {CODE}/"
                raise ConfigError(f"{folder}: {name!r} does not belong there (valid: {valid})")
            if status.st_size > LARGEST_BYTES:
                valid = f"at most {LARGEST_BYTES // 2**20} MiB"
                raise ConfigError(f"{folder}: {name} has {status.st_size} bytes (valid: {valid})")
            yield name, path
