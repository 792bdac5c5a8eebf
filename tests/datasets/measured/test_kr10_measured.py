"""Check registering and reading a user's KR10 measurement."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from helpers.made_samples import CSV_HEADER as HEADER
from helpers.made_samples import CSV_ROW as GOOD
from stiff_datasets.measured.kr10_measured import Kr10Measured, missing, register, registry_file
from stiff_protocols.contract.errors import DataError

KEY = "kr10-measured"
TCP = (0.06, 0.0, 0.08)
NOTHING = "no file registered: bench data register FILE.csv --dataset kr10-measured"


@pytest.fixture(autouse=True)
def home(monkeypatch, tmp_path):
    monkeypatch.setenv("STIFFBENCH_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture()
def csv(tmp_path):
    """Write a file of invented numbers in the schema."""
    path = tmp_path / "my.csv"
    path.write_text(f"{HEADER}\n{GOOD}\n")
    return path


def write_registry(text):
    registry_file().parent.mkdir(parents=True, exist_ok=True)
    registry_file().write_bytes(text.encode("latin-1"))


def test_nothing_is_there_until_a_user_registers_it(home):
    assert missing() == NOTHING
    with pytest.raises(DataError, match=NOTHING):
        Kr10Measured().load()
    assert not home.exists()


def test_a_registered_file_is_read_with_the_shipped_robot_and_its_tcp(csv, kr10):
    path = register(KEY, csv, None, TCP)
    assert missing() == ""
    data = Kr10Measured().load()
    assert data.robot.name == kr10.name
    np.testing.assert_array_equal(data.robot.tcp, kr10.tcp)
    np.testing.assert_allclose(data.samples.deflection, [[0.5e-3, 0.1e-3, -0.9e-3]])
    table = {"csv": str(csv), "tcp": list(TCP), "no_torque": False, "pose_tolerance": 0.05}
    table["register"] = False
    assert tomllib.loads(path.read_text()) == {KEY: table}


def test_a_urdf_of_ones_own_replaces_the_shipped_robot_and_other_tables_stay(csv, tmp_path):
    write_registry('[other]\ncsv = "x.csv"\n\n[kr10-measured]\nurdf = "old.urdf"\n')
    urdf = tmp_path / "mine.urdf"
    shipped = (files("stiff_datasets.robots") / "kr10_r1100_2.urdf").read_text()
    urdf.write_text(shipped.replace('name="kr10_r1100_2"', 'name="mine"'))
    register(KEY, csv, urdf, TCP)
    assert Kr10Measured().load().robot.name == "mine"
    tables = tomllib.loads(registry_file().read_text())
    assert tables["other"] == {"csv": "x.csv"}
    assert tables[KEY]["urdf"] == str(urdf)


@pytest.mark.parametrize(
    ("name", "line", "urdf", "tcp", "message"),
    [
        ("my", GOOD.replace("-60", "60"), None, TCP, r"row 2, column q2_deg: '60'"),
        ("my", GOOD.replace("0.5", "abc"), None, TCP, r"row 2, column dx_mm: 'abc'"),
        ("my", GOOD, None, (60.0, 0.0, 80.0), "three lengths in m"),
        ("my", GOOD, Path("absent.urdf"), TCP, r"absent\.urdf: cannot read"),
        ("absent", GOOD, None, TCP, r"absent\.csv: cannot be read: No such file"),
    ],
)
def test_what_cannot_be_read_is_not_registered(home, csv, name, line, urdf, tcp, message):
    csv.write_text(f"{HEADER}\n{line}\n")
    with pytest.raises(DataError, match=message):
        register(KEY, csv.with_stem(name), urdf, tcp)
    assert not home.exists()
    assert missing() == NOTHING


def test_a_registered_file_that_is_gone_is_named_with_what_to_do(csv):
    register(KEY, csv, None, TCP)
    csv.unlink()
    reason = r"my\.csv: the registered file is gone: bench data register FILE"
    with pytest.raises(DataError, match=reason):
        Kr10Measured().load()
    assert missing().endswith("FILE.csv --dataset kr10-measured")


def test_a_folder_of_a_user_who_does_not_exist_is_named(monkeypatch):
    monkeypatch.setenv("STIFFBENCH_HOME", "~nosuchuser/x")
    with pytest.raises(DataError, match="STIFFBENCH_HOME=~nosuchuser/x: "):
        Kr10Measured().load()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[kr10-measured\n", "not TOML"),
        ("caf\xe9 = 1\n", "not TOML"),
        ("kr10-measured = 3\n", r"table \[kr10-measured\]: .*; register again"),
        ('[kr10-measured]\ncsv = "a.csv"\n', r"table \[kr10-measured\]: tcp: .*; register again"),
        (
            "[kr10-measured]\ncsv = 5\ntcp = [0, 0, 1]\n",
            r"table \[kr10-measured\]: csv: .* string, not 5; register again",
        ),
        (
            '[kr10-measured]\ncsv = "a.csv"\nurdf = 3\ntcp = [0, 0, "a"]\n',
            r"table \[kr10-measured\]: tcp.2: .* number.*, not 'a'; urdf: .* string, not 3; reg",
        ),
        (
            '[kr10-measured]\ncsv = "a.csv"\ntcp = [0, 0, 1]\nsha256 = "a"\n',
            r"table \[kr10-measured\]: .*'sha256'; register again",
        ),
    ],
)
def test_a_damaged_file_of_registrations_is_one_clear_error(csv, text, message):
    write_registry(text)
    before = registry_file().read_bytes()
    with pytest.raises(DataError, match=message) as caught_error:
        Kr10Measured().load()
    assert str(registry_file()) in str(caught_error.value)
    assert "\n" not in str(caught_error.value)
    assert missing() == str(caught_error.value)
    if "not TOML" in message:  # and is never overwritten
        with pytest.raises(DataError, match=r"not TOML."):
            register(KEY, csv, None, TCP)
        assert registry_file().read_bytes() == before
