"""Check what code of others can do in its sealed process, and what it cannot."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from stiff_bench.plan.fits import fit_tasks, plan_run
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.execution import fit_input, score
from stiff_bench.run.fit import fit_and_predict
from stiff_bench.run.fit_process import Limits
from stiff_bench.submissions import sealed_fit
from stiff_bench.submissions.sealed_fit import SealedModel, read_answer, why_not_sealed
from stiff_bench.submissions.submission import read_submission
from stiff_protocols.contract.errors import ConfigError

needs_bubblewrap = pytest.mark.skipif(bool(why_not_sealed()), reason=why_not_sealed() or "there")
LIMITS = Limits(timeout_s=60.0, memory_bytes=2**30)
HEAD = """
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.plugin import ModelInfo

class Mine(VirtualJointModel):
{body}

MODELS = [ModelInfo(key="mine", target=Mine, summary="springs")]
"""
PROBES = """
    def fit(self, train, **about):
        super().fit(train, **about)
        self.found = {name: float(can(probe)) for name, probe in PROBES.items()}
        return self

    @property
    def diagnostics_(self):
        return self.found

    @diagnostics_.setter
    def diagnostics_(self, _):
        pass


def can(probe):
    try:
        return bool(probe())
    except BaseException:
        return False


def network():
    import socket
    return socket.create_connection(("1.1.1.1", 53), timeout=2)


def data():
    from importlib.resources import files
    return (files("stiff_datasets") / "data" / "fanuc_r2000ic.csv").read_text()


def simulator():
    from stiff_datasets.twin.twin_file import shipped_constants
    return shipped_constants("gp12")


def results():
    from pathlib import Path
    return [*Path("/").rglob("results.sqlite*")]


def outside():
    from pathlib import Path
    for folder in ("/", "/usr", "/fit", "/fit/code", "/etc", "/tmp", "/var", str(Path.home())):
        try:
            (Path(folder) / "written-by-a-model").write_text("x")
        except OSError:
            pass


def secret():
    from pathlib import Path
    texts = [b""]
    for process in Path("/proc").glob("[0-9]*/environ"):
        try:
            texts.append(process.read_bytes())
        except OSError:
            pass
    return b"SECRET_TOKEN" in b"".join(texts)


def processes():
    from pathlib import Path
    return len([*Path("/proc").glob("[0-9]*")]) > 5


PROBES = {name: globals()[name] for name in
          ("network", "data", "simulator", "results", "outside", "secret", "processes")}
"""


@pytest.fixture(scope="module")
def task():
    plan = plan_run(
        build_registry(),
        models=["vjm"],
        datasets=["fanuc-r2000ic"],
        protocols=["holdout"],
        splits=1,
        output=Path(),
    )
    return next(fit_tasks(plan))


@pytest.fixture(scope="module")
def given(task):
    return fit_input(task)


def sealed(folder, **options) -> SealedModel:
    return SealedModel(read_submission(folder), options.pop("limits", LIMITS), **options)


@pytest.mark.parametrize(
    "trust",
    [
        pytest.param(True, marks=pytest.mark.slow),
        pytest.param(False, marks=[pytest.mark.slow, needs_bubblewrap]),
    ],
)
def test_a_sealed_fit_predicts_what_a_fit_here_does(submission_of, task, given, trust):
    folder = submission_of(HEAD.format(body="    pass"))
    outcome = sealed(folder, trust=trust).fit(given)
    here = fit_and_predict(task.model, given)
    np.testing.assert_array_equal(outcome.fitted.predicted, here.fitted.predicted)
    assert score(task, given, "run", outcome).status == "ok"


@pytest.mark.slow
@needs_bubblewrap
def test_code_of_others_reaches_no_network_data_simulator_results_files_or_secrets(
    submission_of, given, monkeypatch
):
    monkeypatch.setenv("SECRET_TOKEN", "abc")
    model = sealed(submission_of(HEAD.format(body=PROBES)))
    outcome = model.fit(given)
    assert outcome.fitted is not None, outcome.failure
    assert set(outcome.fitted.diagnostics) > {"network", "data"}
    assert not any(outcome.fitted.diagnostics.values()), outcome.fitted.diagnostics
    places = ("/", "/usr", "/etc", "/tmp", "/var", Path.home(), model.submission.folder)
    assert not any((Path(place) / "written-by-a-model").exists() for place in places)
    assert read_submission(model.submission.folder).sha256 == model.submission.sha256


@pytest.mark.slow
@needs_bubblewrap
@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (
            "    def fit(self, train, **about):\n        import os\n        while True: os.fork()",
            "more than",  # processes or memory
        ),
        (
            "    def fit(self, train, **about):\n        while True: print('x' * 1000)",
            "status",
        ),
        (
            "    def fit(self, train, **about):\n        import time; time.sleep(100)",
            "longer than 8 s",
        ),
        (
            "    def fit(self, train, **about):\n        self.x = bytearray(2**31)\n"
            "        import time; time.sleep(100)",
            "MiB of memory",
        ),
        ("    def fit(self, train, **about):\n        import os; os._exit(0)", "cannot be read"),
    ],
)
def test_what_breaks_a_limit_is_ended_with_its_reason(submission_of, given, body, reason):
    limits = Limits(timeout_s=8.0, memory_bytes=2**30)
    start = time.monotonic()
    outcome = sealed(submission_of(HEAD.format(body=body)), limits=limits).fit(given)
    assert outcome.fitted is None and reason in outcome.failure
    assert time.monotonic() - start < 60.0


@pytest.mark.slow
@needs_bubblewrap
def test_no_process_of_a_submission_outlives_its_fit(submission_of, given):
    import psutil

    body = (
        "    def fit(self, train, **about):\n"
        "        import subprocess, sys\n"
        "        words = [sys.executable, '-c', 'import time; time.sleep(1234)']\n"
        "        subprocess.Popen(words, start_new_session=True)\n"
        "        return super().fit(train, **about)"
    )
    assert sealed(submission_of(HEAD.format(body=body))).fit(given).fitted is not None
    words = [process.info["cmdline"] or [] for process in psutil.process_iter(["cmdline"])]
    assert not any("time.sleep(1234)" in " ".join(line) for line in words)


def test_without_bubblewrap_code_of_others_runs_only_on_trust(submission_of, monkeypatch):
    monkeypatch.setattr(sealed_fit, "BUBBLEWRAP", "no-such-program")
    with pytest.raises(ConfigError, match="--trust"):
        sealed(submission_of(HEAD.format(body="    pass")))


@pytest.mark.parametrize(
    "arrays",
    [
        {"about": np.array("{}"), "predicted": np.zeros((2, 3), dtype=object)},
        {"about": np.array("{}"), "predicted": np.zeros(3)},
        {"about": np.array('{"other": 1}')},
        {"about": np.array("no JSON")},
        {"predicted": np.zeros((2, 3))},
    ],
)
def test_an_answer_that_is_no_numbers_is_refused(tmp_path, arrays):
    np.savez(tmp_path / "answer.npz", **arrays)
    with pytest.raises((ValueError, KeyError)):
        read_answer(tmp_path / "answer.npz")


def test_an_answer_that_unpacks_to_too_much_is_refused(tmp_path):
    about, zeros = np.array("{}"), np.zeros((2**21, 3))
    np.savez_compressed(tmp_path / "answer.npz", about=about, predicted=zeros)
    with pytest.raises(ValueError, match="unpacks"):
        read_answer(tmp_path / "answer.npz")
