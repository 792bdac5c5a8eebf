"""The numbers that ten cheap commands print, kept so that a change of the engine cannot move one.

Made by ``python tests/golden_commands.py`` and compared by `test_golden_commands.py`. Times, memory
and the versions that made a result are left out; every other number of the JSON output counts,
those inside texts too.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from helpers.command_line import bench_here

KEPT = Path(__file__).with_name("golden_commands.json")
ROOT = Path(__file__).parents[1]
COMMITTED, PAPER = (str(ROOT / "results" / name / "runs") for name in ("leaderboard", "paper"))
MODELS = ("--model", "vjm", "--model", "vjm-full", "--model", "knn", "--model", "gp")
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("run", *MODELS, "--protocol", "holdout", "--splits", "3"),
    ("run", *MODELS, "--dataset", "fanuc-r2000ic", "--protocol", "kfold"),
    ("run", "--model", "vjm", "--model", "knn", "--protocol", "leave-one-out"),
    (
        *("run", *MODELS[:6], "--protocol", "kfold", "--metric", "norm", "--metric", "width"),
        *("--metric", "coverage", "--coverage", "0.8"),
        *("--dataset", "kr10-twin", "--dataset", "fanuc-r2000ic"),
    ),
    ("leaderboard",),
    ("compare", "vjm", "knn"),
    ("compare", "vjm", "vjm-full"),
    ("leaderboard", "--results", COMMITTED),
    ("compare", "vjm", "vjm-gp", "--results", COMMITTED),
    ("table", "2"),
    ("table", "10", "--results", PAPER),
)
"""In this order, in one folder: what the first ones store, the later ones rank and compare."""

LEFT_OUT = re.compile(r"command|provenance|.*(seconds|_s|_per_s|_bytes|time|memory|cost).*|made")
"""Names of entries that differ from run to run."""
ABOUT_A_RUN = re.compile(r"made by|stiffbench \d|took|second")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def printed(folder: Path) -> dict[str, dict[str, list[float]]]:
    """Command -> place in its output -> the numbers that stand there."""
    found = {}
    for words in COMMANDS:
        done = bench_here(*words, "--format", "json", cwd=folder)
        assert done.returncode == 0, done.stderr
        title = " ".join(words).replace(f"{ROOT}/", "")
        found[title] = dict(numbers(json.loads(done.stdout)))
    return found


def numbers(content: Any, place: str = "") -> Iterator[tuple[str, list[float]]]:
    """Yield each place of a JSON text with its numbers, in order."""
    if isinstance(content, dict):
        if content.get("table") == "costs":
            return
        for name, entry in content.items():
            if not LEFT_OUT.fullmatch(name):
                yield from numbers(entry, f"{place}/{name}")
    elif isinstance(content, list):
        for index, entry in enumerate(content):
            yield from numbers(entry, f"{place}/{index}")
    elif isinstance(content, str):
        if not ABOUT_A_RUN.search(content) and (inside := NUMBER.findall(content)):
            yield place, [float(number) for number in inside]
    elif content is not None:
        yield place, [float(content)]


def text_of(content: Any) -> str:
    """Return JSON with a line for each list, so that a difference can be read."""
    if not content or not isinstance(content, dict):
        return json.dumps(content)
    lines = [f"{json.dumps(name)}: {text_of(entry)}" for name, entry in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        KEPT.write_text(text_of(printed(Path(scratch))) + "\n")
