"""Where stiffbench keeps files of the user."""

from __future__ import annotations

from pathlib import Path

import platformdirs
import pytest

from stiff_datasets.measured.registered import home, make_folder
from stiff_protocols.contract.errors import DataError


def test_the_environment_variable_names_the_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("STIFFBENCH_HOME", str(tmp_path / "mine"))
    assert home() == tmp_path / "mine"
    assert not home().exists()
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("STIFFBENCH_HOME", "~/mine")
    assert home() == Path("~/mine").expanduser()


@pytest.mark.parametrize("value", [None, ""])
def test_without_it_the_platforms_folder_for_user_data_is_used(monkeypatch, tmp_path, value):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("STIFFBENCH_HOME", raising=False)
    if value is not None:
        monkeypatch.setenv("STIFFBENCH_HOME", value)
    assert home() == platformdirs.user_data_path("stiffbench")


def test_a_folder_that_cannot_be_made_is_named_with_the_way_out(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(DataError, match=r"taken.sub: cannot be made: .*STIFFBENCH_HOME"):
        make_folder(tmp_path / "taken" / "sub")
