"""A model's version is raised with its numbers: every model against the numbers that were kept."""

from __future__ import annotations

import json
from typing import Any

import pytest

from golden_numbers import KEPT, KEYS, PRETRAINING_KEY, finding, library, made
from stiff_models.model_catalog import FAMILIES, model_info
from stiff_models.networks import muon
from stiff_models.physics import full_vjm

KNOWN: dict[str, Any] = json.loads(KEPT.read_text())


LONG = ("dt-cnn", "ft-mlp", "mlp-pretrained", "deep-ensemble", "compliance-net", "tradaboost")
"""Seconds each: their many variants."""


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=[pytest.mark.slow] * (key in LONG)) for key in KEYS]
)
def test_a_model_gives_the_numbers_of_its_version(key: str) -> None:
    if key != PRETRAINING_KEY and (why := model_info(key).missing()):
        pytest.skip(why)
    kept = KNOWN.get(key)
    if kept is not None and kept["library"] != library(key):
        pytest.skip(f"golden numbers of {kept['library']}, here is {library(key)}")
    if found := finding(key, KNOWN, made(key)):
        pytest.fail(found, pytrace=False)


def test_every_family_has_a_place_and_what_is_in_no_catalogue_has_none() -> None:
    assert not KNOWN.keys() - set(KEYS)
    for family in FAMILIES:
        assert any(key.startswith(family.prefix) for key in KEYS)


@pytest.mark.parametrize(
    ("key", "place", "name", "value"),
    [
        ("vjm-full", full_vjm, "TURN_RATIO", 4.0),
        (PRETRAINING_KEY, muon, "ITERATIONS", 2),
    ],
)
def test_a_changed_constant_is_found(
    key: str, place: Any, name: str, value: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place, name, value)
    of = "PRETRAINING_VERSION" if key == PRETRAINING_KEY else "its version"
    assert finding(key, KNOWN, made(key)).startswith(f"numbers of {key} changed: raise {of}\n")


def test_numbers_that_are_to_be_made_are_named() -> None:
    now = KNOWN["vjm"]
    assert finding("new", KNOWN, now).startswith("no golden numbers of new: make them by")
    assert "make them by" in finding("vjm", KNOWN, now | {"version": now["version"] + 1})
