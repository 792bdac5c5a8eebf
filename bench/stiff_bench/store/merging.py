"""Joins the results of several machines in one folder."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence, Set
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

from stiff_bench.store.codec import COLUMNS
from stiff_bench.store.damage import fault_of, salvage
from stiff_bench.store.database import (
    FILE,
    ResultStore,
    has_results,
    read_data,
    read_manifests,
    readable_manifests,
    reading,
    stored_results,
    write_run,
    writing,
)
from stiff_bench.store.versions import NO_MANIFEST, version_of_run
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import CellResult, RunManifest

Kind = Literal["data", "split", "code"]
KINDS: tuple[Kind, ...] = ("data", "split", "code")
"""What folders may say differently."""


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
    found.versions = {run.run_id: version_of_run(run) for run in found.runs}
    for result in stored_results(found.source, report=note):
        key = result.cell.key
        if replace(result.cell).key != key:  # what is written by its key must have its own
            found.damaged.append(f"{folder}: the record {key!r} is another cell's")
            continue
        run_id = sys.intern(result.run_id)
        record = Record(result.status == "ok", run_id, result.n_splits, _numbers_of(result))
        found.records[key] = record
        if not any(one.records.get(key) == record for one in known):
            for subject, value in _said(result, found.versions):
                of_subject = found.claims.setdefault(subject, {})
                other = of_subject.get(value, Claim(value, "", 0))
                of_subject[value] = Claim(value, max(other.run_id, run_id), other.n_cells + 1)
    return found


def disagreements(surveys: Sequence[FolderSurvey]) -> list[Disagreement]:
    """Return where folders contradict each other, by kind and name."""
    subjects = dict.fromkeys(subject for one in surveys for subject in one.claims)
    disputed = [
        subject
        for subject in subjects
        if len({one.says(subject).value for one in surveys if subject in one.claims}) > 1
    ]
    disputed.sort(key=lambda subject: (KINDS.index(subject.kind), subject.name))
    return [
        _disagreement(kind, name, list(found), surveys)
        for (kind, name), found in groupby(disputed, key=lambda subject: subject[:2])
    ]


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
            versions[one.folder] = one.versions.get(said.run_id, NO_MANIFEST)
    return Disagreement(kind, name, len(subjects), claims, versions)


def _numbers_of(result: CellResult) -> bytes:
    """Return a hash of a result's predictions."""
    digest = hashlib.blake2b(digest_size=8)
    if (found := result.prediction) is not None:
        interval = () if found.interval is None else (found.interval.lower, found.interval.upper)
        for array in (found.predicted, *interval):
            digest.update(array.tobytes())
    return digest.digest()


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
    code = version if cell.model_version else runs.get(result.run_id, NO_MANIFEST)
    yield Subject("code", cell.model, (cell.protocol,)), code


_COLUMNS = ", ".join((*COLUMNS, "sha256"))
_COUNTS_OVER = "(a.status = 'ok', a.run_id, a.n_splits) >= (b.status = 'ok', b.run_id, b.n_splits)"
_JOIN_CELLS = f"""
DELETE FROM taken WHERE key IN (
    SELECT key FROM main.cell a JOIN other.cell b USING (key) WHERE {_COUNTS_OVER});
DELETE FROM main.cell WHERE key IN (SELECT key FROM taken);
INSERT INTO main.cell ({_COLUMNS})
    SELECT {_COLUMNS} FROM other.cell WHERE key IN (SELECT key FROM taken) ORDER BY id;
INSERT OR IGNORE INTO main.measure (metric, axis, unit)
    SELECT metric, axis, unit FROM other.measure ORDER BY id;
INSERT INTO main.value (cell, measure, value)
    SELECT c.id, m.id, v.value FROM taken
    JOIN main.cell c USING (key) JOIN other.cell o USING (key) JOIN other.value v ON v.cell = o.id
    JOIN other.measure n ON n.id = v.measure JOIN main.measure m USING (metric, axis, unit);
DROP TABLE taken
"""
"""`taken` holds the keys of the cells to copy; another merge may have been sooner."""


class Disagreeing(ConfigError):
    """The folders contradict each other, and nobody said that they may.

    Attributes:
        found: where.
    """

    def __init__(self, message: str, found: Sequence[Disagreement]) -> None:
        """Store both."""
        super().__init__(message)
        self.found = tuple(found)


@dataclass(frozen=True)
class Merged:
    """What became of a merge.

    Attributes:
        n_cells: of the output now.
        n_there: how many of them were there before.
        taken: folder -> how many cells it holds, and how many were taken from it.
        n_other_numbers: cells of which several folders have results with different numbers.
        damaged: one line for each file that was left out.
        disagreements: that were allowed.
    """

    n_cells: int
    n_there: int
    taken: dict[Path, tuple[int, int]]
    n_other_numbers: int
    damaged: tuple[str, ...]
    disagreements: tuple[Disagreement, ...]


def merge(folders: Sequence[Path], output: Path, allow: Collection[Kind]) -> Merged:
    """Join the results of folders in `output`, which may exist and hold some, or be one of them.

    Of a cell that is in several of them a result counts over a failure, and then the newest run.
    The folders stay as they are. What is stopped is completed by the same merge again.

    Raises:
        Disagreeing: the folders differ in data, splits or code, and `allow` does not have it.
        StoreError: a folder holds no results, changes meanwhile, or `output` cannot be written.
    """
    inputs = _inputs(folders, output)
    with ExitStack() as stack:
        surveys = [_surveyed(folder, stack) for folder in inputs]
        _refuse(disagreements(surveys), allow)
        there = survey(output, surveys)
        found = disagreements([*surveys, there])
        _refuse(found, allow)
        ResultStore(output)
        damaged = [line for one in (*surveys, there) for line in one.damaged]
        takes = _chosen(surveys, there)
        for one, keys in zip(surveys, takes, strict=True):
            damaged += _join(one, keys, output)
    return Merged(
        n_cells=len(set().union(*(one.records for one in (*surveys, there)))),
        n_there=len(there.records),
        taken={
            one.folder: (len(one.records), len(keys))
            for one, keys in zip(surveys, takes, strict=True)
        },
        n_other_numbers=_n_other_numbers([*surveys, there]),
        damaged=tuple(dict.fromkeys(damaged)),
        disagreements=tuple(found),
    )


def _surveyed(folder: Path, stack: ExitStack) -> FolderSurvey:
    """Survey a folder, or what can be read of a damaged one."""
    fault = fault_of(folder)
    if fault is None:
        return survey(folder)
    readable = Path(stack.enter_context(TemporaryDirectory(prefix="bench-merge-")))
    damaged = [f"{folder / FILE}: damaged: {fault}"]
    salvage(folder / FILE, readable / FILE, lambda error: damaged.append(str(error)))
    found = survey(folder, source=readable)
    found.damaged[:0] = damaged
    return found


def _inputs(folders: Sequence[Path], output: Path) -> list[Path]:
    """Return each folder once, without the output."""
    for folder in folders:
        if not has_results(folder):
            raise StoreError(f"{folder}: holds no results; `bench run --output` makes them")
    different = {folder.resolve(): folder for folder in reversed(folders)}
    different.pop(output.resolve(), None)
    if not different:
        raise ConfigError(f"--output {output}: is the only folder given; name one to take from")
    return list(reversed(different.values()))


def _refuse(found: Sequence[Disagreement], allow: Collection[Kind]) -> None:
    refused = [one for one in found if one.kind not in allow]
    if refused:
        kinds = tuple(dict.fromkeys(one.kind for one in refused))
        names = "; ".join(
            f"{kind} of " + ", ".join(one.name for one in refused if one.kind == kind)
            for kind in kinds
        )
        raise Disagreeing(
            f"the folders differ in {names}; nothing was merged "
            f"({' '.join(f'--allow {kind}' for kind in kinds)} merges them all the same)",
            refused,
        )


def _chosen(surveys: Sequence[FolderSurvey], there: FolderSurvey) -> list[set[str]]:
    """Return the keys of the cells to take from each folder."""
    best = {key: (record, -1) for key, record in there.records.items()}
    for number, one in enumerate(surveys):
        for key, record in one.records.items():
            if key not in best or record.counts_over(best[key][0]):
                best[key] = (record, number)
    takes: list[set[str]] = [set() for _ in surveys]
    for key, (_, number) in best.items():
        if number >= 0:
            takes[number].add(key)
    return takes


def _n_other_numbers(surveys: Sequence[FolderSurvey]) -> int:
    numbers: dict[str, bytes] = {}
    other = set()
    for one in surveys:
        for key, record in one.records.items():
            if record.ok and numbers.setdefault(key, record.numbers) != record.numbers:
                other.add(key)
    return len(other)


def _join(one: FolderSurvey, keys: Set[str], output: Path) -> list[str]:
    """Copy cells, data sets and manifests as one transaction; return a line for what is damaged.

    Raises:
        StoreError: the folder changes meanwhile.
    """
    there = {run.run_id: run for run in read_manifests(output)}
    damaged: list[str] = []
    data = [*_data_to_copy(one, output, damaged)]
    with writing(output, one.source) as db:
        db.execute("CREATE TEMP TABLE taken (key TEXT PRIMARY KEY)")
        db.executemany("INSERT INTO taken VALUES (?)", [(key,) for key in keys])
        (n_found,) = db.execute("SELECT count(*) FROM taken JOIN other.cell USING (key)").fetchone()
        if n_found < len(keys):
            raise StoreError(
                f"{one.folder}: {len(keys) - n_found} of its cells cannot be read any more; give "
                "the same command again"
            )
        for statement in _JOIN_CELLS.split(";\n"):
            db.execute(statement)
        for sha256 in data:
            db.execute(
                "INSERT OR REPLACE INTO main.data SELECT * FROM other.data WHERE sha256 = ?",
                (sha256,),
            )
        for run in one.runs:
            if run.run_id not in there or _progress(run) > _progress(there[run.run_id]):
                write_run(db, run)
    return damaged


def _data_to_copy(one: FolderSurvey, output: Path, damaged: list[str]) -> Iterator[str]:
    """Yield the hashes of the data sets that the output lacks; note those that are damaged."""
    with reading(one.source) as db:
        hashes = [row[0] for row in db.execute("SELECT sha256 FROM data ORDER BY sha256")]
    for sha256 in hashes:
        try:
            read_data(output, sha256)
        except StoreError:
            try:
                read_data(one.source, sha256)
            except StoreError as error:
                damaged.append(str(error))
            else:
                yield sha256


def _progress(run: RunManifest) -> tuple[bool, bool]:
    """Say how far a run was when its manifest was copied."""
    return run.status == "finished", run.status == "interrupted"
