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
from pathlib import Path
from typing import Any

import numpy as np

from stiff_datasets.measured.data_card import DataCard, read_card
from stiff_datasets.measured.sample_columns import (
    COLUMNS,
    DEFLECTION_COLUMNS,
    ID_COLUMNS,
    LOADED_COLUMNS,
    column_unit,
    counted,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.sample_file import MAX_DEFLECTION_MM
from stiff_datasets.measured.table_reader import NUMBER
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.types import Robot

Descriptor = dict[str, Any]
"""A JSON object."""
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
PROFILES = "https://datapackage.org/profiles/2.0"
CONTEXT: Descriptor = {
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


def describe(path: Path, robot: Robot | None = None, card: DataCard | None = None) -> Descriptor:
    """Return the Frictionless data package of a CSV file as a JSON object.

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
    name = card.name or path.stem
    limits, columns = _limits(robot), zip(header, zip(*rows, strict=True), strict=True)
    fields = [_field(column, cells, card, limits) for column, cells in columns]
    licence, licence_url = _licence(card)
    source, source_url = card.text("source"), card.url("source")
    spdx = {"name": licence if licence in LICENCES else "other", "title": licence}
    version = re.match(r"\d+\.\d+\.\d+", card.text("version"))
    published = re.search(r"\d{4}-\d{2}-\d{2}", card.text("published"))
    what = card.text("what").rstrip(".") or f"{path.name}, without a data card"
    robot_text = card.text("robot").rstrip(".")
    sentences = [what, f"Robot: {robot_text}" * bool(robot_text), counted(len(rows), "row")]
    subjects = ["deflection"] if {*header} & {*DEFLECTION_COLUMNS, *LOADED_COLUMNS} else []
    subjects += ["simulated"] if card.kind == "simulated" else []
    key = _key(header, rows)
    return {
        "$schema": f"{PROFILES}/datapackage.json",
        "name": re.sub(r"[^a-z0-9._]+", "-", name.lower()).strip("-") or "data",
        "title": name,
        "description": f"{'. '.join(filter(None, sentences))}.",
        **_stated(
            version=version and version[0],
            created=published and f"{published[0]}T00:00:00Z",
            licenses=licence and [spdx | _stated(path=licence_url)],
            sources=source and [{"title": source} | _stated(path=source_url)],
            citation=card.text("citation"),
        ),
        "keywords": ["industrial robot", "stiffness", *subjects],
        "generator": GENERATOR,
        "resources": [
            {
                "$schema": f"{PROFILES}/dataresource.json",
                "name": "samples",
                "type": "table",
                "path": path.name,
                "format": "csv",
                "mediatype": "text/csv",
                "encoding": "utf-8",
                "bytes": len(content),
                "hash": f"sha256:{hashlib.sha256(content).hexdigest()}",
                "rows": len(rows),
                "schema": {
                    "$schema": f"{PROFILES}/tableschema.json",
                    "fields": fields,
                    **_stated(primaryKey=key),
                },
            }
        ],
    }


def croissant(package: Descriptor) -> Descriptor:
    """Return the Croissant 1.0 metadata of a described file as a JSON object."""
    (file,), records = package["resources"], "samples"
    n_rows = counted(file["rows"], "row")
    (licence,) = package.get("licenses", [{}])
    (source,) = package.get("sources", [{}])
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"{records}/{column['name']}",
            "name": column["name"],
            "description": column["description"],
            "dataType": "sc:Float" if column["type"] == "number" else "sc:Text",
            **_stated(unitText=column.get("unit")),
            "source": {"fileObject": {"@id": file["path"]}, "extract": {"column": column["name"]}},
        }
        for column in file["schema"]["fields"]
    ]
    key = [{"@id": f"{records}/{name}"} for name in file["schema"].get("primaryKey", ())]
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": package["title"],
        "description": package["description"],
        **_stated(
            license=licence.get("path") or licence.get("title"),
            url=source.get("path"),
            citeAs=package.get("citation"),
            version=package.get("version"),
            datePublished=package.get("created", "")[:10],
        ),
        "keywords": package["keywords"],
        "isLiveDataset": False,
        "sdPublisher": {"@type": "Organization", "name": GENERATOR},
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": file["path"],
                "name": file["path"],
                "contentUrl": file["path"],
                "contentSize": f"{file['bytes']} B",
                "encodingFormat": "text/csv",
                "sha256": file["hash"].removeprefix("sha256:"),
            }
        ],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": records,
                "name": records,
                "description": f"{n_rows}, in the units of the columns' names",
                **_stated(key=key),
                "field": fields,
            }
        ],
    }


def _licence(card: DataCard) -> tuple[str, str]:
    """Return SPDX identifier (or the card's own text) and URL of the licence, "" if unknown."""
    text, url = card.text("licence"), card.url("licence")
    word = re.split(r"[,;\s(]", text, maxsplit=1)[0].lower()
    for identifier in LICENCES:
        if identifier.lower() == word:
            return identifier, url or f"https://spdx.org/licenses/{identifier}.html"
    return text, url


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


def write_descriptors(path: Path, package: Descriptor) -> tuple[Path, Path]:
    """Write Croissant and the data `package` next to a CSV file, and return their names.

    Existing descriptors of stiffbench are replaced.

    Raises:
        StoreError: as `check_descriptor_files`, or a descriptor cannot be written.
    """
    check_descriptor_files(path)
    paths = descriptor_files(path)
    for descriptor_path, descriptor in zip(paths, (croissant(package), package), strict=True):
        with written_whole(descriptor_path) as temporary:
            temporary.write_text(json_text(descriptor), encoding="utf-8")
    return paths


def json_text(descriptor: Descriptor) -> str:
    """Return a descriptor as indented JSON."""
    return json.dumps(descriptor, indent=1, ensure_ascii=False) + "\n"


def _stated(**facts: Any) -> Descriptor:
    """Return the facts that are not empty."""
    return {name: value for name, value in facts.items() if value}


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


def _limits(robot: Robot | None) -> dict[str, list[float]]:
    """Return the ends of joint positions and deflections, in the units of their columns."""
    limits = {name: [-MAX_DEFLECTION_MM, MAX_DEFLECTION_MM] for name in DEFLECTION_COLUMNS}
    if robot is not None:
        ends = np.round(np.stack([robot.lower, robot.upper]) * file_units(robot), 6)
        limits |= dict(zip(joint_columns(robot), ends.T.tolist(), strict=True))
    return limits


def _field(
    name: str, cells: Sequence[str], card: DataCard, limits: dict[str, list[float]]
) -> Descriptor:
    """Return a column in Frictionless' words; numbers in it widen its limits."""
    filled_cells, unit = [cell for cell in cells if cell], column_unit(name)
    is_number = name not in ID_COLUMNS and bool(filled_cells)
    is_number = is_number and all(map(NUMBER.fullmatch, filled_cells))
    constraints: Descriptor = {"required": True} if len(filled_cells) == len(cells) else {}
    if is_number and name in limits:  # rounding may exceed a limit in a checked row
        values = [float(cell) for cell in filled_cells]
        ends = {"minimum": min(limits[name][0], *values), "maximum": max(limits[name][1], *values)}
        constraints |= {end: value for end, value in ends.items() if not np.isinf(value)}
    meaning = card.meanings.get(name) or (COLUMNS[name].meaning if name in COLUMNS else "")
    return {
        "name": name,
        "type": "number" if is_number else "string",
        "description": f"{meaning}{f' [{unit}]' if unit else ''}".strip() or name,
        **_stated(unit=unit, constraints=constraints),
    }


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
