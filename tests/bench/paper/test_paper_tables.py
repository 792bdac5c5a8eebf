"""The paper's tables with ours: numbers by hand, what is missing, formats that parse."""

from __future__ import annotations

import csv
import io
import statistics
from dataclasses import replace

import numpy as np
import pytest

from helpers.made_results import MadeResults
from stiff_bench.paper.paper_models import (
    EARLY_STEPS,
    FT_MLP,
    FT_MLP_OWN_SOURCE,
    FT_MLP_PAPER_RECIPE,
    VJM,
    pretrained,
    unfrozen,
)
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_tables import (
    NEEDS_NO_RESULTS,
    RECIPE,
    SPECIMENS,
    TABLES,
    read_table,
)
from stiff_bench.results.notes import TRAINING_MARK
from stiff_bench.tables.published import about_table
from stiff_bench.tables.writers import render
from stiff_protocols.contract.errors import ConfigError, StoreError

PAPER, ON_ALL, FAIR = "paper-holdout", "paper-holdout@read_on=all", "holdout"
OURS, EARLY = "ours, paper-holdout", "ours, stopped early"
TESTED, READ, FAIRLY = "ours, test part", "ours, all samples", "ours, holdout"


class PaperRuns(MadeResults):
    """Results whose errors on the source are 1, 2, 3 and 4 times those along z, which are given."""

    def _done(self, cell, presentation, run_id, data, rows, error_mm):
        if cell.protocol == ON_ALL:  # the fit of the split of the same number
            sha256 = cell.split_sha256
            cell = replace(cell, rows_sha256=sha256, split_sha256=f"{sha256}, all rows")
        names = ("training MAE", "training STDE", "test MAE", "test STDE")
        of_source = {
            f"source {name} [mm]": (i + 1) * np.mean(error_mm) for i, name in enumerate(names)
        }
        result = super()._done(cell, presentation, run_id, data, rows, error_mm)
        return replace(result, diagnostics=of_source)

    def of(self, model, errors_mm=(), protocol=PAPER, **words):
        return self.add(model, errors_mm, "kr10-twin", protocol, **words)

    @property
    def read(self):
        return PaperResults.of(self.folder)


@pytest.fixture()
def runs(tmp_path):
    return PaperRuns(tmp_path)


def values(table, group, row):
    """Column -> number of a row, of one group of columns."""
    (cells,) = (cells for cells in table.rows if tuple(cells[: len(row)]) == row)
    pairs = zip(table.columns, cells, strict=True)
    return {column.name: cell for column, cell in pairs if column.group == group}


def labels(table):
    """The texts of each row."""
    return [tuple(cell for cell in row if isinstance(cell, str)) for row in table.rows]


def notes(tables):
    return " ".join(note for table in tables for note in table.notes)


def test_tables_6_and_7_have_the_errors_on_the_source_that_the_networks_report(runs):
    """Those stopped early have columns of their own."""
    runs.of(pretrained(layers=3, width=100), [0.1, 0.3])
    runs.of(pretrained(activation="tanh"), [0.1])
    runs.of(pretrained(activation="tanh", stopped_early=True), [0.4])
    (part,) = TABLES["6"](runs.read)
    assert [row for (row,) in labels(part)] == ["2", "3", "4", "5", "6"]
    assert values(part, "published", ("3",))["test MAE"].value == 0.2186
    ours = values(part, OURS, ("3",))
    assert [ours[column].value for column in ours] == pytest.approx([0.2, 0.4, 0.6, 0.8])
    assert ours["test STDE"].spread == pytest.approx(statistics.stdev([0.4, 1.2]))
    assert ours["train MAE"].n == 2
    assert set(values(part, OURS, ("2",)).values()) == {None}
    (part,) = (table := TABLES["7"](runs.read))
    assert values(part, OURS, ("tanh",))["train MAE"].value == pytest.approx(0.1)
    assert values(part, EARLY, ("tanh",))["train MAE"].value == pytest.approx(0.4)
    assert "Without a result under paper-holdout: mlp-pretrained@activation=sigmoid" in notes(table)
    assert f"Stopped early: {EARLY_STEPS} steps" in notes(table)


def test_table_8_keeps_the_rows_of_models_that_failed_and_says_why_each_did(runs):
    *failed, done = (unfrozen([layer]) for layer in ("1", "2", "3", "4", "out"))
    runs.of(done, [0.1])
    for model in failed:
        runs.of(model, failed=[0])
    (part,) = (table := TABLES["8"](runs.read))
    assert labels(part) == [("1 layer", layer) for layer in ("1", "2", "3", "4", "out")]
    assert set(values(part, OURS, ("1 layer", "4")).values()) == {None}
    note_text = notes(table)
    assert all(f"{model.name} (failed: it broke)" in note_text for model in failed)
    assert "with `--rerun failed` computes it again" in note_text


def test_results_that_all_failed_are_refused_with_the_reason_and_the_command(runs):
    runs.of(unfrozen(["1"]), failed=[0])
    with pytest.raises(StoreError, match=r"failed: it broke.*--rerun failed"):
        TABLES["8"](runs.read)


def test_table_9_has_every_error_on_both_parts_of_the_fits_that_are_read_on_all_samples(runs):
    """The first four of the twelve samples are held out, with an error of 0.3 mm along z."""
    runs.of(FT_MLP, [0.3], picked_on_test=True)
    runs.of(FT_MLP, [[0.3] * 4 + [0.1] * 4 + [0.2] * 4], ON_ALL, rows=range(12))
    (part,) = (table := TABLES["9"](runs.read))
    best = "optimized (best epoch)"
    assert labels(part)[4:] == [(best, error) for error in ("3-D", "X", "Y", "Z")]
    for error in ("3-D", "Z"):
        row_values = values(part, OURS, (best, error))
        assert row_values["validation MAE"].value == pytest.approx(0.3)
        assert row_values["validation STDE"].value == pytest.approx(0.0, abs=1e-12)
        assert row_values["train MAE"].value == pytest.approx(0.15)
        assert row_values["train STDE"].value == pytest.approx(0.05)
        assert row_values["train MAE"].mark == "epoch picked on test part"
    assert values(part, OURS, (best, "X"))["train MAE"].value == pytest.approx(0.0, abs=1e-12)
    assert f"{FT_MLP.name}: epoch picked on test part." in notes(table)
    published = values(part, "published", ("normal (last epoch)", "3-D"))
    assert published["validation MAE"].value == 0.1997
    assert set(values(part, "published", ("normal (last epoch)", "X")).values()) == {None}


def test_table_10_has_three_readings_and_reductions_split_by_split(runs):
    runs.of(VJM, [0.1, 0.4])
    runs.of(FT_MLP, [0.05, 0.1])
    runs.of(FT_MLP_OWN_SOURCE, [0.025, 0.3])
    runs.of(VJM, [0.2], FAIR)
    runs.of(FT_MLP, [0.3], FAIR)
    runs.of(VJM, [0.4], ON_ALL)
    runs.of(FT_MLP, [0.1], ON_ALL, reports_training=True)
    errors, reductions = (table := TABLES["10"](runs.read))
    row = ("Z", "MAE")
    assert values(errors, "published", row)["DT-CNN"].value == 0.0628
    assert values(errors, TESTED, row)["FT-MLP"].value == pytest.approx(0.075)
    assert values(errors, TESTED, row)["DT-CNN"] is None
    assert values(errors, FAIRLY, row)["VJM"].value == pytest.approx(0.2)
    assert values(errors, READ, row)["FT-MLP"].value == pytest.approx(0.1)
    assert values(errors, READ, row)["FT-MLP"].mark == TRAINING_MARK
    assert TRAINING_MARK in notes(table)
    published = values(reductions, "published", row)
    assert published["claimed"].value == 24.9
    assert published["from Table 10"].value == pytest.approx(24.87, abs=0.01)
    ours, own_source = values(reductions, TESTED, row).values()
    assert own_source.value == pytest.approx(50)  # 75 and 25 %
    assert list(values(errors, "published", row)) == ["VJM", "FT-MLP", "DT-CNN"]
    assert values(errors, TESTED, row)["FT-MLP, own source"].value == pytest.approx(0.1625)
    assert ours.value == pytest.approx(62.5)  # 50 and 75 %; that of the means would be 70
    assert ours.spread == pytest.approx(statistics.stdev([50, 75])) and ours.n == 2
    fairly, _ = values(reductions, FAIRLY, row).values()
    assert fairly.value == pytest.approx(-50)
    read, _ = values(reductions, READ, row).values()
    assert read.value == pytest.approx(75)
    undefined, _ = values(reductions, TESTED, ("X", "MAE")).values()
    assert undefined is None  # the VJM has no error there


def test_the_papers_recipe_is_one_column_more_where_it_is_stored_and_a_command_where_not(runs):
    for model in (VJM, FT_MLP):
        runs.of(model, [0.4, 0.8])
    errors, _ = TABLES["10"](runs.read)
    (part,) = TABLES["9"](runs.read)
    for table in (errors, part):
        assert "recipe (100,000 + 50,000 iterations) is not stored" in notes([table])
        assert not any("recipe" in column.name + column.group for column in table.columns)
    runs.of(FT_MLP_PAPER_RECIPE, [0.1])
    errors, reductions = TABLES["10"](runs.read)
    (part,) = TABLES["9"](runs.read)
    assert "is not stored" not in notes([errors, part])
    assert "Left out" not in notes([errors, reductions])  # the recipe has one split by design
    row = ("Z", "MAE")
    row_values = values(errors, TESTED, row)
    assert (row_values[RECIPE].value, row_values[RECIPE].n) == (pytest.approx(0.1), 1)
    assert (row_values["VJM"].value, row_values["VJM"].n) == (pytest.approx(0.6), 2)
    assert RECIPE not in values(errors, FAIRLY, row)
    assert values(reductions, TESTED, row)[f"{RECIPE} against VJM"].value == pytest.approx(75)
    of_recipe = values(part, "ours, the paper's recipe", ("optimized (best epoch)", "Z"))
    assert of_recipe["validation MAE"].value == pytest.approx(0.1)


@pytest.mark.parametrize(("number", "n_rows"), [("1", 15), ("4", 6), ("5", 5)])
def test_the_papers_own_plans_are_printed_as_typed_and_read_no_results(number, n_rows, tmp_path):
    (part,) = TABLES[number](None)
    assert len(part.rows) == n_rows and "published" in part.title and len(part.notes) == 1
    line = next(csv.DictReader(io.StringIO(render([part], "csv", ""))))
    assert line["source"] == "published" and line["table"] == number
    with pytest.raises(ConfigError, match=f"table {number} is the paper's alone and reads none"):
        read_table(number, tmp_path)


def test_only_splits_that_all_models_have_count_and_a_note_says_how_many_do_not(runs):
    """A protocol without results has no columns, and a note."""
    runs.of(VJM, [0.1, 0.2, 0.3])
    runs.of(FT_MLP, [0.4])
    errors, reductions = (table := TABLES["10"](runs.read))
    vjm = values(errors, TESTED, ("Z", "MAE"))["VJM"]
    assert (vjm.value, vjm.n) == (pytest.approx(0.1), 1)
    assert "Left out: 2 splits of paper-holdout" in notes(table)
    assert not values(errors, FAIRLY, ("Z", "MAE"))
    assert not values(reductions, FAIRLY, ("Z", "MAE"))
    assert "nothing to print of kr10-twin under holdout" in notes(table)


@pytest.mark.parametrize("number", sorted(set(TABLES) - NEEDS_NO_RESULTS.keys()))
def test_a_folder_without_the_tables_results_is_refused_naming_the_command(runs, number):
    runs.of("knn", [0.1])
    with pytest.raises(StoreError, match=r"nothing to print .*`bench reproduce paper`"):
        TABLES[number](runs.read)


def test_results_of_another_seed_data_set_or_specimen_do_not_count(runs):
    runs.add(VJM.name, [0.1], "kr10-twin@specimen=1", PAPER)
    runs.add(VJM.name, [0.1], "fanuc-r2000ic", PAPER)
    runs.of(VJM, [0.1], seed=7)
    with pytest.raises(StoreError, match="nothing to print"):
        TABLES["10"](runs.read)


def test_table_2_says_of_how_many_specimens_it_is():
    assert len(SPECIMENS) == 5
    assert f"over {len(SPECIMENS)} robots" in " ".join(about_table("2")["notes"])


def test_the_vjm_of_the_twin_is_near_the_papers_tables_2_and_3_that_it_was_calibrated_by(
    monkeypatch,
):
    monkeypatch.setattr("stiff_bench.paper.paper_tables.SPECIMENS", range(2))  # for time
    (errors,), (stiffness,) = TABLES["2"](None), TABLES["3"](None)
    for axis in "XYZ":
        published = values(errors, "published", (axis,))
        ours = values(errors, "ours, kr10-twin", (axis,))
        assert ours["MAE"].value == pytest.approx(published["MAE"].value, rel=0.4)
        assert ours["MAE"].spread is None and ours["MAE"].n == 1
        of_all = values(errors, "ours, specimens 0 to 4", (axis,))
        assert of_all["MAE"].n == 2 and 0.0 < of_all["MAE"].spread < 0.05
    for joint in ("A1", "A2", "A3", "A4", "A5", "A6"):
        published = values(stiffness, "published", (joint,))["stiffness"].value
        ours = values(stiffness, "ours, kr10-twin", (joint,))["stiffness"].value
        assert ours == pytest.approx(published, rel=0.25)
    assert values(stiffness, "published", ("A4",))["stiffness"].value == 2.27
    assert stiffness.unit == "10^3 Nm/rad"
    assert all(phrase in " ".join(errors.notes) for phrase in ("calibrated against", "not a test"))
