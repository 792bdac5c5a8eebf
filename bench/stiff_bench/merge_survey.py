"""What folders of results say that are to be joined, and where they contradict each other.

A folder says of a data set which numbers it has, of a split which rows, of a model which version
computed it. What its newest run says counts: an older run of it may have known other data.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Literal, NamedTuple

from stiff_bench.contest_name import SHORT
from stiff_bench.store import readable_manifests, stored_results
from stiff_protocols.errors import StoreError
from stiff_protocols.record import CellResult, RunManifest

Kind = Literal["data", "split", "code"]
KINDS: tuple[Kind, ...] = ("data", "split", "code")
"""What folders may say differently."""


NOT_KNOWN = "not known"


class Subject(NamedTuple):
    """What folders say something of.

    Attributes:
        kind: of what is said.
        name: for people.
        detail: what tells it from others of this name.
    """

    kind: Kind
    name: str
    detail: tuple[object, ...] = ()


class Claim(NamedTuple):
    """What a folder says of a subject.

    Attributes:
        value: a hash, or versions where none was stored.
        run_id: the newest run that says it.
        n_cells: how many of its results say it.
    """

    value: str
    run_id: str
    n_cells: int


class Record(NamedTuple):
    """What must be known of a stored cell to choose among several; the larger one counts.

    Attributes:
        ok: it is a result.
        run_id: a run's name begins with its time.
        n_splits: that were asked for; the newest command counts.
        numbers: hash of the predictions.
    """

    ok: bool
    run_id: str
    n_splits: int
    numbers: bytes

    def counts_over(self, other: Record) -> bool:
        """Say whether this one is to stand in the other's place."""
        return self[:3] > other[:3]


@dataclass
class FolderSurvey:
    """What a folder holds.

    Attributes:
        folder: of the results, for people.
        source: where they are read: the folder, or what could be read of a damaged one.
        records: key -> the record that counts.
        claims: subject -> value -> claim.
        versions: run -> version and commit of stiffbench, for people.
        runs: the manifests.
        damaged: one line for each row that cannot be read.
    """

    folder: Path
    source: Path
    records: dict[str, Record] = field(default_factory=dict)
    claims: dict[Subject, dict[str, Claim]] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    runs: list[RunManifest] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)

    def says(self, subject: Subject) -> Claim:
        """Return what the newest run says of a subject that the folder knows."""
        return max(self.claims[subject].values(), key=lambda claim: claim.run_id)


@dataclass(frozen=True)
class Disagreement:
    """Folders that say different things under one name.

    Attributes:
        kind, name: of the subjects.
        n_subjects: how many of this name they say different things of.
        claims: folder -> what it says of the first of these, with the number of its cells in all.
        versions: folder -> version and commit of stiffbench behind that claim.
    """

    kind: Kind
    name: str
    n_subjects: int
    claims: Mapping[Path, Claim]
    versions: Mapping[Path, str]


def survey(
    folder: Path, known: Sequence[FolderSurvey] = (), *, source: Path | None = None
) -> FolderSurvey:
    """Read what a folder holds, once through.

    Args:
        folder: of the results; an empty one, or none at all, holds nothing.
        known: other folders; a cell that came from one of them says nothing new.
        source: where its results are read; None: there.

    Raises:
        StoreError: the folder is none of ours, or its file is damaged as a whole.
    """
    found = FolderSurvey(folder, source or folder)

    def note(error: StoreError) -> None:
        found.damaged.append(str(error))

    found.runs = list(readable_manifests(found.source, note))
    software = {run.run_id: _software(run) for run in found.runs}
    found.versions = dict(software)
    for result in stored_results(found.source, report=note):
        key = result.cell.key
        if replace(result.cell).key != key:  # what is written by its key must have its own
            found.damaged.append(f"{folder}: the record {key!r} is another cell's")
            continue
        record = found.records[key] = _record(result)
        if not any(one.records.get(key) == record for one in known):
            _note_claims(found, result, software)
    return found


def disagreements(surveys: Sequence[FolderSurvey]) -> list[Disagreement]:
    """Return where folders contradict each other, by kind and name."""
    subjects = dict.fromkeys(subject for one in surveys for subject in one.claims)
    disputed = [subject for subject in subjects if len(_values(subject, surveys)) > 1]
    disputed.sort(key=lambda subject: (KINDS.index(subject.kind), subject.name))
    return [
        _disagreement(kind, name, list(found), surveys)
        for (kind, name), found in groupby(disputed, key=lambda subject: subject[:2])
    ]


def _values(subject: Subject, surveys: Sequence[FolderSurvey]) -> set[str]:
    return {one.says(subject).value for one in surveys if subject in one.claims}


def _disagreement(
    kind: Kind, name: str, subjects: Sequence[Subject], surveys: Sequence[FolderSurvey]
) -> Disagreement:
    first = subjects[0]
    claims, versions = {}, {}
    for one in surveys:
        if first in one.claims:
            said = one.says(first)
            n_cells = sum(one.says(each).n_cells for each in subjects if each in one.claims)
            claims[one.folder] = said._replace(n_cells=n_cells)
            versions[one.folder] = one.versions.get(said.run_id, NOT_KNOWN)
    return Disagreement(kind, name, len(subjects), claims, versions)


def _record(result: CellResult) -> Record:
    digest = hashlib.blake2b(digest_size=8)
    if result.prediction is not None:
        digest.update(result.prediction.predicted.tobytes())
        if result.prediction.interval is not None:
            digest.update(result.prediction.interval.lower.tobytes())
            digest.update(result.prediction.interval.upper.tobytes())
    ok = result.status == "ok"
    return Record(ok, sys.intern(result.run_id), result.n_splits, digest.digest())


def _note_claims(found: FolderSurvey, result: CellResult, runs: Mapping[str, str]) -> None:
    for subject, value in _said(result, runs):
        of_subject = found.claims.setdefault(subject, {})
        other = of_subject.get(value, Claim(value, "", 0))
        run_id = max(other.run_id, sys.intern(result.run_id))
        of_subject[value] = Claim(value, run_id, other.n_cells + 1)


def _said(result: CellResult, runs: Mapping[str, str]) -> Iterator[tuple[Subject, str]]:
    """Yield what a result says of data, split and model."""
    cell, shown = result.cell, result.shown
    yield Subject("data", shown.dataset), cell.data_sha256
    if cell.source_sha256:
        source = f"source of {shown.protocol} for {shown.dataset}"
        yield Subject("data", source, (cell.data_sha256, cell.condition)), cell.source_sha256
    split = (cell.data_sha256, cell.condition, cell.split_index, cell.seed)
    yield Subject("split", f"{shown.protocol} of {shown.dataset}", split), cell.split_sha256
    # where no version is stored, that of stiffbench stands for it
    version = f"{cell.model_version}, scoring {cell.scoring_version}"
    code = version if cell.model_version else runs.get(result.run_id, NOT_KNOWN)
    yield Subject("code", cell.model, (cell.protocol,)), code


def _software(run: RunManifest) -> str:
    """Return version and commit of stiffbench."""
    facts = run.environment
    commit = str(facts.get("commit", ""))[:SHORT]
    dirty = " with changes" if facts.get("dirty") == "true" else ""
    return f"{facts.get('stiffbench', NOT_KNOWN)}{f', commit {commit}{dirty}' if commit else ''}"
