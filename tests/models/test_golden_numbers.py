"""A model's version is raised with its numbers: every model against the numbers that were kept."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import golden_numbers
from golden_numbers import KEPT, KEYS, PRETRAINING_KEY, VARIANTS, finding, library, made, main
from stiff_models.model_catalog import FAMILIES, model_info
from stiff_models.networks import optimizers as muon
from stiff_models.regressors import gaussian_process as likelihood
from stiff_models.transfer import freeze

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
        ("gp", likelihood, "NOISE_BOUNDS", (1e-3, 10.0)),
        ("ft-mlp", freeze, "DISCRIMINATIVE_FACTOR", 2.5),
        (PRETRAINING_KEY, muon, "ITERATIONS", 2),
    ],
)
def test_a_changed_constant_is_found(
    key: str, place: Any, name: str, value: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place, name, value)
    if key == "ft-mlp":  # one fit is enough
        variants = [v for v in VARIANTS[key] if v.get("freeze") == "discriminative"]
        monkeypatch.setitem(VARIANTS, key, variants)
    of = "PRETRAINING_VERSION" if key == PRETRAINING_KEY else "its version"
    assert finding(key, KNOWN, made(key)).startswith(f"numbers of {key} changed: raise {of}\n")


def test_numbers_that_are_to_be_made_are_named() -> None:
    now = KNOWN["vjm"]
    assert finding("new", KNOWN, now).startswith("no golden numbers of new: make them by")
    assert "make them by" in finding("vjm", KNOWN, now | {"version": now["version"] + 1})
    more = now | {"numbers": now["numbers"] | {"another=1": [0.0]}}
    assert "another=1" in finding("vjm", KNOWN, more)


@pytest.fixture()
def another(tmp_path: Path) -> Path:
    """A file with other numbers of one model than it gives."""
    content = {key: copy.deepcopy(KNOWN[key]) for key in ("mean", "zero", "vjm")}
    content["vjm"]["numbers"][""][0] += 2e-9
    path = tmp_path / "golden.json"
    path.write_text(golden_numbers.text_of(content))
    return path


def test_the_command_refuses_numbers_that_changed_while_the_version_did_not(another: Path) -> None:
    before = another.read_bytes()
    refused = main(another, ("mean", "vjm"))
    assert refused.splitlines()[0] == "numbers of vjm changed: raise its version"
    assert "mean" not in refused and another.read_bytes() == before


def test_the_command_writes_them_where_the_version_was_raised_and_leaves_the_others(
    another: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raised = replace(model_info("vjm"), version=model_info("vjm").version + 1)
    monkeypatch.setattr(
        golden_numbers, "model_info", lambda key: raised if key == "vjm" else model_info(key)
    )
    assert main(another, ("mean", "vjm")) == ""
    content = json.loads(another.read_text())
    assert content["vjm"]["version"] == raised.version
    assert content["vjm"]["numbers"][""][0] == pytest.approx(
        KNOWN["vjm"]["numbers"][""][0], abs=1e-12
    )
    assert content["mean"] == KNOWN["mean"] and content["zero"] == KNOWN["zero"]
