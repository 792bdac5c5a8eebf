"""Check that files are written completely or not at all; check reading TOML."""

from __future__ import annotations

import pytest

from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.files import make_folder, read_toml, written_whole


def test_a_file_appears_whole(tmp_path):
    path = tmp_path / "a.csv"
    with written_whole(path) as temporary:
        temporary.write_text("new")
        assert not path.exists() and temporary.suffix == ".csv"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("stop", [ValueError, KeyboardInterrupt, SystemExit])
def test_the_old_file_stands_after_whatever_stops_the_new_one(tmp_path, stop):
    path = tmp_path / "a.csv"
    path.write_text("old")
    with pytest.raises(stop), written_whole(path) as temporary:
        temporary.write_text("half")
        raise stop
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_named(tmp_path):
    with (
        pytest.raises(StoreError, match=r"absent/a\.csv: cannot be written: No such file"),
        written_whole(tmp_path / "absent" / "a.csv"),
    ):
        pass
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="file/folder: cannot create this folder: Not a directory"):
        make_folder(tmp_path / "file" / "folder")


def test_tables_of_a_toml_file_come_back(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[a.b]\nc = [1, [2.5, "x"]]\n', encoding="utf-8")
    assert read_toml(path) == {"a": {"b": {"c": [1, [2.5, "x"]]}}}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"a = \xff", "can't decode"),
        (b"a", "Expected '='"),
    ],
)
def test_what_is_no_toml_of_settings_is_refused(tmp_path, text, message):
    path = tmp_path / "a.toml"
    path.write_bytes(text)
    with pytest.raises(DataError, match=rf"a\.toml: not TOML: .*{message}"):
        read_toml(path)
