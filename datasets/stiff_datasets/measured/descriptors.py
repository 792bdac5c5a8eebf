"""Write descriptors of a CSV file: Croissant and a Frictionless data package.

``NAME.croissant.json`` (Croissant 1.0, JSON-LD) and ``NAME.datapackage.json`` (Data Package 2.0)
describe ``NAME.csv`` and its data card ``NAME.md``: columns with type, unit, meaning and limits,
number of rows, sha256, licence, citation, source. Facts that the card does not state are omitted.
Both are plain JSON and need no package.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiff_datasets.measured.data_card import DataCard, read_card
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    ID_COLUMNS,
    LOADED_COLUMNS,
    column_meaning,
    column_unit,
    counted,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.sample_file import MAX_DEFLECTION_MM
from stiff_datasets.measured.sheet_files import NUMBER
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.types import Robot

CROISSANT, DATA_PACKAGE = ".croissant.json", ".datapackage.json"
"""Extensions of the descriptors."""
GENERATOR = "stiffbench"
"""Author in both descriptors; a file without it is not overwritten."""
LICENCES = (
    *("0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "CC0-1.0", "CC-BY-3.0", "CC-BY-4.0"),
    *("CC-BY-NC-4.0", "CC-BY-NC-ND-4.0", "CC-BY-NC-SA-4.0", "CC-BY-ND-4.0", "CC-BY-SA-4.0"),
    *("CDLA-Permissive-2.0", "CDLA-Sharing-1.0", "GPL-3.0-only", "GPL-3.0-or-later", "MIT"),
    *("ODbL-1.0", "ODC-By-1.0", "PDDL-1.0"),
)
"""SPDX identifiers of common data licences; other licences are given as text."""
NEEDED_FACTS = ("licence", "citation", "source", "version", "published")
"""Facts that published data should state."""
CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    **{
        name: f"cr:{name}"
        for name in (
            *("citeAs", "column", "equivalentProperty", "extract", "field", "fileProperty"),
            *("fileObject", "fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key"),
            *("md5", "parentField", "path", "recordSet", "references", "regex", "repeated"),
            *("replace", "samplingRate", "separator", "source", "subField", "transform"),
        )
    },
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
}
"""The standard context of Croissant 1.0."""


@dataclass(frozen=True)
class Column:
    """A column of a CSV file.

    Attributes:
        name: name in the header.
        is_number: true if every filled cell is a number.
        required: true if no cell is empty.
        low, high: limits of the numbers, in the unit of the column; None: no limits.
        meaning: description; "" if neither the schema nor the card has one.
    """

    name: str
    is_number: bool
    required: bool
    low: float | None = None
    high: float | None = None
    meaning: str = ""

    @property
    def text(self) -> str:
        """Meaning and unit in words, such as "torque ... [N m]"."""
        unit = column_unit(self.name)
        return f"{self.meaning}{f' [{unit}]' if unit else ''}".strip() or self.name


@dataclass(frozen=True)
class DescribedFile:
    """A CSV file with its columns and its card.

    Attributes:
        path: the file.
        content: its bytes.
        columns: columns in the order of the file.
        key: names of the columns that identify a row; () if there are none.
        n_rows: number of rows below the header.
        card: its data card.
    """

    path: Path
    content: bytes
    columns: tuple[Column, ...]
    key: tuple[str, ...]
    n_rows: int
    card: DataCard

    @property
    def name(self) -> str:
        """Name of the data set from the card, else the file name without extension."""
        return self.card.name or self.path.stem

    @property
    def description(self) -> str:
        """The card's first sentences, and the number of rows."""
        what = self.card.text("what").rstrip(".") or f"{self.path.name}, without a data card"
        robot = self.card.text("robot").rstrip(".")
        parts = [what, f"Robot: {robot}" if robot else "", f"{counted(self.n_rows, 'row')}"]
        return ". ".join(filter(None, parts)) + "."

    @property
    def sha256(self) -> str:
        """Hash of the file's bytes."""
        return hashlib.sha256(self.content).hexdigest()

    @property
    def missing_facts(self) -> list[str]:
        """The needed facts that the card does not state."""
        return [fact for fact in NEEDED_FACTS if fact not in self.card.facts]

    @property
    def keywords(self) -> list[str]:
        """Subjects, with "simulated" if the card says so."""
        names = {column.name for column in self.columns}
        subjects = ["deflection"] if names & {*DEFLECTION_COLUMNS, *LOADED_COLUMNS} else []
        origins = ["simulated"] if self.card.kind == "simulated" else []
        return ["industrial robot", "stiffness", *subjects, *origins]

    @property
    def published(self) -> str:
        """Date of publication as YYYY-MM-DD; "" if the card does not state it."""
        match = re.search(r"\d{4}-\d{2}-\d{2}", self.card.text("published"))
        return match[0] if match else ""

    @property
    def version(self) -> str:
        """Version as MAJOR.MINOR.PATCH; "" if the card does not state it."""
        match = re.match(r"\d+\.\d+\.\d+", self.card.text("version"))
        return match[0] if match else ""

    @property
    def licence(self) -> tuple[str, str]:
        """SPDX identifier (or the card's own text) and URL of the licence, "" if unknown."""
        text, url = self.card.text("licence"), self.card.url("licence")
        word = re.split(r"[,;\s(]", text, maxsplit=1)[0].lower()
        for identifier in LICENCES:
            if identifier.lower() == word:
                return identifier, url or f"https://spdx.org/licenses/{identifier}.html"
        return text, url


def describe(path: Path, robot: Robot | None = None, card: DataCard | None = None) -> DescribedFile:
    """Read a CSV file and its data card.

    Args:
        path: the file, with a comma between cells, a point in decimals and one header row.
        robot: gives the limits of the joint columns; None: no limits.
        card: the data card; None: the card next to the file.

    Raises:
        DataError: the file has another format, or its card is invalid; the message describes the
            fix.
    """
    content = _content(path)
    header, rows = _rows(path, content)
    card = read_card(path) if card is None else card
    limits: dict[str, list[float]] = {}
    if robot is not None:
        ends = np.round(np.stack([robot.lower, robot.upper]) * file_units(robot), 6)
        limits = dict(zip(joint_columns(robot), ends.T.tolist(), strict=True))
    largest = MAX_DEFLECTION_MM
    limits |= {name: [-largest, largest] for name in DEFLECTION_COLUMNS}
    columns = tuple(
        _column(name, cells, card, limits.get(name))
        for name, cells in zip(header, zip(*rows, strict=True), strict=True)
    )
    return DescribedFile(path, content, columns, _key(header, rows), len(rows), card)


def descriptor_files(path: Path) -> tuple[Path, Path]:
    """Return the names of a CSV file's descriptors: Croissant, data package."""
    return path.with_suffix(CROISSANT), path.with_suffix(DATA_PACKAGE)


def check_descriptor_files(path: Path) -> None:
    """Check that existing descriptors of a CSV file were written by stiffbench.

    Raises:
        StoreError: a descriptor was written by another program.
    """
    for descriptor_path in filter(Path.exists, descriptor_files(path)):
        try:
            descriptor = json.loads(descriptor_path.read_bytes())
            publisher = descriptor.get("generator") or descriptor["sdPublisher"]["name"]
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            publisher = None
        if publisher != GENERATOR:
            raise StoreError(
                f"{descriptor_path}: exists, was not written by stiffbench and is not "
                "overwritten; rename the data file, or move this file first"
            )


def write_descriptors(file: DescribedFile) -> tuple[Path, Path]:
    """Write both descriptors next to a file, and return their names.

    Existing descriptors of stiffbench are replaced.

    Raises:
        StoreError: as `check_descriptor_files`, or a descriptor cannot be written.
    """
    check_descriptor_files(file.path)
    paths = descriptor_files(file.path)
    for path, descriptor in zip(paths, (croissant(file), data_package(file)), strict=True):
        with written_whole(path) as temporary:
            temporary.write_text(json_text(descriptor), encoding="utf-8")
    return paths


def json_text(descriptor: dict[str, Any]) -> str:
    """Return a descriptor as indented JSON."""
    return json.dumps(descriptor, indent=1, ensure_ascii=False) + "\n"


def croissant(file: DescribedFile) -> dict[str, Any]:
    """Return the Croissant 1.0 metadata of a file as a JSON object."""
    name, records = file.path.name, "samples"
    licence, licence_url = file.licence
    stated = {
        "license": licence_url or licence,
        "url": file.card.url("source"),
        "citeAs": file.card.text("citation"),
        "version": file.version,
        "datePublished": file.published,
    }
    source = {"fileObject": {"@id": name}}
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"{records}/{column.name}",
            "name": column.name,
            "description": column.text,
            "dataType": "sc:Float" if column.is_number else "sc:Text",
            **({"unitText": column_unit(column.name)} if column_unit(column.name) else {}),
            "source": {**source, "extract": {"column": column.name}},
        }
        for column in file.columns
    ]
    key = [{"@id": f"{records}/{column}"} for column in file.key]
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": file.name,
        "description": file.description,
        **{fact: text for fact, text in stated.items() if text},
        "keywords": file.keywords,
        "isLiveDataset": False,
        "sdPublisher": {"@type": "Organization", "name": GENERATOR},
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": name,
                "name": name,
                "contentUrl": name,
                "contentSize": f"{len(file.content)} B",
                "encodingFormat": "text/csv",
                "sha256": file.sha256,
            }
        ],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": records,
                "name": records,
                "description": f"{counted(file.n_rows, 'row')}, in the units of the columns' names",
                **({"key": key} if key else {}),
                "field": fields,
            }
        ],
    }


def data_package(file: DescribedFile) -> dict[str, Any]:
    """Return the Frictionless data package of a file as a JSON object."""
    licence, licence_url = file.licence
    source = file.card.text("source")
    licences = {"name": licence if licence in LICENCES else "other", "title": licence}
    licences |= {"path": licence_url} if licence_url else {}
    sources = {"title": source} | ({"path": url} if (url := file.card.url("source")) else {})
    stated = {
        "version": file.version,
        "created": f"{file.published}T00:00:00Z" if file.published else "",
        "licenses": [licences] if licence else [],
        "sources": [sources] if source else [],
        "citation": file.card.text("citation"),
    }
    key = {"primaryKey": [*file.key]} if file.key else {}
    return {
        "$schema": "https://datapackage.org/profiles/2.0/datapackage.json",
        "name": _slug(file.name),
        "title": file.name,
        "description": file.description,
        **{fact: text for fact, text in stated.items() if text},
        "keywords": file.keywords,
        "generator": GENERATOR,
        "resources": [
            {
                "$schema": "https://datapackage.org/profiles/2.0/dataresource.json",
                "name": "samples",
                "type": "table",
                "path": file.path.name,
                "format": "csv",
                "mediatype": "text/csv",
                "encoding": "utf-8",
                "bytes": len(file.content),
                "hash": f"sha256:{file.sha256}",
                "rows": file.n_rows,
                "schema": {
                    "$schema": "https://datapackage.org/profiles/2.0/tableschema.json",
                    "fields": [_field(column) for column in file.columns],
                    **key,
                },
            }
        ],
    }


def _field(column: Column) -> dict[str, Any]:
    unit = column_unit(column.name)
    stated = {
        "required": column.required or None,
        "minimum": column.low,
        "maximum": column.high,
    }
    constraints = {name: value for name, value in stated.items() if value is not None}
    return {
        "name": column.name,
        "type": "number" if column.is_number else "string",
        "description": column.text,
        **({"unit": unit} if unit else {}),
        **({"constraints": constraints} if constraints else {}),
    }


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error


def _rows(path: Path, content: bytes) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a plain CSV file.

    Raises:
        DataError: other programs would read other cells than stiffbench.
    """
    reason = "not text in UTF-8 without a byte order mark"
    if not content.startswith(b"\xef\xbb\xbf"):
        try:
            header, *rows = csv.reader(io.StringIO(content.decode(), newline=""), strict=True)
            reason = _odd_table(header, rows)
        except (UnicodeDecodeError, csv.Error, ValueError):
            reason = "not a CSV file in UTF-8"
    if reason:
        raise DataError(
            f"{path}: {reason}; descriptors need plain CSV with commas: run bench data export "
            f"{shlex.quote(str(path))} --output DIR (with your --robot or --urdf)"
        )
    return header, rows


def _odd_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return the reason why a table is not plain; "" if it is."""
    if len(header) < 2 or not rows:
        return "has no commas between cells" if rows else "has no rows"
    if header[0].startswith("#"):
        return "its header is a remark"
    if len({*header}) < len(header) or any(not name or name != name.strip() for name in header):
        return "two columns have the same name, or a name is empty or has blanks around it"
    for number, row in enumerate(rows, start=2):
        if len(row) != len(header):
            return f"row {number} has {counted(len(row), 'cell')}, the header {len(header)}"
        if any(NUMBER.fullmatch(cell) and not cell.isascii() for cell in row):
            return f"row {number} has a number with a typographic minus sign"
    return ""


def _column(name: str, cells: Sequence[str], card: DataCard, limits: list[float] | None) -> Column:
    filled_cells = [cell for cell in cells if cell]
    numbers = (
        name not in ID_COLUMNS and all(map(NUMBER.fullmatch, filled_cells)) and bool(filled_cells)
    )
    low = high = None
    if numbers and limits is not None:  # rounding may exceed a limit in a checked row
        values = [float(cell) for cell in filled_cells]
        low, high = min(limits[0], *values), max(limits[1], *values)
        low, high = (None if np.isinf(end) else end for end in (low, high))
    meaning = card.meanings.get(name) or column_meaning(name)
    return Column(name, numbers, len(filled_cells) == len(cells), low, high, meaning)


def _key(header: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the columns that identify a row: pose and load, or the first; () if none do."""
    for names in (ID_COLUMNS[:2], header[:1]):
        if {*names} <= {*header}:
            places = [header.index(name) for name in names]
            values = [tuple(row[place] for place in places) for row in rows]
            is_number = len(names) == 1 and all(NUMBER.fullmatch(value[0]) for value in values)
            if len({*values}) == len(rows) and all(map(all, values)) and not is_number:
                return tuple(names)
    return ()


def _slug(name: str) -> str:
    """Return a valid name for a data package: lower case, no special characters."""
    return re.sub(r"[^a-z0-9._]+", "-", name.lower()).strip("-") or "data"
