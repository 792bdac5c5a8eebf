"""`bench compare --perturb`: does the order of the models outlast mistakes of the measurement?"""

from __future__ import annotations

import json

import numpy as np
import pytest

import stiffbench as sb
from helpers.command_line import assert_refused, bench_here
from stiff_bench.analysis.sensitivity import Mistake, mean_error
from stiff_bench.store.database import read_results
from stiff_bench.tables.units import MM
from stiff_datasets.measured.sample_files import sample_table, write_table
from stiff_protocols.contract.errors import ConfigError

pytestmark = pytest.mark.slow
NO_OTHERS = {"force_noise_percent": 0.0, "registration_deg": 0.0, "deflection_shift_mm": 0.0}
NO_OTHER_WORDS = ("--force-noise=0", "--registration=0", "--deflection-shift=0")
UNNOTICED_MM = 1e-20
"""So small that it changes no number of a data set."""
DATA = ("--dataset", "fanuc-r2000ic")


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Two splits of three models on the FANUC, where `knn` is far worse than the VJM."""
    folder = tmp_path_factory.mktemp("sensitivity") / "runs"
    sb.evaluate(["knn", "mean", "vjm"], "fanuc-r2000ic", splits=2, output=folder)
    return folder


def numbers(tables, row: int) -> dict[str, float]:
    """Column -> value of a row that has one."""
    (table,) = tables.tables
    cells = [getattr(cell, "value", cell) for cell in table.rows[row]]
    return {column.name: cell for column, cell in zip(table.columns, cells, strict=True)}


def stored_errors(folder) -> dict[str, float]:
    """Model -> mean 3-D error of its stored results, mm."""
    by_model: dict[str, list] = {}
    for one in sorted(read_results(folder), key=lambda one: one.cell.split_index):
        by_model.setdefault(one.shown.model, []).append(one)
    return {model: MM * mean_error(results) for model, results in by_model.items()}


def test_without_a_perturbation_the_stored_errors_come_out_exactly_and_in_order(stored):
    found = sb.open_results(stored).sensitivity(tcp_off_mm=UNNOTICED_MM, draws=2, **NO_OTHERS)
    errors = stored_errors(stored)
    unperturbed, unnoticed = numbers(found, 0), numbers(found, 1)
    assert {model: unperturbed[model] for model in errors} == errors
    assert {model: unnoticed[model] for model in errors} == errors
    (table,) = found.tables
    best, pairs, tau = table.rows[1][-6:-3]
    assert (best.share, pairs.share, tau.value, tau.spread) == ((2, 2), (6, 6), 1.0, 0.0)
    assert "best in 2 of 2" in found.text and "holds in 2" in found.text


def test_models_stand_in_their_order_and_every_mistake_has_a_row(stored):
    found = sb.open_results(stored).sensitivity("knn", "vjm", draws=1)
    (table,) = found.tables
    assert [column.name for column in table.columns[1:3]] == ["vjm", "knn"]
    assert [row[0] for row in table.rows] == [
        "none",
        "TCP off by 0.5 mm",
        "force noise of 2 %",
        "registration turned by 0.1 deg",
        "deflections shifted by 0.05 mm",
    ]
    assert numbers(found, 0)["knn"] == numbers(found, 1)["knn"], "knn knows no TCP"
    assert numbers(found, 0)["vjm"] != numbers(found, 1)["vjm"]


def test_a_mistake_that_is_large_enough_changes_the_order():
    """Three models, two draws: the first two change places in one of them."""
    mistake = Mistake(
        "made", np.array([1.0, 2.0, 3.0]), np.array([[1.1, 2.0, 2.5], [2.2, 2.1, 3.0]])
    )
    assert mistake.ranks.tolist() == [1.0, 2.0, 3.0]
    assert (mistake.best_held, mistake.orders_held) == (1, 1)
    held = mistake.pairs_held.sum(axis=0)
    assert (held[0, 1], held[0, 2], held[1, 2]) == (1, 2, 2)
    assert mistake.taus == pytest.approx([1.0, 1.0 / 3.0])  # (2 - 1) / 3 pairs


def test_a_pair_that_changes_places_is_named_with_its_verdict(stored):
    found = sb.open_results(stored).sensitivity(
        "vjm", "knn", draws=1, tcp_off_mm=0.0, **(NO_OTHERS | {"force_noise_percent": 100.0})
    )
    (table,) = found.tables
    row = dict(zip([column.name for column in table.columns], table.rows[1], strict=True))
    assert row["knn"].value < row["vjm"].value and row["rank of knn"] == 1
    assert row["vjm before knn"].share == row["best holds"].share == (0, 1)
    assert row["Kendall's tau"].value == -1.0
    assert "vjm is ahead of knn in 0 of 1 draws" in table.notes[0]
    assert "no significant difference" in table.notes[0]


class Broken:
    """A model that never has a result."""

    def fit(self, train, *, robot, validation=None, seed=0):
        raise ValueError("it broke")

    def predict(self, q, wrench):
        raise AssertionError


def test_splits_that_some_lack_and_models_without_a_result_are_left_out_and_named(tmp_path):
    sb.evaluate(["mean", "vjm", Broken], "fanuc-r2000ic", splits=2, output=tmp_path)
    sb.evaluate("knn", "fanuc-r2000ic", output=tmp_path)
    (table,) = sb.open_results(tmp_path).sensitivity(draws=1, tcp_off_mm=1.0, **NO_OTHERS).tables
    assert [column.name for column in table.columns[1:4]] == ["vjm", "knn", "mean"]
    assert table.about["splits"] == 1
    assert any("1 of 2 splits" in note for note in table.notes)
    assert any("no result of Broken" in note for note in table.notes)


@pytest.mark.parametrize(
    "words",
    [
        ("--protocol", "kfold", "--metric", "norm", "--metric", "width", "--coverage", "0.8"),
        ("--protocol", "repeated-holdout", "--splits", "2"),
        ("--protocol", "sensor-noise@levels=0,5"),
        ("--protocol", "nested", "--model", "knn"),
    ],
    ids=lambda words: words[1],
)
def test_the_splits_of_every_kind_of_protocol_are_had_again(tmp_path, words):
    models = ("--model", "mean", "--model", "vjm")
    assert bench_here("run", *models, *DATA, *words, cwd=tmp_path).returncode == 0
    done = bench_here("compare", "--perturb", "--draws", "1", *NO_OTHER_WORDS, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "TCP off by 0.5 mm" in done.stdout


def test_options_of_models_and_protocol_are_those_of_the_stored_results(tmp_path):
    about = {"protocol": "repeated-holdout@test_fraction=0.3", "splits": 2, "output": tmp_path}
    sb.evaluate(["knn@neighbours=3", "mean"], "fanuc-r2000ic", **about)
    found = sb.open_results(tmp_path).sensitivity(draws=1, tcp_off_mm=UNNOTICED_MM, **NO_OTHERS)
    errors, unperturbed = stored_errors(tmp_path), numbers(found, 0)
    assert {model: unperturbed[model] for model in errors} == errors
    assert not any("other options" in note for note in found.tables[0].notes)


def test_a_file_of_ones_own_may_be_gone(tmp_path, fanuc):
    write_table(tmp_path / "my.csv", [sample_table(fanuc.samples, fanuc.robot)])
    words = ("run", "--model", "mean", "--model", "vjm", "--data", "my.csv")
    robot = ("--robot", "fanuc-r2000ic")
    assert bench_here(*words, *robot, cwd=tmp_path).returncode == 0
    (tmp_path / "my.csv").unlink()
    asked = ("compare", "vjm", "mean", "--perturb", "--draws", "1", "--format", "json")
    done = bench_here(*asked, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (table,) = json.loads(done.stdout)["tables"]
    assert table["dataset"] == "my.csv" and len(table["rows"]) == 5


def test_a_model_whose_plugin_is_missing_is_refused_and_named(tmp_path, plugin_file):
    file = plugin_file("theirs")
    run = ("run", "--model", "theirs", "--model", "mean", *DATA, "--no-isolate")
    assert bench_here(*run, "--plugin", file, cwd=tmp_path).returncode == 0
    asked = ("compare", "--perturb", "--draws", "1")
    assert_refused(bench_here(*asked, cwd=tmp_path), "unknown model 'theirs'", "--plugin")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--tcp-off", "half"], ["valid: a length such as 0.01mm"]),
        (["vjm"], ["vjm alone", "two models or more"]),
        (["vjm", "gp"], ["unknown model with results 'gp'"]),
        ([*NO_OTHER_WORDS, "--tcp-off=0"], ["nothing is perturbed"]),
    ],
    ids=str,
)
def test_bad_words_are_refused_in_one_line(stored, words, parts):
    done = bench_here("compare", "--perturb", "--results", "runs", *words, cwd=stored.parent)
    assert_refused(done, *parts)


@pytest.mark.parametrize(
    "words", [["vjm"], [], ["vjm", "knn", "mean"], ["vjm", "knn", "--draws=3"]]
)
def test_without_perturb_there_are_two_models_and_no_mistakes(stored, words):
    done = bench_here("compare", "--results", "runs", *words, cwd=stored.parent)
    assert_refused(done, "--perturb")


@pytest.mark.parametrize("name", ["tcp_off_mm", "force_noise_percent", "draws", "jobs"])
def test_a_bad_size_is_refused_by_its_name_in_python(stored, name):
    with pytest.raises(ConfigError, match=f"{name} -1"):
        sb.open_results(stored).sensitivity(**{name: -1})
