"""What was asked for, narrowed to what a folder has: each of several may have other names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stiff_bench.collected import Contest, chosen_contests, competitor_names, stands_for
from stiff_bench.report.commands import Choice
from stiff_protocols.errors import ConfigError, unknown_name


def check_choice(contests: Sequence[Contest], choice: Choice) -> None:
    """See that each word has results, and that the data sets and protocols meet somewhere.

    Args:
        contests: of all folders together.
        choice: what was asked for.

    Raises:
        ConfigError: a word has none, or they do not meet.
    """
    known = competitor_names(contests)
    for word in choice.models:
        if not _has_model(contests, word):
            raise ConfigError(f"--model: {unknown_name('model with results', word, known)}")
    if not chosen_contests(contests, datasets=choice.datasets, protocols=choice.protocols):
        raise ConfigError(
            f"--dataset {', '.join(choice.datasets)} --protocol {', '.join(choice.protocols)}: no "
            "data set of these has results under a protocol of these"
        )


def narrowed(contests: Sequence[Contest], choice: Choice) -> tuple[Choice, tuple[str, ...]]:
    """Return the words that one folder has results of, and those that it has not.

    Args:
        contests: of the folder.
        choice: what was asked for, see `check_choice`.
    """
    models = tuple(word for word in choice.models if _has_model(contests, word))
    datasets = tuple(word for word in choice.datasets if _has(contests, datasets=(word,)))
    protocols = tuple(word for word in choice.protocols if _has(contests, protocols=(word,)))
    here = replace(choice, models=models, datasets=datasets, protocols=protocols)
    asked = (*choice.models, *choice.datasets, *choice.protocols)
    present = {*models, *datasets, *protocols}
    return here, tuple(word for word in asked if word not in present)


def chosen_here(contests: Sequence[Contest], asked: Choice, here: Choice) -> list[Contest]:
    """Return the contests of a folder that were asked for; none where it lacks all of a kind."""
    for words, present in (
        (asked.models, here.models),
        (asked.datasets, here.datasets),
        (asked.protocols, here.protocols),
    ):
        if words and not present:
            return []
    return chosen_contests(contests, datasets=here.datasets, protocols=here.protocols)


def _has_model(contests: Sequence[Contest], word: str) -> bool:
    return any(stands_for(word, name) for name in competitor_names(contests))


def _has(
    contests: Sequence[Contest], *, datasets: Sequence[str] = (), protocols: Sequence[str] = ()
) -> bool:
    try:
        return bool(chosen_contests(contests, datasets=datasets, protocols=protocols))
    except ConfigError:
        return False
