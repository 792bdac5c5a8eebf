"""Every reader takes a file or refuses it in one line that names it, whatever is in the file."""

from __future__ import annotations

import pytest
from fuzz.fuzzing import fuzz
from fuzz.readers import READERS

FEW, MANY = 20, 500


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_by_name(name, tmp_path):
    count = fuzz(name, tmp_path, FEW, seed=0)
    assert count.refused > FEW / 4  # or the damage is none


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_hundreds_of_damaged_files_are_read_or_refused_by_name(name, tmp_path):
    count = fuzz(name, tmp_path, MANY, seed=1)
    assert count.accepted > 0
    assert count.refused > MANY / 4
