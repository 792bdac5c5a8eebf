"""Submissions to the leaderboard: pack a model's code, and evaluate it here."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

from stiff_bench.paper.study_file import find_study
from stiff_bench.parameter_types import FilePath, Folder
from stiff_bench.results.fresh_robots import FILE, read_entries
from stiff_bench.run.execution import Execution
from stiff_bench.run.fit_process import Limits
from stiff_bench.submissions.card import read_card
from stiff_bench.submissions.sealed_fit import SealedModel
from stiff_bench.submissions.submission import pack_submission, read_submission
from stiff_bench.submissions.verification import verify
from stiff_bench.tables.writers import Tables, Text
from stiff_protocols.contract.files import written_whole

STUDY = "leaderboard"
BOARD_RESULTS = Path("results/leaderboard/runs")
TIMEOUT_S, MEMORY_BYTES = 600.0, 4 * 2**30
"""Limits of a fit."""


def submit(output: Folder, card: FilePath, plugin: FilePath | None = None) -> Text:
    """Pack a model for the leaderboard: its card and its code.

    The folder holds no numbers. `bench verify` computes them, on the board's robots and on robots
    that are drawn then.

    Args:
        output: new folder for the submission.
        card: card of the model: plugin file, authors, licence and reference.
        plugin: plugin file; by default the one that the card names, next to the card.

    Raises:
        ConfigError: the card or a file is wrong.
        StoreError: the folder exists or cannot be written.
    """
    file = Path(plugin) if plugin is not None else Path(card).parent / read_card(Path(card)).plugin
    packed = pack_submission(Path(card), file, Path(output))
    command = shlex.join(["bench", "verify", str(output), "--lite"])
    return Text(f"{output}: {packed.card.model}, sha256 {packed.sha256[:12]}; next: {command}")


def verify_submission(
    folder: Folder,
    *,
    lite: bool = False,
    write: bool = False,
    trust: bool = False,
    results: Folder = BOARD_RESULTS,
    command: str = "",
) -> Tables:
    """Evaluate a submission: all numbers are computed here.

    The code runs in sealed processes (bubblewrap): without network, without the test labels, with
    10 minutes and 4 GiB for each fit. It is scored on the board's robots, and on 12 fresh robots
    that are drawn when the fits start.

    Args:
        folder: folder of the submission.
        lite: four robots of each kind.
        write: store the fits on the board's robots in the results, and the numbers of the fresh
            robots in fresh.json next to them.
        trust: run the code without bubblewrap, as any program of yours.
        results: results of the board.
        command: command of the run, stored with the results.

    Raises:
        ConfigError: the folder is not a submission, bubblewrap is missing, or the model fails.
        StoreError: the results cannot be read or written.
    """
    submission = read_submission(Path(folder))
    limits = Limits(timeout_s=TIMEOUT_S, memory_bytes=MEMORY_BYTES)
    verification = verify(
        SealedModel(submission, limits, trust),
        find_study(STUDY),
        lite=lite,
        results=Path(results),
        execution=Execution(),
        command=command,
        write=write,
    )
    if write:
        folder = Path(results).parent
        entries = {**read_entries(folder), verification.model: verification.record()}
        with written_whole(folder / FILE) as temporary:
            temporary.write_text(json.dumps(entries, indent=2, sort_keys=True) + "\n")
    return Tables([verification.table()], command)
