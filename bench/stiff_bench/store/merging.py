"""Joins the results of several machines in one folder."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

from stiff_bench.store.codec import COLUMNS
from stiff_bench.store.damage import fault_of, salvage
from stiff_bench.store.database import (
    FILE,
    DamagedFile,
    ResultStore,
    execute_each,
    has_results,
    read_data,
    read_manifests,
    reading,
    stored_results,
    why_no_results,
    write_run,
    writing,
)
from stiff_bench.store.names import SHORT
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import CellResult, RunManifest

Kind = Literal["data", "split", "code"]
"""What folders may disagree on."""
Subject = tuple[Kind, str, tuple[object, ...]]
"""Kind, name for people, and what tells it from others of this name."""


class Record(NamedTuple):
    """What must be known of a stored cell to choose among several; the larger one counts.

    Attributes:
        ok: it is a result.
        run_id: a run's name begins with its time.
        numbers: hash of the predictions.
    """

    ok: bool
    run_id: str
    numbers: int


@dataclass
class FolderSurvey:
    """What a folder holds.

    Attributes:
        folder: of the results, for people.
        source: where they are read: the folder, or what could be read of a damaged one.
        records: key -> the record that counts.
        claims: subject -> the newest run that has a result on it, and its hash or version.
        runs: the manifests.
        damaged: one line for each row that cannot be read.
    """

    folder: Path
    source: Path
    records: dict[str, Record] = field(default_factory=dict)
    claims: dict[Subject, tuple[str, str]] = field(default_factory=dict)
    runs: list[RunManifest] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)


def _survey(folder: Path, stack: ExitStack, known: Sequence[FolderSurvey] = ()) -> FolderSurvey:
    """Read what a folder holds; a cell that came from a `known` folder claims nothing new."""
    found = FolderSurvey(folder, folder)

    def note(error: DamagedFile) -> None:
        found.damaged.append(str(error))

    if has_results(folder) and (fault := fault_of(folder)) is not None:
        found.source = Path(stack.enter_context(TemporaryDirectory(prefix="bench-merge-")))
        found.damaged.append(f"{folder / FILE}: damaged: {fault}")
        salvage(folder / FILE, found.source / FILE, note)
    found.runs = read_manifests(found.source, note)
    for result in stored_results(found.source, report=note):
        key = result.cell.key
        if replace(result.cell).key != key:  # what is written by its key must have its own
            found.damaged.append(f"{folder}: the record {key!r} is another result's")
            continue
        run_id = sys.intern(result.run_id)
        record = Record(result.status == "ok", run_id, _numbers_of(result))
        found.records[key] = record
        if not any(one.records.get(key) == record for one in known):
            for subject, value in _claims_of(result):
                found.claims[subject] = max(found.claims.get(subject, ("", "")), (run_id, value))
    return found


def _numbers_of(result: CellResult) -> int:
    """Return a hash of a result's predictions."""
    if (found := result.prediction) is None:
        return 0
    interval = () if found.interval is None else (found.interval.lower, found.interval.upper)
    return hash(tuple(array.tobytes() for array in (found.predicted, *interval)))


def _claims_of(result: CellResult) -> Iterator[tuple[Subject, str]]:
    """Yield the hashes of a result's data and split, and the version of its model."""
    cell, shown = result.cell, result.shown
    yield ("data", shown.dataset, ()), shown.measured_sha256 or cell.data_sha256
    if shown.measured_sha256:
        paths = f"paths of {shown.protocol} for {shown.dataset}"
        yield ("data", paths, (shown.measured_sha256,)), cell.data_sha256
    if cell.source_sha256:
        source = f"source of {shown.protocol} for {shown.dataset}"
        yield ("data", source, (cell.data_sha256, cell.condition)), cell.source_sha256
    split = (cell.data_sha256, cell.condition, cell.split_index, cell.seed)
    yield ("split", f"{shown.protocol} of {shown.dataset}", split), cell.split_sha256
    version = f"version {cell.model_version}, scoring {cell.scoring_version}"
    yield ("code", cell.model, (cell.protocol, cell.coverage is not None)), version


def _disagreements(surveys: Sequence[FolderSurvey]) -> dict[tuple[Kind, str], str]:
    """Return kind and name -> a line with the folders' values, where their newest runs differ."""
    found: dict[tuple[Kind, str], str] = {}
    for kind, name, detail in dict.fromkeys(subject for one in surveys for subject in one.claims):
        claims = {one.folder: one.claims.get((kind, name, detail)) for one in surveys}
        values = {folder: claim[1] for folder, claim in claims.items() if claim is not None}
        if len({*values.values()}) > 1 and (kind, name) not in found:
            short = SHORT if kind != "code" else None
            shown = "; ".join(f"{folder}: {value[:short]}" for folder, value in values.items())
            found[kind, name] = f"{kind} of {name} ({shown})"
    return found


_COLUMNS = ", ".join((*COLUMNS, "sha256"))
_JOIN_CELLS = f"""
DELETE FROM taken WHERE key IN (
    SELECT key FROM main.cell a JOIN other.cell b USING (key)
    WHERE (a.status = 'ok', a.run_id) >= (b.status = 'ok', b.run_id));
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
"""`taken` holds the keys of a folder's cells; those that do not count are not copied."""


@dataclass(frozen=True)
class Merged:
    """What became of a merge.

    Attributes:
        output: the folder that was merged into.
        n_cells, n_there: of the output, now and before.
        taken: folder -> how many cells it holds, and how many were taken from it.
        n_other_numbers: cells of which several folders have results with different numbers.
        damaged, disagreements: a line for each row that was left out, or difference allowed.
    """

    output: Path
    n_cells: int
    n_there: int
    taken: dict[Path, tuple[int, int]]
    n_other_numbers: int
    damaged: tuple[str, ...]
    disagreements: tuple[str, ...]

    @property
    def report(self) -> list[str]:
        """What became of it, in lines."""
        lines = [f"merged all the same: {line}" for line in self.disagreements]
        lines += [f"left out: {line}" for line in self.damaged]
        for folder, (n_cells, n_taken) in self.taken.items():
            line = f"{folder}: {n_taken} of {n_cells} results taken"
            others = "; the others are stored or newer in another folder"
            lines.append(line if n_taken == n_cells else f"{line}{others}")
        if self.n_other_numbers:
            lines.append(
                f"warning: {self.n_other_numbers} results have other numbers in another folder "
                "(other rounding?); those of the newest run count"
            )
        left_out = f", {len(self.damaged)} damaged rows left out" if self.damaged else ""
        total = f"{self.n_cells} results in {self.output}, {self.n_there} of them from before"
        return [*lines, f"{total}{left_out}"]


def merge(folders: Sequence[Path], output: Path, allow: Collection[Kind]) -> Merged:
    """Join the results of folders in `output`, which may exist and hold some, or be one of them.

    Of a cell that is in several of them a result counts over a failure, and then the newest run.
    The folders stay as they are. What is stopped is completed by the same merge again.

    Raises:
        ConfigError: the folders differ in data, splits or code, and `allow` does not have it.
        StoreError: a folder holds no results, changes meanwhile, or `output` cannot be written.
    """
    inputs = _inputs(folders, output)
    with ExitStack() as stack:
        surveys = [_survey(folder, stack) for folder in inputs]
        there = _survey(output, stack, surveys)
        every = [*surveys, there]
        found = _disagreements(every)
        refused = {key: line for key, line in found.items() if key[0] not in allow}
        if refused:
            kinds = " and ".join(dict.fromkeys(kind for kind, _ in refused))
            raise ConfigError(
                f"the folders differ in {', '.join(refused.values())}; nothing was merged "
                f"(allow {kinds} to merge them all the same)"
            )
        ResultStore(output)
        damaged = [line for one in every for line in one.damaged]
        for one in surveys:
            damaged += _join(one, output)
    best: dict[str, Record] = {}
    numbers: defaultdict[str, set[int]] = defaultdict(set)
    for one in (there, *surveys):
        for key, record in one.records.items():
            best[key] = max(best.get(key, record), record, key=lambda each: each[:2])
            if record.ok:
                numbers[key].add(record.numbers)
    n_taken = {
        one.folder: sum(best[key] is record for key, record in one.records.items())
        for one in surveys
    }
    return Merged(
        output=output,
        n_cells=len(best),
        n_there=len(there.records),
        taken={one.folder: (len(one.records), n_taken[one.folder]) for one in surveys},
        n_other_numbers=sum(len(different) > 1 for different in numbers.values()),
        damaged=tuple(dict.fromkeys(damaged)),
        disagreements=tuple(found.values()),
    )


def _inputs(folders: Sequence[Path], output: Path) -> list[Path]:
    """Return each folder once, without the output."""
    for folder in folders:
        if not has_results(folder):
            raise StoreError(
                f"{folder}: {why_no_results(folder)} (valid: an output of `bench run`)"
            )
    different = {folder.resolve(): folder for folder in folders}
    different.pop(output.resolve(), None)
    if not different:
        raise ConfigError(f"{output}: is the only folder given; name one to take from", "output")
    return list(different.values())


def _join(one: FolderSurvey, output: Path) -> list[str]:
    """Copy cells, data sets and manifests as one transaction; return a line for what is damaged.

    Raises:
        StoreError: the folder changes meanwhile.
    """
    there = {run.run_id: run.status for run in read_manifests(output)}
    damaged: list[str] = []
    data = [*_data_to_copy(one, output, damaged)]
    with writing(output, one.source) as db:
        db.execute("CREATE TEMP TABLE taken (key TEXT PRIMARY KEY)")
        db.executemany("INSERT INTO taken VALUES (?)", [(key,) for key in one.records])
        query = "SELECT count(*) FROM taken WHERE key NOT IN (SELECT key FROM other.cell)"
        (n_lost,) = db.execute(query).fetchone()
        if n_lost:
            lost = f"{n_lost} of its results cannot be read any more"
            raise StoreError(f"{one.folder}: {lost}; give the same command again")
        execute_each(db, _JOIN_CELLS)
        copy = "INSERT OR REPLACE INTO main.data SELECT * FROM other.data WHERE sha256 = ?"
        db.executemany(copy, [(sha256,) for sha256 in data])
        for run in one.runs:
            # a run that was copied while it ran: finished < interrupted < running
            if run.run_id not in there or run.status < there[run.run_id]:
                write_run(db, run)
    return damaged


def _data_to_copy(one: FolderSurvey, output: Path, damaged: list[str]) -> Iterator[str]:
    """Yield the hashes of the data sets that the output lacks; note those that are damaged."""
    with reading(one.source) as db:
        hashes = [row[0] for row in db.execute("SELECT sha256 FROM data ORDER BY sha256")]
    for sha256 in hashes:
        with suppress(StoreError):
            read_data(output, sha256)
            continue
        try:
            read_data(one.source, sha256)
        except StoreError as error:
            damaged.append(str(error))
        else:
            yield sha256
