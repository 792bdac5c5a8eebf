"""Report the progress of long work to a listener."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """A report: `step` of `total` in `phase`, with the newest training loss if any."""

    phase: str
    step: int
    total: int
    loss: float | None = None


Listener = Callable[[Progress], None]
_listener: ContextVar[Listener | None] = ContextVar("stiffbench_progress", default=None)


def report(phase: str, step: int, total: int, loss: float | None = None) -> None:
    """Send a report to the listener, if any. Cheap enough for every few training steps."""
    listener = _listener.get()
    if listener is not None:
        listener(Progress(phase, step, total, loss))


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Send every report made inside the block to `listener`."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)
