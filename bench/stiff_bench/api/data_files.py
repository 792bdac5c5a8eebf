"""Describe a user's file of samples for others, and export data sets."""

from __future__ import annotations

import re
import shlex
import warnings
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

from stiff_bench.api.robots import load_robot, read_robot, robot_words, shipped_name
from stiff_bench.parameter_types import Form, HeldJoints, Point
from stiff_bench.plan.options import Choice
from stiff_bench.tables.dataset_facts import card_text
from stiff_bench.tables.units import counted
from stiff_bench.tables.writers import Text
from stiff_datasets.measured import kr10_measured
from stiff_datasets.measured.card_text import (
    FILL_IN,
    FIRST_VERSION,
    earlier_card,
    exported_card,
    fact_rows,
    one_row,
    own_card,
    tcp_option,
    what_text,
)
from stiff_datasets.measured.data_card import card_file, parse_card
from stiff_datasets.measured.descriptors import (
    DescribedFile,
    check_descriptor_files,
    describe,
    write_descriptors,
)
from stiff_datasets.measured.exported_files import ExportedFiles, export
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.sample_file import MeasuredData, read_samples
from stiff_datasets.measured.validation_report import validate
from stiff_datasets.robots.shipped_robots import DEFAULT_ROBOT, named_robot
from stiff_datasets.robots.urdf_writer import robot_urdf, shipped_urdf
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchWarning
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.types import BenchmarkData, Robot

LONGEST_STEM = 120
"""Longest name of exported files; file systems allow 255 bytes with the extension."""


def register(
    file: Path,
    *,
    options: FileOptions,
    dataset: Literal["kr10-measured"] | None = None,
    robot: str | None = None,
    urdf: Path | None = None,
    tip: str | None = None,
    base: str | None = None,
    hold: HeldJoints | None = None,
    tcp: Point | None = None,
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
        robot: shipped robot that was measured; by default the KR10 with `dataset`.
        urdf: URDF of your own robot, in place of `robot`.
        tip: last link of the robot in the URDF; by default the end of the longest chain, without
            fingers.
        base: first link of the robot in the URDF, and the base frame; by default the URDF's.
        hold: joint of the URDF that does not move, such as a rail, at a value in deg or mm, by name
            or number (rail, J3, 3); may be repeated.
        tcp: (3,) tool centre point in the frame of the last link, in m; by default the shipped
            robot's, or 0,0,0 with `urdf`.
        licence: SPDX identifier or URL, for a new card.
        citation: reference to cite, for a new card.
        source: place of publication, for a new card.

    Raises:
        ConfigError: no robot is named, or the card states a licence, citation or source already.
        DataError: the file or its card cannot be read, or it is not plain CSV and gets no name.
        StoreError: a descriptor of another program is there, or a file cannot be written.
    """
    csv, given = file, {"Licence": licence, "Citation": citation, "Source": source}
    facts = {row: text for row, text in given.items() if text}
    of_urdf = {"tip": tip, "base": base, "hold": hold}
    measured_robot = _robot_of(csv, dataset, robot, urdf, of_urdf, tcp)
    samples = read_samples(csv, measured_robot, options)
    data = BenchmarkData(samples, measured_robot)
    card, is_new = card_file(csv), not earlier_card(csv)
    if not is_new and facts:
        name = next(iter(facts))
        raise ConfigError(f"is for a new card; edit the row {name} of {card}", name.lower())
    text = own_card(csv, data, options.no_torque, facts) if is_new else earlier_card(csv)
    reason = ""
    try:
        described = describe(csv, measured_robot, parse_card(text, card))
        check_descriptor_files(csv)
    except DataError as error:
        if dataset is None:
            raise
        reason = str(error)
    lines = [f"{csv}: {counted(len(samples), 'sample')} of {measured_robot.name}"]
    lines[0] += _verdict(csv, measured_robot, options)
    if dataset is not None:
        default = named_robot(DEFAULT_ROBOT).tcp if urdf is None else (0.0, 0.0, 0.0)
        x, y, z = default if tcp is None else tcp
        place = kr10_measured.register(dataset, csv, urdf, (x, y, z), options, **of_urdf)
        use = f"bench run --dataset {dataset}"
        lines.append(f"{dataset}: named in {place}; use it with: {use}")
    if reason:
        return Text("\n".join([*lines, f"no descriptors: {reason}"]))
    if is_new:
        with written_whole(card) as temporary:
            temporary.write_text(text, encoding="utf-8")
    paths = write_descriptors(described)
    lines += [f"{card}: new data card"] if is_new else []
    lines += [f"{path}: written" for path in paths]
    return Text("\n".join([*lines, *_gaps(described, card, "this command again")]))


def _robot_of(
    csv: Path,
    dataset: str | None,
    robot: str | None,
    urdf: Path | None,
    of_urdf: Mapping[str, Any],
    tcp: Sequence[float] | None,
) -> Robot:
    """Return the robot of a user's file.

    Raises:
        ConfigError: none is named, two are, or the data set is of another one.
    """
    if urdf is not None:
        if robot is not None:
            raise ConfigError(f"{robot} and --urdf {urdf}: give only one of them", "robot")
        return read_robot(urdf, tcp=tcp, **of_urdf)
    for option, value in of_urdf.items():
        if value:
            text = value if isinstance(value, str) else ", ".join(value)
            raise ConfigError(f"{text} requires --urdf", option)
    if dataset is not None and robot not in (None, DEFAULT_ROBOT):
        raise ConfigError(f"{robot}: {dataset} is of {DEFAULT_ROBOT} (or give --urdf)", "robot")
    if robot is None and dataset is None:
        raise ConfigError(f"{csv}: name the measured robot: --urdf FILE.urdf or --robot NAME")
    return load_robot(robot or DEFAULT_ROBOT, tcp=tcp)


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


def _gaps(described: DescribedFile, card: Path, command: str) -> list[str]:
    """Return lines on missing facts of a data card, and how to fill them in."""
    missing = described.missing_facts
    if not missing:
        return []
    rows = (f"  | {fact.capitalize()} | {FILL_IN[fact.capitalize()]} |" for fact in missing)
    first = f"not stated: {', '.join(missing)}; fill in these rows of {card}:"
    return [first, *rows, f"then run {command}"]


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
    stem, source = _file_stem(choice), _source_file(choice)
    name = stem if "csv" in choice.context else one_row(choice.name)
    earlier, origin = "", choice.info.key
    if source is not None:
        earlier, origin = earlier_card(source.csv), source.csv.name
    elif choice.info.card:
        earlier = card_text(choice.info.key, choice.info.card)
    rows = _card_rows(choice, data, earlier)
    if source is not None and source.options.no_torque:
        rows["Torques"] = "not measured"
    shipped = shipped_name(data.robot)
    urdf = shipped_urdf(named_robot(shipped)) if shipped else robot_urdf(data.robot)

    def card(words: str, sha256: str) -> str:
        read = {
            "Files": f"`{stem}.csv`; robot `{stem}.urdf`"
            + (", licence in the file" * bool(shipped)),
            "Read by": f"`bench run --model vjm --data {stem}.csv {words}`",
            "sha256 of samples and robot": f"`{data.sha256}`",
        }
        if sha256 != data.sha256:
            read["The same, as read from these files"] = f"`{sha256}`"
        return exported_card(name, data, rows | read, origin, earlier)

    return Text(_export_text(export(data, folder, stem, urdf, card), data, name))


def _source_file(choice: Choice[DatasetInfo]) -> MeasuredData | None:
    """Return the user's file of a data set; None: the data set has no file."""
    if choice.info.key == kr10_measured.KR10_MEASURED:
        entry = kr10_measured.registration()
        options = FileOptions(entry.no_torque, entry.sheet, entry.pose_tolerance, entry.register)
        return MeasuredData(csv=Path(entry.csv), robot=load_robot(), options=options)
    return choice.make() if "csv" in choice.context else None


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
    rows = {"What": what, "Version": FIRST_VERSION}
    rows |= {f"Caveat {i}": one_row(text) for i, text in enumerate(info.caveats, start=1)}
    if info.kind == "simulated":
        rows |= {"Source": f"{program}: `bench data export {one_row(shlex.quote(choice.name))}`"}
        rows |= {"Version": version("stiffbench")}
        if info.card:
            rows |= {"Citation": f"the stiffbench authors, {program}, data set {choice.name}"}
    return rows | fact_rows(stated)


def _export_text(files: ExportedFiles, data: BenchmarkData, name: str) -> str:
    csv, card, urdf, *_ = files.paths
    n_samples = counted(len(data.samples), "sample")
    lines = [f"{name}: {n_samples} of {data.robot.name} exported", *map(str, files.paths)]
    if files.sha256 == data.sha256:
        lines += ["read back: the same samples and robot", f"sha256: {data.sha256}"]
    else:
        share = f"{files.n_rounded} of {data.samples.q.size} joint positions"
        differing = share if files.n_rounded else "placements of the robot"
        lines += [
            f"read back: {differing} differ by rounding, 1e-15; all other numbers are the same",
            f"sha256 of the data set:          {data.sha256}",
            f"sha256 as read from these files: {files.sha256}",
        ]
    command = shlex.join(["bench", "data", "register", str(csv), "--urdf", str(urdf)])
    command += f" {tcp_option(data.robot.tcp_on_flange)}"
    return "\n".join([*lines, *_gaps(files.described, card, command)])
