"""Progress of a run and of other work."""

from __future__ import annotations

from types import SimpleNamespace

from stiff_bench.run.progress import display
from stiff_protocols.contract.progress import Progress, report


def fit(model, **result):
    """Return a stub of a fit and its result."""
    presentation = SimpleNamespace(model=model, dataset="data", protocol="holdout")
    identity = SimpleNamespace(condition="", split_index=0)
    about = {"status": "ok", "presentation": presentation, "fit": identity, "n_splits": 1}
    return SimpleNamespace(**about | result)


def test_lines_off_a_terminal_have_the_newest_fit_its_phase_and_what_became_of_the_others(
    monkeypatch, capsys
):
    monkeypatch.setattr("stiff_bench.run.progress.SECONDS_BETWEEN_LINES", 0.0)
    with display() as run_display:
        run_display.begin(2, 2)
        run_display.start(fit("quick"))
        run_display.step(Progress("training", 1, 2, 0.5))
        run_display.end(fit("quick"))
        run_display.end(fit("bad", status="failed", failure="why\x1b", log=("last",)))
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == "" and lines[0].startswith("fits: 0/2 [") and "2 cached]" in lines[1]
    assert any("quick on data, holdout split 1/1" in line for line in lines)
    assert any("2 cached; training 1/2; loss 0.5" in line for line in lines)
    assert any("2/2" in line and "2 cached, 1 ok, 1 failed" in line for line in lines)
    assert [line for line in lines if "[" not in line] == [r"  bad: FAILED: why\x1b", "    | last"]


def test_other_work_has_lines_of_each_phase(capsys):
    with display():
        report("poses", 1, 2)
        report("poses", 2, 2)
        report("loads", 3, 3)
    lines = capsys.readouterr().err.splitlines()
    last_lines = {line.partition(":")[0]: line for line in lines}
    assert "2/2" in last_lines["poses"] and "3/3" in last_lines["loads"]
