"""How and how long ours were trained, beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence

from stiff_protocols.record import CellResult

PAPER_PRETRAINING, PAPER_FINE_TUNING = 100_000, 50_000
"""Steps of the paper's trainings."""
PRETRAINING = "recipe=fast: Muon, Huber loss, 1,024 samples a step, linear decay"
FINE_TUNING = "recipe=fast: Adam, all samples a step, linear decay"
"""How the tables' networks are trained, but for those that are stopped early."""


def pretraining_note(results: Sequence[CellResult]) -> str:
    """Return a line about the pre-trainings."""
    return (
        f"Pre-training: ours {_steps(results, 'pre-training')} ({PRETRAINING}), the paper's "
        f"{PAPER_PRETRAINING:,} iterations (mean squared error; optimizer and batch not stated)."
    )


def fine_tuning_note(results: Sequence[CellResult]) -> str:
    """Return a line about both trainings."""
    return (
        f"{pretraining_note(results)} Fine-tuning: ours {_steps(results, 'fine-tuning')} "
        f"({FINE_TUNING}), the paper's {PAPER_FINE_TUNING:,} epochs at a rate of 0.03; both of the "
        "mean absolute error."
    )


def _steps(results: Sequence[CellResult], training: str) -> str:
    """Return how many steps the results' curves of a training go."""
    lengths = sorted(
        {int(one.curves[training][-1, 0]) for one in results if len(one.curves.get(training, ()))}
    )
    if not lengths:
        return "of unknown length"
    return f"{' or '.join(f'{length:,}' for length in lengths)} steps"
