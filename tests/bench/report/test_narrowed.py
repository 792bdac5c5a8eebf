"""What was asked for, of several folders: each has its own names."""

from __future__ import annotations

import pytest

from made_results import MadeResults
from stiff_bench.analysis.stored_leaderboard import StoredResults
from stiff_bench.report.report import check_choice, chosen_here, narrowed
from stiff_bench.report.runs import Selection
from stiff_protocols.contract.errors import ConfigError


@pytest.fixture()
def contests(tmp_path):
    made = MadeResults(tmp_path / "runs")
    made.add("vjm", [0.1], "twin@specimen=1")
    made.add("mlp@width=3", [0.1], "robot", protocol="transfer")
    return StoredResults.read(made.folder).contests


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ({"models": ("vjm", "vmj")}, "--model: .*'vmj'"),
        ({"datasets": ("moon",)}, "--dataset: .*'moon'"),
        ({"protocols": ("guess",)}, "--protocol: .*'guess'"),
        ({"datasets": ("twin",), "protocols": ("transfer",)}, "--dataset twin --protocol transfer"),
    ],
)
def test_a_word_that_no_folder_has_results_of_is_refused(contests, choice, said):
    with pytest.raises(ConfigError, match=said):
        check_choice(contests, Selection(**choice))


def test_words_that_a_folder_has_stay_and_the_others_are_named(contests):
    asked = Selection(
        models=("mlp", "gp"), datasets=("twin", "moon"), protocols=("holdout", "loso")
    )
    here, lacking = narrowed(contests, asked)
    assert (here.models, here.datasets, here.protocols) == (("mlp",), ("twin",), ("holdout",))
    assert lacking == ("gp", "moon", "loso")


@pytest.mark.parametrize("kind", ["models", "datasets", "protocols"])
def test_a_folder_that_lacks_all_words_of_a_kind_shows_nothing(contests, kind):
    asked = Selection(**{kind: ("elsewhere",)})
    here, _ = narrowed(contests, asked)
    assert chosen_here(contests, asked, here) == []


def test_without_words_a_folder_shows_all(contests):
    here, lacking = narrowed(contests, Selection())
    assert lacking == ()
    assert chosen_here(contests, Selection(), here) == [*contests]
