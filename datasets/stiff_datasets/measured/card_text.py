"""Write the text of a new data card, for a user's file or an exported data set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from stiff_datasets.measured.data_card import (
    NOISE_LINE,
    TO_DO,
    DataCard,
    card_file,
    states_no_torque,
    without_relative_links,
)
from stiff_datasets.measured.sample_columns import (
    MM_PER_M,
    SIMULATED_GROUP,
    counted,
    in_file_units,
)
from stiff_protocols.contract.screen import one_line, printable
from stiff_protocols.contract.types import BenchmarkData

FILL_IN = {
    "Licence": "an SPDX identifier such as CC-BY-4.0, or the URL of the licence",
    "Citation": "authors, title and year, or the DOI of the paper",
    "Source": "URL where the data are published",
    "Version": "MAJOR.MINOR.PATCH",
    "Published": "YYYY-MM-DD",
}
"""Row of a card -> hint what to enter, in the order of the card."""
FIRST_VERSION = "1.0.0"
UNKNOWNS = """## How it was measured

TODO: instruments, dates, temperature, procedure, who measured.
State the noise of the instrument in a row of the table above, such as `| Instrument noise | 0.02 mm per reading |`.

## What is unknown

TODO"""  # noqa: E501


def card_text(name: str, rows: Mapping[str, str], body: str = UNKNOWNS) -> str:
    """Return a card in Markdown: a heading, a table of rows, and a body.

    Missing rows of `FILL_IN` get a hint what to enter.
    """
    needed = {row: f"{TO_DO}: {hint}" for row, hint in FILL_IN.items() if not rows.get(row)}
    lines = [f"| {row} | {value} |" for row, value in {**rows, **needed}.items() if value]
    return "\n".join(
        [f"# Data card: {one_line(name)}", "", "| | |", "|---|---|", *lines, "", body, ""]
    )


def own_card(path: Path, data: BenchmarkData, no_torque: bool, facts: Mapping[str, str]) -> str:
    """Return the first card of a user's own file of samples.

    Args:
        path: the file.
        data: its samples and their robot.
        no_torque: true if torques were not measured.
        facts: known rows of `FILL_IN`.
    """
    rows = {
        "What": what_text(data),
        "Robot": robot_text(data),
        **({"Torques": "not measured"} if no_torque else {}),
        "Version": FIRST_VERSION,
    }
    return card_text(path.stem, rows | {row: one_row(text) for row, text in facts.items()})


def exported_card(
    name: str, data: BenchmarkData, rows: Mapping[str, str], origin: str, earlier: str
) -> str:
    """Return the card of an exported data set, with its earlier card below.

    Args:
        name: name of the data set.
        data: its samples and their robot.
        rows: rows of the card's table.
        origin: name of the data set or file that the earlier card describes.
        earlier: text of that card; "" if there is none.
    """
    noise_mm = in_file_units(np.array([data.samples.instrument_noise]), MM_PER_M)[0]
    rows = {"What": rows["What"], "Robot": robot_text(data), **rows}
    if noise_mm and not any(map(NOISE_LINE.match, earlier.splitlines())):
        number = np.format_float_positional(noise_mm, trim="-")
        rows["Instrument noise"] = f"{number} mm per deflection"
    if rows.pop("Torques", "") and not states_no_torque(earlier):
        rows["Torques"] = "not measured"
    body = f"## The data card of {origin}\n\n{_below(earlier)}" if earlier else UNKNOWNS
    return card_text(name, rows, body)


def what_text(data: BenchmarkData) -> str:
    """Return the row "What" of a user's card: the content, and SIMULATED if it is."""
    samples = data.samples
    count = counted(len(samples), "sample")
    poses = counted(len(np.unique(samples.pose_id)), "pose")
    origin = "SIMULATED: " if SIMULATED_GROUP in samples.group else ""
    return f"{origin}{count} of loads and TCP deflections at {poses}"


def robot_text(data: BenchmarkData) -> str:
    """Return robot, number of joints and TCP for a card's row."""
    robot = data.robot
    return one_row(f"{robot.joints_text}, TCP {tcp_text(robot.tcp_on_flange)} m")


def tcp_text(tcp: Iterable[float]) -> str:
    """Return a (3,) TCP, m, as text with all digits: "0.06,0,0.08"."""
    return ",".join(np.format_float_positional(length, trim="-") for length in tcp)


def tcp_option(tcp: Iterable[float]) -> str:
    """Return the option `--tcp` for a (3,) TCP, m in the frame of the robot's last link."""
    text = tcp_text(tcp)
    return f"--tcp={text}" if text.startswith("-") else f"--tcp {text}"


def one_row(text: str) -> str:
    """Return a text as a cell of a Markdown table."""
    return printable(" ".join(text.split())).replace("|", r"\|")


def earlier_card(path: Path) -> str:
    """Return the text of the card next to a file of samples; "" if there is none."""
    card = card_file(path)
    if card == path or not card.is_file():
        return ""
    return card.read_text(encoding="utf-8", errors="replace").strip()


def fact_rows(card: DataCard) -> dict[str, str]:
    """Return the rows of `FILL_IN` that a card states."""
    rows = {row: card.facts.get(row.lower(), "") for row in FILL_IN}
    return {row: without_relative_links(value) for row, value in rows.items() if value}


def _below(card: str) -> str:
    """Return a card to insert below a heading: its headings move one level down."""
    lines: list[str] = []
    in_code = False
    for line in without_relative_links(card).splitlines():
        in_code ^= line.startswith("```")
        if line.startswith("# ") and not in_code and not lines:
            continue
        lines.append(f"#{line}" if line.startswith("#") and not in_code else line)
    return "\n".join(lines).strip()
