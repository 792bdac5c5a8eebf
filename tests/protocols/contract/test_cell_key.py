"""Check that a cell's key and seed are stable, and that fields change them."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import pytest

from stiff_protocols.contract.record import READING_OPTION, Fit

FIT = Fit(
    model="ft-mlp",
    model_params={"freeze": "layers:1,2", "width": 380, "learning_rate": 1e-3, "ü": None},
    dataset="kr10-twin",
    dataset_params={"specimen": 3, "seed": 0},
    data_sha256="11",
    protocol="sample-efficiency",
    protocol_params={"sizes": [10, 20], "folds": 5},
    split_index=2,
    split_sha256="22",
    seed=7,
    coverage=0.9,
    condition="n = 10",
    rows_sha256="33",
    source_sha256="44",
)
PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
from protocols.contract.test_cell_key import FIT
print(FIT.key, FIT.model_seed)
"""
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def test_the_key_is_the_same_in_a_process_that_hashes_or_writes_otherwise():
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(Path(__file__).parents[2])],
        env=os.environ | ASCII | {"PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert process.stdout.strip() == f"{FIT.key} {FIT.model_seed}"


@pytest.mark.parametrize("name", ["model_params", "dataset_params", "protocol_params"])
def test_the_key_does_not_depend_on_the_order_of_options(name):
    options = getattr(FIT, name)
    for order in itertools.permutations(options):
        reordered_cell = replace(FIT, **{name: {key: options[key] for key in order}})
        assert (reordered_cell.key, reordered_cell.model_seed) == (FIT.key, FIT.model_seed)


CHANGED = {
    str: lambda value: f"{value}x",
    int: lambda value: value + 1,
    float: lambda value: value / 2,
    dict: lambda value: value | {"another": 1},
}


@pytest.mark.parametrize("name", [item.name for item in fields(Fit)])
def test_every_field_of_a_cell_changes_its_key(name):
    """Test all fields, so that new ones are included."""
    value = getattr(FIT, name)
    assert replace(FIT, **{name: CHANGED[type(value)](value)}).key != FIT.key


NO_PART_OF_THE_SEED = {
    **{"model": "gp", "model_params": {}, "model_version": "2", "interval_version": 9},
    **{"coverage": 0.5, "condition": "n = 20", "split_sha256": "23", "source_sha256": ""},
    "protocol_params": FIT.protocol_params | {READING_OPTION: "all"},
}


def test_a_cell_has_the_key_and_the_seed_that_it_always_had():
    """A changed key loses stored results; a changed seed changes random models."""
    plain_cell = Fit("m", {"a": 1, "b": 2.5}, "d", {}, "00", "p", {}, 0, "11", 0)
    assert plain_cell.key == "8a49b67bbeadb3aae6d65663"
    versioned_cell = replace(
        plain_cell, model_version="2", interval_version=2, coverage=0.9, source_sha256="x"
    )
    assert (
        replace(versioned_cell, condition="n = 5", rows_sha256="y").key
        == "dbb33d74898fbad004e67ddb"
    )
    assert FIT.model_seed == 2208388108
    for name, value in NO_PART_OF_THE_SEED.items():
        assert replace(FIT, **{name: value}).model_seed == FIT.model_seed, name
    other_cell = replace(FIT, dataset="my-robot-ü", rows_sha256="", seed=2**32 + 5)
    assert other_cell.model_seed == 3571893947


@pytest.mark.parametrize("name", ["model_params", "dataset_params", "protocol_params"])
def test_every_option_and_its_type_changes_the_key(name):
    options = getattr(FIT, name)
    for option in options:
        variants = [options | {option: value} for value in ("other", 2.5, False)]
        variants.append({key: value for key, value in options.items() if key != option})
        keys = {replace(FIT, **{name: variant}).key for variant in (options, *variants)}
        assert len(keys) == 5
    for values in ((1, "1"), ([10, 20], [20, 10])):
        keys = {replace(FIT, model_params={"a": value}).key for value in values}
        assert len(keys) == 2
