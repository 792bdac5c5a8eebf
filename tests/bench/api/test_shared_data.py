"""`bench data register` and `bench data export`: their files, output and refusals."""

from __future__ import annotations

import json
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


def test_a_named_file_may_have_any_form_but_gets_no_descriptors_then(place):
    table = sb.load_dataset("kr10-twin").frame()
    table.to_csv(place / "kr10.csv", sep=";", decimal=",", index=False)
    printed = done(place, "data register kr10.csv --dataset kr10-measured")
    assert "bench run --dataset kr10-measured" in printed and "no descriptors" in printed
    assert names(place) == ["home", "kr10.csv", "my.csv"]
    done(place, "data export kr10-measured --output out")
    exported = pd.read_csv(place / "out" / "kr10-measured.csv")
    np.testing.assert_allclose(exported["dx_mm"], table["dx_mm"], rtol=1e-12)


@pytest.mark.usefixtures("empty_pictures")
def test_what_is_exported_of_a_simulation_never_passes_for_a_measurement(place):
    done(place, "data export kr10-twin --output out")
    printed = done(place, "data info out/kr10-twin.csv --robot kr10-r1100-2")
    assert "caveat: kr10-twin.csv is simulated" in printed
    words = "data register out/kr10-twin.csv --dataset kr10-measured"
    assert_refused(bench_here(*words.split(), cwd=place), "SIMULATED")
    assert "home" not in names(place)


@pytest.mark.parametrize(
    ("word", "stem"),
    [
        ("kr10-twin@plan=wide", "kr10-twin_plan=wide"),
        pytest.param("arm-family@robot=3", "arm-family_robot=3", marks=pytest.mark.slow),
        ("fanuc-r2000ic", "fanuc-r2000ic"),
    ],
)
def test_an_export_reads_back_with_the_words_of_its_card_and_is_registered(place, word, stem):
    printed = done(place, f"data export {word} --output out")
    made = [place / "out" / f"{stem}{ending}" for ending in (".csv", ".md", ".urdf")]
    assert all(path.is_file() for path in made) and len(names(place / "out")) == 5
    (row,) = (line for line in made[1].read_text().splitlines() if line.startswith("| Read by"))
    tcp = row.split("--tcp ")[1].split("`")[0]
    robot = sb.read_robot(made[2], tcp=[float(x) for x in tcp.split(",")])
    read, data = sb.read_samples(made[0], robot=robot), sb.load_dataset(word)
    np.testing.assert_allclose(read.samples.q, data.samples.q, rtol=1e-15)
    np.testing.assert_array_equal(read.samples.deflection, data.samples.deflection)
    assert read.data.sha256 in printed and data.data.sha256 in printed
    _, frictionless = descriptor_files(made[0])
    assert ("simulated" in package(frictionless)["keywords"]) == (word != "fanuc-r2000ic")
    before = frictionless.read_text()
    done(place, f"data register out/{stem}.csv --urdf out/{stem}.urdf --tcp {tcp}")
    assert frictionless.read_text() == before


def test_python_exports_the_same(place):
    text = sb.load_dataset("kr10-twin").export(place / "python")
    assert "kr10-twin.csv" in text
    done(place, "data export kr10-twin --output command")
    for path in (place / "python").iterdir():
        assert path.read_bytes() == (place / "command" / path.name).read_bytes()
