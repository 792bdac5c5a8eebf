"""Scores of models under one protocol and condition, over the data sets of one robot type."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.field import Field, complete_models
from stiff_bench.grouped import grouped
from stiff_bench.same_robot import dataset_of, family_of
from stiff_bench.standing import Standings


@dataclass(frozen=True)
class ColumnValue:
    """A model's score over the data sets of a column.

    Attributes:
        mean: over the data sets that have it, in the metric's unit; NaN where none has.
        std: over them; NaN for one.
        n_datasets: how many have it.
        failed: "FAILED" or "SKIPPED" where it did in one of them; else "".
        best: it has the best mean of the models that have all data sets.
        like_best: it cannot be told from the best in more than half of the contests; None: it
            lacks a data set, or no test applies.
    """

    mean: float
    std: float
    n_datasets: int
    failed: str
    best: bool
    like_best: bool | None


@dataclass(frozen=True)
class Column:
    """One protocol and condition on the data sets of one robot type.

    Attributes:
        family: name of the data sets without the options that make another robot of the type.
        protocol, condition: as shown.
        datasets: their names.
        seeds: of the runs' splits.
        values: by model; one that was run nowhere here is not there.
    """

    family: str
    protocol: str
    condition: str
    datasets: tuple[str, ...]
    seeds: tuple[int, ...]
    values: Mapping[str, ColumnValue]


def columns(fields: Sequence[Field], standings: Standings) -> Iterator[Column]:
    """Yield a column for each robot type, protocol and condition, in the fields' order."""
    for (family, protocol, condition), members in grouped(fields, _place).items():
        datasets = tuple(dict.fromkeys(_dataset(field) for field in members))
        values = dict(_values(members, standings))
        seeds = tuple(sorted({field.name.seed for field in members}))
        yield Column(family, protocol, condition, datasets, seeds, values)


def _place(field: Field) -> tuple[str, str, str]:
    return family_of(field.name.dataset), field.name.protocol, field.name.condition


def _dataset(field: Field) -> str:
    return dataset_of(field.name.dataset)


def _values(fields: Sequence[Field], standings: Standings) -> Iterator[tuple[str, ColumnValue]]:
    complete = complete_models(fields)
    like = _like_best(fields, complete, standings)
    scores = {
        model: _by_dataset(fields, model)
        for model in dict.fromkeys(name for field in fields for name in field.contest.competitors)
        if any(model in field.scores or model in field.missing for field in fields)
    }
    sign = standings.key.sign
    best = min((sign * np.mean(scores[model]) for model in complete), default=math.nan)
    for model, found in scores.items():
        yield (
            model,
            ColumnValue(
                mean=float(np.mean(found)) if found else math.nan,
                std=float(np.std(found, ddof=1)) if len(found) > 1 else math.nan,
                n_datasets=len(found),
                failed=max(field.failed(model) for field in fields),
                best=model in complete and bool(sign * np.mean(found) == best),
                like_best=like.get(model),
            ),
        )


def _by_dataset(fields: Sequence[Field], model: str) -> list[float]:
    """Return a model's score on each data set where it lacks no repetition."""
    return [
        float(np.mean([field.mean(model) for field in members]))
        for members in grouped(fields, _dataset).values()
        if all(model in field.scores for field in members)
    ]


def _like_best(
    fields: Sequence[Field], models: tuple[str, ...], standings: Standings
) -> dict[str, bool]:
    """Return whether each model is like the best in more than half of the contests."""
    if not models:
        return {}
    found = [standings.of(field, models).like_best for field in fields]
    tested = [like for like in found if like is not None]
    if len(tested) < len(fields):
        return {}
    share = np.mean(tested, axis=0)
    return {model: bool(part > 0.5) for model, part in zip(models, share, strict=True)}
