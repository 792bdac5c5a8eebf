"""Command lines that make again what the page shows."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Choice:
    """Which contests and models a page shows, and what it ranks by.

    Attributes:
        models, datasets, protocols: words of the command line; none named means all.
        metric, axis: what is ranked by; no axis: the mean over them.
        seed: of the draws of poses.
    """

    models: tuple[str, ...] = ()
    datasets: tuple[str, ...] = ()
    protocols: tuple[str, ...] = ()
    metric: str = "norm"
    axis: str | None = None
    seed: int = 0

    def command(self, *words: str, folder: Path, ranked: bool = False) -> str:
        """Return a command line with these options.

        Args:
            words: that it begins with.
            folder: of the results.
            ranked: the command ranks, and draws poses.
        """
        options = [
            ("--results", str(folder)),
            *_each("--model", self.models),
            *_each("--dataset", self.datasets),
            *_each("--protocol", self.protocols),
        ]
        if ranked:
            options += [("--metric", self.metric)] if self.metric != "norm" else []
            options += [("--axis", self.axis)] if self.axis is not None else []
            options += [("--seed", str(self.seed))] if self.seed else []
        return shell_words("bench", *words, *(word for option in options for word in option))


def shell_words(*words: str) -> str:
    """Return words as a shell reads them."""
    return shlex.join(words)


def _each(option: str, values: Iterable[str]) -> list[tuple[str, str]]:
    return [(option, value) for value in values]
