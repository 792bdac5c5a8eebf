"""`bench data register` and `bench data export`: their files, output and refusals."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from helpers.command_line import assert_refused, bench_here
from helpers.shipped_descriptors import FOLDER
from stiff_datasets.measured.descriptors import descriptor_files

ALL_ROWS = (FOLDER / "fanuc_r2000ic.csv").read_text().splitlines(keepends=True)
CSV = "".join(ALL_ROWS[:16])
MADE = ["my.croissant.json", "my.csv", "my.datapackage.json", "my.md"]


@pytest.fixture()
def place(tmp_path, monkeypatch) -> Path:
    """Return a folder with rows of the FANUC as `my.csv`, and registrations in `home`."""
    monkeypatch.setenv("STIFFBENCH_HOME", str(tmp_path / "home"))
    (tmp_path / "my.csv").write_text(CSV)
    return tmp_path


def done(place: Path, words: str) -> str:
    done = bench_here(*words.split(), cwd=place)
    assert done.returncode == 0, done.stderr
    return done.stdout


def names(place: Path) -> list[str]:
    return sorted(path.name for path in place.iterdir())


def package(path: Path) -> dict:
    return json.loads(path.read_text())


REGISTER = "data register my.csv --robot fanuc-r2000ic --no-torque"


@pytest.mark.slow
def test_a_file_gets_a_card_to_fill_in_and_descriptors_that_follow_it(place):
    printed = done(place, f"{REGISTER} --licence CC-BY-4.0")
    assert names(place) == MADE
    assert "15 samples of fanuc_r2000ic" in printed and "| Citation |" in printed
    assert "| Licence |" not in printed
    first = package(place / "my.datapackage.json")
    assert first["licenses"][0]["name"] == "CC-BY-4.0" and "citation" not in first
    card = place / "my.md"
    filled = card.read_text().replace("TODO: authors, title and year, or the DOI", "Me, 2026")
    card.write_text(filled)
    assert "| Citation |" not in done(place, REGISTER)
    assert card.read_text() == filled
    assert package(place / "my.datapackage.json")["citation"].startswith("Me, 2026")


@pytest.mark.slow
def test_a_card_of_ones_own_is_never_changed(place):
    (place / "my.md").write_text("Torques were not measured.\n")
    refused = bench_here(*REGISTER.split(), "--licence", "MIT", cwd=place)
    assert_refused(refused, "--licence", "my.md")
    assert names(place) == ["my.csv", "my.md"]
    done(place, REGISTER)
    assert (place / "my.md").read_text() == "Torques were not measured.\n"
    assert names(place) == MADE


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ("data register my.csv", ["--urdf", "--robot"]),
        ("data register my.csv --robot ur5 --dataset kr10-measured", ["--robot ur5"]),
        ("data register semicolons.csv --robot fanuc-r2000ic", ["bench data export semicolons"]),
        ("data export kr10-twin --output my.csv", ["my.csv"]),
        ("data export kr10-twin --robot ur5 --output out", ["kr10-twin"]),
    ],
)
def test_what_cannot_be_shared_is_refused_and_nothing_is_written(place, words, parts):
    (place / "semicolons.csv").write_text(CSV.replace(",", ";"))
    before = names(place)
    assert_refused(bench_here(*words.split(), cwd=place), *parts)
    assert names(place) == before


@pytest.mark.slow
def test_a_named_file_may_have_any_form_but_gets_no_descriptors_then(place):
    table = sb.load_dataset("kr10-twin").frame()
    table.to_csv(place / "kr10.csv", sep=";", decimal=",", index=False)
    printed = done(place, "data register kr10.csv --dataset kr10-measured")
    assert "bench run --dataset kr10-measured" in printed and "no descriptors" in printed
    assert names(place) == ["home", "kr10.csv", "my.csv"]
    done(place, "data export kr10-measured --output out")
    exported = pd.read_csv(place / "out" / "kr10-measured.csv")
    np.testing.assert_allclose(exported["dx_mm"], table["dx_mm"], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("empty_pictures")
def test_what_is_exported_of_a_simulation_never_passes_for_a_measurement(place):
    done(place, "data export kr10-twin --output out")
    printed = done(place, "data info out/kr10-twin.csv --robot kr10-r1100-2")
    assert "caveat: kr10-twin.csv is simulated" in printed
    words = "data register out/kr10-twin.csv --dataset kr10-measured"
    assert_refused(bench_here(*words.split(), cwd=place), "SIMULATED")
    assert "home" not in names(place)


@pytest.mark.slow
def test_the_commands_that_follow_can_be_pasted_and_name_the_robot(place):
    words = ["data", "export", "my.csv", "--robot", "fanuc-r2000ic", "--no-torque"]
    printed = bench_here(*words, "--output", "out dir ü", cwd=place).stdout
    (command,) = (line for line in printed.splitlines() if line.startswith("then run bench"))
    words = shlex.split(command)[3:]
    assert words[:3] == ["data", "register", "out dir ü/my.csv"]
    assert words[3:5] == ["--urdf", "out dir ü/my.urdf"]
    (place / "a b.csv").write_bytes((place / words[2]).read_bytes())
    options = [*words[3:], "--pose-tolerance", "0.1"]
    registered = bench_here("data", "register", "a b.csv", *options, cwd=place)
    assert registered.returncode == 0, registered.stderr
    check = re.search(r"which bench (data validate .*) lists", registered.stdout)  # of torques
    assert check
    words = shlex.split(check[1])
    assert words[:3] == ["data", "validate", "a b.csv"] and sorted(words[3:]) == sorted(options)
    assert "every torque is zero" in bench_here(*words, cwd=place).stdout


@pytest.mark.slow
@pytest.mark.parametrize("word", ["kr10-twin@plan=wide", "fanuc-r2000ic"])
def test_an_export_is_that_of_python_and_is_registered_with_the_words_of_its_card(place, word):
    printed, data = done(place, f"data export {word} --output out"), sb.load_dataset(word)
    assert data.data.sha256 in printed
    data.export(place / "python")
    for path in (place / "python").iterdir():
        assert path.read_bytes() == (place / "out" / path.name).read_bytes()
    stem = word.replace("@", "_")
    csv, card, urdf = (place / "out" / f"{stem}{ending}" for ending in (".csv", ".md", ".urdf"))
    (row,) = (line for line in card.read_text().splitlines() if line.startswith("| Read by"))
    tcp = row.split("--tcp ")[1].split("`")[0]
    _, frictionless = descriptor_files(csv)
    assert ("simulated" in package(frictionless)["keywords"]) == (word != "fanuc-r2000ic")
    before = frictionless.read_text()
    assert data.robot.name in done(place, f"data register {csv} --urdf {urdf} --tcp {tcp}")
    assert frictionless.read_text() == before
