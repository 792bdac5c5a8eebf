"""Compare every model with its golden numbers; changed numbers need a new version."""

from __future__ import annotations

import json
from typing import Any

import pytest

from golden_numbers import (
    GOLDEN_FILE,
    KEYS,
    PRETRAINING_KEY,
    current_numbers,
    describe_problem,
    library,
)
from stiff_models.model_catalog import FAMILIES, model_info
from stiff_models.networks import muon
from stiff_models.physics import full_vjm

STORED_ENTRIES: dict[str, Any] = json.loads(GOLDEN_FILE.read_text())


LONG = ("dt-cnn", "ft-mlp", "mlp-pretrained", "deep-ensemble", "compliance-net")
"""Models whose many variants take seconds."""


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=[pytest.mark.slow] * (key in LONG)) for key in KEYS]
)
def test_a_model_gives_the_numbers_of_its_version(key: str) -> None:
    if key != PRETRAINING_KEY and (reason := model_info(key).missing()):
        pytest.skip(reason)
    entry = STORED_ENTRIES.get(key)
    if entry is not None and entry["library"] != library(key):
        pytest.skip(f"golden numbers of {entry['library']}, here is {library(key)}")
    if problem := describe_problem(key, STORED_ENTRIES, current_numbers(key)):
        pytest.fail(problem, pytrace=False)


def test_every_family_has_a_place_and_what_is_in_no_catalogue_has_none() -> None:
    assert not STORED_ENTRIES.keys() - set(KEYS)
    for family in FAMILIES:
        assert any(key.startswith(family.prefix) for key in KEYS)


@pytest.mark.parametrize(
    ("key", "module", "name", "value"),
    [
        ("vjm-full", full_vjm, "TURN_RATIO", 4.0),
        (PRETRAINING_KEY, muon, "ITERATIONS", 2),
    ],
)
def test_a_changed_constant_is_found(
    key: str, module: Any, name: str, value: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, name, value)
    version_name = "PRETRAINING_VERSION" if key == PRETRAINING_KEY else "its version"
    assert describe_problem(key, STORED_ENTRIES, current_numbers(key)).startswith(
        f"numbers of {key} changed: raise {version_name}\n"
    )


def test_numbers_that_are_to_be_made_are_named() -> None:
    entry = STORED_ENTRIES["vjm"]
    assert describe_problem("new", STORED_ENTRIES, entry).startswith(
        "no golden numbers of new: make them by"
    )
    assert "make them by" in describe_problem(
        "vjm", STORED_ENTRIES, entry | {"version": entry["version"] + 1}
    )
