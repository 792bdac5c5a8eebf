"""The study of ways to carry simulated data over: errors relative to the VJM's."""

from __future__ import annotations

import numpy as np
import pytest

from made_results import MadeResults
from stiff_bench.paper.study import TRANSFER_DATA, transfer_study
from stiff_bench.paper.transfer import transfer_table, write_transfer

ON = {"dataset": "kr10-twin", "protocol": "holdout"}
SPECIMENS = [one.name for one in TRANSFER_DATA["default"]]


def test_the_specimens_of_a_twin_are_one_column_with_their_spread():
    vjm = dict.fromkeys([*SPECIMENS, "fanuc-r2000ic"], 2e-4)
    ratios = [0.4, 0.5, 0.6, 0.7, 0.8]
    tuned = {name: 2e-4 * ratio for name, ratio in zip(SPECIMENS, ratios, strict=True)}
    table = transfer_table({"vjm": vjm, "ft-mlp": tuned | {"fanuc-r2000ic": 3e-4}})
    assert [column.name for column in table.columns] == ["model", "default", "FANUC"]
    first, second = table.rows
    assert (first[0], second[0]) == ("ft-mlp", "vjm")  # the better one on the default twin
    assert first[1].value == pytest.approx(0.6) and first[1].n == 5
    assert first[1].spread == pytest.approx(np.std(ratios, ddof=1))
    assert first[2].value == pytest.approx(1.5) and first[2].spread is None


def test_the_page_says_what_was_not_computed(tmp_path):
    made = MadeResults(tmp_path / "transfer" / "runs")
    keys = [key for model in ("vjm", "ft-mlp") for key in made.add(model, [0.2], **ON)]
    made.add_run("run-1", keys)
    *_, page = write_transfer(tmp_path, "bench reproduce transfer", 12)
    text = page.read_text(encoding="utf-8")
    assert "12 fits not computed" in text and "| ft-mlp" in text


def test_what_is_of_the_kr10_runs_on_the_kr10_alone():
    for run in transfer_study():
        of_the_paper = [model for model in run.models if model.options.get("preset") == "paper"]
        assert not of_the_paper or all(one.key.startswith("kr10") for one in run.datasets)
