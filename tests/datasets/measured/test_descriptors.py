"""Check the descriptors of CSV files, and that Croissant and Frictionless accept them."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import pytest

from helpers.made_samples import CSV_HEADER, CSV_ROW
from helpers.shipped_descriptors import FOLDER, ROBOTS, described
from stiff_datasets.measured.data_card import parse_card
from stiff_datasets.measured.descriptors import (
    croissant,
    describe,
    descriptor_files,
    json_text,
    write_descriptors,
)
from stiff_protocols.contract.errors import DataError, StoreError

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the two libraries
shipped = pytest.mark.parametrize("name", ROBOTS)


@pytest.fixture()
def file(tmp_path) -> Path:
    path = tmp_path / "my.csv"
    path.write_text(f"{CSV_HEADER}\n{CSV_ROW}\n")
    return path


def cells(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as lines:
        return list(csv.DictReader(lines))


def is_valid(package: Path) -> bool:
    from frictionless import validate

    return validate(str(package)).valid


def records(descriptor: Path) -> list[dict[str, object]]:
    """Return the rows as mlcroissant reads them, from a descriptor without any finding."""
    from mlcroissant import Dataset

    dataset = Dataset(descriptor)
    assert dataset.metadata.ctx.issues.report() == ""
    return [
        {name.partition("/")[2]: value for name, value in record.items()}
        for record in dataset.records("samples")
    ]


def same_cell(cell: str, value: object) -> bool:
    if isinstance(value, bytes):
        return value.decode() == cell
    if cell == "":
        return value is None or value != value  # NaN
    return value == float(cell)


def test_every_data_file_that_is_shipped_has_descriptors():
    assert {path.name for path in FOLDER.glob("*.csv")} == {*ROBOTS}


@shipped
def test_the_committed_descriptors_are_those_of_file_card_and_code(name):
    package = described(name)
    written = [path.read_text("utf-8") for path in descriptor_files(FOLDER / name)]
    assert written == [json_text(croissant(package)), json_text(package)], (
        "run: python tests/helpers/shipped_descriptors.py"
    )


@pytest.mark.slow
@shipped
def test_croissant_reads_the_rows_of_the_file(name):
    rows, read = cells(FOLDER / name), records(descriptor_files(FOLDER / name)[0])
    assert len(rows) == len(read) > 0
    for row, record in zip(rows, read, strict=True):
        assert {*row} == {*record}
        assert all(same_cell(row[column], record[column]) for column in row)


@shipped
def test_frictionless_accepts_the_file(name):
    assert is_valid(descriptor_files(FOLDER / name)[1])


DAMAGES = {
    "a number changed": lambda text: text.replace("-0.686", "-0.668"),
    "a row is missing": lambda text: text[: text.rindex("P43")],
    "a row twice": lambda text: text + text.splitlines()[-1] + "\n",
    "a word in place of a number": lambda text: text.replace("-0.686", "about 0.7"),
    "a column renamed": lambda text: text.replace("dz_mm", "dz_um"),
    "a deflection that no robot has": lambda text: text.replace("-0.686", "-68.6"),
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_copy_is_refused_by_both(damage, tmp_path):
    from mlcroissant import Dataset, GenerationError

    for path in FOLDER.glob("fanuc_r2000ic.*"):
        shutil.copy(path, tmp_path)
    copy = tmp_path / "fanuc_r2000ic.csv"
    text = copy.read_text()
    copy.write_text(DAMAGES[damage](text))
    assert copy.read_text() != text
    for_croissant, package = descriptor_files(copy)
    assert not is_valid(package)
    with pytest.raises(GenerationError):
        list(Dataset(for_croissant).records("samples"))


def without_hash(package: Path) -> None:
    """Remove size, hash and row count; only the schema can then detect changes."""
    descriptor = json.loads(package.read_text())
    for name in ("bytes", "hash", "rows"):
        del descriptor["resources"][0][name]
    package.write_text(json.dumps(descriptor))


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        (",10,-60,", ",400,-60,", "constraint-error"),
        (",0.5,", ",51,", "constraint-error"),
        (",0.5,", ",,", "constraint-error"),
        (",0.5,", ",1 mm,", "type-error"),
        ("\nP1,1,", "\nP1,1,all,10,-60,70,0,40,0,50,10,-80,1,2,0,0,0,0\nP1,1,", "primary-key"),
    ],
)
def test_the_schema_tells_a_row_that_cannot_be(file, kr10, old, new, kind):
    from frictionless import validate

    package = write_descriptors(file, describe(file, kr10))[1]
    without_hash(package)
    assert is_valid(package)
    file.write_text(file.read_text().replace(old, new))
    assert kind in [error[0] for error in validate(str(package)).flatten(["type"])]


@shipped
def test_every_column_has_a_meaning_and_every_number_a_unit(name):
    for column in described(name)["resources"][0]["schema"]["fields"]:
        assert column["description"] not in ("", column["name"])
        assert ("unit" in column) == (column["type"] == "number")


@pytest.mark.slow
def test_the_facts_of_the_card_are_in_both(file):
    card = file.with_suffix(".md")
    card.write_text(
        "# Data card: Hall 3\n\n| | |\n|---|---|\n| What | Twelve poses |\n"
        "| License | [CC BY](https://creativecommons.org/licenses/by/4.0/) |\n"
        "| Paper | *A and B*, `2025` |\n| Source | <https://example.org/data>, folder 3 |\n"
        "| Version | 1.2.0 |\n| Published | 2025-03-01 |\n\n"
        "| column | meaning |\n|---|---|\n| `q1_deg` .. `q6_deg` | by encoder |\n"
        "| dx_mm | by laser tracker |\n"
    )
    package = describe(file)
    jsonld = croissant(package)
    for descriptor in (jsonld, package):
        assert descriptor["description"].startswith("Twelve poses")
        assert descriptor["version"] == "1.2.0"
    assert jsonld["name"] == package["title"] == "Hall 3" and package["name"] == "hall-3"
    assert jsonld["license"] == "https://creativecommons.org/licenses/by/4.0/"
    assert jsonld["citeAs"] == package["citation"] == "A and B, 2025"
    assert jsonld["url"] == package["sources"][0]["path"] == "https://example.org/data"
    assert jsonld["datePublished"] == package["created"][:10] == "2025-03-01"
    meanings = {field["name"]: field["description"] for field in jsonld["recordSet"][0]["field"]}
    assert meanings["q5_deg"] == "by encoder [deg]"
    assert meanings["dx_mm"] == "by laser tracker [mm]"
    write_descriptors(file, package)
    assert is_valid(descriptor_files(file)[1]) and len(records(descriptor_files(file)[0])) == 1


@pytest.mark.parametrize(
    ("text", "licence"),
    [
        ("MIT, notice below", ("MIT", "https://spdx.org/licenses/MIT.html")),
        ("cc-by-4.0", ("CC-BY-4.0", "https://spdx.org/licenses/CC-BY-4.0.html")),
        ("https://a.org/terms.", ("https://a.org/terms.", "https://a.org/terms")),
        ("ask us", ("ask us", "")),
        ("TODO: ask", ("", "")),
    ],
)
def test_a_licence_is_an_spdx_identifier_a_url_or_a_text(file, text, licence):
    card = parse_card(f"| | |\n|---|---|\n| Licence | {text} |\n", file)
    package = describe(file, card=card)
    (stated,) = package.get("licenses", [{}])
    assert (stated.get("title", ""), stated.get("path", "")) == licence
    write_descriptors(file, package)
    assert is_valid(descriptor_files(file)[1])


def test_a_file_without_a_card_has_descriptors_without_its_facts(file):
    paths = write_descriptors(file, describe(file))
    assert not {*json.loads(paths[0].read_text())} & {"license", "citeAs", "url", "version"}
    assert is_valid(paths[1])


def test_descriptors_are_replaced_unless_another_program_wrote_them(file):
    paths = write_descriptors(file, describe(file))
    file.with_suffix(".md").write_text("| | |\n|---|---|\n| Version | 2.0.0 |\n")
    assert write_descriptors(file, describe(file)) == paths
    assert json.loads(paths[1].read_text())["version"] == "2.0.0"
    for foreign_text in ('{"name": "mine"}', "[]", "no JSON"):
        for path in paths:
            write_descriptors(file, describe(file))
            path.write_text(foreign_text)
            with pytest.raises(StoreError, match=re.escape(f"{path}: exists")):
                write_descriptors(file, describe(file))
            assert path.read_text() == foreign_text
            path.unlink()


@pytest.mark.parametrize(
    "content",
    [
        f"{CSV_HEADER}\n{CSV_ROW}\n".replace(",", ";").encode(),
        b"\xef\xbb\xbf" + f"{CSV_HEADER}\n{CSV_ROW}\n".encode(),
        f"{CSV_HEADER}\n{CSV_ROW}\n".encode("utf-16"),
        f"# by hand\n{CSV_HEADER}\n{CSV_ROW}\n".encode(),
        f"{CSV_HEADER}\n\n{CSV_ROW}\n".encode(),
        f"{CSV_HEADER}\n{CSV_ROW},5\n".encode(),
        f"{CSV_HEADER}\n".encode(),
        b"",
        b'a,b\n"1,2',
    ],
)
def test_a_file_that_is_not_plain_csv_is_refused_with_the_command_that_writes_it(file, content):
    file.write_bytes(content)
    with pytest.raises(DataError, match=rf"{file}: .*bench data export {file} --output DIR"):
        describe(file)


def test_limits_of_joints_are_the_robots(file, kr10):
    fields = describe(file, kr10)["resources"][0]["schema"]["fields"]
    constraints = {field["name"]: field.get("constraints", {}) for field in fields}
    assert (constraints["q1_deg"]["minimum"], constraints["q1_deg"]["maximum"]) == (-170.0, 170.0)
    assert constraints["fx_N"] == constraints["pose_id"] == {"required": True}
