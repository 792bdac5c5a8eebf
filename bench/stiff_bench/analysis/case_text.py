"""Write one comparison for a terminal: a table of models, the verdict, and facts."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

from stiff_bench.analysis.answer import NOISE_FLOOR, Answer
from stiff_bench.analysis.answer_text import MATRIX_FORMAT, headline, matrix_table, sentences
from stiff_bench.analysis.scored_case import ScoredCase
from stiff_bench.analysis.verdict import DISAGREEMENTS, Estimate, disagreement
from stiff_bench.console import one_line
from stiff_bench.tables.fit_notes import outcome_notes
from stiff_bench.tables.metric_table import mark_of, metric_values
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table
from stiff_bench.tables.terminal import WORSE, print_lines, print_table, screen_console, screen_of
from stiff_bench.tables.units import MM, counted, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES, BOUND_NAMES
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.scoring.paired import LEVEL, ROPE_M

if TYPE_CHECKING:
    from rich.console import Console

_METRICS = tuple(METRICS[key] for key in ("norm", "mae", "norm-p95", "norm-max", "removed"))


@dataclass(frozen=True)
class _Row:
    """A row of the table: results of a model, or a known bound of a simulation."""

    name: Name
    results: Sequence[CellResult]
    ratio: float | None = None
    status: str = ""

    def value(self, metric: str, axis: str, *, spread: bool = False) -> Entry:
        """Return the printed mean over splits, with `spread` also its standard deviation."""
        mean = metric_values(self.results, _METRICS).get((metric, axis)) if self.results else None
        if mean is None:
            return None
        return Quantity(mean.value, mean.spread if spread else None, n=mean.n)


def case_table(answer: Answer, case: ScoredCase, title: str = "") -> Table:
    """Return models by 3-D error: change against the VJM, axes and the largest error.

    The best model comes first. Models without a result and the noise floor come last.
    """
    models = sorted(case.models, key=case.mean)
    rows = [
        _Row(
            Name(name, mark_of(case.case.competitors[name].presentation)),
            case.results[name],
            None if name == REFERENCE_MODEL else answer.ratio(name, case),
        )
        for name in models
    ]
    rows += [_Row(Name(name), (), status=case.missing[name]) for name in sorted(case.missing)]
    has_paths = case.case.has_paths
    bounds = (NOISE_FLOOR, BOUND_NAMES["uncorrected"]) if has_paths else (NOISE_FLOOR,)
    rows += [_Row(Name(name), results) for name in bounds if (results := case.bound_results(name))]
    axes = [
        Column(axis.upper(), format=MATRIX_FORMAT, value=partial(_axis_error, axis))
        for axis in AXES
    ]
    paths = [
        Column("95 % below", format=MATRIX_FORMAT, value=lambda row: row.value("norm-p95", "")),
        Column("removed", unit="%", format=".0f", value=lambda row: row.value("removed", "")),
    ]
    return Table.of(
        title,
        [
            Column("model", "text", value=lambda row: row.name),
            Column("3-D error", format=MATRIX_FORMAT, value=_error),
            Column("vs VJM", format=signed_percent, by_sign=-1, value=_ratio),
            *(paths if has_paths else axes),
            Column("largest", format=MATRIX_FORMAT, value=lambda row: row.value("norm-max", "")),
        ],
        rows,
        unit="mm",
        best_first=bool(models),
    )


def _axis_error(axis: str, row: _Row) -> Entry:
    return row.value("mae", axis)


def _error(row: _Row) -> Entry:
    return (
        Quantity(status=row.status.partition(":")[0])
        if row.status
        else row.value("norm", "", spread=True)
    )


def _ratio(row: _Row) -> Entry:
    if row.name.text == NOISE_FLOOR:
        return Quantity(status="floor")
    return None if row.ratio is None else Quantity(100.0 * (row.ratio - 1.0))


def signed_percent(change: Quantity) -> str:
    """Return a change in % with its sign and unit."""
    return f"{change.value:+.0f} %".replace("-", "\u2212")


def case_title(case: ScoredCase) -> str:
    """Return data set, kind, protocol, splits and unit in one line."""
    presentation, n_splits = case.case.presentation, len(case.slots)
    protocol = ", ".join(filter(None, (presentation.protocol, case.name.condition)))
    spread = ", mean ± sd over splits" if n_splits > 1 else ""
    where = "path error" if case.case.has_paths else "error"
    return (
        f"{presentation.dataset} ({presentation.kind}) · {protocol}, "
        f"{counted(n_splits, 'split')} · {where} in mm{spread}"
    )


def verdict_sentence(answer: Answer, case: ScoredCase) -> str:
    """Return the comparison of the best model with the VJM, with its uncertainty."""
    rivals = [name for name in case.models if name != REFERENCE_MODEL]
    if REFERENCE_MODEL not in case.scores or not rivals:
        return ""
    winners = [name for name in rivals if answer.verdict(name, case) == "a"]
    model = min(winners or rivals, key=case.mean)
    verdict, results = answer.verdict(model, case), answer.estimates(model, case)
    if verdict is None or not results:
        return f"{model} against vjm: no test is possible with one split and one pose."
    gain = MM * (case.mean(REFERENCE_MODEL) - case.mean(model))
    amount = f"{abs(gain):.3f} mm {'less' if gain >= 0.0 else 'more'} error"
    main = max(results, key=lambda result: result.high - result.low)
    if verdict == "equivalent":
        rope = f"{MM * ROPE_M:g} mm"
        equivalent = f"{model} and vjm are equivalent: their errors differ by less than {rope}."
        return f"{equivalent}{_of_fits(case)}"
    if verdict in ("a", "b"):
        better = "better" if verdict == "a" else "worse"
        less = " No model is better than vjm." if verdict == "b" else ""
        text = f"{model} is {better} than vjm: {amount} ({_interval(main, gain)})."
        return f"{text}{less}{_smaller_error(case, rivals, model)}{_of_fits(case)}"
    return (
        f"No model is reliably better than vjm. The closest, {model}, has {amount} "
        f"({_interval(main, gain)}).{_disagreement(results, gain)}"
    )


def _smaller_error(case: ScoredCase, rivals: Sequence[str], winner: str) -> str:
    """Return a sentence on a model with less error whose gain is not significant; else ""."""
    best = min(rivals, key=case.mean)
    if best == winner:
        return ""
    return (
        f" {best} has less error ({MM * case.mean(best):.3f} mm), but its gain is not significant."
    )


def _of_fits(case: ScoredCase) -> str:
    """Return a warning if the spread over splits is unknown; else ""."""
    if case.errors.of_splits is not None:
        return ""
    splits = "One split does" if len(case.slots) == 1 else "Pooled splits do"
    return f" {splits} not show how results vary with the training samples."


def _interval(estimate: Estimate, gain: float) -> str:
    """Return bounds of the gain, or of the loss if the model is worse."""
    bounds = (-estimate.high, -estimate.low) if gain >= 0.0 else (estimate.low, estimate.high)
    low, high = (f"{MM * bound:.3f}" for bound in bounds)
    return f"{percent(1.0 - LEVEL)} interval {low} to {high}"


def _disagreement(results: Sequence[Estimate], gain: float) -> str:
    """Return a sentence if splits and poses disagree on significance; else ""."""
    if all(estimate.excludes_zero for estimate in results):
        return " Its interval excludes zero, but not after correction for all pairs of models."
    return f" {DISAGREEMENTS[disagreement(results[0], results[-1])]}".rstrip()


def case_facts(case: ScoredCase) -> str:
    """Return the kind of the data and the sizes of training and test part."""
    results = next(iter(case.results.values()))
    trained = [result.n_train for result in results]
    tested = [len(result.prediction.rows) for result in results if result.prediction is not None]
    kind = f"{case.case.presentation.kind.capitalize()} robot."
    sizes = f"Trained on {_range(trained)} samples, tested on {_range(tested)}."
    return f"{kind} {sizes}" if any(trained) else kind


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low}" if low == high else f"{low} to {high}"


def case_notes(case: ScoredCase) -> list[str]:
    """Return caveats of the data, choices and warnings of fits."""
    every = [list(competitor.done.values()) for competitor in case.case.competitors.values()]
    outcomes = [note for of_model in every if of_model for note in outcome_notes(of_model)]
    presentation = case.case.presentation
    return [*filter(None, [presentation.warning]), *outcomes, *presentation.caveats]


def answer_screen(
    answer: Answer,
    facts: str = "",
    *,
    failures: Sequence[str] = (),
    options: str = "",
    verbose: bool = False,
    console: Console | None = None,
) -> str:
    """Return an answer for a terminal: a table, the verdict, facts, and next steps.

    One comparison is printed as a table of its models, several as a matrix. With `verbose` the
    tables of several comparisons follow.

    Args:
        answer: answer with at least one comparison.
        facts: text on the run and its results folder.
        failures: lines on fits without a result, with reasons.
        options: options of the next commands, after a space, such as " --results my/runs".
        verbose: True to print all notes.
        console: console of `screen_console`; None: the terminal.
    """
    console = console or screen_console()
    single_case = answer.cases[0] if len(answer.cases) == 1 else None
    if single_case is None:
        print_table(console, replace(matrix_table(answer), notes=[]))
        console.print()
    for case in answer.cases if single_case is None and verbose else filter(None, [single_case]):
        print_table(console, case_table(answer, case, case_title(case)))
        console.print()
    if single_case is None:
        print_lines(console, f"{headline(answer)}.", style="bold")
        for sentence in sentences(answer):
            print_lines(console, sentence.text)
    elif verdict := verdict_sentence(answer, single_case):
        print_lines(console, verdict, style="bold")
    print_lines(console, f"{case_facts(single_case)} {facts}" if single_case else facts)
    for line in failures:
        print_lines(console, line, style=WORSE)
    listed = list(chain(*map(case_notes, answer.cases)))
    notes = Table("", (), (), listed, brief=not verbose).visible_table()
    for note in notes.notes:
        print_lines(console, note, style="dim")
    best = next((model.name for model in answer.models if model.name != REFERENCE_MODEL), "")
    options = one_line(options)
    model = shlex.quote(one_line(best))
    next_steps = [
        *([f"bench compare {model} {REFERENCE_MODEL}{options}"] if best else []),
        f"bench report{options} --output report.html",
        "more metrics: --metric stde",
    ]
    line = f"Next: {' · '.join(next_steps)}"
    if len(line) > console.width:  # one command per line, so that commands are not wrapped
        line = "\n      ".join([f"Next: {next_steps[0]}", *next_steps[1:]])
    console.print(line, style="dim", soft_wrap=True)
    return screen_of(console)
