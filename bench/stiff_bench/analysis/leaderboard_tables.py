"""A leaderboard as tables. Here SI becomes mm and per cent."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations, compress

import numpy as np

from stiff_bench.analysis.costs import cost_table
from stiff_bench.analysis.critical_difference import RankAnalysis
from stiff_bench.analysis.leaderboard import (
    Leaderboard,
    RankedModel,
    ScoreColumn,
    Section,
    UnrankedModel,
)
from stiff_bench.analysis.same_robot import dataset_of, family_of, of_families, of_robots
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.names import grouped, labels
from stiff_bench.tables.metric_table import SELECTION_MARK, number_format
from stiff_bench.tables.render import DETAILED, render
from stiff_bench.tables.table import Cell, Column, Name, Quantity, Table
from stiff_bench.tables.units import PRINTED, counted, percent
from stiff_protocols.scoring.bootstrap import RANK_RESAMPLES
from stiff_protocols.scoring.paired import LEVEL

BEST, LIKE_BEST = "*", "≈"
NAMED_BLOCKS = 4
"""Conditions that a note on missing results names; the tables by protocol show the others."""


def render_leaderboard(
    board: Leaderboard, fmt: str, command: str, provenance: Sequence[str]
) -> str:
    """Return the tables as text of the given format.

    Args:
        board: the numbers.
        fmt: "github", "latex", "csv", "html" or "json".
        command: that makes them.
        provenance: lines on where the results come from.
    """
    tables = []
    for section in board.sections:
        tables += section_tables(section, board, provenance)
        tables += section_details(section, board.key) if fmt in DETAILED else []
    about = {"sort_key": board.key.text, "direction": board.key.metric.direction}
    return render(tables, fmt, command, about=about)


def section_tables(section: Section, board: Leaderboard, provenance: Sequence[str]) -> list[Table]:
    """Return ranks, scores by protocol, critical differences and costs of one section."""
    tables = [_ranks(section, board, provenance), *_by_protocol(section, board.key)]
    if any(analysis.outcome for analysis in section.analyses):
        tables.append(analyses_table(section, board.key))
    costs = cost_table(section)
    return [*tables, costs] if costs.rows else tables


def section_details(section: Section, key: SortKey) -> list[Table]:
    """Return each model's score in each contest, and ranks and pairs of each analysis."""
    found = [analysis for analysis in section.analyses if analysis.outcome is not None]
    return [
        _scores(section, key),
        *([_mean_ranks(section, found), _pairs(section, found)] if found else []),
    ]


def _about(section: Section, table: str) -> dict[str, object]:
    return {"table": table, "selects_on_test": section.selects_on_test}


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _scores(section: Section, key: SortKey) -> Table:
    """Return each model's score in each contest, or why it has none."""
    texts = ("dataset", "data_sha256", "source_sha256", "protocol", "condition", "seed", "splits")
    unit, factor = PRINTED[key.metric.unit]
    rows: list[list[Cell]] = []
    for field in section.fields:
        name = field.name
        place = (
            *(name.dataset, name.data_sha256, name.source_sha256, name.protocol, name.condition),
            *(name.seed, len(field.slots), field.left_out),
        )
        for model in section.marks:
            score = (
                field.mean(model) * factor
                if model in field.scores
                else Quantity(status=field.missing[model])
            )
            rows.append([Name(model, section.mark_under(name.protocol, model)), *place, score])
    return Table(
        title=f"Scores in each contest | {key.text}",
        columns=[
            *(Column(text, "text") for text in ("model", *texts, "splits left out")),
            Column(key.text, unit=unit, format=number_format(key.metric)),
        ],
        rows=rows,
        about=_about(section, "scores"),
    )


def _mean_ranks(section: Section, found: Sequence[RankAnalysis]) -> Table:
    """Return each model's mean rank over the robots of each analysis."""
    return Table(
        title="Mean ranks over robots",
        columns=[
            *(Column(text, "text") for text in ("model", "protocol", "condition", "robots")),
            Column("mean rank over robots", format=".2f"),
        ],
        rows=[
            [model, one.protocol, one.condition, robots, float(rank)]
            for one in found
            if one.outcome is not None
            for robots in [", ".join(robot.text for robot in one.robots)]
            for model, rank in zip(one.models, one.outcome.mean_ranks, strict=True)
        ],
        about=_about(section, "mean ranks over robots"),
    )


def _pairs(section: Section, found: Sequence[RankAnalysis]) -> Table:
    """Return the p-values of each pair of models of each analysis."""
    rows: list[list[Cell]] = []
    for one in found:
        outcome = one.outcome
        if outcome is None:
            continue
        for i, j in combinations(range(len(one.models)), 2):
            conover = None if outcome.conover is None else float(outcome.conover[i, j])
            nemenyi = float(outcome.nemenyi[i, j])
            models = (one.models[i], one.models[j])
            rows.append([*models, one.protocol, one.condition, nemenyi, conover])
    return Table(
        title="Pairs over robots",
        columns=[
            *(Column(text, "text") for text in ("model", "other", "protocol", "condition")),
            *(Column(text, format=".2g") for text in ("Nemenyi p", "Conover p")),
        ],
        rows=rows,
        about=_about(section, "pairs over robots"),
    )


def analyses_table(section: Section, key: SortKey) -> Table:
    """Return a row for each analysis of a section that has an outcome."""
    found = [analysis for analysis in section.analyses if analysis.outcome is not None]
    types = {robot.type for analysis in found for robot in analysis.robots}
    notes = [
        'Friedman: p-value of "all models are equal". CD: mean ranks over robots that are at '
        f"least so far apart differ (Nemenyi, level {LEVEL:g}). Pairs: told apart by Nemenyi's and "
        "by Conover's test (Holm). Groups: models that are not told apart. A robot counts once: "
        "scores on several data sets of it (loads, sensors, seeds) are averaged.",
    ]
    if len(types) == 1:
        notes.append(
            f"all robots are of one type ({types.pop()}, "
            f"{' and '.join(section.kinds)}): what holds for its specimens need not hold for "
            "another robot."
        )
    if len(found) > 1:
        notes.append(
            "all protocols together: the score of a model on a robot is its mean rank over the "
            "contests there."
        )
    agreeing = [len(analysis.robots) for analysis in found if _robots_agree(analysis)]
    if agreeing:
        notes.append(
            "Conover: - where all robots agree on every rank. Without any disagreement to measure "
            f"by it would be certain of every difference; {min(agreeing)} robots that agree have "
            f"an exact two-sided p of {2.0 * 0.5 ** min(agreeing):.3g} for a pair."
        )
    return Table(
        title=f"Critical difference over robots | {key.text}",
        columns=[
            Column("protocol, condition", "text"),
            Column("robots", "text"),
            Column("models"),
            Column("Friedman p", format=".2g"),
            Column("CD", format=".2f"),
            *(Column(f"pairs: {test}", format=_of) for test in ("Nemenyi", "Conover")),
            Column("groups, best first", "text"),
        ],
        rows=[_analysis_cells(analysis) for analysis in found],
        notes=[*notes, *section.caveats],
        about=_about(section, "critical difference"),
    )


def _of(pairs: Quantity) -> str:
    return " of ".join(map(str, pairs.share or ()))


def _robots_agree(analysis: RankAnalysis) -> bool:
    return analysis.differs and analysis.outcome is not None and analysis.outcome.conover is None


def _analysis_cells(analysis: RankAnalysis) -> list[Cell]:
    outcome = analysis.outcome
    assert outcome is not None
    upper = np.triu_indices(len(analysis.models), k=1)
    told = [
        None
        if p is None or not analysis.differs
        else Quantity(share=(int((p[upper] < LEVEL).sum()), len(p[upper])))
        for p in (outcome.nemenyi, outcome.conover)
    ]
    groups = [f"{{{', '.join(analysis.models[i] for i in group)}}}" for group in outcome.groups]
    return [
        analysis.text,
        of_robots(analysis.families),
        len(analysis.models),
        outcome.friedman_p,
        outcome.critical_difference,
        *told,
        (", ".join(groups) or "none") if analysis.differs else "all (Friedman)",
    ]


def _ranks(section: Section, board: Leaderboard, provenance: Sequence[str]) -> Table:
    n_contests = len(section.fields)
    better = "larger" if board.key.sign < 0.0 else "smaller"
    apart = f" | {SELECTION_MARK}s: not a fair comparison" if section.selects_on_test else ""
    columns = [
        Column("model", "text"),
        Column("place"),
        Column("mean rank", format=".2f", about={"metric": board.key.text}),
        Column(f"{percent(1.0 - LEVEL)} interval", format=".2f", about={"metric": board.key.text}),
        *(Column("won"), Column("like the best")),
        *(Column("within CD of the best", "text"), Column("contests")),
    ]
    return Table(
        title=(
            f"Leaderboard, {counted(n_contests, 'contest')}: {_scope(section)}{apart} | sorted by "
            f"mean rank of {board.key.text} ({better} is better)"
        ),
        columns=columns,
        rows=[
            *(_ranked_cells(place, m, n_contests) for place, m in enumerate(section.ranked, 1)),
            *(_unranked_cells(model, n_contests) for model in section.unranked),
        ],
        notes=(*_rank_notes(section, board.key), *section.caveats, *board.notes, *provenance),
        about=_about(section, "ranks"),
    )


def _scope(section: Section) -> str:
    families = {dataset_of(field.name): family_of(field.name) for field in section.fields}
    protocols = list(dict.fromkeys(field.name.protocol for field in section.fields))
    kinds = " and ".join(section.kinds)
    seeds = _seeds(len({field.name.seed for field in section.fields}))
    return f"{of_families(families)} ({kinds}) under {', '.join([*protocols, *seeds])}"


def _seeds(number: int) -> list[str]:
    return [counted(number, "seed")] if number > 1 else []


def _ranked_cells(place: int, model: RankedModel, n_contests: int) -> list[Cell]:
    interval = Quantity(low=model.low, high=model.high) if np.isfinite(model.low) else None
    return [
        Name(model.name, model.mark),
        place,
        model.mean_rank,
        interval,
        model.won,
        None if model.like_best is None else Quantity(share=(model.like_best, n_contests)),
        {True: "yes", False: "no", None: "-"}[model.within_cd],
        Quantity(share=(n_contests, n_contests)),
    ]


def _unranked_cells(model: UnrankedModel, n_contests: int) -> list[Cell]:
    done = Quantity(share=(n_contests - len(model.missing), n_contests))
    return [Name(model.name, model.mark), *[None] * 6, done]


def _rank_notes(section: Section, key: SortKey) -> Iterator[str]:
    n_ranked = len(section.ranked)
    if n_ranked:
        yield (
            f"mean rank: of {counted(n_ranked, 'model')} with a result in every contest, ranked "
            "among themselves; 1 is the best, ties share their mean rank. A contest is a data set "
            "under a protocol, condition and seed; each weighs the same, so that a protocol weighs "
            f"as many as it has: {_weights(section)}."
        )
        if key.resamples:
            yield (
                f"interval: {RANK_RESAMPLES} draws of the poses, the same for all models and "
                "contests, widened to hold the mean rank where draws pull it to the middle. The "
                "fitted models and the data sets are held fixed: other training "
                "sets and other robots are not in it."
            )
        else:
            yield f"no intervals: {key.metric.key} is no mean over rows, as norm and mae are."
        yield _test_text(key)
        if any(model.within_cd is not None for model in section.ranked):
            yield (
                f"within CD of the best: in {section.analyses[0].text}, its mean rank over robots "
                "is less than the critical difference behind the best one, so that the two are "
                f"not told apart (Nemenyi, level {LEVEL:g}); yes for all where Friedman's test "
                "finds no difference. Place and CD go by ranks, * in the tables by the mean error: "
                "the best of one need not be the best of the other."
            )
    else:
        yield (
            "no mean ranks: fewer than two models have a result in every contest; name fewer "
            "contests (--dataset, --protocol) or finish the runs."
        )
    for model in section.unranked:
        yield _missing_note(model, len(section.fields))
    called = labels(field.contest.name for field in section.fields)
    for field in section.fields:
        if field.left_out:
            yield f"{called[field.name]}: {field.left_out}"
    yield from _no_analysis_notes(section.analyses)


def _test_text(key: SortKey) -> str:
    if key.is_cost:
        return (
            "costs: no test; the first fit of a run loads libraries, and a pre-training from the "
            "cache is free."
        )
    tests = "corrected t over splits, with Holm over the models"
    if key.resamples:
        tests = (
            "corrected t over splits, or Wilcoxon over poses where there is one split, with Holm "
            "over the models, and the bootstrap over poses must both find a difference"
        )
    return (
        "like the best: contests in which it is the best, equivalent to the best or not "
        f"distinguishable from it ({tests}; level {LEVEL:g})."
    )


def _weights(section: Section) -> str:
    counts = Counter(field.name.protocol for field in section.fields)
    return ", ".join(f"{protocol} {count}" for protocol, count in counts.items())


def _missing_note(model: UnrankedModel, n_contests: int) -> str:
    if not model.missing:
        return f"{model.name}: no mean rank, it is the only model with all contests."
    by_reason: dict[str, Counter[str]] = {}
    for contest, reason in model.missing.items():
        block = " | ".join(filter(None, (contest.protocol, contest.condition)))
        by_reason.setdefault(reason, Counter())[block] += 1
    parts = []
    for reason, blocks in by_reason.items():
        named = [
            f"{block} ({counted(n, 'data set')})" for block, n in [*blocks.items()][:NAMED_BLOCKS]
        ]
        more = blocks.total() - sum([*blocks.values()][:NAMED_BLOCKS])
        parts.append(f"{reason}: {', '.join(named)}{f' and {more} more' if more else ''}")
    return (
        f"{model.name}: no mean rank, {len(model.missing)} of {counted(n_contests, 'contest')} "
        f"missing. {'; '.join(parts)}."
    )


def _no_analysis_notes(analyses: Sequence[RankAnalysis]) -> Iterator[str]:
    without = [analysis for analysis in analyses if analysis.why_none]
    for reason, found in grouped(without, lambda analysis: analysis.why_none).items():
        blocks = "; ".join(analysis.text for analysis in found)
        named = "" if len(found) == len(analyses) else f" of {blocks}"
        yield f"no critical-difference analysis{named}: it {reason}."


def _by_protocol(section: Section, key: SortKey) -> Iterator[Table]:
    """Yield a table for each robot type and protocol; its columns are the conditions."""
    for (family, protocol), found in grouped(
        section.columns, lambda column: (column.family, column.protocol)
    ).items():
        datasets = list(dict.fromkeys(name for column in found for name in column.datasets))
        several = len(datasets) > 1
        spread = ", mean ± standard deviation over data sets" if several else ""
        apart = f" | {SELECTION_MARK}s" if section.selects_on_test else ""
        models = [m for m in section.marks if any(m in column.values for column in found)]
        named = of_families(dict.fromkeys(datasets, family))
        unit, _ = PRINTED[key.metric.unit]
        columns = [
            Column(
                _heading(column, several),
                unit=unit,
                format=number_format(key.metric),
                about={
                    "metric": key.text,
                    "protocol": protocol,
                    "condition": column.condition,
                    "datasets": " ".join(column.datasets),
                    "seeds": " ".join(map(str, column.seeds)),
                },
            )
            for column in found
        ]
        yield Table(
            title=f"{protocol} on {named}{apart} | {key.text}{spread}",
            columns=[Column("model", "text"), *columns],
            rows=[
                [
                    Name(model, section.mark_under(protocol, model)),
                    *(_score(column, model, key) for column in found),
                ]
                for model in models
            ],
            notes=(_marks_note(key, several), *section.caveats_of(family, protocol)),
            unit=unit,
            about=_about(section, "scores by protocol"),
        )


def _marks_note(key: SortKey, several: bool) -> str:
    parts = [
        f"{BEST} best mean of the models with all data sets of a column (place and CD go by ranks)",
        f"{LIKE_BEST} not distinguishable from the best in more than half of its data sets",
        "- not run, or run not finished",
        "(2/5) mean over 2 of 5 data sets, not comparable",
    ]
    shown = [True, not key.is_cost, True, several]
    return "; ".join(compress(parts, shown)) + "."


def _heading(column: ScoreColumn, several: bool) -> str:
    name = column.condition or column.protocol
    datasets = [counted(len(column.datasets), "data set")] if several else []
    about = ", ".join([*datasets, *_seeds(len(column.seeds))])
    return f"{name} ({about})" if about else name


def _score(column: ScoreColumn, model: str, key: SortKey) -> Quantity | None:
    """Return a model's score over the data sets of a column; some of them alone are no mean."""
    value = column.values.get(model)
    if value is None:
        return None
    _, factor = PRINTED[key.metric.unit]
    mean, std = _known(value.mean * factor), _known(value.std * factor)
    if not value.n_datasets:
        return Quantity(status=value.failed)
    if value.n_datasets < len(column.datasets):
        share = (value.n_datasets, len(column.datasets))
        return Quantity(mean, std, share=share, status=value.failed)
    mark = BEST if value.best else LIKE_BEST if value.like_best else ""
    return Quantity(mean, std, mark=mark)
