"""Comparison of two models: numbers by hand, verdicts, and the report."""

from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
import pytest
from scipy import stats

from helpers.compared_results import made_data, spread, steady, store_results, task_in
from stiff_bench.results.comparison import compare, compare_folder
from stiff_bench.results.comparison_tables import comparison_tables, comparison_text
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


def compared(folder, **question):
    task, data = task_in(folder)
    return compare(task, "a", "b", data, Question(**question))


def report_on(folder, a="a", b="b", question=None, **words):
    return compare_folder(folder, a, b, question or Question(), Selection(**words))


def rendered(report, fmt="github"):
    return render(comparison_tables(report), fmt, "bench compare a b", text=comparison_text(report))


def csv_lines(report):
    return [*csv.DictReader(io.StringIO(rendered(report, "csv")))]


def table_of(report, name):
    """Return the rows of a table by its name in json."""
    return {table.about["table"]: table for table in comparison_tables(report)}[name].rows


def notes_of(report):
    """Return all notes."""
    *_, last_table, _ = json.loads(rendered(report, "json"))["tables"]
    return "\n".join(last_table["notes"])


def test_over_splits_the_numbers_are_those_of_the_corrected_t_test_by_hand(tmp_path):
    row = compared(store_results(tmp_path, PAIR)).differences["x"]
    differences = np.subtract(A_SPLITS, B_SPLITS)
    scale = math.sqrt((1 / 5 + 8 / 32) * differences.var(ddof=1))  # 8 rows tested, 32 trained on
    half = scale * stats.t.ppf(0.975, 4)
    assert row.difference == pytest.approx(differences.mean())
    assert row.means == pytest.approx((1.1e-4, 2.16e-4))
    assert (row.estimate.low, row.estimate.high) == pytest.approx(
        (differences.mean() - half, differences.mean() + half)
    )
    p_uncorrected = 2 * stats.t.cdf(differences.mean() / scale, 4)
    # Holm: y and z are equal in A and B
    assert row.estimate.p_value == pytest.approx(3 * p_uncorrected)
    a_better = stats.t.cdf((-1e-5 - differences.mean()) / scale, 4)
    assert row.estimate.posterior.a_better == pytest.approx(a_better)


def test_the_tested_share_of_the_data_corrects_however_few_rows_are_trained_on(tmp_path):
    folders = [store_results(tmp_path / f"{n}", PAIR, n_train=n) for n in (32, 5)]
    many, few = (compared(folder).differences["x"].estimate for folder in folders)
    assert many.high - many.low == few.high - few.low


def test_equal_models_are_equivalent_and_noise_is_no_difference(tmp_path):
    near = spread(1e-4, 2e-5)
    models = {"a": near, "b": lambda index, rows: near(index, rows) * 1.001}
    folder = store_results(tmp_path / "near", models)
    assert compared(folder).norm.verdict == "equivalent"
    assert "a and b are equivalent on made (kfold, 5 splits)" in rendered(report_on(folder))
    noise = {"a": spread(0.0, 1e-3, seed=1), "b": spread(0.0, 1e-3, seed=2)}
    folder = store_results(tmp_path / "noise", noise)
    assert compared(folder).norm.verdict == "open"
    headline = comparison_text(report_on(folder))
    assert "No significant difference between a and b on made (kfold, 5 splits)" in headline


def test_the_headline_is_printed_once_and_tables_have_few_notes_and_json_all(tmp_path):
    caveats = tuple(f"caveat {n}" for n in range(9))
    folder = store_results(tmp_path, PAIR, caveats=caveats)
    for a, b in (("a", "b"), ("b", "a")):
        report = report_on(folder, a, b)
        text, headline = rendered(report), comparison_text(report)
        assert headline.startswith("a is better than b on made (kfold, 5 splits)")
        assert "0.106 mm smaller" in headline and "over splits" in headline
        assert text.startswith(headline) and text.count(headline) == 1
    assert "made (measured)" in text
    notes = [line for line in text.split("**")[-1].splitlines() if line[:2] == "- "]
    assert len(notes) == 5 and "--format json" in notes[3] and "made by" in notes[4]
    assert all(caveat in notes_of(report) for caveat in caveats)


@pytest.mark.parametrize(
    "tests", [{"tests": [np.arange(40)]}, {"tests": np.arange(40)[:, None], "pooled": True}]
)
def test_one_split_and_pooled_splits_are_judged_over_poses_and_the_verdict_names_them(
    tmp_path, tests
):
    report = report_on(store_results(tmp_path, ONE_FIT, **tests))
    (comparison,) = report.comparisons
    assert not comparison.over_splits and comparison.n_poses == 40
    assert comparison.norm.verdict == "a" and "these fits)" in comparison_text(report)
    verdicts = {"A better (these fits)", "equivalent (these fits)", "no significant difference"}
    assert {line["verdict"] for line in csv_lines(report)} <= verdicts


def test_verdicts_of_one_training_and_of_unfair_protocols_are_counted_apart_with_marks(tmp_path):
    store_results(tmp_path, PAIR, condition="n = 5")
    for size in (10, 20):
        store_results(tmp_path, ONE_FIT, condition=f"n = {size}", tests=[np.arange(40)])
    regime = "trained on simulated deflections only"
    fields = {"a": {"regime": regime}, "b": {"picked_on_test": True}}
    unfair = {"selects_on_test": True, "warning": "beware.", "caveats": ("made by hand.",)}
    store_results(tmp_path, PAIR, condition="paper", model_fields=fields, **unfair)
    report = report_on(tmp_path)
    over_splits, of_fits, not_counted = comparison_text(report).split(". ")
    assert over_splits.startswith("Of 1 comparison over several splits: a better in 1")
    assert of_fits.startswith("Of 2 comparisons") and "these fits" in of_fits
    assert not_counted.startswith("Not counted: 1 comparison")
    rows = {str(row[0]): row[-1] for row in table_of(report, "cases")}
    mark = f"[selects on the test part; A: {regime}; B: epoch picked on test part]"
    assert f"made, kfold, paper {mark}" in rows
    assert [*rows.values()].count("A better (these fits)") == 2
    unfair_lines = [line for line in csv_lines(report) if line["selects_on_test"] == "True"]
    assert {line["condition"] for line in unfair_lines} == {"paper"}
    for note in ("Different training data", "only b picked", "beware.", "made by hand."):
        assert note in notes_of(report)


def test_a_winner_on_the_poses_that_every_split_tests_needs_other_poses_too(tmp_path):
    swing = np.random.default_rng(5).permutation(np.linspace(-1.4e-4, 1.4e-4, 40))

    def b(index, rows):  # worse by 0.015 mm whatever it learns from, but better at many poses
        x = 2.15e-4 + 1e-7 * index + swing[rows]
        return np.column_stack([x, np.zeros((len(rows), 2))])

    models = {"a": steady(*[2e-4] * 5), "b": b}
    folder = store_results(tmp_path, models, tests=[np.arange(36)] * 5)
    row = compared(folder).norm
    assert row.over_splits.p_value < 0.05 and row.over_splits.high < 0.0 < row.over_poses.high
    assert row.verdict == "open" and row.cautious == row.over_poses
    report = report_on(folder)
    assert "over poses)" in comparison_text(report)
    assert "no significant difference (poses)" in rendered(report)


def test_splits_without_a_result_of_both_are_left_out_and_named(tmp_path):
    folder = store_results(tmp_path, PAIR, failed={"a": [1, 3]})
    comparison = compared(folder)
    assert comparison.n_splits == 3
    mean_of_b = np.mean([B_SPLITS[number] for number in (0, 2, 4)])
    assert comparison.differences["x"].means[1] == pytest.approx(mean_of_b)
    assert "a has no result on 2 of 5 splits (failed: it broke)" in rendered(report_on(folder))
    store_results(folder, PAIR, failed={"b": range(5)}, condition="n = 5")
    with pytest.raises(ConfigError, match=r"b has no result \(failed: it broke\)"):
        report_on(folder, conditions=("n = 5",))


def test_specimens_count_as_data_sets_and_splits_do_not(tmp_path):
    names = ["made", *(f"made@specimen={number}" for number in range(1, 5))]
    for number, name in enumerate(names):
        store_results(tmp_path, PAIR, data=made_data(number), dataset=name)
    (row,) = table_of(report_on(tmp_path), "over datasets")
    assert str(row[0]) == "made, kfold" and row[1:6] == [5, 5, 0, 0, 0]  # all of A
    # a mean of 5 data sets, not of 25 splits
    assert row[6:] == pytest.approx([-0.106, 2 * 0.5**5])
    four = report_on(tmp_path, datasets=("made@specimen=0", *names[1:4]))
    assert len(four.comparisons) == 4 and table_of(four, "over datasets")[0][-1] is None


def test_a_model_may_spell_out_the_defaults_that_its_results_were_made_with(tmp_path):
    options = {"a": {"depth": 3}, "knn": {"neighbours": 5, "scale": 1e-3, "weights": "near"}}
    options["knn@weights=far"] = options["knn"] | {"weights": "far"}
    folder = store_results(tmp_path, dict.fromkeys(options, PAIR["a"]), options=options)
    for word, name in (
        ("knn@neighbours=5", "knn"),
        ("knn@scale=0.001@weights=near", "knn"),
        ("knn@weights=far@neighbours=5", "knn@weights=far"),
    ):
        assert report_on(folder, b=word).b == name
    for word in ("knn@neighbours=6", "knn@colour=red"):
        with pytest.raises(ConfigError, match=f"'{word}'.*valid: a, knn, knn@weights"):
            report_on(folder, b=word)
    with pytest.raises(ConfigError, match="both models are 'a'"):
        report_on(folder, b="a@depth=3")


def test_what_reports_training_rows_is_not_compared_and_the_reason_is_named(tmp_path):
    store_results(tmp_path, PAIR, condition="all samples", reports_training=True)
    with pytest.raises(ConfigError, match=f"not compared: .*all samples.*: {TRAINING_MARK}"):
        report_on(tmp_path)
    store_results(tmp_path, PAIR, condition="n = 5")
    report = report_on(tmp_path)
    assert [comparison.name.condition for comparison in report.comparisons] == ["n = 5"]
    assert any(TRAINING_MARK in note for note in report.notes)


def test_tasks_with_one_text_are_named_by_what_differs_and_seeds_are_in_order(tmp_path):
    for seed in (10, 3):
        store_results(tmp_path, PAIR, seed=seed)
    hashes = [made_data(number).sha256 for number in (1, 2)]
    for number in (1, 2):
        store_results(tmp_path, PAIR, data=made_data(number), condition="n = 5")
    store_results(tmp_path, PAIR, condition="n = 6")
    assert [str(row[0]) for row in table_of(report_on(tmp_path), "cases")] == [
        "made, kfold, seed 3",
        "made, kfold, seed 10",
        *(f"made, kfold, n = 5, data {sha256[:8]}" for sha256 in sorted(hashes)),
        "made, kfold, n = 6",
    ]


def test_what_cannot_be_compared_is_one_clear_line(tmp_path):
    folder = store_results(tmp_path / "r", PAIR)
    store_results(folder, {"vjm@slopes=2": PAIR["a"]}, condition="elsewhere")
    for words, message in (
        ({"b": "a"}, "both models are 'a'"),
        ({"b": "vjm@slopes=3"}, "'vjm@slopes=3'; did you mean 'vjm@slopes=2'"),
        ({"b": "aa"}, r"'aa'; did you mean 'a'\? \(valid: a, b, vjm@slopes=2"),
        (
            {"b": "vjm@slopes=2"},
            r"a and vjm@slopes=2 have no comparison in common: a was run in "
            r"\(made \| kfold\); vjm@slopes=2 was run in \(made \| kfold \| elsewhere\)",
        ),
        ({"datasets": ("mode",)}, "dataset.*'mode'; did you mean 'made'"),
        ({"conditions": ("else",)}, r"^unknown condition .*'else'; did .*\(valid: elsewhere\)$"),
    ):
        with pytest.raises(ConfigError, match=message):
            report_on(folder, **words)
    with pytest.raises(StoreError, match="nothing: no such folder"):
        report_on(tmp_path / "nothing")


def test_models_that_were_run_with_different_tcps_are_refused_with_the_tcps(tmp_path):
    data = made_data()
    moved = BenchmarkData(data.samples, shipped_robot("kr10_r1100_2", tcp=(0.06, 0.0, 0.1)))
    store_results(tmp_path, {"a": PAIR["a"]}, data=data)
    store_results(tmp_path, {"b": PAIR["b"]}, data=moved)
    message = r"no comparison in common: .*; made is the name of different .*: TCP \("
    with pytest.raises(ConfigError, match=message):
        report_on(tmp_path)


def test_csv_and_json_hold_the_numbers_of_the_report_in_mm(tmp_path):
    report = report_on(store_results(tmp_path, PAIR))
    row = report.comparisons[0].norm
    values = {
        line["column"]: line
        for line in csv_lines(report)
        if (line["error"], line["method"]) == ("norm", "over splits")
    }
    assert float(values["A - B"]["value"]) == pytest.approx(1000 * row.difference, rel=1e-12)
    high = float(values["95 % interval"]["high"])
    assert high == pytest.approx(1000 * row.estimate.high, rel=1e-12)
    assert values["A - B"]["verdict"] == "A better" and values["A - B"]["unit"] == "mm"
    document = json.loads(rendered(report, "json"))
    *_, estimates = document["tables"]
    errors = {(record["error"], record["method"]): record["values"] for record in estimates["rows"]}
    assert errors["norm", "over splits"][3]["low"] == pytest.approx(1000 * row.estimate.low)
    assert document["text"] == comparison_text(report)


def test_the_seed_moves_only_the_intervals_over_poses_and_the_rope_is_in_mm(tmp_path):
    models = {"a": spread(1e-4, 4e-5, seed=1), "b": spread(1.2e-4, 4e-5, seed=2)}
    folder = store_results(tmp_path, models)
    first, second = (compared(folder, seed=seed).norm for seed in (0, 1))
    assert first.over_splits == second.over_splits
    assert first.over_poses.low != second.over_poses.low
    tables = open_results(folder).compare("a", "b", equivalence_mm=0.2)
    assert "less than 0.2 mm with probability > 0.99" in tables.text
