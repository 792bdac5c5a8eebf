"""How long ours were trained, beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence

from stiff_protocols.record import CellResult

PAPER_PRETRAINING, PAPER_FINE_TUNING = 100_000, 50_000
"""Steps of the paper's trainings."""


def pretraining_note(results: Sequence[CellResult]) -> str:
    """Return a line about the length of the pre-trainings."""
    return (
        f"Pre-training: ours {_steps(results, 'pre-training')}, the paper's "
        f"{PAPER_PRETRAINING:,} iterations."
    )


def fine_tuning_note(results: Sequence[CellResult]) -> str:
    """Return a line about the length of both trainings."""
    return (
        f"{pretraining_note(results)} Fine-tuning: ours {_steps(results, 'fine-tuning')}, the "
        f"paper's {PAPER_FINE_TUNING:,} epochs."
    )


def _steps(results: Sequence[CellResult], training: str) -> str:
    """Return how many steps the results' curves of a training go."""
    lengths = sorted(
        {int(one.curves[training][-1, 0]) for one in results if len(one.curves.get(training, ()))}
    )
    if not lengths:
        return "of unknown length"
    return f"{' or '.join(f'{length:,}' for length in lengths)} steps"
