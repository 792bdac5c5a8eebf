"""Comparison of two models: numbers by hand, verdicts, and the report."""

from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from helpers.compared_results import task_in, made_data, spread, steady, store_results
from stiff_bench.results.comparison import compare, compare_folder
from stiff_bench.results.comparison_tables import comparison_tables, sentence
from stiff_bench.results.selection import Selection
from stiff_bench.results.significance import Question
from stiff_bench.cli.result_commands import compare as compare_command
from stiff_bench.tables.metric_table import TRAINING_MARK
from stiff_bench.tables.writers import render
from stiff_datasets.robots.shipped_robots import shipped_robot
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.types import BenchmarkData

A_SPLITS = (1.0e-4, 1.2e-4, 0.9e-4, 1.1e-4, 1.3e-4)
B_SPLITS = (2.0e-4, 2.1e-4, 2.2e-4, 2.1e-4, 2.4e-4)
PAIR = {"a": steady(*A_SPLITS), "b": steady(*B_SPLITS)}


def compared(folder, a="a", b="b", **question):
    task, data = task_in(folder)
    return compare(task, a, b, data, Question(**question))


def report_on(folder, a="a", b="b", question=None, **words):
    return compare_folder(folder, a, b, question or Question(), Selection(**words))


def store_specimens(folder, n_specimens, models=PAIR, **how):
    """Store the same results on data of several specimens."""
    for specimen in range(n_specimens):
        name = f"made@specimen={specimen}" if specimen else "made"
        store_results(folder, models, data=made_data(specimen), dataset=name, **how)


def row_names(text):
    """Return the first cell of each row."""
    return [line.split(" | ")[0].strip("| ") for line in text.splitlines() if "| made" in line]


def rendered(report, fmt="github"):
    return render(comparison_tables(report), fmt, "bench compare a b", text=sentence(report))


def over_datasets(report):
    """Return the only row of the table over data sets."""
    tables = {table.about["table"]: table for table in comparison_tables(report)}
    (row,) = tables["over datasets"].rows
    return row


def csv_lines(report):
    return [*csv.DictReader(io.StringIO(rendered(report, "csv")))]


def text_of(folder, fmt="github", **words):
    return rendered(report_on(folder, **words), fmt)


def test_over_splits_the_numbers_are_those_of_the_corrected_t_test_by_hand(tmp_path):
    row = compared(store_results(tmp_path, PAIR)).row("x")
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
    many, few = (compared(folder).rows[0].estimate for folder in folders)
    assert many.high - many.low == few.high - few.low


def test_equal_models_are_equivalent_and_noise_is_no_difference(tmp_path):
    near = spread(1e-4, 2e-5)
    folder = store_results(
        tmp_path / "near", {"a": near, "b": lambda index, rows: near(index, rows) * 1.001}
    )
    assert compared(folder).row("norm").verdict == "equivalent"
    assert "a and b are equivalent on made (kfold, 5 splits)" in text_of(folder)
    noise = {"a": spread(0.0, 1e-3, seed=1), "b": spread(0.0, 1e-3, seed=2)}
    folder = store_results(tmp_path / "noise", noise)
    assert compared(folder).row("norm").verdict == "open"
    assert "No significant difference between a and b on made (kfold, 5 splits)" in text_of(folder)


def test_the_headline_is_printed_once_and_tables_have_few_notes_and_json_all(tmp_path):
    caveats = tuple(f"caveat {n}" for n in range(9))
    folder = store_results(tmp_path, PAIR, caveats=caveats)
    for a, b in (("a", "b"), ("b", "a")):
        report = report_on(folder, a, b)
        text, headline = rendered(report), sentence(report)
        assert headline.startswith("a is better than b on made (kfold, 5 splits)")
        assert "0.106 mm smaller" in headline and "over splits" in headline
        assert text.startswith(headline) and text.count(headline) == 1
    notes = [line for line in rendered(report).split("**")[-1].splitlines() if line[:2] == "- "]
    assert len(notes) == 5 and "--format json" in notes[3] and "made by" in notes[4]
    *_, last_table, _ = json.loads(rendered(report, "json"))["tables"]
    assert {*caveats} <= {*last_table["notes"]}


ONE_FIT = {"a": spread(1e-4, 2e-5, seed=1), "b": spread(1.5e-4, 2e-5, seed=2)}


@pytest.mark.parametrize(
    "tests", [{"tests": [np.arange(40)]}, {"tests": np.arange(40)[:, None], "pooled": True}]
)
def test_one_split_and_pooled_splits_are_judged_over_poses_and_the_verdict_names_them(
    tmp_path, tests
):
    folder = store_results(tmp_path, ONE_FIT, **tests)
    report = report_on(folder)
    (comparison,) = report.comparisons
    assert not comparison.over_splits and comparison.n_poses == 40
    assert comparison.row("norm").verdict == "a"
    assert "these fits)" in sentence(report)
    of_fits = {f"{verdict} (these fits)" for verdict in ("A better", "equivalent")}
    assert {line["verdict"] for line in csv_lines(report)} <= of_fits | {
        "no significant difference"
    }


def test_verdicts_of_one_training_are_counted_apart(tmp_path):
    store_results(tmp_path, PAIR, condition="n = 5")
    store_results(tmp_path, ONE_FIT, condition="n = 10", tests=[np.arange(40)])
    store_results(tmp_path, ONE_FIT, condition="n = 20", tests=[np.arange(40)])
    over_splits, of_fits = sentence(report_on(tmp_path)).split(". ")
    assert over_splits.startswith("Of 1 comparison over several splits: a better in 1")
    assert of_fits.startswith("Of 2 comparisons") and "these fits" in of_fits
    assert text_of(tmp_path).count("A better (these fits)") == 2


def test_a_winner_on_the_poses_that_every_split_tests_needs_other_poses_too(tmp_path):
    swing = np.random.default_rng(5).permutation(np.linspace(-1.4e-4, 1.4e-4, 40))

    def b(index, rows):  # worse by 0.015 mm whatever it learns from, but better at many poses
        x = 2.15e-4 + 1e-7 * index + swing[rows]
        return np.column_stack([x, np.zeros((len(rows), 2))])

    models = {"a": steady(*[2e-4] * 5), "b": b}
    folder = store_results(tmp_path, models, tests=[np.arange(36)] * 5)
    row = compared(folder).row("norm")
    assert row.over_splits.p_value < 0.05 and row.over_splits.high < 0.0
    assert row.over_poses.high > 0.0
    assert row.verdict == "open" and row.cautious == row.over_poses
    assert "over poses)" in sentence(report_on(folder))
    assert "no significant difference (poses)" in text_of(folder)


def test_splits_without_a_result_of_both_are_left_out_and_named(tmp_path):
    folder = store_results(tmp_path, PAIR, failed={"a": [1, 3]})
    comparison = compared(folder)
    assert comparison.n_splits == 3
    split_numbers = [0, 2, 4]
    assert comparison.row("x").means[1] == pytest.approx(
        np.mean([B_SPLITS[k] for k in split_numbers])
    )
    assert "a has no result on 2 of 5 splits (failed: it broke)" in text_of(folder)
    store_results(folder, PAIR, failed={"b": range(5)}, condition="n = 5")
    with pytest.raises(ConfigError, match=r"b has no result \(failed: it broke\)"):
        report_on(folder, conditions=("n = 5",))


def test_specimens_count_as_data_sets_and_splits_do_not(tmp_path):
    store_specimens(tmp_path, 5)
    name, *counts, difference, p_value = over_datasets(report_on(tmp_path))
    assert str(name) == "made, kfold" and counts == [5, 5, 0, 0, 0]  # all of A
    assert p_value == pytest.approx(2 * 0.5**5)  # of 5 data sets, not of 25 splits
    assert difference == pytest.approx(-0.106)
    four = report_on(tmp_path, datasets=tuple(f"made@specimen={k}" for k in range(4)))
    assert len(four.comparisons) == 4 and over_datasets(four)[-1] is None


def test_names_are_printed_with_their_marks(tmp_path):
    folder = store_results(
        tmp_path,
        PAIR,
        caveats=("made by hand.",),
        selects_on_test=True,
        warning="the test part picks the epoch.",
        model_fields={
            "a": {"regime": "trained on simulated deflections only"},
            "b": {"picked_on_test": True},
        },
    )
    report = report_on(folder)
    text = rendered(report)
    assert (
        "**A = a [trained on simulated deflections only], B = b [epoch picked on test part]" in text
    )
    assert "made (measured)" in text
    *_, last_table, _ = json.loads(rendered(report, "json"))["tables"]
    notes_text = "\n".join(last_table["notes"])
    for note in ("Different training data", "only b picked", "the test part picks", "by hand."):
        assert note in notes_text


def test_a_model_may_spell_out_the_defaults_that_its_results_were_made_with(tmp_path):
    options = {"a": {"depth": 3}, "knn": {"neighbours": 5, "scale": 1e-3, "weights": "near"}}
    options["knn@weights=far"] = options["knn"] | {"weights": "far"}
    folder = store_results(tmp_path, {name: PAIR["a"] for name in options}, options=options)
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


def test_what_selects_on_the_test_part_is_marked_and_not_counted(tmp_path):
    store_results(tmp_path, PAIR, condition="n = 5")
    store_results(tmp_path, PAIR, condition="n = 6")
    store_results(
        *(tmp_path, PAIR),
        condition="paper",
        selects_on_test=True,
        warning="beware.",
        model_fields={"b": {"picked_on_test": True}},
    )
    headline = sentence(report_on(tmp_path))
    assert headline.startswith("Of 2 comparisons: a better in 2")
    assert "Not counted: 1 comparison" in headline
    mark = "[selects on the test part; B: epoch picked on test part]"
    assert f"| made, kfold, paper {mark} " in text_of(tmp_path)
    lines = csv_lines(report_on(tmp_path))
    assert {line["condition"] for line in lines if line["selects_on_test"] == "True"} == {"paper"}


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
    assert row_names(text_of(tmp_path)) == [
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
        (
            {"conditions": ("else",)},
            r"^unknown condition .*'else'; did .*\(valid: elsewhere\)$",
        ),
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
    with pytest.raises(
        ConfigError, match=r"no comparison in common: .*; made is the name of different .*: TCP \("
    ):
        report_on(tmp_path)


def test_csv_and_json_hold_the_numbers_of_the_report_in_mm(tmp_path):
    folder = store_results(tmp_path, PAIR)
    report = report_on(folder)
    row = report.comparisons[0].row("norm")
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
    assert document["text"] == sentence(report)


def test_the_seed_moves_the_pose_intervals_and_not_those_over_splits(tmp_path):
    models = {"a": spread(1e-4, 4e-5, seed=1), "b": spread(1.2e-4, 4e-5, seed=2)}
    folder = store_results(tmp_path, models)
    (first,), (second,) = (
        report_on(folder, question=Question(seed=seed)).comparisons for seed in (0, 1)
    )
    assert first.row("norm").over_splits == second.row("norm").over_splits
    assert first.row("norm").over_poses.low != second.row("norm").over_poses.low


def test_the_command_takes_a_rope_in_mm(tmp_path):
    folder = str(store_results(tmp_path, PAIR))
    done = CliRunner().invoke(
        compare_command, ["a", "b", "--results", folder, "--equivalence", "0.2"]
    )
    assert done.exit_code == 0, done.output
    assert "less than 0.2 mm with probability > 0.99" in done.output
