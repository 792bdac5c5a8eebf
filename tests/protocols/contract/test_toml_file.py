"""TOML of settings: what is read, and what is refused before it takes time or memory."""

from __future__ import annotations

import pytest

from stiff_protocols.contract.files import read_toml


def test_tables_come_back(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[a.b]\nc = [1, [2.5, "x"]]\n', encoding="utf-8")
    assert read_toml(path) == {"a": {"b": {"c": [1, [2.5, "x"]]}}}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"a = " + b"[" * 5000 + b"]" * 5000, "inside each other"),
        (b"a = " + b"[" * 20 + b"]" * 20, "inside each other"),
        (b"a" + b".a" * 30 + b" = 1", "inside each other"),
        (b"a" + b".a" * 100_000 + b" = 1", "larger than"),
        (b"a = " + b"9" * 5000, "4300 digits"),
        (b"a = \xff", "can't decode"),
        (b"a", "Expected '='"),
    ],
)
def test_what_is_no_toml_of_settings_is_refused(tmp_path, text, message):
    path = tmp_path / "a.toml"
    path.write_bytes(text)
    with pytest.raises(ValueError, match=message):
        read_toml(path)
