"""Compare two models: per task the difference of their errors, its uncertainty, and the verdict.

The columns and marks are explained in docs/definitions.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np

from stiff_bench.results.columns import setting, signed_percent
from stiff_bench.results.load import StoredResults, Task
from stiff_bench.results.notes import (
    TRAINING_MARK,
    caveats_of,
    failure_lines,
    left_out_notes,
    mark_of,
    same_name_other_data,
    sources,
)
from stiff_bench.results.scored_task import shared_errors, sort_key, split_sizes
from stiff_bench.results.selection import EVERYTHING, Selection, resolve_model_name
from stiff_bench.results.significance import (
    Estimate,
    Question,
    Verdict,
    decide,
    estimates,
)
from stiff_bench.store.names import label_parts, labels, natural_key
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.table import SCREEN, Column, Name, Quantity, Table, text_columns
from stiff_bench.tables.units import MM, counted, first_few, percent
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.paired import holm

ERRORS = {**{axis: sort_key("mae", axis) for axis in AXES}, "norm": sort_key("norm")}
"""Compared errors: the absolute error along each axis, and the length of the error vector."""
METHODS = ("over splits", "over poses")
CHANCES = ("P(A better)", "P(equivalent)", "P(B better)")
VERDICTS: dict[Verdict, str] = {
    "a": "A better",
    "b": "B better",
    "equivalent": "equivalent",
    "open": "no significant difference",
}
SELECTS_ON_TEST = "selects on the test part"
"""Mark of a task whose protocol lets models choose on the test part."""
KEYS = (
    *("dataset", "protocol", "condition", "seed", "data_sha256", "source_sha256", "splits"),
    *("selects_on_test", "mark_a", "mark_b", "n_train", "n_test", "n_poses"),
    *("error", "method", "verdict"),
)
"""Texts of an estimate in csv and json."""
THESE_FITS = (
    "these fits: one split or pooled splits do not show how results vary with the training "
    "samples; repeated-holdout with --splits 5 does."
)
DISAGREEMENTS = {
    (True, False): "The splits agree on it, but a few poses could turn it: measure more poses.",
    (False, True): "The poses agree on it, but it changes from split to split: use more --splits.",
}
"""Advice on an open verdict, by whether the intervals over splits and over poses exclude zero."""
OTHER_MODELS = "leaderboard and report correct p for all pairs of models; here it is not corrected."
Row = dict[str, Any]


@dataclass(frozen=True)
class Comparison:
    """Two models in all tasks in which both were run.

    Attributes:
        a, b: names.
        question: settings of the tests.
        rows: a row per task and error of `ERRORS`: the task, its `KEYS`, mean errors A, B and A - B
            in mm, estimates by method in m, and the verdict of all estimates.
        notes: notes on the numbers, most important first.
    """

    a: str
    b: str
    question: Question
    rows: Sequence[Row]
    notes: Sequence[str]

    @property
    def norms(self) -> list[Row]:
        """Return the rows of the 3-D error, one per task."""
        return [row for row in self.rows if row["error"] == "norm"]

    @property
    def text(self) -> str:
        """Return the result in a sentence; tasks that select on the test part do not count."""
        norms = self.norms
        if len(norms) == 1:
            return self._task_text(norms[0])
        counts = Counter(row["verdict"] for row in norms if not row["selects_on_test"])
        unfair = counted(len(norms) - counts.total(), "comparison")
        return (
            f"Of {counted(counts.total(), 'comparison')}: {self.a} better in {counts['a']}, "
            f"{self.b} better in {counts['b']}, equivalent (within {self._rope}) in "
            f"{counts['equivalent']}, no significant difference in {counts['open']}."
            + f" Not counted: {unfair} whose protocol {SELECTS_ON_TEST}."
            * (counts.total() < len(norms))
        )

    def _task_text(self, row: Row) -> str:
        a, b, of_methods, estimate = self.a, self.b, row["estimates"], _widest(row)
        outcome = {
            "a": f"{a} is better than {b}",
            "b": f"{b} is better than {a}",
            "equivalent": f"{a} and {b} are equivalent (within {self._rope})",
            "open": f"No significant difference between {a} and {b}",
        }[row["verdict"]]
        fits = "these fits" if len(of_methods) == 1 else ""
        texts = (row["protocol"], row["condition"], counted(row["splits"], "split"), fits)
        over = next(method for method, of in of_methods.items() if of is estimate)
        sure = tuple(of.low > 0.0 or of.high < 0.0 for of in of_methods.values())
        advice = DISAGREEMENTS.get(sure, "") if row["verdict"] == "open" else ""
        sign = -1 if row["verdict"] == "a" else 1
        low, high = sorted((sign * MM * estimate.low, sign * MM * estimate.high))
        amount = f"of {a} minus {b} {row['A - B']:.3f} mm"
        if row["verdict"] in ("a", "b"):
            amount = f"{sign * row['A - B']:.3f} mm smaller"
        return (
            f"{outcome} on {row['dataset']} ({', '.join(filter(None, texts))}): mean 3-D error "
            f"{amount} ({self._interval} {low:.3f} to {high:.3f} mm {over}). {advice}"
        ).rstrip()

    @property
    def _rope(self) -> str:
        return f"{MM * self.question.rope:g} mm"

    @property
    def _interval(self) -> str:
        return f"{percent(self.question.confidence)} interval"

    def tables(self) -> list[Table]:
        """Return a table for a terminal, one for documents, and all estimates for csv and json."""
        rows = [
            row | _numbers(estimate) | {"method": method, "verdict": _verdict_text(row)}
            for row in self.rows
            for method, estimate in row["estimates"].items()
        ]
        estimates_table = Table.of(
            "Estimates by each method | mean error, mm",
            [*text_columns(*KEYS), *self._columns(on_screen=False)],
            rows,
            self.notes,
            unit="mm",
            about={"a": self.a, "b": self.b, "table": "estimates"},
            formats=("csv", "json"),
        )
        return [self._differences(on_screen=on) for on in (True, False)] + [estimates_table]

    def _differences(self, *, on_screen: bool) -> Table:
        """Return a row per task, or a row per error of a single task."""
        norms = self.norms
        several, (first, *_) = len(norms) > 1, norms
        name, texts = first["task"].name, first["task"].presentation
        place = Name(setting(texts, name.condition, first["splits"], name.seed), _marks(first))
        if several:
            kinds = dict.fromkeys(row["task"].presentation.kind for row in norms)
            place = Name(f"{len(norms)} comparisons ({' and '.join(kinds)})")
        parts = label_parts(row["task"].name for row in norms)
        records = [
            {
                **row,
                **_numbers(next(iter(row["estimates"].values()))),
                "comparison": Name(", ".join(parts[row["task"].name]), _marks(row)),
                "mean error": "3-D" if row["error"] == "norm" else row["error"].upper(),
                "vs B": 100.0 * (row["A"] / row["B"] - 1.0) if row["B"] else None,
                "interval": _numbers(_widest(row))["interval"],
                "verdict": _verdict_text(row),
            }
            for row in (norms if several else self.rows)
        ]
        heading, kind = ("comparison", "3-D error") if several else ("mean error", "error")
        columns = self._columns(on_screen=on_screen)
        return Table.of(
            f"A = {self.a}, B = {self.b} | {place} | mean {kind}, mm",
            [*text_columns(heading), *columns, *text_columns("verdict")],
            records,
            self.notes,
            unit="mm",
            about={"a": self.a, "b": self.b},
            brief=True,
            formats=(SCREEN,) if on_screen else ("github", "latex", "html"),
        )

    def _columns(self, *, on_screen: bool) -> list[Column]:
        """Return the columns of numbers."""
        length = ".3f" if on_screen else ".4f"
        change = [Column("vs B", format=signed_percent, is_change=True)]
        tests = [Column("p", format=".2g")]
        tests += [Column(name, format=_chance_text) for name in CHANCES]
        return [
            *(Column(name, unit="mm", format=length) for name in "AB"),
            Column("A - B", unit="mm", format=f"+{length}"),
            *(change if on_screen else []),
            Column(self._interval, unit="mm", format=f"+{length}", value=itemgetter("interval")),
            *([] if on_screen else tests),
        ]


def _numbers(estimate: Estimate) -> Row:
    """Return an estimate's cells, by column; the interval is in mm."""
    posterior = estimate.posterior
    chances = (posterior.a_better, posterior.equivalent, posterior.b_better)
    return {
        "interval": Quantity(low=MM * estimate.low, high=MM * estimate.high),
        **{"p": estimate.p_value, **dict(zip(CHANCES, chances, strict=True))},
    }


def _widest(row: Row) -> Estimate:
    """Return the estimate with the wider interval, for texts with a single interval."""
    of_methods: dict[str, Estimate] = row["estimates"]
    return max(of_methods.values(), key=lambda estimate: estimate.high - estimate.low)


def _verdict_text(row: Row) -> str:
    """Return the verdict in words, with a mark if it holds only for the fitted models."""
    of_fits = "over splits" not in row["estimates"] and row["verdict"] != "open"
    return f"{VERDICTS[row['verdict']]}{' (these fits)' * of_fits}"


def _marks(row: Row) -> str:
    """Return the marks of a task in a table: of its protocol, of A and of B."""
    a, b = row["mark_a"], row["mark_b"]
    marks = {"A and B: ": a} if a == b else {"A: ": a, "B: ": b}
    marks = {"": SELECTS_ON_TEST * row["selects_on_test"], **marks}
    return "; ".join(f"{name}{mark}" for name, mark in marks.items() if mark)


def _chance_text(chance: Quantity) -> str:
    """Format a probability; it is never written as 0 or 1."""
    value = chance.value or 0.0
    return "> 0.99" if value > 0.99 else "< 0.01" if value < 0.01 else f"{value:.2f}"


def compare_models(
    stored: StoredResults,
    a: str,
    b: str,
    question: Question,
    selection: Selection = EVERYTHING,
) -> Comparison:
    """Compare two models in every selected task with common splits.

    Raises:
        ConfigError: a name is unknown, A is B, or they have no task in common.
        StoreError: the samples of a task are corrupt.
    """
    a, b = (resolve_model_name(word, stored.tasks) for word in (a, b))
    if a == b:
        raise ConfigError(f"both models are {a!r}; give two different models")
    chosen = selection.tasks_of(stored.tasks)
    chosen.sort(key=lambda task: (natural_key(task.name.text), task.name))
    names = labels(task.name for task in chosen)
    rows, tasks, notes = list[Row](), list[Task](), list[str]()
    for task in chosen:
        if {a, b} <= task.models.keys():
            try:
                rows += _task_rows(task, a, b, stored.data_of(task.name.data_sha256), question)
                tasks.append(task)
            except DataError as error:
                notes.append(f"not compared: {names[task.name]}: {error}.")
    other_data = same_name_other_data(tasks or chosen, stored.data_of)
    if not tasks:
        run = {name: [names[t.name] for t in chosen if name in t.models] for name in (a, b)}
        places = [
            f"{name} was run in {first_few(of_name) or 'none of these'}"
            for name, of_name in run.items()
        ]
        reasons = "; ".join([*places, *other_data])
        raise ConfigError(" ".join(notes) or f"{a} and {b} have no comparison in common: {reasons}")
    pairs = [(task, name) for task in tasks for name in (a, b)]
    counts = Counter(
        result.run_id
        for task, name in pairs
        for result in task.results(name, task.shared_splits((a, b)))
    )
    failures = [fit for task, name in pairs for fit in task.models[name].failures.values()]
    notes = [
        *(task.presentation.warning for task in tasks),
        THESE_FITS * any("over splits" not in row["estimates"] for row in rows),
        *failure_lines(failures),
        OTHER_MODELS * any(len(task.models) > 2 for task in tasks),
        *notes,
        *other_data,
        *left_out_notes(tasks),
        *caveats_of(tasks),
        sources(stored.folder, stored.runs, counts),
    ]
    return Comparison(a, b, question, rows, [*filter(None, dict.fromkeys(notes))])


def _task_rows(task: Task, a: str, b: str, data: StoredData, question: Question) -> list[Row]:
    """Return a row per error of two models on their common splits of a task.

    Raises:
        DataError: a model has no results there, they share no split, or only one pose was tested.
    """
    texts = task.presentation
    if texts.reports_training:
        raise DataError(TRAINING_MARK)
    for name in (a, b):
        if not task.models[name].done:
            failure = next(iter(task.models[name].failures.values()))
            raise DataError(f"{name} has no result ({failure.why_none})")
    if not (splits := task.shared_splits((a, b))):
        raise DataError(f"{a} and {b} have no result on the same split")
    results = [task.results(name, splits) for name in (a, b)]
    tested = np.concatenate([of.prediction.rows for of in results[0] if of.prediction])
    n_poses = len(np.unique(data.samples.pose_id[tested]))
    if n_poses < 2:
        raise DataError("a bootstrap over poses needs at least 2 poses, there is 1")
    n_train, n_test = split_sizes(results[0])
    mark_a, mark_b = (mark_of(task.models[name].presentation) for name in (a, b))
    of_task = {
        **{"task": task, **asdict(task.name), "splits": len(splits)},
        **{"selects_on_test": texts.selects_on_test, "mark_a": mark_a, "mark_b": mark_b},
        **{"n_train": n_train, "n_test": n_test, "n_poses": n_poses},
    }
    means, of_errors = [], []
    for key in ERRORS.values():
        scores = [of for part in results if (of := key.of_splits(part)) is not None]
        errors = shared_errors(key, results, scores, data, question.seed)
        of_methods = estimates(errors, [(0, 1)], question, all_p_values=True)
        means.append([float(of_model.mean()) for of_model in scores])
        of_errors.append([estimate for (estimate,) in of_methods])
    # the axes are corrected for each other (Holm); the length is a separate question
    *of_axes, _ = of_errors
    for method in range(len(of_errors[0])):
        p_values = holm([of_axis[method].p_value for of_axis in of_axes])
        for of_axis, p_value in zip(of_axes, p_values, strict=True):
            of_axis[method] = replace(of_axis[method], p_value=float(p_value))
    return [
        {
            **{**of_task, "error": error},
            **{"A": MM * mean_a, "B": MM * mean_b, "A - B": MM * (mean_a - mean_b)},
            "estimates": dict(zip(METHODS[-len(of_error) :], of_error, strict=True)),
            "verdict": decide(of_error, question.confidence),
        }
        for error, (mean_a, mean_b), of_error in zip(ERRORS, means, of_errors, strict=True)
    ]
