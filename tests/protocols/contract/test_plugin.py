"""A catalogue entry names kind and origin of its model."""

from __future__ import annotations

import pytest

from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import Citation, ModelInfo


@pytest.mark.parametrize(
    ("authors", "text"),
    [
        (["Ada B. One"], "One, 2020"),
        (["Ada One", "Bo Two"], "One and Two, 2020"),
        (["Ada One", "Bo Two", "Cy Three"], "One et al., 2020"),
        (["the robot group"], "the robot group, 2020"),
        ([], "A title, 2020"),
    ],
)
def test_a_citation_shows_the_family_names_and_the_year(authors, text):
    assert Citation(authors=authors, year=2020, title="A title").text == text


def test_a_bibtex_entry_cannot_be_left_by_the_texts_in_it():
    hostile = Citation(
        authors=["A} @evil{x"], year=2020, title="\\input{x} 50 %\n}", url="http://a/}b%20"
    )
    entry = hostile.bibtex("a model@x={1}")
    assert entry.startswith("@misc{a-model-x-1-,\n") and entry.endswith("\n}")
    inside = [line.partition("= {")[2].removesuffix("},") for line in entry.splitlines()[1:-1]]
    assert len(inside) == 4 and not any(sign in text for text in inside for sign in "{}\\")
    assert "%" not in "".join(inside[:3]) and inside[3] == "http://a/b%20"


def test_every_shipped_model_that_learns_has_a_kind():
    assert {info.key for info in MODELS if info.kind == "other"} == {"zero", "mean", "knn"}


def test_an_unknown_kind_is_refused():
    with pytest.raises(ConfigError, match="'magic'"):
        ModelInfo(key="mine", target=object, summary="mine", kind="magic")
