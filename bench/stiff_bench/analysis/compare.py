"""`bench compare A B`: from a folder of results to a report on two competitors."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stiff_bench.analysis.collected import (
    Contest,
    chosen_contests,
    collect,
    competitor_meant,
    left_out_notes,
    same_name_other_data,
)
from stiff_bench.analysis.comparison import NORM, Comparison, compare, paired_errors
from stiff_bench.analysis.same_robot import dataset_of, family_of
from stiff_bench.analysis.verdict import Question, Verdict
from stiff_bench.analysis.where import Where, where_better
from stiff_bench.store.database import read_data, read_manifests
from stiff_bench.store.names import ContestName, grouped, labels, natural_key
from stiff_bench.store.samples import StoredData
from stiff_bench.store.versions import differing_libraries, sources
from stiff_protocols.contract.errors import ConfigError, DataError, unknown_name
from stiff_protocols.scoring.paired import wilcoxon_signed_rank
from stiff_protocols.scoring.ranks import FEWEST_DATASETS


@dataclass(frozen=True)
class Across:
    """A and B over several data sets of one robot type, under one protocol and condition.

    Attributes:
        family: the data sets' name without their specimen.
        protocol, condition, seed: shared.
        verdicts: of the mean length of the error, one a data set; "open" where repeats of one
            data set disagree.
        of_fits: a verdict among them is of fitted models alone (one split, or all scored together).
        mean_difference: over the data sets, A less B, m.
        p_value: Wilcoxon over the data sets' differences; None where they are too few.
        selects_on_test: the protocol lets models choose on the test part.
    """

    family: str
    protocol: str
    condition: str
    seed: int
    verdicts: tuple[Verdict, ...]
    of_fits: bool
    mean_difference: float
    p_value: float | None
    selects_on_test: bool


def across_datasets(comparisons: Sequence[Comparison]) -> list[Across]:
    """Sum up over the data sets of one robot type, wherever there are several.

    Splits of one data set are never counted as data sets, nor are repeats of it with another seed,
    whose differences are averaged. Where one name stands for different data, there is no sum.
    """
    found = []
    for key, group in grouped(comparisons, _setting).items():
        by_dataset = grouped(group, lambda one: dataset_of(one.name))
        unambiguous = len({one.name.dataset for one in group}) == len(group)
        if len(by_dataset) > 1 and unambiguous:
            found.append(_across(key, list(by_dataset.values())))
    return found


def _setting(comparison: Comparison) -> tuple[str, str, str, int]:
    """Return what data sets that are summed up share."""
    name = comparison.name
    return family_of(name), name.protocol, name.condition, name.seed


def _across(key: tuple[str, str, str, int], datasets: Sequence[Sequence[Comparison]]) -> Across:
    differences = [
        float(np.mean([one.row(NORM).difference for one in repeats])) for repeats in datasets
    ]
    return Across(
        *key,
        verdicts=tuple(_common_verdict(repeats) for repeats in datasets),
        of_fits=not all(one.over_splits for repeats in datasets for one in repeats),
        mean_difference=float(np.mean(differences)),
        p_value=wilcoxon_signed_rank(differences) if len(datasets) >= FEWEST_DATASETS else None,
        selects_on_test=any(one.selects_on_test for repeats in datasets for one in repeats),
    )


def _common_verdict(repeats: Sequence[Comparison]) -> Verdict:
    first, *others = [one.row(NORM).verdict for one in repeats]
    return first if all(other == first for other in others) else "open"


FEW = 3
"""So many contests are named in an error message."""


@dataclass(frozen=True)
class CompareWords:
    """The words of a `bench compare` command line.

    Attributes:
        a, b: names of competitors, e.g. "ft-mlp@freeze=full".
        results: folder of the results.
        datasets, protocols, conditions: which contests; none named means all.
        question: what is asked of each.
        command: the command line, for the record.
    """

    a: str
    b: str
    results: Path
    datasets: tuple[str, ...]
    protocols: tuple[str, ...]
    conditions: tuple[str, ...]
    question: Question
    command: str


@dataclass(frozen=True)
class Report:
    """Two competitors wherever they met.

    Attributes:
        a, b: names.
        question: what was asked.
        comparisons: one a contest; at least one.
        across: over data sets of one robot type.
        where: who is better where, if there is one contest.
        notes: contests that could not be compared, names that stand for several data sets, and
            results that were left out.
        provenance: which stiffbench made the results, and libraries that differ.
        command: the command line that made it.
    """

    a: str
    b: str
    question: Question
    comparisons: tuple[Comparison, ...]
    across: tuple[Across, ...]
    where: Where | None
    notes: tuple[str, ...]
    provenance: tuple[str, ...]
    command: str


def compare_folder(words: CompareWords) -> Report:
    """Compare two competitors in every contest in which both have results on the same splits.

    Raises:
        ConfigError: a name is unknown, A is B, or they never met.
        StoreError: the folder holds no results, or damaged ones.
    """
    contests = collect(words.results)
    a, b = (competitor_meant(word, contests, words.results) for word in (words.a, words.b))
    if a == b:
        raise ConfigError(f"compare {a!r} with another model than itself")
    words = replace(words, a=a, b=b)
    chosen = chosen_contests(contests, datasets=words.datasets, protocols=words.protocols)
    chosen = sorted(_under(words.conditions, chosen), key=lambda one: _in_order(one.name))
    data_of = functools.cache(functools.partial(read_data, words.results))
    met, apart = _compared(chosen, words, data_of)
    if not met:
        raise ConfigError(" ".join(apart) or _never_met(chosen, a, b))
    where = None
    if len(met) == 1:
        data = data_of(met[0][0].name.data_sha256)
        where = where_better(paired_errors(met[0][0], a, b), data, words.question)
    comparisons = tuple(comparison for _, comparison in met)
    shared = [contest for contest, _ in met]
    return Report(
        a=a,
        b=b,
        question=words.question,
        comparisons=comparisons,
        across=tuple(across_datasets(comparisons)),
        where=where,
        notes=(
            *apart,
            *_alone(chosen, a, b),
            *same_name_other_data(shared),
            *left_out_notes(shared),
        ),
        provenance=_provenance(shared, words),
        command=words.command,
    )


def _in_order(name: ContestName) -> tuple[list[tuple[int, str]], int, str, str]:
    return natural_key(name.text), name.seed, name.data_sha256, name.source_sha256


def _compared(
    chosen: Sequence[Contest], words: CompareWords, data_of: Callable[[str], StoredData]
) -> tuple[list[tuple[Contest, Comparison]], list[str]]:
    """Return the contests in which both have results, and why others could not be compared."""
    met, apart = [], []
    called = labels(contest.name for contest in chosen)
    for contest in chosen:
        if not {words.a, words.b} <= set(contest.competitors):
            continue
        data = data_of(contest.name.data_sha256)
        try:
            met.append((contest, compare(contest, words.a, words.b, data, words.question)))
        except DataError as error:
            apart.append(f"not compared: {called[contest.name]}: {error}.")
    return met, apart


def _provenance(contests: Sequence[Contest], words: CompareWords) -> tuple[str, ...]:
    """Say which stiffbench made the results that were compared, and libraries that differ."""
    names = words.a, words.b
    counts = {
        name: Counter(
            result.run_id
            for contest in contests
            for result in contest.results(name, contest.shared_slots(names))
        )
        for name in names
    }
    runs = read_manifests(words.results)
    made = sources(words.results, runs, counts[words.a] + counts[words.b])
    return (*made, *differing_libraries(runs, counts))


def _under(conditions: Sequence[str], contests: Sequence[Contest]) -> list[Contest]:
    """Return the contests of these conditions; none named means all."""
    known = {contest.name.condition for contest in contests}
    for condition in conditions:
        if condition not in known:
            meant = unknown_name("condition", condition, known - {""})
            raise ConfigError(f"--condition: {meant}")
    return [one for one in contests if not conditions or one.name.condition in conditions]


def _never_met(chosen: Iterable[Contest], a: str, b: str) -> str:
    """Say where each was run."""
    chosen = list(chosen)
    called = labels(one.name for one in chosen)
    run = {
        name: _few([called[one.name] for one in chosen if name in one.competitors])
        for name in (a, b)
    }
    return f"{a} and {b} never met: {a} was run in {run[a]}; {b} was run in {run[b]}"


def _alone(chosen: Iterable[Contest], a: str, b: str) -> Iterator[str]:
    """Yield a line for each that was run where the other was not."""
    chosen = list(chosen)
    called = labels(one.name for one in chosen)
    for name, other in ((a, b), (b, a)):
        more = [
            called[one.name]
            for one in chosen
            if name in one.competitors and other not in one.competitors
        ]
        if more:
            yield f"{name} alone was run in {_few(more)}."


def _few(names: Sequence[str]) -> str:
    if not names:
        return "none of these contests"
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return ", ".join(f"({name})" for name in names[:FEW]) + more
