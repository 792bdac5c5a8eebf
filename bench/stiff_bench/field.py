"""Who takes part in a contest, with which scores, and why the others do not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations

from stiff_bench.collected import Competitor, Contest
from stiff_bench.contest_name import ContestName
from stiff_bench.newest import Slot
from stiff_bench.sort_key import SortKey
from stiff_protocols.errors import StoreError
from stiff_protocols.record import CellResult
from stiff_protocols.types import FloatArray

NOT_RUN = "not run"
NOT_FINISHED = "run not finished"


@dataclass(frozen=True, eq=False)
class Field:
    """Who takes part in a contest.

    Attributes:
        contest: the stored results.
        slots: the splits that all who take part have; no other counts.
        scores: model -> (J,) its value on each of these splits, in the metric's unit; one value
            where the protocol scores all splits together.
        missing: model -> why it has no score.
    """

    contest: Contest
    slots: tuple[Slot, ...]
    scores: Mapping[str, FloatArray]
    missing: Mapping[str, str]

    @property
    def name(self) -> ContestName:
        """What all results share."""
        return self.contest.name

    def mean(self, model: str) -> float:
        """Return a model's mean over the splits, in the metric's unit."""
        return float(self.scores[model].mean())

    def results(self, model: str) -> list[CellResult]:
        """Return a model's results on the splits that count."""
        return self.contest.results(model, self.slots)

    def failed(self, model: str) -> str:
        """Return "FAILED" or "SKIPPED" where a model was run and gave no result; else ""."""
        word, *_ = self.missing.get(model, "").split(maxsplit=1) or [""]
        return word if word in ("FAILED", "SKIPPED") else ""

    @property
    def left_out(self) -> str:
        """Which splits do not count, for people; "" where all do."""
        present = {model: self.contest.competitors[model].done for model in self.scores}
        n_all = len({slot for done in present.values() for slot in done})
        if n_all == len(self.slots):
            return ""
        lacking = [
            f"{model} lacks {n_all - len(done)}"
            for model, done in present.items()
            if len(done) < n_all
        ]
        return (
            f"only the {len(self.slots)} of {n_all} splits count that all models have "
            f"({', '.join(lacking)})"
        )


def field_of(
    contest: Contest, models: Sequence[str], key: SortKey, asked: Set[str] = frozenset()
) -> Field:
    """Return who of the models takes part, and with which scores.

    A model that was asked for fewer splits, and has them all, takes part, and only the splits that
    all have count. One that lacks a value is missing, and so is one whose run did not come to its
    end, unless it has every split that the finished ones share: it takes none from the others.

    Args:
        contest: the stored results.
        models: by name.
        key: what they are ranked by.
        asked: keys of the cells that the folder's runs were asked for.

    Raises:
        StoreError: two models have no split in common.
    """
    whole = {
        model: key.of_splits(contest.results(model))
        for model in models
        if model in contest.competitors and not contest.competitors[model].reasons
    }
    missing = {
        model: reason for model in models if (reason := _why_missing(contest, model, whole, key))
    }
    missing |= _unfinished(contest, [model for model in models if model not in missing], asked)
    present = [model for model in models if model not in missing]
    slots = tuple(contest.shared_slots(present)) if present else ()
    if present and not slots:
        _refuse(contest, present)
    found = {
        model: whole[model]
        if len(slots) == len(contest.competitors[model].done)
        else key.of_splits(contest.results(model, slots))
        for model in present
    }
    scores = {model: values for model, values in found.items() if values is not None}
    return Field(contest, slots, scores, missing)


def complete_models(fields: Sequence[Field]) -> tuple[str, ...]:
    """Return the models that have a score in all of these contests, in the order of their names."""
    return tuple(sorted(set.intersection(*(set(field.scores) for field in fields))))


def _why_missing(
    contest: Contest, model: str, values: Mapping[str, FloatArray | None], key: SortKey
) -> str:
    competitor = contest.competitors.get(model)
    if competitor is None:
        return NOT_RUN
    if competitor.reasons:
        (reason, _), *_ = Counter(competitor.reasons.values()).most_common(1)
        status, _, why = reason.partition(": ")
        n_all = len(competitor.reasons) + len(competitor.done)
        said = " ".join(why.split())
        return f"{status.upper()} in {len(competitor.reasons)} of {n_all} splits: {said}"
    return f"no value of {key.text}" if values[model] is None else ""


def _unfinished(contest: Contest, models: Sequence[str], asked: Set[str]) -> dict[str, str]:
    """Return which of these models take no part because their run did not come to its end."""
    why = {model: _why_unfinished(contest, contest.competitors[model], asked) for model in models}
    finished = [model for model in models if not why[model]]
    needed = set(contest.shared_slots(finished))
    return {
        model: reason
        for model, reason in why.items()
        if reason and not (finished and needed <= contest.competitors[model].done.keys())
    }


def _why_unfinished(contest: Contest, competitor: Competitor, asked: Set[str]) -> str:
    n_done = len(competitor.done)
    if n_done < competitor.n_asked:
        return f"{n_done} of {competitor.n_asked} splits asked for: {NOT_FINISHED}"
    return NOT_FINISHED if _asked_for_more(contest, competitor, asked) else ""


def _asked_for_more(contest: Contest, competitor: Competitor, asked: Set[str]) -> bool:
    """Say whether a model was to be run on more of the others' splits and was not."""
    own = {result.cell.coverage: result.cell for result in competitor.done.values()}
    return any(
        replace(cell, split_index=slot[0], split_sha256=slot[1], rows_sha256=rows_sha256).key
        in asked
        for slot, rows_sha256 in contest.rows_sha256.items()
        if slot not in competitor.done
        for cell in own.values()
    )


def _refuse(contest: Contest, models: Sequence[str]) -> None:
    apart = [pair for pair in combinations(models, 2) if not contest.shared_slots(pair)]
    named = apart[0] if apart else tuple(models)
    raise StoreError(
        f"{contest.name.text}: {' and '.join(named)} were run on different splits and share none, "
        "so they cannot be compared; leave one out (--model) or run it anew"
    )
