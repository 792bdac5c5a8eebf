"""`bench submit` and `bench verify`: honest submissions are verified, forged ones refused."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import assert_refused, bench_here
from stiff_bench.paper.study_file import find_study
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.cell import Execution
from stiff_bench.run.runner import run_cells
from stiff_bench.store.database import ResultStore, read_results
from stiff_bench.submissions import verification
from stiff_bench.submissions.published_results import place_of
from stiff_bench.submissions.record import Record, record_metrics
from stiff_bench.submissions.refit import study_tasks
from stiff_bench.submissions.statuses import SUBMISSIONS, model_statuses, submissions_in
from stiff_bench.submissions.submission import file_sha256, read_verification, wrong_files
from stiff_bench.submissions.verification import place_of_record
from stiff_protocols.contract.types import TRUTHS, Prediction

TOP = Path(__file__).parents[3]
CARD = """
name = "Half springs"
model = "half-springs"
plugin = "half_springs.py"
authors = ["A. Tester"]
url = "https://example.org/half-springs"
reference = "none"
licence = "MIT"
summary = "Half of what springs predict."
tuned_on = "none"
hardware = "one CPU core"
"""


@pytest.fixture(scope="module")
def card_file(half_springs):
    file = half_springs.parent / "card.toml"
    file.write_text(CARD)
    return file


def submitted(card_file, study_file, folder, *words):
    return bench_here(
        *("submit", "--lite", "--card", card_file, "--study", study_file, "--results"),
        *(folder / "runs", "--output", folder / "submission", *words),
        cwd=folder,
    )


@pytest.fixture(scope="module")
def submission(card_file, study_file, tmp_path_factory):
    """Return an honest submission, computed in this process."""
    folder = tmp_path_factory.mktemp("submitted")
    ran = bench_here(
        *("run", "--study", study_file, "--lite", "--model", "half-springs", "--plugin"),
        *(card_file.with_name("half_springs.py"), "--no-isolate", "--output", folder / "runs"),
        cwd=folder,
    )
    assert ran.returncode == 0, ran.stderr
    done = submitted(card_file, study_file, folder)
    assert done.returncode == 0, done.stderr
    return folder / "submission"


@pytest.fixture(scope="module")
def tasks(study_file):
    """Return the fits of the study by place."""
    study = study_tasks(find_study(str(study_file)), "lite", "vjm", build_registry())
    return {place_of(task.cell, task.presentation): task for task in study}


@pytest.fixture()
def refitted_here(monkeypatch):
    """Compute fits again in this process, without the start of others."""

    def recompute(request):
        registry = build_registry()
        registry.add_file(request.plugin)
        study = find_study(request.study)
        chosen = study_tasks(study, request.scope, request.model, registry, request.places)
        run_cells(chosen, "", ResultStore(request.output), Execution())
        return read_results(request.output)

    monkeypatch.setattr(verification, "recompute", recompute)


def verified(folder: Path, study_file: Path, *words: str):
    return bench_here("verify", folder, "--study", study_file, *words, cwd=folder.parent)


def lines_of(done) -> dict[str, tuple[str, str]]:
    """Return status and text of each printed check by subject."""
    lines = [line[2:] for line in done.stdout.splitlines() if line.startswith("  ")]
    parts = [(line[:12].strip(), *line[14:].partition(": ")[::2]) for line in lines]
    return {subject: (status, text) for status, subject, text in parts}


def forged(submission: Path, folder: Path, edit, *, rehashed: bool = True) -> Path:
    """Return a copy with records changed by `edit`, and their new hashes."""
    copy = folder / "forged"
    shutil.copytree(submission, copy)
    file = copy / "records.jsonl"
    records = [json.loads(line) for line in file.read_text().splitlines()]
    for record in records:
        edit(record)
    file.write_text("".join(f"{json.dumps(record)}\n" for record in records))
    if rehashed:
        hash_again(copy)
    return copy


def hash_again(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"] = {name: file_sha256(folder / name) for name in manifest["files"]}
    (folder / "manifest.json").write_text(json.dumps(manifest))


def with_metrics(record: dict, tasks, predicted) -> None:
    """Return a record with other predictions, m, and their metrics."""
    task = tasks[place_of_record(Record.model_validate(record))]
    rows = task.split.reported
    measured = task.data.samples.deflection[rows]
    bounds = task.data.bound_deflections
    prediction = Prediction(
        rows,
        np.asarray(predicted),
        measured,
        reference=verification.reference_values(task, verification.fit_input(task)),
        bound_deflections={name: bounds[name][rows] for name in TRUTHS if name in bounds},
    )
    record["metrics"] = record_metrics(prediction)
    record["predicted_mm"] = (1000.0 * prediction.predicted).tolist()


def assert_failed(done, subject: str, *parts: str) -> None:
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("refused: ")
    status, text = lines_of(done)[subject]
    assert status == "failed" and all(part in text for part in parts), text


@pytest.mark.slow
def test_an_honest_submission_is_verified_and_what_is_not_verified_is_listed(
    submission, study_file, refitted_here
):
    done = verified(submission, study_file)
    assert done.returncode == 0, done.stdout
    lines = lines_of(done)
    for subject in ("files", "schema", "splits", "metrics", "labels", "code"):
        assert lines[subject][0] == "ok", lines[subject]
    assert {name for name, line in lines.items() if line[0] == "not verified"} >= {"cost", "card"}
    assert done.stdout.splitlines()[-1] == f"verified: {submission}"


@pytest.mark.slow
def test_the_choice_of_fits_is_printed_and_repeated_by_its_seed(
    submission, study_file, refitted_here
):
    done = [verified(submission, study_file, "--seed", "7", "--share", "1") for _ in range(2)]
    assert "2 of 2 fits (seed 7)" in lines_of(done[0])["code"][1]
    assert done[0].stdout == done[1].stdout


@pytest.mark.slow
def test_a_changed_file_is_refused_and_nothing_else_is_read(submission, study_file, tmp_path):
    def nothing(_):
        pass

    copy = forged(submission, tmp_path, nothing, rehashed=False)
    (copy / "code" / "half_springs.py").write_text("raise SystemExit\n")
    (copy / "code" / "more.py").write_text("")
    (copy / "environment.json").unlink()
    done = verified(copy, study_file)
    reasons = ("more.py is not in manifest", "half_springs.py was changed", "json is missing")
    assert_failed(done, "files", *reasons)
    assert len(lines_of(done)) == 1


def test_a_link_in_the_place_of_a_file_is_refused(submission, study_file, tmp_path):
    copy = tmp_path / "linked"
    shutil.copytree(submission, copy)
    (copy / "card.toml").unlink()
    (copy / "card.toml").symlink_to(submission / "card.toml")
    assert_failed(verified(copy, study_file), "files", "card.toml is a link")


def test_records_that_do_not_follow_the_schema_are_refused(submission, study_file, tmp_path):
    copy = forged(submission, tmp_path, lambda record: record.update(metrics={"norm_mm": "low"}))
    assert_failed(verified(copy, study_file), "schema", "line 1: metrics.norm_mm = 'low'")


def test_the_card_of_another_model_is_refused(submission, study_file, tmp_path):
    copy = forged(submission, tmp_path, lambda _: None)
    card = copy / "card.toml"
    card.write_text(card.read_text().replace('"half-springs"', '"better-springs"'))
    hash_again(copy)
    assert_failed(verified(copy, study_file), "schema", "better-springs", "half-springs")


def test_an_edited_metric_is_refused(submission, study_file, tmp_path):
    def edit(record):
        record["metrics"]["norm_mm"] *= 0.9

    copy = forged(submission, tmp_path, edit)
    assert_failed(verified(copy, study_file), "metrics", "norm_mm is ")


def test_edited_predictions_without_new_metrics_are_refused(submission, study_file, tmp_path):
    def edit(record):
        record["predicted_mm"][0][2] += 0.01

    assert_failed(verified(forged(submission, tmp_path, edit), study_file), "metrics", "kr10-twin")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "reason"),
    [(0.33, "33% of the RMS error"), (0.05, "the stated 3-D error is 5% lower")],
)
def test_edited_predictions_with_new_metrics_and_hashes_are_refused(
    gain, reason, submission, study_file, tasks, tmp_path, refitted_here
):
    def edit(record):
        task = tasks[place_of_record(Record.model_validate(record))]
        measured = task.data.samples.deflection[task.split.reported]
        predicted = Record.model_validate(record).predicted
        with_metrics(record, tasks, predicted + gain * (measured - predicted))

    done = verified(forged(submission, tmp_path, edit), study_file)
    assert lines_of(done)["metrics"][0] == "ok"
    assert_failed(done, "code", reason)


def test_predictions_within_the_stated_tolerance_are_reported_not_refused(
    submission, study_file, tasks, tmp_path, refitted_here
):
    def edit(record):
        predicted = Record.model_validate(record).predicted
        with_metrics(record, tasks, predicted * (1.0 + 1e-4))

    done = verified(forged(submission, tmp_path, edit), study_file)
    assert done.returncode == 0
    assert "within 10% of the RMS error" in lines_of(done)["code"][1]
    assert lines_of(done)["last digits"][0] == "not verified"


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_copied_test_labels_are_refused_also_with_noise_or_mixed_with_a_model(
    share, submission, study_file, tasks, tmp_path
):
    random = np.random.default_rng(0)

    def edit(record):
        task = tasks[place_of_record(Record.model_validate(record))]
        rows = task.split.reported
        labels = task.data.samples.deflection[rows]
        noisy = labels + random.normal(scale=2e-6, size=labels.shape)
        oracle = task.data.bound_deflections["oracle"][rows]
        with_metrics(record, tasks, share * noisy + (1.0 - share) * oracle)

    done = verified(forged(submission, tmp_path, edit), study_file)
    assert_failed(done, "labels", "noise")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"split_sha256": "0" * 64}, "other rows than in the split"),
        ({"data_sha256": "0" * 64}, "other data"),
        ({"seed": 1}, "not in the study"),
        ({"n_train": 140}, "140 training samples, not "),
        ({"model": "springs"}, "of the model springs, not half-springs"),
        ({"status": "failed", "failure": "it broke"}, "the fit failed: it broke"),
    ],
)
def test_records_of_other_splits_and_data_are_refused(
    changed, reason, submission, study_file, tmp_path
):
    copy = forged(submission, tmp_path, lambda record: record.update(changed))
    assert_failed(verified(copy, study_file), "splits", reason)


def test_easier_rows_under_the_hash_of_the_split_are_refused(submission, study_file, tmp_path):
    def edit(record):
        record["rows"] = [row + 1 for row in record["rows"]]

    assert_failed(verified(forged(submission, tmp_path, edit), study_file), "splits", "other rows")


def test_other_deflections_under_the_hash_of_the_data_are_refused(submission, study_file, tmp_path):
    def edit(record):
        record["measured_mm"] = record["predicted_mm"]

    done = verified(forged(submission, tmp_path, edit), study_file)
    assert_failed(done, "splits", "other measured deflections")


def test_a_missing_record_is_refused(submission, study_file, tmp_path):
    copy = forged(submission, tmp_path, lambda _: None)
    lines = (copy / "records.jsonl").read_text().splitlines(keepends=True)
    (copy / "records.jsonl").write_text(lines[0])
    hash_again(copy)
    assert_failed(verified(copy, study_file), "splits", "no record")


@pytest.mark.slow
def test_records_of_other_code_are_refused(submission, study_file, tmp_path, refitted_here):
    copy = forged(submission, tmp_path, lambda _: None)
    plugin = copy / "code" / "half_springs.py"
    plugin.write_text(plugin.read_text() + "\n# changed\n")
    hash_again(copy)
    assert_failed(verified(copy, study_file), "code", "computed with other code")


def test_a_model_that_cannot_be_run_here_is_reported(submission, study_file, tmp_path, monkeypatch):
    def skipped(records, results, which):
        yield verification.Check("not verified", "code", "cannot be run here: needs a GPU")

    monkeypatch.setattr(verification, "recompute", lambda request: [])
    monkeypatch.setattr(verification, "compare_fits", skipped)
    done = verified(submission, study_file)
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == f"reported: {submission}"


@pytest.mark.slow
def test_the_column_of_status_has_what_was_verified_and_written(
    submission, study_file, tmp_path, refitted_here
):
    runs, submissions = submission.parent / "runs", tmp_path / "submissions"
    assert model_statuses(runs, submissions) == {"vjm": "verified", "half-springs": "reported"}
    shutil.copytree(submission, submissions / "half-springs")
    assert model_statuses(runs, submissions)["half-springs"] == "reported"
    verified(submissions / "half-springs", study_file, "--write")
    assert model_statuses(runs, submissions)["half-springs"] == "verified"
    assert verified(submissions / "half-springs", study_file).returncode == 0
    manifest = submissions / "half-springs" / "manifest.json"
    manifest.write_text(manifest.read_text() + "\n")  # another state of the folder
    assert model_statuses(runs, submissions)["half-springs"] == "reported"


@pytest.mark.slow
def test_a_verified_submission_is_added_to_results_as_if_it_were_computed_there(
    submission, study_file, tmp_path, refitted_here
):
    runs, copy = tmp_path / "runs", tmp_path / "copy"
    shutil.copytree(submission, copy)
    words = ("results", "add", copy, "--results", runs)
    assert_refused(bench_here(*words, cwd=tmp_path), "not verified: run `bench verify")
    verified(copy, study_file, "--write")
    assert_refused(bench_here(*words, cwd=tmp_path), "no result of the VJM on kr10-twin")
    bench_here(
        *("run", "--study", study_file, "--lite", "--model", "vjm", "--output", runs), cwd=tmp_path
    )
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    computed = {result.cell.key: result for result in read_results(submission.parent / "runs")}
    added = {result.cell.key: result for result in read_results(runs)}
    assert added.keys() == computed.keys()
    for key, result in added.items():
        np.testing.assert_allclose(
            result.prediction.predicted, computed[key].prediction.predicted, rtol=1e-14
        )
        assert (
            result.presentation == computed[key].presentation
            and result.n_train == computed[key].n_train
        )


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('licence = "MIT"', "", "licence is missing (valid keys: name, model"),
        ('licence = "MIT"', 'license = "MIT"', "unknown key 'license'; did you mean 'licence'"),
        ('url = "https://example.org/half-springs"', "", "give contact or url"),
        ('"half_springs.py"', '"../half_springs.py"', "plugin = '../half_springs.py'"),
        ('model = "half-springs"', 'model = "vjm"', "a model of stiffbench"),
        ('model = "half-springs"', 'model = "half"', "unknown model 'half'"),
    ],
)
def test_a_wrong_card_is_refused_before_anything_is_computed(
    old, new, reason, half_springs, study_file, tmp_path
):
    card = tmp_path / "card.toml"
    card.write_text(CARD.replace(old, new))
    shutil.copy(half_springs, tmp_path)
    assert_refused(submitted(card, study_file, tmp_path), reason)
    assert not (tmp_path / "runs").exists() and not (tmp_path / "submission").exists()


def test_an_existing_folder_and_a_folder_without_a_submission_are_refused(
    submission, card_file, study_file, tmp_path
):
    assert_refused(submitted(card_file, study_file, submission.parent), "already exists")
    assert_refused(verified(tmp_path, study_file), "no manifest.json in it")


def test_every_committed_submission_is_complete_and_its_status_is_of_its_present_files():
    submissions = submissions_in(TOP / SUBMISSIONS)
    assert submissions
    index = (TOP / SUBMISSIONS / "README.md").read_text("utf-8")
    for submission in submissions:
        assert wrong_files(submission.folder, submission.manifest) == []
        stored = read_verification(submission.folder)
        assert stored is None or stored.outcome != "refused"
        assert f"[{submission.folder.name}]({submission.folder.name}/card.toml)" in index


@pytest.mark.slow
def test_the_code_runs_in_processes_that_are_ended_at_their_limit(submission, study_file, tmp_path):
    done = verified(submission, study_file)
    assert lines_of(done)["code"][0] == "ok", done.stdout
    copy = forged(submission, tmp_path, lambda _: None)
    plugin = copy / "code" / "half_springs.py"
    mark = f"import os\nprint(os.getpid(), file=open({str(tmp_path / 'ran')!r}, 'a'))\n"
    plugin.write_text(mark + plugin.read_text())
    hash_again(copy)
    assert_failed(verified(copy, study_file), "code", "computed with other code")
    assert str(os.getpid()) not in (tmp_path / "ran").read_text().split()
    slow = "    def fit(self, *_, **__):\n        import time; time.sleep(60)\n\n    def predict"
    plugin.write_text(plugin.read_text().replace("    def predict", slow))
    hash_again(copy)
    assert_failed(verified(copy, study_file, "--timeout", "2"), "code", "longer than")
    plugin.write_text("import os\nos.environ['SECRET']\n")
    hash_again(copy)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SECRET", "token")
        assert_failed(verified(copy, study_file), "code", "KeyError")
