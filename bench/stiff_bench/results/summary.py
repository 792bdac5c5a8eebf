"""Write the sentences about results: which model, how much, how sure, but, data.

Errors are converted to mm and % here.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
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
from stiff_bench.results.leaderboard import Leaderboard, and_more, robot_ratios, split_counts
from stiff_bench.results.notes import outcome_notes, span_text
from stiff_bench.results.scored_task import ScoredTask
from stiff_bench.results.scores import FEWEST_ROBOTS, Scores
from stiff_bench.results.significance import Estimate, disagreement
from stiff_bench.store.names import grouped, labels
from stiff_bench.tables.units import MM, counted, first_few, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.scoring.over_robots import MARGIN
from stiff_protocols.scoring.paired import LEVEL, ROPE_M

if TYPE_CHECKING:
    from pandas import DataFrame

Row = Mapping[Any, Any]
CLOSE_FORMAT = ".3f"
"""Format of two ratios that may be close."""
DISAGREEMENTS = {
    "": "",
    "splits": "The splits agree on it, but a few poses could turn it: measure more poses.",
    "poses": "The poses agree on it, but it changes from split to split: use more --splits.",
}


@dataclass(frozen=True)
class Summary:
    """The result in sentences; an empty text is omitted.

    Attributes:
        which: model to use, or that none is better.
        how_much: its gain.
        how_sure: evidence behind it.
        gain: range of the gain, and error that remains.
        but: exceptions.
        data: kind of the data and scope of the claim.
    """

    which: str
    how_much: str = ""
    how_sure: str = ""
    gain: str = ""
    but: str = ""
    data: str = ""

    @property
    def headline(self) -> str:
        """Return the result in one line."""
        return ": ".join(filter(None, (self.which, self.how_much)))

    @property
    def sentences(self) -> list[tuple[str, str]]:
        """Return the labelled sentences after the headline."""
        labelled = {
            **{"How sure": self.how_sure, "Gain": self.gain},
            **{"But": self.but, "Data": self.data},
        }
        return [(label, text) for label, text in labelled.items() if text]

    @property
    def lines(self) -> list[str]:
        """Return the labelled sentences as lines of text."""
        return [f"{label}: {text}" for label, text in self.sentences]


def change_text(ratio: float) -> str:
    """Return a ratio to the VJM's error as a change.

    >>> change_text(0.512), change_text(1.06)
    ('49 % less', '6 % more')
    """
    return f"{abs(1.0 - ratio) * 100.0:.0f} % {'less' if ratio <= 1.0 else 'more'}"


def summarize(scores: Scores, table: DataFrame) -> Summary:
    """Return the result of several tasks: over robots, or per data set.

    `table` is the `model_frame` of the scores.
    """
    rivals = table[table["complete"] & (table["model"] != REFERENCE_MODEL)].to_dict("records")
    if not rivals or number(rivals[0], "ratio") is None:
        counts = Counter(task.best() for task in scores.tasks)
        (model, n_best), *_ = counts.most_common()
        best_in = f"in {n_best} of {len(scores.tasks)} comparisons"
        which = f"{model} has the best {scores.key.text} {best_in}"
        return Summary(which, data=_data_text(scores))
    if "won" in table:
        return _over_robots(scores, table, rivals)
    return _per_dataset(scores, rivals, [*table["model"]])


# over robots


def _over_robots(scores: Scores, table: DataFrame, rivals: Sequence[Row]) -> Summary:
    lead = min(rivals, key=lambda row: row["ratio"])
    which, how_much = f"No model is reliably better than the VJM over {scores.scope}", ""
    if lead["verdict"] == "better":
        bounds = f"{lead['low']:{RATIO_FORMAT}} to {lead['high']:{RATIO_FORMAT}}"
        which = f"Use {lead['model']}"
        how_much = (
            f"{lead['ratio']:{RATIO_FORMAT}} times the VJM's error ({bounds}, {INTERVAL} over "
            f"{scores.scope})"
        )
    rows = table[table["complete"]].to_dict("records")
    return Summary(
        which,
        how_much,
        how_sure=_lead_certainty(lead, rows),
        but=" ".join(_lead_exceptions(scores, lead, rows)),
        data=_lead_data(scores, lead, rows),
    )


def _lead_certainty(lead: Row, rows: Sequence[Row]) -> str:
    low, high = lead["without low"], lead["without high"]
    names = [
        row["model"]
        for row in rows
        if row["model"] != lead["model"] and not (number(row, "p best") or 0.0) < LEVEL
    ]
    rival_text = (
        f"Not significantly worse: {first_few(names)}."
        if names
        else "Every other model is significantly worse."
    )
    return (
        f"{lead['model']} has the smallest error on {lead['won']:.0f} of "
        f"{counted(int(lead['n robots']), 'robot')}. Without any one robot the ratio lies between "
        f"{low:{RATIO_FORMAT}} and {high:{RATIO_FORMAT}}. {rival_text}"
    )


def _lead_exceptions(scores: Scores, lead: Row, rows: Sequence[Row]) -> Iterator[str]:
    """Yield robots and groups of data sets with a clearly better model."""
    ahead = [
        f"{best} on {robot} ({of_robot[best]:{CLOSE_FORMAT}} against "
        f"{of_robot[lead['model']]:{CLOSE_FORMAT}})"
        for robot, of_robot in robot_ratios(scores).to_dict("index").items()
        for best in [min(of_robot, key=lambda name: of_robot[name])]
        if _is_ahead(of_robot[best], of_robot[lead["model"]])
    ]
    if ahead:
        yield f"Another model is more than {EQUAL_TEXT} better: {first_few(ahead, 2)}."
    for key in [key for key in lead if isinstance(key, tuple) and key[0] == "group"]:
        in_group = {row["model"]: ratio for row in rows if (ratio := number(row, key))}
        best = min(in_group, key=lambda name: in_group[name], default=lead["model"])
        if lead["model"] in in_group and _is_ahead(in_group[best], in_group[lead["model"]]):
            yield (
                f"On the data sets {key[1]!r} {best} is ahead ({in_group[best]:{RATIO_FORMAT}} "
                f"against {in_group[lead['model']]:{RATIO_FORMAT}})."
            )
    yield f"Its worst robot is {lead['worst robot']} ({lead['worst']:{RATIO_FORMAT}})."


def _is_ahead(ratio: float, of_leader: float) -> bool:
    """Return True if a ratio is smaller by more than the practical margin."""
    return math.log(of_leader / ratio) > MARGIN


def _lead_data(scores: Scores, lead: Row, rows: Sequence[Row]) -> str:
    """Return the number of measured robots, and the scores on them."""
    kinds = [tasks[0].kind for tasks in scores.robots.values()]
    n_measured = kinds.count("measured")
    verb = "is" if n_measured == 1 else "are"
    text = f"{n_measured} of {counted(len(kinds), 'robot')} {verb} measured"
    for dataset, tasks in scores.measured.items():
        key = "measured", dataset
        if (ratio := number(lead, key)) is None:
            continue
        verdict = VERDICT_TEXTS[lead["measured verdict", dataset]] or "not tested"
        in_data = {row["model"]: value for row in rows if (value := number(row, key))}
        best = min(in_data, key=lambda name: in_data[name])
        text += (
            f"; on {dataset} ({counted(len(tasks[0].data.measured), 'sample')}) {lead['model']} "
            f"has {ratio:{RATIO_FORMAT}} times the VJM's error ({verdict})"
        )
        if best != lead["model"]:
            text += f"; smallest on the board: {best} ({in_data[best]:.2f})"
    return f"{text}."


def split_notes(scores: Scores, table: DataFrame) -> list[str]:
    """Return notes on models with fewer splits and on models without every score."""
    complete = {*table[table["complete"]]["model"]}
    fewer = {name: of for name, of in split_counts(scores).items() if of[0] < of[1]}
    notes = []
    for text, is_shown in (
        ("With fewer splits", True),
        ("Not on the board, without every score", False),
    ):
        names = [name for name in fewer if (name in complete) == is_shown]
        of_counts = [
            f"{first_few(same)} ({there} of {n_all})"
            for (there, n_all), same in grouped(names, lambda name: fewer[name]).items()
        ]
        if of_counts:
            notes.append(f"{text}: {'; '.join(of_counts)}.")
    return notes


def model_summary(scores: Scores, row: Row) -> Summary:
    """Return the result of one model of a `model_frame` over robots."""
    if row["model"] == REFERENCE_MODEL:
        role = "the baseline: the errors of all models are divided by its errors."
        return Summary(REFERENCE_MODEL, how_sure=role)
    ratios = robot_ratios(scores)[row["model"]]
    measured = [
        f"{dataset}: {ratio:{RATIO_FORMAT}} times the VJM's error ({verdict})."
        for dataset in scores.measured
        if (ratio := number(row, ("measured", dataset))) is not None
        for verdict in [VERDICT_TEXTS[row["measured verdict", dataset]] or "not tested"]
    ]
    return Summary(
        row["model"],
        how_sure=f"{row['ratio']:.2f} times the VJM's error ({row['low']:.2f} to "
        f"{row['high']:.2f}, {INTERVAL} over {scores.scope}); {row['verdict']}.",
        gain=f"best on {ratios.idxmin()} ({ratios.min():.2f}), worst on {row['worst robot']} "
        f"({row['worst']:.2f}); the smallest error of all models on {row['won']:.0f} of "
        f"{counted(len(ratios), 'robot')}.",
        data=" ".join(measured),
    )


# with few robots: per data set


def _per_dataset(scores: Scores, rivals: Sequence[Row], models: Sequence[str]) -> Summary:
    """Return the best of the models that win more tasks against the VJM than they lose."""
    verdicts = {
        row["model"]: Counter(v for task in scores.tasks if (v := task.verdict(row["model"])))
        for row in rivals
    }
    winners = [
        row
        for row in rivals
        if row["ratio"] < 1.0 and verdicts[row["model"]]["a"] > verdicts[row["model"]]["b"]
    ]
    best = (winners or rivals)[0]
    name, counts, n_tasks = best["model"], verdicts[best["model"]], len(scores.tasks)
    data = f"on {next(iter(scores.datasets))}"
    which, how_much = f"No model is reliably better than the VJM {data}", ""
    if len(scores.datasets) > 1:
        data = "on these data sets"
        which = f"No model is reliably better than the VJM {data}"
    if winners:
        won = f" (better in {counts['a']} of {counted(n_tasks, 'comparison')})" * (n_tasks > 1)
        which = f"Use {name} {data}"
        how_much = f"{change_text(best['ratio'])} error than the VJM{won}"
    sure = (
        f"{name} is better than the VJM in {counts['a']} of "
        f"{counted(counts.total(), 'comparison')}, worse in {counts['b']}; "
        f"{counts['open'] + counts['equivalent']} show no significant difference."
    )
    if not counts:
        sure = "No test applies: there is one split, and poses cannot be resampled."
    return Summary(
        which,
        how_much,
        how_sure=sure,
        gain=_gain_text(scores, best),
        but=_dataset_exceptions(scores, models, name),
        data=_data_text(scores),
    )


def _gain_text(scores: Scores, best: Row) -> str:
    """Return the range of a model's gain over tasks, and of the error that remains."""
    of_model = scores.frame[scores.frame["model"] == best["model"]]
    errors = sorted(scores.key.factor * of_model["error"])
    span = change_text(best["ratio"])
    most, least = change_text(best["smallest"]), change_text(best["largest"])
    if len(scores.tasks) > 1 and most != least:
        same = most.split()[-1] == least.split()[-1]
        nearer, farther = (least, most) if best["largest"] <= 1.0 else (most, least)
        span = f"{nearer.split()[0]} to {farther}" if same else f"{most} to {least}"
    remaining = " to ".join(dict.fromkeys(f"{error:.2f}" for error in (errors[0], errors[-1])))
    return f"{span} error than the VJM; {remaining} {scores.key.unit} of error remain."


def _dataset_exceptions(scores: Scores, models: Sequence[str], model: str) -> str:
    """Return the headings under which another model is significantly better; "" for none."""
    key, errors = scores.key, error_matrix(scores, models)
    plans = {heading[1:] for heading in scores.columns}
    parts = []
    for heading, tasks in scores.columns.items():
        column = errors[heading].dropna()
        if column.empty:
            continue
        rival = str((key.sign * column).idxmin())
        if rival in (model, REFERENCE_MODEL):
            continue
        if all(task.verdict(rival, model) == "a" for task in tasks):
            text = heading[0] if len(plans) == 1 else ", ".join(filter(None, heading))
            smaller, larger = (key.factor * column.get(name, 0.0) for name in (rival, model))
            parts.append(
                f"on {text} {rival} is better ({smaller:.2f} against {larger:.2f} {key.unit})"
            )
    text = first_few(parts, 2)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


KINDS = {"unknown": "of unknown origin", "user's file": "of unknown origin"}
"""Kinds of data in sentences."""


def _data_text(scores: Scores) -> str:
    """Return a text on the kinds of the data and on the scope of the claim."""
    kinds = grouped(scores.datasets, lambda name: scores.datasets[name][0].kind)
    n_sets = counted(len(scores.datasets), "data set")
    if len(kinds) == 1 and "measured" not in kinds:
        (kind,) = kinds
        text = f"All data are {KINDS.get(kind, kind)}."
    else:
        parts = [
            f"{len(names)} {'is' if len(names) == 1 else 'are'} {KINDS.get(kind, kind)}"
            for kind, names in kinds.items()
            if kind != "measured"
        ]
        text = "; ".join([*_measured_text(scores, n_sets), *parts]) + "."
    if scores.claim is None:
        number_of_robots = counted(len(scores.robots), "robot")
        few = f"too few for a claim about other robots (at least {FEWEST_ROBOTS})"
        text += f" {number_of_robots}: {few}."
    return text


def _measured_text(scores: Scores, n_sets: str) -> Iterator[str]:
    """Yield a text on the models that beat the VJM on measured data."""
    if not (measured := scores.measured):
        return
    samples = [
        f"{name}, {counted(len(tasks[0].data.measured), 'sample')}"
        for name, tasks in measured.items()
    ]
    better = [
        name
        for name in scores.models
        if any(task.verdict(name) == "a" for task in chain.from_iterable(measured.values()))
    ]
    verb = "is" if len(measured) == 1 else "are"
    outcome = "no model is reliably better than the VJM"
    if better:
        outcome = f"{first_few(better)} {'is' if len(better) == 1 else 'are'} better than the VJM"
    yield f"{len(measured)} of {n_sets} {verb} measured ({first_few(samples, 2)}): there, {outcome}"


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


def task_summary(task: ScoredTask) -> Summary:
    """Return the comparison of the best model with the VJM, with its uncertainty."""
    rivals = [name for name in task.models if name != REFERENCE_MODEL]
    if REFERENCE_MODEL not in task.scores or not rivals:
        return Summary("")
    winners = [name for name in rivals if task.verdict(name) == "a"]
    model = task.best(winners or rivals)
    verdict, results = task.verdict(model), task.estimates(model)
    if verdict is None or not results:
        return Summary(
            f"{model} against {REFERENCE_MODEL}", "no test is possible with one split and one pose."
        )
    gain = MM * (task.mean(REFERENCE_MODEL) - task.mean(model))
    main = max(results, key=lambda result: result.high - result.low)
    amount = (
        f"{abs(gain):.3f} mm {'less' if gain >= 0.0 else 'more'} error "
        f"({_gain_interval(main, gain)})."
    )
    if verdict == "equivalent":
        rope = f"{MM * ROPE_M:g} mm"
        equal = f"their errors differ by less than {rope}.{_fits_warning(task)}"
        return Summary(f"{model} and {REFERENCE_MODEL} are equivalent", equal)
    if verdict in ("a", "b"):
        better = "better" if verdict == "a" else "worse"
        less = f" No model is better than {REFERENCE_MODEL}." if verdict == "b" else ""
        smaller = _smaller_error(task, rivals, model)
        return Summary(
            f"{model} is {better} than {REFERENCE_MODEL}",
            f"{amount}{less}{smaller}{_fits_warning(task)}",
        )
    return Summary(
        f"No model is reliably better than {REFERENCE_MODEL}. The closest, {model}, has {amount}"
        f"{_disagreement_text(results)}"
    )


def _smaller_error(task: ScoredTask, rivals: Sequence[str], winner: str) -> str:
    """Return a sentence on a model with less error whose gain is not significant; else ""."""
    best = task.best(rivals)
    if best == winner:
        return ""
    return (
        f" {best} has less error ({MM * task.mean(best):.3f} mm), but its gain is not significant."
    )


def _fits_warning(task: ScoredTask) -> str:
    """Return a warning if the spread over splits is unknown; else ""."""
    if task.errors.of_splits is not None:
        return ""
    splits = "One split does" if len(task.splits) == 1 else "Pooled splits do"
    return f" {splits} not show how results vary with the training samples."


def _gain_interval(estimate: Estimate, gain: float) -> str:
    """Return bounds of the gain, or of the loss if the model is worse."""
    bounds = (-estimate.high, -estimate.low) if gain >= 0.0 else (estimate.low, estimate.high)
    low, high = (f"{MM * bound:.3f}" for bound in bounds)
    return f"{INTERVAL} {low} to {high}"


def _disagreement_text(results: Sequence[Estimate]) -> str:
    """Return a sentence if splits and poses disagree on significance; else ""."""
    if all(estimate.excludes_zero for estimate in results):
        return " Its interval excludes zero, but not after correction for all pairs of models."
    return f" {DISAGREEMENTS[disagreement(results[0], results[-1])]}".rstrip()


def task_facts(task: ScoredTask) -> str:
    """Return the kind of the data and the sizes of training and test part."""
    results = next(iter(task.results.values()))
    trained = [result.n_train for result in results]
    tested = [len(result.prediction.rows) for result in results if result.prediction is not None]
    is_known = task.kind not in KINDS
    kind = f"{task.kind.capitalize()} robot" if is_known else f"Data {KINDS[task.kind]}"
    sizes = f"Trained on {span_text(trained)} samples, tested on {span_text(tested)}."
    return f"{kind}. {sizes}" if any(trained) else f"{kind}."


def task_notes(task: ScoredTask) -> list[str]:
    """Return caveats of the data, choices and warnings of fits."""
    every = [list(model.done.values()) for model in task.task.models.values()]
    outcomes = [note for of_model in every if of_model for note in outcome_notes(of_model)]
    presentation = task.task.presentation
    return [*filter(None, [presentation.warning]), *outcomes, *presentation.caveats]


# notes of leaderboards


FEW_SPLITS = 5
"""Number of splits below which only very large differences are significant."""
MOST_LISTED = 4
"""Largest number of missing results that are listed individually."""


def correction_text(tasks: Sequence[ScoredTask]) -> str:
    """Return a text about the correction of p-values in tasks."""
    counts = {len(task.models) * (len(task.models) - 1) // 2 for task in tasks}
    if counts == {1}:
        return "one pair, p needs no correction"
    number_text = f"{counts.pop()} " if len(counts) == 1 else ""
    return f"p corrected by Holm for all {number_text}pairs of models in a comparison"


def dataset_notes(scores: Scores) -> Iterator[str]:
    """Yield explanations of the marks, and a note if there are few splits."""
    key = scores.key
    if key.is_cost:
        yield f"{BEST} best mean."
        return
    correction = correction_text(scores.tasks)
    yield f"{BEST} best mean; {LIKE_BEST} no significant difference from it, {correction}."
    yield (
        f"difference: {percent(1.0 - LEVEL)} intervals; over poses the fitted models are held "
        "fixed."
    )
    fewest = min(len(task.splits) for task in scores.tasks)
    if 1 < fewest < FEW_SPLITS and not scores.tasks[0].task.presentation.pooled:
        yield (
            f"{fewest} splits show only very large differences; --splits {FEW_SPLITS} shows more."
        )


def section_notes(scores: Scores, board: Leaderboard, *, has_datasets: bool) -> Iterator[str]:
    """Yield notes on all tables of a section, most important first.

    `has_datasets` is True if the section has a table per data set.
    """
    warnings = (task.task.presentation.warning for task in scores.tasks)
    yield from filter(None, dict.fromkeys(warnings))
    if has_datasets and scores.claim is None and not scores.key.is_cost:
        yield (
            f"{counted(len(scores.robots), 'robot')}: too few for a claim about other robots; a "
            f"board over robots needs at least {FEWEST_ROBOTS} simulated or {FEWEST_ROBOTS} "
            "measured ones."
        )
    task_labels = labels(task.name for task in scores.tasks)
    if scores.missing and has_datasets:
        yield f"Scores are missing: {_missing_text(scores)}."
    if cut := [task for task in scores.tasks if task.left_out]:
        yield f"{task_labels[cut[0].name]}{and_more(cut)}: {cut[0].left_out}."
    if board.notes:
        yield f"{board.notes[0].removesuffix('.')}{and_more(board.notes)}."


def _missing_text(scores: Scores) -> str:
    """Return the missing results of each model with reasons, or their numbers."""
    missing = scores.missing
    task_labels = labels(task.name for task in scores.tasks)
    is_listed = sum(map(len, missing.values())) <= MOST_LISTED
    parts = []
    for model, of_model in missing.items():
        places = [
            f"{', '.join(task_labels[task] for task in tasks)}: {reason}"
            for reason, tasks in grouped(of_model, of_model.__getitem__).items()
        ]
        named = f" ({'; '.join(places)})" if is_listed else ""
        parts.append(f"{len(of_model)} of {len(task_labels)} results of {model}{named}")
    if is_listed:
        return ", ".join(parts)
    return f"{first_few(parts)}; `--format json` lists them with reasons"
