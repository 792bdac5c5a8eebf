"""Describe a user's file of samples for others, and export data sets."""

from __future__ import annotations

import re
import shlex
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from stiff_bench.api.robots import URDF_OPTIONS, as_robot, robot_words, shipped_name
from stiff_bench.parameter_types import Form
from stiff_bench.plan.options import Choice
from stiff_bench.tables.dataset_facts import card_text
from stiff_bench.tables.units import counted
from stiff_bench.tables.writers import Text
from stiff_datasets.measured import kr10_measured
from stiff_datasets.measured.data_card import (
    FILL_IN,
    card_file,
    earlier_card,
    fact_rows,
    new_card,
    one_row,
    parse_card,
    read_card,
    tcp_option,
    what_text,
)
from stiff_datasets.measured.descriptors import (
    check_descriptor_files,
    describe,
    descriptor_files,
    write_descriptors,
)
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.sample_file import read_samples
from stiff_datasets.measured.table_reader import sample_table, write_table
from stiff_datasets.measured.validation_report import validate
from stiff_datasets.robots import urdf_reader
from stiff_datasets.robots.shipped_robots import DEFAULT_ROBOT, named_robot
from stiff_datasets.robots.urdf_writer import robot_urdf, shipped_urdf
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchWarning, StoreError
from stiff_protocols.contract.files import check_new_file, make_folder, written_whole
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import BenchmarkData, Robot

LONGEST_STEM = 120
"""Longest name of exported files; file systems allow 255 bytes with the extension."""


def register(
    file: Path,
    *,
    options: FileOptions,
    dataset: Literal["kr10-measured"] | None = None,
    robot: str | Robot | None = None,
    licence: Annotated[str, Form("TEXT")] | None = None,
    citation: Annotated[str, Form("TEXT")] | None = None,
    source: Annotated[str, Form("URL")] | None = None,
) -> Text:
    """Describe your own CSV file for others.

    Writes a Croissant and a Frictionless descriptor next to the file, from its data card. A file
    without a card gets one to fill in.

    Args:
        file: your measurement.
        options: statements about the file.
        dataset: name that the file gets in other commands.
        robot: robot that was measured; by default the KR10 with `dataset`.
        licence: SPDX identifier or URL, for a new card.
        citation: reference to cite, for a new card.
        source: place of publication, for a new card.

    Raises:
        ConfigError: no robot is named, the data set is of another one, or the card states a
            licence, citation or source already.
        DataError: the file or its card cannot be read, or it is not plain CSV and gets no name.
        StoreError: a descriptor of another program is there, or a file cannot be written.
    """
    csv, given = file, {"Licence": licence, "Citation": citation, "Source": source}
    facts = {row: one_row(text) for row, text in given.items() if text}
    if robot is None and dataset is None:
        raise ConfigError(f"{csv}: name the measured robot: --urdf FILE.urdf or --robot NAME")
    measured_robot = as_robot(robot)
    read_by = URDF_OPTIONS.get(measured_robot, {"urdf": None})
    shipped = shipped_name(measured_robot)
    if dataset is not None and read_by["urdf"] is None and shipped != DEFAULT_ROBOT:
        raise ConfigError(f"{shipped}: {dataset} is of {DEFAULT_ROBOT} (or give --urdf)", "robot")
    samples = read_samples(csv, measured_robot, options)
    data = BenchmarkData(samples, measured_robot)
    card, text = card_file(csv), earlier_card(csv)
    is_new = not text.strip()
    if not is_new and facts:
        name = next(iter(facts))
        raise ConfigError(f"is for a new card; edit the row {name} of {card}", name.lower())
    if is_new:
        facts |= {"Torques": "not measured"} if options.no_torque else {}
        text = new_card(csv.stem, data, facts)
    reason = ""
    try:
        package = describe(csv, measured_robot, parse_card(text, card))
        check_descriptor_files(csv)
    except DataError as error:
        if dataset is None:
            raise
        reason = str(error)
    lines = [f"{csv}: {counted(len(samples), 'sample')} of {measured_robot.name}"]
    lines[0] += _verdict(csv, measured_robot, options)
    if dataset is not None:
        x, y, z = read_by.get("tcp") or measured_robot.tcp_on_flange.tolist()
        read_by = {**read_by, "tcp": (x, y, z)}
        place = kr10_measured.register(dataset, csv, options=options, **read_by)
        use = f"bench run --dataset {dataset}"
        lines.append(f"{dataset}: named in {place}; use it with: {use}")
    if reason:
        return Text("\n".join([*lines, f"no descriptors: {reason}"]))
    if is_new:
        with written_whole(card) as temporary:
            temporary.write_text(text, encoding="utf-8")
    paths = write_descriptors(csv, package)
    lines += [f"{card}: new data card"] if is_new else []
    lines += [f"{path}: written" for path in paths]
    return Text("\n".join([*lines, *_gaps(csv, "this command again")]))


def _verdict(csv: Path, robot: Robot, options: FileOptions) -> str:
    """Return the verdict of `bench data validate` on a file that can be read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)
        report = validate(csv, robot, options)
    if not report.warnings:
        return f", {report.verdict}"
    words = shlex.join(["bench", "data", "validate", str(csv), *options.words])
    n_warnings = counted(len(report.warnings), "warning")
    return f", {report.verdict}: {n_warnings}, which {words}{robot_words(robot)} lists"


def _gaps(csv: Path, command: str) -> list[str]:
    """Return lines on missing facts of a file's data card, and how to fill them in."""
    missing = {
        row: hint for row, hint in FILL_IN.items() if row.lower() not in read_card(csv).facts
    }
    if not missing:
        return []
    first = f"not stated: {', '.join(missing).lower()}; fill in these rows of {card_file(csv)}:"
    return [
        first,
        *(f"  | {row} | {hint} |" for row, hint in missing.items()),
        f"then run {command}",
    ]


def export_dataset(choice: Choice[DatasetInfo], data: BenchmarkData, folder: Path) -> Text:
    """Write a data set as CSV, URDF, data card and descriptors; return a summary.

    Args:
        choice: data set with options.
        data: samples and robot of the data set.
        folder: folder of the files, created if needed; existing files are not overwritten.

    Raises:
        DataError: a file cannot represent the data; see `read_samples`.
        StoreError: a file exists, or cannot be written.
    """
    stem, (source, no_torque) = _file_stem(choice), _source_file(choice)
    name = stem if "csv" in choice.context else one_row(choice.name)
    earlier, origin = "", choice.info.key
    if source is not None:
        earlier, origin = earlier_card(source), source.name
    elif choice.info.card:
        earlier = card_text(choice.info.key, choice.info.card)
    rows = _card_rows(choice, data, earlier)
    if no_torque:
        rows["Torques"] = "not measured"
    tcp = tcp_option(data.robot.tcp_on_flange)
    shipped = shipped_name(data.robot)
    urdf = shipped_urdf(named_robot(shipped)) if shipped else robot_urdf(data.robot)
    rows |= {
        "Files": f"`{stem}.csv`; robot `{stem}.urdf`" + ", licence in the file" * bool(shipped),
        "Read by": f"`bench run --model vjm --data {stem}.csv --urdf {stem}.urdf {tcp}`",
        "sha256 of samples and robot": f"`{data.sha256}`",
    }
    csv = folder / f"{stem}.csv"
    paths = (csv, csv.with_suffix(".md"), csv.with_suffix(".urdf"), *descriptor_files(csv))
    with _written_together(paths) as (new_csv, new_card_file, new_urdf, *_):
        write_table(new_csv, [sample_table(data.samples, data.robot)])
        new_urdf.write_text(urdf, encoding="utf-8")
        robot = urdf_reader.read_robot(new_urdf, tcp=data.robot.tcp_on_flange.tolist())
        new_card_file.write_text(new_card(name, data, rows, origin, earlier), encoding="utf-8")
        with warnings.catch_warnings():  # the data set's own reader gave them
            warnings.simplefilter("ignore", StiffBenchWarning)
            samples = read_samples(new_csv, robot)
        if (sha256 := BenchmarkData(samples, robot).sha256) != data.sha256:
            rows["The same, as read from these files"] = f"`{sha256}`"
            new_card_file.write_text(new_card(name, data, rows, origin, earlier), encoding="utf-8")
        write_descriptors(new_csv, describe(new_csv, robot))
    lines = [f"{name}: {counted(len(samples), 'sample')} of {data.robot.name} exported"]
    lines += map(str, paths)
    if sha256 == data.sha256:
        lines += ["read back: the same samples and robot", f"sha256: {sha256}"]
    else:
        n_rounded = int(np.count_nonzero(samples.q != data.samples.q))
        share = f"{n_rounded} of {data.samples.q.size} joint positions"
        differing = share if n_rounded else "placements of the robot"
        lines += [
            f"read back: {differing} differ by rounding, 1e-15; all other numbers are the same",
            f"sha256 of the data set:          {data.sha256}",
            f"sha256 as read from these files: {sha256}",
        ]
    words = ["bench", "data", "register", str(csv), "--urdf", str(csv.with_suffix(".urdf"))]
    return Text("\n".join([*lines, *_gaps(csv, f"{shlex.join(words)} {tcp}")]))


@contextmanager
def _written_together(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Yield temporary paths of new files of one folder; move all of them there at the end, or none.

    The folder is created if needed. StoreError: a file exists, or cannot be written.
    """
    folder = paths[0].parent
    is_new_folder = not folder.exists()
    make_folder(folder)
    moved: list[Path] = []
    try:
        for path in paths:
            check_new_file(path)
        with tempfile.TemporaryDirectory(prefix=".export-", dir=folder) as temporary:
            yield [Path(temporary, path.name) for path in paths]
            for path in paths:
                shutil.move(Path(temporary, path.name), path)
                moved.append(path)
    except BaseException as error:
        for path in moved:
            path.unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        raise StoreError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        if is_new_folder and not any(folder.iterdir()):
            folder.rmdir()


def _source_file(choice: Choice[DatasetInfo]) -> tuple[Path | None, bool]:
    """Return the user's file of a data set, None for no file; true if torques were not measured."""
    if choice.info.key == kr10_measured.KR10_MEASURED:
        entry = kr10_measured.registration()
        return Path(entry.csv), entry.no_torque
    if "csv" not in choice.context:
        return None, False
    data = choice.make()
    return data.csv, data.options.no_torque


def _file_stem(choice: Choice[DatasetInfo]) -> str:
    """Return the name of exported files without extension: "kr10-twin_plan=wide"."""
    name = Path(choice.name).stem if "csv" in choice.context else choice.name
    stem = re.sub(r"[^\w.=+-]+", "_", name).strip("._")
    return stem[:LONGEST_STEM] or "data"


def _card_rows(choice: Choice[DatasetInfo], data: BenchmarkData, earlier: str) -> dict[str, str]:
    """Return the rows of an exported card: description, source and citation."""
    info, program = choice.info, f"stiffbench {version('stiffbench')}"
    stated = parse_card(earlier, Path("card"))
    what = one_row(f"{info.kind.upper()}: {info.summary}")
    if "csv" in choice.context:
        what = stated.facts.get("what") or what_text(data)
    if choice.options_text:
        what = f"{what}; options: {one_row(choice.options_text)}"
    rows = {"What": what}
    rows |= {f"Caveat {i}": one_row(text) for i, text in enumerate(info.caveats, start=1)}
    if info.kind == "simulated":
        rows |= {"Source": f"{program}: `bench data export {one_row(shlex.quote(choice.name))}`"}
        rows |= {"Version": version("stiffbench")}
        if info.card:
            rows |= {"Citation": f"the stiffbench authors, {program}, data set {choice.name}"}
    return rows | fact_rows(stated)
