"""What stored results say: tables, comparisons, ranks, a page."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf, radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiff_bench.api.tables import Tables
from stiff_bench.store.database import read_results
from stiff_bench.tables.metric_table import build_tables
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import MM, PRINTED
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult, ResultRecord
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import METRICS, metric

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.analysis.leaderboard import Leaderboard
    from stiff_bench.run.runner import Finished
    from stiff_bench.store.merging import Kind, Merged


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Ranks(Tables):
    """A leaderboard's tables.

    Attributes:
        board: the ranks as numbers.
    """

    board: Leaderboard

    @property
    def why_no_diagrams(self) -> str:
        """Why no critical-difference diagram can be drawn; "" where one can."""
        analyses = self.board.sections[0].analyses
        found = any(one.outcome is not None for one in analyses)
        return "" if found else f"no critical difference: it {analyses[0].why_none}"

    def save_diagrams(self, file: Path | str) -> None:
        """Draw the critical-difference diagrams of the protocols that do not select on test.

        Raises:
            ConfigError: there is none to draw, or the file's suffix is no picture's.
            StoreError: it cannot be written.
        """
        from stiff_bench.figures.ranks import save_diagrams

        if why := self.why_no_diagrams:
            raise ConfigError(f"{file}: {why}")
        first = self.board.sections[0]
        kinds = " and ".join(first.kinds)
        save_diagrams(first.analyses, f"{self.board.key.text} ({kinds})", Path(file))


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """Results of models on data sets under protocols.

    Attributes:
        folder: where they are stored.
        metrics: keys, that `table` shows; none: the usual ones.
        command: that made them, for the record.
        finished: what became of the run that made them; None: they are read from the folder.
    """

    folder: Path
    metrics: tuple[str, ...] = ()
    command: str = ""
    finished: Finished | None = None

    @cached_property
    def cells(self) -> tuple[CellResult, ...]:
        """One result for each model, data set, protocol and split, failures too.

        Raises:
            StoreError: the folder holds no results, or damaged ones.
        """
        if self.finished is not None:
            return self.finished.results
        return tuple(read_results(self.folder))

    @property
    def _counting(self) -> Sequence[CellResult]:
        """The results that a table is made of, in its order."""
        if self.finished is not None:
            return self.cells
        from stiff_bench.analysis.collected import StoredResults
        from stiff_bench.analysis.leaderboard import newest_results

        return newest_results(StoredResults.read(self.folder))

    def frame(self) -> DataFrame:
        """Return every metric as tidy data: a row a metric, axis and split, in printed units.

        A failed cell has one row with its reason and no value.
        """
        from pandas import DataFrame

        rows = []
        for one in self.cells:
            about = {**_about(one), "status": one.status, "failure": one.failure}
            rows += [{**about, **metric_line(record)} for record in one.records] or [about]
        return DataFrame(rows)

    def predictions(self) -> DataFrame:
        """Return a row a test sample: deflection of the data set and as predicted, mm."""
        from pandas import DataFrame, concat

        parts = []
        for one in self.cells:
            if (found := one.prediction) is None:
                continue
            arrays = {"": found.measured, "_predicted": found.predicted}
            columns = {
                f"d{axis}{name}_mm": MM * array[:, number]
                for name, array in arrays.items()
                for number, axis in enumerate(AXES)
            }
            parts.append(DataFrame({**_about(one), "row": found.rows, **columns}))
        return concat(parts, ignore_index=True) if parts else DataFrame()

    def table(self, *metrics: str, verbose: bool = False) -> Tables:
        """Return a table for each data set and protocol, as `bench run` prints it.

        Args:
            metrics: keys, as `bench list metrics` shows them; none: those that were asked for, or
                the usual ones: mae, stde and me, of tool paths norm, norm-p95, norm-max, removed.
            verbose: with the numbers that the fits report, such as stiffnesses, beneath.

        Of results that contradict each other in a folder, the newest run's count.

        Raises:
            ConfigError: there is no such metric.
            StoreError: the folder holds no results, or damaged ones.
        """
        shown = [metric(key) for key in metrics or self.metrics]
        tables = build_tables(self._counting, shown)
        if verbose:
            tables = [replace(one, notes=[*one.notes, *one.details]) for one in tables]
        return Tables(lambda: tables, partial(render, tables, command=self.command))

    def compare(
        self,
        a: str,
        b: str,
        *,
        datasets: Sequence[str] = (),
        protocols: Sequence[str] = (),
        conditions: Sequence[str] = (),
        equivalence_mm: float = 0.01,
        confidence: float = 0.95,
        seed: int = 0,
    ) -> Tables:
        """Return whether model `a` is better than model `b`, by how much, and how sure that is.

        Args:
            a: name of a model, with its options.
            b: another one.
            datasets: names, or keys that stand for all variants; none: all.
            protocols: the same.
            conditions: of the protocols; none: all.
            equivalence_mm: largest difference in mean error that makes none in practice, mm.
            confidence: of intervals and verdicts (0..1).
            seed: of the resampling of poses.

        Raises:
            ConfigError: a model has no results, or they have no splits in common.
            StoreError: the folder holds no results, or damaged ones.
        """
        from stiff_bench.analysis.comparison import compare_folder
        from stiff_bench.analysis.comparison_text import comparison_tables, render_report, sentence
        from stiff_bench.analysis.verdict import Question

        question = Question(rope=equivalence_mm / MM, confidence=confidence, seed=seed)
        chosen = {"datasets": datasets, "protocols": protocols, "conditions": conditions}
        found = compare_folder(self.folder, a, b, question, **chosen)
        text_as = partial(render_report, found, command=self.command)
        return Tables(lambda: comparison_tables(found).values(), text_as, sentence(found))

    def sensitivity(
        self,
        *models: str,
        tcp_off_mm: float = 0.5,
        force_noise_percent: float = 2.0,
        registration_deg: float = 0.1,
        deflection_shift_mm: float = 0.05,
        draws: int = 10,
        datasets: Sequence[str] = (),
        protocols: Sequence[str] = (),
        conditions: Sequence[str] = (),
        equivalence_mm: float = 0.01,
        confidence: float = 0.95,
        seed: int = 0,
        jobs: int = 1,
    ) -> Tables:
        """Return whether the order of the models outlasts the mistakes of a measurement.

        The models are fitted and scored anew on perturbed copies of the data set, training and test
        samples alike, with the splits and seeds of these results; nothing is stored. A size of 0
        leaves its mistake out.

        Args:
            models: names, with their options; none: all that have results.
            tcp_off_mm: distance of the TCP from where it was said to be, in a random direction, mm.
            force_noise_percent: standard deviation of each component of force and torque, per cent
                of its norm.
            registration_deg: angle between the measuring device's frame and the robot's base frame,
                about a random axis, deg.
            deflection_shift_mm: length of a constant that is added to all deflections, in a random
                direction, mm.
            draws: how often each mistake is drawn.
            datasets: names, or keys that stand for all variants; none: all.
            protocols: the same.
            conditions: of the protocols; none: all.
            equivalence_mm: as in `compare`, for the verdict on pairs that change places.
            confidence: likewise.
            seed: of the draws.
            jobs: how many fits at once, each in a process of its own.

        Raises:
            ConfigError: a size is wrong, a model has no results, or models, data or splits cannot
                be had again.
            ModelError: a fit fails.
            StoreError: the folder holds no results, or damaged ones.
        """
        from stiff_bench.analysis.sensitivity import (
            render_sensitivities,
            sensitivities,
            sensitivity_table,
            sentence,
        )
        from stiff_bench.analysis.verdict import Question
        from stiff_bench.api.catalog import registry
        from stiff_bench.api.process import pinned
        from stiff_datasets.measured.perturbations import Perturbations

        for name, number in {"draws": draws, "jobs": jobs}.items():
            if number < 1:
                raise ConfigError(f"{number} (valid: 1 or more)", name)
        sizes = {
            "tcp_off_mm": tcp_off_mm,
            "force_noise_percent": force_noise_percent,
            "registration_deg": registration_deg,
            "deflection_shift_mm": deflection_shift_mm,
        }
        for name, size in sizes.items():
            if not 0.0 <= size < inf:
                raise ConfigError(f"{size} (valid: a number of at least 0)", name)
        found = sensitivities(
            self.folder,
            models,
            Perturbations(
                tcp_m=tcp_off_mm / MM,
                force=force_noise_percent / 100.0,
                turn_rad=radians(registration_deg),
                shift_m=deflection_shift_mm / MM,
            ),
            registry(),
            draws=draws,
            question=Question(rope=equivalence_mm / MM, confidence=confidence, seed=seed),
            threads=pinned(),
            jobs=jobs,
            datasets=datasets,
            protocols=protocols,
            conditions=conditions,
        )
        text_as = partial(render_sensitivities, found, command=self.command)
        return Tables(lambda: map(sensitivity_table, found), text_as, sentence(found))

    def leaderboard(
        self,
        metric: str = "norm",
        axis: str | None = None,
        *,
        models: Sequence[str] = (),
        datasets: Sequence[str] = (),
        protocols: Sequence[str] = (),
        seed: int = 0,
    ) -> Ranks:
        """Return the ranks of the models over all data sets and protocols.

        Args:
            metric: to rank by; a key.
            axis: of a metric that has axes: "x", "y" or "z"; None: the mean over them.
            models: names, or keys that stand for all variants; none: all.
            datasets: the same.
            protocols: the same.
            seed: of the resampling of poses.

        Raises:
            ConfigError: fewer than two models have results, or the metric cannot rank.
            StoreError: the folder holds no results, or damaged ones.
        """
        from stiff_bench.analysis.collected import StoredResults
        from stiff_bench.analysis.leaderboard import build_leaderboard
        from stiff_bench.analysis.leaderboard_tables import render_leaderboard, section_tables
        from stiff_bench.analysis.sort_key import sort_key

        chosen = {"models": models, "datasets": datasets, "protocols": protocols}
        key = sort_key(metric, axis)
        board = build_leaderboard(StoredResults.read(self.folder), key=key, seed=seed, **chosen)
        text_as = partial(render_leaderboard, board, command=self.command)

        def tables() -> Iterator[Table]:
            for section in board.sections:
                yield from section_tables(section, board)

        return Ranks(tables, text_as, board=board)

    def report(
        self,
        file: Path | str,
        *,
        models: Sequence[str] = (),
        datasets: Sequence[str] = (),
        protocols: Sequence[str] = (),
        metric: str = "norm",
        axis: str | None = None,
        seed: int = 0,
        others: Sequence[Results] = (),
    ) -> Path:
        """Write all that the results say as one HTML page that needs no network.

        Args:
            file: the page; an older one is replaced.
            models: names, or keys that stand for all variants; none: all.
            datasets: the same.
            protocols: the same.
            metric: to rank by; a key.
            axis: of a metric that has axes: "x", "y" or "z"; None: the mean over them.
            seed: of the resampling of poses.
            others: results that stand on the same page, each by itself.

        Raises:
            ConfigError: the file's suffix is no page's, or a name has no results.
            StoreError: a folder holds no results, or damaged ones, or the file cannot be written.
        """
        from stiff_bench.report.report_content import Selection, write_report

        folders = [one.folder for one in (self, *others)]
        chosen = Selection(tuple(models), tuple(datasets), tuple(protocols), metric, axis, seed)
        write_report(folders, chosen, Path(file), self.command)
        return Path(file)

    def diagnostics(self) -> DataFrame:
        """Return what the fits report beside their errors, such as stiffnesses: a row a number."""
        from pandas import DataFrame

        return DataFrame(
            [
                {**_about(one), "diagnostic": name, "value": value}
                for one in self.cells
                for name, value in one.diagnostics.items()
            ]
        )

    def __len__(self) -> int:
        """Return the number of results and failures."""
        return len(self.cells)

    def __repr__(self) -> str:
        """Return the tables for a terminal."""
        return repr(self.table())

    def _repr_html_(self) -> str:
        return self.table().text_as("html")


def metric_line(record: ResultRecord) -> dict[str, object]:
    """Return a metric as a line of tidy data, in the unit that it is printed in."""
    unit, factor = PRINTED[METRICS[record.metric].unit]
    value = {"value": record.value * factor, "unit": unit}
    return {"metric": record.metric, "axis": record.axis, **value}


def _about(one: CellResult) -> dict[str, Any]:
    return {
        "model": one.shown.model,
        "dataset": one.shown.dataset,
        "protocol": one.shown.protocol,
        "condition": one.cell.condition,
        "split": one.cell.split_index,
        "seed": one.cell.seed,
    }


def open_results(folder: Path | str) -> Results:
    """Return what a folder holds, such as the --output of `bench run`; it is read when asked."""
    return Results(Path(folder), command=f"stiffbench.open_results({str(folder)!r})")


def merge(
    folders: Sequence[Path | str], output: Path | str, *, allow: Collection[Kind] = ()
) -> Merged:
    """Join the results of several folders, such as of several machines, in one.

    Args:
        folders: that are joined; they stay as they are.
        output: a new folder, or one that holds some.
        allow: in what the folders may differ: "data", "split" or "code".

    Raises:
        ConfigError: the folders differ in what is not allowed.
        StoreError: a folder holds no results, or `output` cannot be written.
    """
    from stiff_bench.store import merging

    return merging.merge([*map(Path, folders)], Path(output), allow)
