"""Write the sentences about results: which model, how much, how sure, but, data.

Errors are converted to mm and % here.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from statistics import median
from typing import TYPE_CHECKING, Any

from stiff_bench.results.columns import (
    BEST,
    EQUAL_TEXT,
    INTERVAL,
    LIKE_BEST,
    RATIO_FORMAT,
    VERDICT_TEXTS,
    error_matrix,
    number,
)
from stiff_bench.results.scored_task import ScoredTask
from stiff_bench.results.scores import FEWEST_ROBOTS, Scores, complete_logs
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import MM, counted, first_few, percent
from stiff_datasets.measured.sample_columns import is_planned
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.scoring.over_robots import MARGIN
from stiff_protocols.scoring.paired import LEVEL, ROPE_M

if TYPE_CHECKING:
    from pandas import DataFrame

Row = Mapping[Any, Any]


@dataclass(frozen=True)
class Summary:
    """The result in sentences.

    Attributes:
        headline: model to use and its gain, or that none is better.
        sentences: labels and texts: How sure, But (exceptions), Data (kinds, scope of the claim).
    """

    headline: str
    sentences: list[tuple[str, str]]

    @property
    def lines(self) -> list[str]:
        """Return the labelled sentences as lines of text."""
        return [f"{label}: {text}" for label, text in self.sentences]


def summarize(scores: Scores, table: DataFrame) -> Summary:
    """Return the result of several tasks: over robots, or per data set.

    `table` is the `model_frame` of the scores.
    """
    is_rival = table["complete"] & ~table["model"].isin([REFERENCE_MODEL, *scores.copies])
    rivals = table[is_rival].to_dict("records")
    if not rivals or number(rivals[0], "ratio") is None:
        ((model, n_best),) = Counter(task.best() for task in scores.tasks).most_common(1)
        best_in = f"in {n_best} of {counted(len(scores.tasks), 'comparison')}"
        data = _data_text(scores)
        return Summary(f"{model} has the best {scores.key.text} {best_in}", [("Data", data)])
    if "won" in table:
        return _over_robots(scores, table)
    return _per_dataset(scores, rivals, [*table["model"]])


# over robots


def _over_robots(scores: Scores, table: DataFrame) -> Summary:
    """Return the result of the model with the smallest ratio; the first row may be the VJM."""
    rows = table[table["complete"]].to_dict("records")
    followers = {REFERENCE_MODEL, *scores.copies}
    lead = min((row for row in rows if row["model"] not in followers), key=lambda row: row["ratio"])
    headline = f"No model is reliably better than the VJM over {scores.scope}"
    if lead["verdict"] == "better":
        headline = (
            f"Use {lead['model']}: {_ratio(lead['ratio'])} times the VJM's error "
            f"({_ratio(lead['low'])} to {_ratio(lead['high'])}, {INTERVAL} over {scores.scope})"
        )
    rival, of_rivals = lead["rival"], "Every other model is significantly worse."
    if lead["model"] != rival:
        of_rivals = f"Against the best spring model, {rival}: {lead['verdict rival']}."
    elif like := [row["model"] for row in rows if row["verdict rival"] in ("open", "better")]:
        of_rivals = f"Not significantly worse: {first_few(like)}."
    how_sure = (
        f"{lead['model']} has the smallest error on {lead['won']:.0f} of "
        f"{counted(int(lead['n robots']), 'robot')}. Without any one robot the ratio lies between "
        f"{_ratio(lead['without low'])} and {_ratio(lead['without high'])}. {of_rivals}"
    )
    but = f"Its worst robot is {lead['worst robot']} ({_ratio(lead['worst'])})."
    if ahead := [*_models_ahead(scores, lead["model"])]:
        but = f"Another model is more than {EQUAL_TEXT} better: {first_few(ahead, 2)}. {but}"
    data = _lead_data(scores, lead, rows)
    return Summary(headline, [("How sure", how_sure), ("But", but), ("Data", data)])


def _ratio(value: float) -> str:
    return f"{value:{RATIO_FORMAT}}"


def _models_ahead(scores: Scores, model: str) -> Iterator[str]:
    """Yield the robots on which another model is better by more than the practical margin."""
    for robot, logs in complete_logs(scores).to_dict("index").items():
        best = min({*logs} - {*scores.copies}, key=lambda name: logs[name])
        if logs[model] - logs[best] > MARGIN:
            errors = (f"{math.exp(logs[name]):.3f}" for name in (best, model))
            yield f"{best} on {robot} ({' against '.join(errors)})"


def _lead_data(scores: Scores, lead: Row, rows: Sequence[Row]) -> str:
    """Return the number of measured robots, and the scores on them."""
    datasets = [key[1] for key in lead if isinstance(key, tuple) and key[0] == "measured"]
    n_elsewhere = len({*datasets} - {*scores.measured})  # scored against readings, not the truth
    robots = scores.frame.drop_duplicates("robot")
    n_measured = int((robots["kind"] == "measured").sum()) + n_elsewhere
    verb = "is" if n_measured == 1 else "are"
    text = f"{n_measured} of {counted(len(robots) + n_elsewhere, 'robot')} {verb} measured"
    for dataset in datasets:
        key = "measured", dataset
        if (ratio := number(lead, key)) is None:
            continue
        text += f"; on {dataset} {lead['model']} has {_ratio(ratio)} times the VJM's error"
        if verdict := VERDICT_TEXTS.get(lead.get(("measured verdict", dataset)), ""):
            text += f" ({verdict})"
        in_data = {row["model"]: value for row in rows if (value := number(row, key))}
        best = min(in_data, key=lambda name: in_data[name])
        if best != lead["model"]:
            text += f"; smallest on the board: {best} ({_ratio(in_data[best])})"
    return f"{text}."


def split_notes(scores: Scores, table: DataFrame) -> list[str]:
    """Return notes on models with fewer splits and on models without every score."""
    if scores.claim is None:
        return []
    rows, complete = scores.rows, {*table[table["complete"]]["model"]}
    counts, n_all = rows["model"].value_counts(), rows["task"].nunique()
    fewer = [name for name in scores.models if 0 < counts.get(name, 0) < n_all]
    by_count = grouped(fewer, lambda name: (name not in complete, counts[name]))
    kinds = ("With fewer splits", "Not on the board, without every score")
    return [
        f"{kinds[is_missing]}: {first_few(names)} ({count} of {n_all})."
        for (is_missing, count), names in sorted(by_count.items())
    ]


# with few robots: per data set


def _per_dataset(scores: Scores, rivals: Sequence[Row], models: Sequence[str]) -> Summary:
    """Return the best of the models that win more tasks against the VJM than they lose."""
    counts = {row["model"]: scores.verdict_counts(row["model"]) for row in rivals}
    winners = [
        row
        for row in rivals
        if row["ratio"] < 1.0 and counts[row["model"]]["a"] > counts[row["model"]]["b"]
    ]
    best = (winners or rivals)[0]
    name, of_best = best["model"], counts[best["model"]]
    names = [*scores.datasets]
    data = f"on {names[0]}" if len(names) == 1 else "on these data sets"
    headline = f"No model is reliably better than the VJM {data}"
    if winners:
        won = f"better in {of_best['a']} of {counted(of_best.total(), 'comparison')}"
        less = 100.0 * (1.0 - best["ratio"])
        headline = f"Use {name} {data}: {less:.0f} % less error than the VJM, {won}"
    sentences = []
    if not of_best:
        no_test = "no test applies: there is one split, and poses cannot be resampled."
        sentences.append(("How sure", no_test))
    if better := [*_better_models(scores, models, name)]:
        but = f"Another model is significantly better: {first_few(better, 2)}."
        sentences.append(("But", but))
    return Summary(headline, [*sentences, ("Data", _data_text(scores))])


def _better_models(scores: Scores, models: Sequence[str], model: str) -> Iterator[str]:
    """Yield the headings whose best model is significantly better than a model."""
    originals = [name for name in models if name not in scores.copies]
    best = (scores.key.sign * error_matrix(scores, originals)).fillna(math.inf).idxmin()
    for heading, tasks in scores.columns.items():
        rival = str(best[heading])
        if all(task.verdict(rival, model) == "a" for task in tasks):
            yield f"{rival} on {', '.join(filter(None, heading))}"


def _data_text(scores: Scores) -> str:
    """Return a text on the kinds of the data and on the scope of the claim."""
    kinds = Counter(tasks[0].kind for tasks in scores.datasets.values())
    text = ", ".join(f"{n} {kind}" for kind, n in kinds.items())
    text += " data set" if kinds.total() == 1 else " data sets"
    if tasks := [*chain.from_iterable(scores.measured.values())]:
        better = [name for name in scores.models if any(t.verdict(name) == "a" for t in tasks)]
        text += f"; better than the VJM on measured data: {first_few(better) or 'no model'}"
    return f"{text}." if scores.claim else f"{text}. {few_robots_text(scores)}"


def few_robots_text(scores: Scores) -> str:
    """Return why nothing is claimed about other robots."""
    n_robots = counted(scores.frame["robot"].nunique(), "robot")
    few = f"a board needs at least {FEWEST_ROBOTS} of one kind, simulated or measured"
    return f"{n_robots}: too few for a claim about other robots; {few}."


# one task


def task_title(task: ScoredTask) -> str:
    """Return data set, kind, protocol, splits and unit in one line."""
    presentation, n_splits = task.task.presentation, len(task.splits)
    protocol = ", ".join(filter(None, (presentation.protocol, task.name.condition)))
    spread = ", mean ± sd over splits" if n_splits > 1 else ""
    error = "path error" if task.task.has_paths else "error"
    return (
        f"{presentation.dataset} ({presentation.kind}) · {protocol}, "
        f"{counted(n_splits, 'split')} · {error} in mm{spread}"
    )


def task_headline(task: ScoredTask) -> str:
    """Return the comparison of the best model with the VJM, with its uncertainty; else ""."""
    rivals = [name for name in task.models if name not in (REFERENCE_MODEL, *task.copies)]
    if REFERENCE_MODEL in task.scores and task.copies and not rivals:
        copies = [f"{name} {mark}" for name, mark in task.copies.items()]
        return f"No model adds anything to its teacher: {first_few(copies)}."
    if REFERENCE_MODEL not in task.scores or not rivals:
        return ""
    winners = [name for name in rivals if task.verdict(name) == "a"]
    model = task.best(winners or rivals)
    verdict, results = task.verdict(model), task.estimates(model)
    if verdict is None or not results:
        return f"{model} cannot be tested against {REFERENCE_MODEL}: one split, one pose."
    which = {
        "a": f"{model} is better than {REFERENCE_MODEL}",
        "b": f"{model} is worse than {REFERENCE_MODEL}, and no model is better",
        "equivalent": f"{model} and {REFERENCE_MODEL} are equivalent, within {MM * ROPE_M:g} mm",
        "open": f"No model is reliably better than {REFERENCE_MODEL}; the closest is {model}",
    }
    gain = MM * (task.mean(REFERENCE_MODEL) - task.mean(model))
    widest = max(results, key=lambda result: result.high - result.low)
    sign = -MM if gain >= 0.0 else MM
    low, high = sorted((sign * widest.low, sign * widest.high))
    less = "less" if gain >= 0.0 else "more"
    texts = [f"{abs(gain):.3f} mm {less} error ({INTERVAL} {low:.3f} to {high:.3f})."]
    if winners and (best := task.best(rivals)) != model:
        texts.append(f"{best} has less error, but its gain is not significant.")
    if task.errors.of_splits is None:
        texts.append("It holds for these fits: other training samples can change it.")
    return f"{which[verdict]}: {' '.join(texts)}"


LIKE_TRAINING = {"holdout", "holdout-paths", "repeated-holdout", "kfold", "leave-one-out"}
"""Protocols whose test poses are like the training poses."""
LEFT_OUT_REGIONS = "workspace-extrapolation"


def elsewhere_notes(tasks: Sequence[ScoredTask]) -> Iterator[str]:
    """Yield a sentence per comparison whose test poses do not tell the errors on a path elsewhere.

    Left-out regions contradict it, or the poses were planned and no regions were left out.
    """
    regions = {
        task.name.data_sha256: task for task in tasks if task.task.fit.protocol == LEFT_OUT_REGIONS
    }
    for task in tasks:
        if task.task.fit.protocol not in LIKE_TRAINING:
            continue
        model, of_regions = task.best(), regions.get(task.name.data_sha256)
        where = f"{task.name.dataset}, {task.name.protocol}"
        if of_regions is not None and model in of_regions.scores:
            best = of_regions.best()
            error, least = (MM * of_regions.mean(name) for name in (model, best))
            if error > math.exp(MARGIN) * least > 0.0:
                yield (
                    f"{where}: {model} is the best only near the training poses. In left-out "
                    f"regions it has {error:.3f} mm and {best} {least:.3f} mm, which tells more "
                    "about a path elsewhere."
                )
        elif is_planned(task.data.measured.group):
            yield (
                f"{where}: planned poses are unlike a path's, so errors and order of the "
                f"models can differ there; --protocol {LEFT_OUT_REGIONS} tests left-out regions."
            )


# notes of leaderboards


POWER, MORE_SAMPLES = 0.8, 250
"""Probability of finding a difference, and a number of samples to compare with."""


def _exploratory_notes(scores: Scores) -> Iterator[str]:
    """Yield the reason for missing verdicts, and the difference that the samples can show."""
    yield (
        "exploratory: tcp=fit and a prior of vjm-full were chosen on these samples, so no verdicts "
        "are given."
    )
    from scipy.special import stdtrit  # slow, and few tables need it

    shares = [
        (estimates[0].high - estimates[0].low) / 2.0 / task.mean(REFERENCE_MODEL)
        for task in scores.tasks
        for name in task.models
        if (estimates := task.estimates(name))
    ]
    if shares:
        n_samples, freedom = len(scores.tasks[0].data.measured), len(scores.tasks[0].splits) - 1
        certain, likely = stdtrit(max(freedom, 1), [1.0 - LEVEL / 2.0, POWER])
        difference = median(shares) * (1.0 + likely / certain)
        yield (
            f"a difference of {100.0 * difference:.0f} % of the VJM's error is found in "
            f"{n_samples} samples with a probability of {percent(POWER)} (median over models, from "
            f"the intervals over splits); in {MORE_SAMPLES} samples it would be about "
            f"{100.0 * difference * math.sqrt(n_samples / MORE_SAMPLES):.0f} %."
        )


FEW_SPLITS = 5
"""Number of splits below which only very large differences are significant."""


def dataset_notes(scores: Scores, *, has_verdicts: bool = True) -> Iterator[str]:
    """Yield explanations of the marks, and a note if there are few splits.

    Without verdicts the first notes say why, and which difference the data cannot show.
    """
    if scores.key.is_cost:
        yield f"{BEST} best mean."
        return
    if has_verdicts:
        pairs = {math.comb(len(task.models), 2) for task in scores.tasks}
        n_pairs = f"{max(pairs)} " * (len(pairs) == 1)
        correction = f"p corrected by Holm for all {n_pairs}pairs of models in a comparison"
        if pairs == {1}:
            correction = "one pair, p needs no correction"
        yield f"{BEST} best mean; {LIKE_BEST} no significant difference from it, {correction}."
    else:
        yield from _exploratory_notes(scores)
    yield f"difference: {INTERVAL}s; over poses the fitted models are held fixed."
    fewest = min(len(task.splits) for task in scores.tasks)
    if 1 < fewest < FEW_SPLITS and not scores.tasks[0].task.presentation.pooled:
        yield (
            f"{fewest} splits show only very large differences; --splits {FEW_SPLITS} shows more."
        )
