"""Read a robot program in the language of its suffix."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from stiff_apply.programs import fanuc_ls, krl, rapid, urscript
from stiff_apply.programs.program import Language, RobotProgram, program_table
from stiff_protocols.contract.errors import DataError

LANGUAGES = {
    ".src": krl.LANGUAGE,
    ".mod": rapid.LANGUAGE,
    ".modx": rapid.LANGUAGE,
    ".prg": rapid.LANGUAGE,
    ".ls": fanuc_ls.LANGUAGE,
    ".script": urscript.LANGUAGE,
    ".urscript": urscript.LANGUAGE,
}
"""Suffix of a program -> its language."""


def read_program(path: Path, harmless: Collection[str] = ()) -> RobotProgram:
    """Read the motions of a robot program.

    Args:
        path: KUKA .src (with the .dat of the same name), ABB .mod, FANUC .ls, or URScript .script.
        harmless: names of routines of other files that do not change frames or other state.

    Raises:
        DataError: the file cannot be read, its language is unknown, or it has no motion.
    """
    language = language_of(path)
    names = [name.replace("*", path.stem).lower() for name in language.companions]
    try:
        files = {file.name.lower(): file for file in path.parent.iterdir()} if names else {}
        paths = [path, *(files[name] for name in names if name in files)]
        by_name = {file.name.lower(): file.read_bytes().decode("latin-1") for file in paths}
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    texts = [by_name.get(name, "") for name in (path.name.lower(), *names)]
    written = [path, *(files[name] for name in names[:1] if name in files)]
    return program_table(tuple(written), tuple(texts), language, harmless)


def language_of(path: Path) -> Language:
    """Return the language of a program by its suffix; DataError for an unknown one."""
    suffix = path.suffix.lower()
    if suffix not in LANGUAGES:
        raise DataError(
            f"{path}: unknown language of a robot program (valid: KUKA .src, ABB .mod, FANUC .ls, "
            "URScript .script)"
        )
    return LANGUAGES[suffix]
