"""The card of a submission: a TOML file about a model and its authors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.files import read_toml
from stiff_protocols.contract.plugin import Citation, ModelKind

Text = Annotated[str, Field(min_length=1, max_length=2000)]
Line = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\n]*$")]


class Card(BaseModel):
    """A model and its authors.

    Attributes:
        name: name of the method.
        model: name on the command line, with options: "my-model@ridge=0.1".
        plugin: file name of the plugin, next to the card.
        kind: what the model is made of.
        authors: names.
        year: of the method.
        contact: e-mail address or account; this or `url`.
        url: address of the method or its code.
        reference: paper or report, with its DOI; "none" if there is none.
        licence: SPDX identifier of the plugin file's licence, such as "MIT".
        summary: the method in one or two sentences.
        tuned_on: data on which options were chosen; "none" if none were.
        hardware: machine that the method needs, such as "one CPU core".
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Line
    model: Line
    plugin: Annotated[str, Field(pattern=r"^[A-Za-z]\w*\.py$")]
    kind: ModelKind
    authors: Annotated[list[Line], Field(min_length=1)]
    year: Annotated[int, Field(ge=1950, le=2100)]
    contact: Annotated[str, Field(max_length=200)] = ""
    url: Annotated[str, Field(max_length=200)] = ""
    reference: Text
    licence: Line
    summary: Text
    tuned_on: Text
    hardware: Text

    @model_validator(mode="after")
    def _reachable(self) -> Card:
        if not (self.contact or self.url):
            raise ValueError("give contact or url")
        return self

    @property
    def citation(self) -> Citation:
        """Return what to cite: the method by its name."""
        return Citation(authors=self.authors, year=self.year, title=self.name, url=self.url)


def read_card(path: Path) -> Card:
    """Read a card.

    Raises:
        ConfigError: the file cannot be read, or a key or value is wrong; the message names it.
    """
    content = read_toml(path, error=ConfigError)
    try:
        return Card.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {describe_problem(error, Card)}") from None


def describe_problem(error: ValidationError, model: type[BaseModel]) -> str:
    """Return a text with the wrong field, its value, and valid values."""
    problem: Any = min(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    key = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        return str(unknown_name("key", key, model.model_fields))
    if problem["type"] == "missing":
        return f"{key} is missing (valid keys: {', '.join(model.model_fields)})"
    reason = problem["msg"].removeprefix("Value error, ")
    value = str(problem["input"])[:60]
    return f"{key} = {value!r}: {reason}" if key else reason
