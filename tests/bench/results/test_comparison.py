"""Comparison of two models: numbers by hand, verdicts, and the tables."""

from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
import pytest
from scipy import stats

from helpers.compared_results import made_data, spread, steady, store_results
from stiff_bench.results.comparison import SELECTS_ON_TEST, compare_models
from stiff_bench.results.load import StoredResults
from stiff_bench.results.notes import TRAINING_MARK
from stiff_bench.results.results import open_results
from stiff_bench.results.selection import Selection
from stiff_bench.results.significance import Question
from stiff_bench.tables.writers import render
from stiff_datasets.robots.shipped_robots import shipped_robot
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.types import BenchmarkData

A_SPLITS = (1.0e-4, 1.2e-4, 0.9e-4, 1.1e-4, 1.3e-4)
B_SPLITS = (2.0e-4, 2.1e-4, 2.2e-4, 2.1e-4, 2.4e-4)
PAIR = {"a": steady(*A_SPLITS), "b": steady(*B_SPLITS)}
ONE_FIT = {"a": spread(1e-4, 2e-5, seed=1), "b": spread(1.5e-4, 2e-5, seed=2)}


def compared(folder, a="a", b="b", question=None, **words):
    stored = StoredResults.read(folder)
    return compare_models(stored, a, b, question or Question(), Selection(**words))


def row_of(folder, error="norm", **question):
    """Return the row of an error in the only task, and its estimate over splits."""
    comparison = compared(folder, question=Question(**question))
    (row,) = (row for row in comparison.rows if row["error"] == error)
    return row, row["estimates"].get("over splits")


def rendered(comparison, fmt="github"):
    return render(comparison.tables(), fmt, "bench compare a b", text=comparison.text)


def csv_lines(comparison):
    return [*csv.DictReader(io.StringIO(rendered(comparison, "csv")))]


def shown_rows(comparison):
    """Return the cells of the table for documents, by the first column."""
    _, table, _ = comparison.tables()
    return {str(row[0]): row for row in table.rows}


def test_over_splits_the_numbers_are_those_of_the_corrected_t_test_by_hand(tmp_path):
    row, estimate = row_of(store_results(tmp_path, PAIR), "x")
    differences = np.subtract(A_SPLITS, B_SPLITS)
    scale = math.sqrt((1 / 5 + 8 / 32) * differences.var(ddof=1))  # 8 rows tested, 32 trained on
    half = scale * stats.t.ppf(0.975, 4)
    assert row["A - B"] == pytest.approx(1000 * differences.mean())
    assert (row["A"], row["B"]) == pytest.approx((0.11, 0.216))
    assert (estimate.low, estimate.high) == pytest.approx(
        (differences.mean() - half, differences.mean() + half)
    )
    p_uncorrected = 2 * stats.t.cdf(differences.mean() / scale, 4)
    assert estimate.p_value == pytest.approx(3 * p_uncorrected)  # Holm: y and z are equal
    a_better = stats.t.cdf((-1e-5 - differences.mean()) / scale, 4)
    assert estimate.posterior.a_better == pytest.approx(a_better)


def test_the_tested_share_of_the_data_corrects_however_few_rows_are_trained_on(tmp_path):
    folders = [store_results(tmp_path / f"{n}", PAIR, n_train=n) for n in (32, 5)]
    (_, many), (_, few) = (row_of(folder, "x") for folder in folders)
    assert many.high - many.low == few.high - few.low


def test_equal_models_are_equivalent_and_noise_is_no_difference(tmp_path):
    near = spread(1e-4, 2e-5)
    models = {"a": near, "b": lambda index, rows: near(index, rows) * 1.001}
    folder = store_results(tmp_path / "near", models)
    assert (
        "a and b are equivalent (within 0.01 mm) on made (kfold, 5 splits)" in compared(folder).text
    )
    tables = open_results(folder).compare("a", "b", equivalence_mm=0.2)
    assert "equivalent (within 0.2 mm)" in tables.text
    noise = {"a": spread(0.0, 1e-3, seed=1), "b": spread(0.0, 1e-3, seed=2)}
    text = compared(store_results(tmp_path / "noise", noise)).text
    assert "No significant difference between a and b on made (kfold, 5 splits)" in text


def test_the_sentence_names_the_better_model_and_notes_are_few_except_in_json(tmp_path):
    caveats = tuple(f"caveat {n}" for n in range(9))
    folder = store_results(tmp_path, PAIR, caveats=caveats)
    for a, b in (("a", "b"), ("b", "a")):
        comparison = compared(folder, a, b)
        assert comparison.text.startswith("a is better than b on made (kfold, 5 splits)")
        assert "0.106 mm smaller" in comparison.text and "over splits)" in comparison.text
        assert list(shown_rows(comparison)) == ["X", "Y", "Z", "3-D"]
    text = rendered(comparison)
    assert text.count(comparison.text) == 1 and "made (measured)" in text
    notes = [line for line in text.split("**")[-1].splitlines() if line[:2] == "- "]
    assert len(notes) == 5 and "--format json" in notes[3] and "made by" in notes[4]
    (estimates,) = json.loads(rendered(comparison, "json"))["tables"]
    assert {*caveats} < {*estimates["notes"]}


@pytest.mark.parametrize(
    "tests", [{"tests": [np.arange(40)]}, {"tests": np.arange(40)[:, None], "pooled": True}]
)
def test_one_split_and_pooled_splits_are_judged_over_poses_and_the_verdict_says_so(tmp_path, tests):
    comparison = compared(store_results(tmp_path, ONE_FIT, **tests))
    assert "a is better" in comparison.text and "these fits)" in comparison.text
    lines = csv_lines(comparison)
    verdicts = {"A better (these fits)", "equivalent (these fits)", "no significant difference"}
    assert {line["verdict"] for line in lines} <= verdicts
    assert {(line["method"], line["n_poses"]) for line in lines} == {("over poses", "40")}


def test_verdicts_of_several_tasks_are_counted_except_under_unfair_protocols(tmp_path):
    store_results(tmp_path, PAIR, condition="n = 5")
    for size in (10, 20):
        store_results(tmp_path, ONE_FIT, condition=f"n = {size}", tests=[np.arange(40)])
    regime = "trained on simulated deflections only"
    fields = {"a": {"regime": regime}, "b": {"picked_on_test": True}}
    unfair = {"selects_on_test": True, "warning": "beware.", "caveats": ("made by hand.",)}
    store_results(tmp_path, PAIR, condition="paper", model_fields=fields, **unfair)
    comparison = compared(tmp_path)
    assert comparison.text.startswith("Of 3 comparisons: a better in 3, b better in 0")
    assert comparison.text.endswith(f"Not counted: 1 comparison whose protocol {SELECTS_ON_TEST}.")
    rows = {name: row[-1] for name, row in shown_rows(comparison).items()}
    mark = f"[{SELECTS_ON_TEST}; A: {regime}; B: epoch picked on test part]"
    assert rows[f"made, kfold, paper {mark}"] == "A better"
    assert [*rows.values()].count("A better (these fits)") == 2
    unfair_lines = [line for line in csv_lines(comparison) if line["selects_on_test"] == "True"]
    assert {line["condition"] for line in unfair_lines} == {"paper"}
    assert {"beware.", "made by hand."} < {*comparison.notes}


def test_a_winner_on_the_poses_that_every_split_tests_needs_other_poses_too(tmp_path):
    swing = np.random.default_rng(5).permutation(np.linspace(-1.4e-4, 1.4e-4, 40))

    def b(index, rows):  # worse by 0.015 mm whatever it learns from, but better at many poses
        x = 2.15e-4 + 1e-7 * index + swing[rows]
        return np.column_stack([x, np.zeros((len(rows), 2))])

    models = {"a": steady(*[2e-4] * 5), "b": b}
    folder = store_results(tmp_path, models, tests=[np.arange(36)] * 5)
    row, over_splits = row_of(folder)
    over_poses = row["estimates"]["over poses"]
    assert over_splits.p_value < 0.05 and over_splits.high < 0.0 < over_poses.high
    assert row["verdict"] == "open"
    comparison = compared(folder)
    assert "over poses). The splits agree on it, but a few poses could turn it" in comparison.text
    shown_interval = shown_rows(comparison)["3-D"][4]
    assert shown_interval.high == pytest.approx(1000 * over_poses.high)


def test_splits_without_a_result_of_both_are_left_out_and_failures_named(tmp_path):
    folder = store_results(tmp_path, PAIR, failed={"a": [1, 3]})
    row, _ = row_of(folder, "x")
    assert row["splits"] == 3
    assert row["B"] == pytest.approx(1000 * np.mean([B_SPLITS[number] for number in (0, 2, 4)]))
    assert "FAILED: a (2 fits): it broke" in rendered(compared(folder))
    store_results(folder, PAIR, failed={"b": range(5)}, condition="n = 5")
    with pytest.raises(ConfigError, match=r"b has no result \(failed: it broke\)"):
        compared(folder, conditions=("n = 5",))


def test_a_model_may_spell_out_the_defaults_that_its_results_were_made_with(tmp_path):
    options = {"a": {"depth": 3}, "knn": {"neighbours": 5, "scale": 1e-3, "weights": "near"}}
    options["knn@weights=far"] = options["knn"] | {"weights": "far"}
    folder = store_results(tmp_path, dict.fromkeys(options, PAIR["a"]), options=options)
    for word, name in (
        ("knn@neighbours=5", "knn"),
        ("knn@scale=0.001@weights=near", "knn"),
        ("knn@weights=far@neighbours=5", "knn@weights=far"),
    ):
        assert compared(folder, b=word).b == name
    for word in ("knn@neighbours=6", "knn@colour=red"):
        with pytest.raises(ConfigError, match=f"'{word}'.*valid: a, knn, knn@weights"):
            compared(folder, b=word)
    with pytest.raises(ConfigError, match="both models are 'a'"):
        compared(folder, b="a@depth=3")


def test_what_reports_training_rows_is_not_compared_and_the_reason_is_named(tmp_path):
    store_results(tmp_path, PAIR, condition="all samples", reports_training=True)
    with pytest.raises(ConfigError, match=f"not compared: .*all samples.*: {TRAINING_MARK}"):
        compared(tmp_path)
    store_results(tmp_path, PAIR, condition="n = 5")
    comparison = compared(tmp_path)
    assert {row["condition"] for row in comparison.rows} == {"n = 5"}
    assert any(TRAINING_MARK in note for note in comparison.notes)


def test_tasks_with_one_text_are_named_by_what_differs_and_seeds_are_in_order(tmp_path):
    for seed in (10, 3):
        store_results(tmp_path, PAIR, seed=seed)
    hashes = [made_data(number).sha256 for number in (1, 2)]
    for number in (1, 2):
        store_results(tmp_path, PAIR, data=made_data(number), condition="n = 5")
    store_results(tmp_path, PAIR, condition="n = 6")
    assert list(shown_rows(compared(tmp_path))) == [
        "made, kfold, seed 3",
        "made, kfold, seed 10",
        *(f"made, kfold, n = 5, data {sha256[:8]}" for sha256 in sorted(hashes)),
        "made, kfold, n = 6",
    ]


def test_what_cannot_be_compared_is_one_clear_line(tmp_path):
    folder = store_results(tmp_path / "r", PAIR)
    store_results(folder, {"vjm@slopes=2": PAIR["a"]}, condition="elsewhere")
    for words, message in (
        ({"b": "vjm@slopes=3"}, "'vjm@slopes=3'; did you mean 'vjm@slopes=2'"),
        ({"b": "aa"}, r"'aa'; did you mean 'a'\? \(valid: a, b, vjm@slopes=2"),
        (
            {"b": "vjm@slopes=2"},
            r"a and vjm@slopes=2 have no comparison in common: a was run in "
            r"made \| kfold; vjm@slopes=2 was run in made \| kfold \| elsewhere",
        ),
        ({"datasets": ("mode",)}, "dataset.*'mode'; did you mean 'made'"),
        ({"conditions": ("else",)}, r"^unknown condition .*'else'; did .*\(valid: elsewhere\)$"),
    ):
        with pytest.raises(ConfigError, match=message):
            compared(folder, **words)
    with pytest.raises(StoreError, match="nothing: no such folder"):
        compared(tmp_path / "nothing")


def test_models_that_were_run_with_different_tcps_are_refused_with_the_tcps(tmp_path):
    data = made_data()
    moved = BenchmarkData(data.samples, shipped_robot("kr10_r1100_2", tcp=(0.06, 0.0, 0.1)))
    store_results(tmp_path, {"a": PAIR["a"]}, data=data)
    store_results(tmp_path, {"b": PAIR["b"]}, data=moved)
    message = r"no comparison in common: .*; made is the name of different .*: TCP \("
    with pytest.raises(ConfigError, match=message):
        compared(tmp_path)


def test_csv_and_json_hold_the_numbers_of_each_method_in_mm(tmp_path):
    folder = store_results(tmp_path, PAIR)
    comparison, (row, estimate) = compared(folder), row_of(folder)
    values = {
        line["column"]: line
        for line in csv_lines(comparison)
        if (line["error"], line["method"]) == ("norm", "over splits")
    }
    assert float(values["A - B"]["value"]) == pytest.approx(row["A - B"], rel=1e-12)
    high = float(values["95 % interval"]["high"])
    assert high == pytest.approx(1000 * estimate.high, rel=1e-12)
    assert values["A - B"]["verdict"] == "A better" and values["A - B"]["unit"] == "mm"
    (estimates,) = json.loads(rendered(comparison, "json"))["tables"]
    errors = {(record["error"], record["method"]): record["values"] for record in estimates["rows"]}
    assert errors["norm", "over splits"][3]["low"] == pytest.approx(1000 * estimate.low)


def test_the_seed_moves_only_the_intervals_over_poses(tmp_path):
    models = {"a": spread(1e-4, 4e-5, seed=1), "b": spread(1.2e-4, 4e-5, seed=2)}
    folder = store_results(tmp_path, models)
    (first, of_splits), (second, of_same_splits) = (row_of(folder, seed=seed) for seed in (0, 1))
    assert of_splits == of_same_splits
    assert first["estimates"]["over poses"].low != second["estimates"]["over poses"].low
