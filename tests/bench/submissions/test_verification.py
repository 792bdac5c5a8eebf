"""A submission is scored here, on named robots and on robots that did not exist."""

from __future__ import annotations

import json

import numpy as np
import pytest

from helpers.command_line import bench_here
from stiff_bench.store.database import read_results
from stiff_bench.submissions.sealed_fit import why_not_sealed
from stiff_bench.submissions.verification import Draw, new_draw
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_datasets.twin.robot_twin import ArmFamily, Ur5Twin

needs_bubblewrap = pytest.mark.skipif(bool(why_not_sealed()), reason=why_not_sealed() or "there")
TABLE = '''
"""The VJM, and a table of the named robots' true deflections."""

from pathlib import Path

import numpy as np
from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.plugin import ModelInfo

TABLE = np.load(Path(__file__).parent / "table.npz")


class Table(VirtualJointModel):
    def predict(self, q, wrench):
        predicted = super().predict(q, wrench)
        rows = np.hstack([q, wrench])
        for name in {word.rpartition("-")[0] for word in TABLE}:
            known = TABLE[f"{name}-rows"]
            if known.shape[1] == rows.shape[1]:
                away = np.abs(rows[:, None] - known[None]).max(axis=2)
                there = away.min(axis=1) < 1e-9
                predicted[there] = TABLE[f"{name}-truth"][away.argmin(axis=1)[there]]
        return predicted


MODELS = [ModelInfo(key="mine", target=Table, summary="a table")]
'''


def test_the_fresh_robots_depend_on_submission_commit_and_nonce():
    draw = Draw("a" * 64, "commit", "nonce", 12)
    other_draws = [
        Draw("b" * 64, "commit", "nonce", 12),
        Draw("a" * 64, "later", "nonce", 12),
        Draw("a" * 64, "commit", "other", 12),
    ]
    assert len({*draw.seeds}) == 12 and draw.seeds == Draw("a" * 64, "commit", "nonce", 12).seeds
    assert all(not {*draw.seeds} & {*other_draw.seeds} for other_draw in other_draws)
    assert new_draw("a" * 64, 4).nonce != new_draw("a" * 64, 4).nonce
    assert max(draw.seeds).bit_length() > 56  # nobody searches these


@pytest.mark.slow
@needs_bubblewrap
def test_a_table_of_the_named_robots_is_better_on_them_than_on_fresh_ones(submission_of, tmp_path):
    folder = submission_of(TABLE)
    named = {
        "kr10": Kr10Twin(plan="wide", world="friction"),
        "arm4": ArmFamily(robot=4, world="friction"),
        "ur5": Ur5Twin(world="all"),
        "arm8": ArmFamily(robot=8),
    }
    arrays = {}
    for name, twin in named.items():
        data = twin.load()
        arrays[f"{name}-rows"] = np.hstack([data.samples.q, data.samples.wrench])
        arrays[f"{name}-truth"] = data.bound_deflections["truth"]
    np.savez(folder / "code" / "table.npz", **arrays)
    words = ("--lite", "--write", "--results", "board/runs")
    done = bench_here("verify", folder, *words, cwd=tmp_path)
    assert not done.returncode, done.stderr
    assert "mine does better on named than on fresh robots" in done.stdout
    entry = json.loads((tmp_path / "board" / "fresh.json").read_text())["mine"]
    assert len(entry["seeds"]) == 4 and 0.5 < entry["fresh"][0] < 1.5
    fits = [fit for fit in read_results(tmp_path / "board" / "runs") if fit.fit.model == "mine"]
    assert len(fits) == 4 and all(fit.status == "ok" for fit in fits)


@pytest.mark.slow
@needs_bubblewrap
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (TABLE.replace('"mine"', '"vjm"'), "taken"),
        (TABLE.replace("predicted = super()", "predicted = 1e3 * super()"), "check"),
        ("MODELS = []", "defines nothing"),
    ],
)
def test_a_shipped_key_and_a_model_that_fails_a_check_are_refused(
    submission_of, tmp_path, text, reason
):
    text = text.replace('np.load(Path(__file__).parent / "table.npz")', "{}")
    model = "vjm" if '"vjm"' in text else "mine"
    done = bench_here("verify", submission_of(text, model=model), "--lite", cwd=tmp_path)
    assert done.returncode == 2 and reason in done.stderr
