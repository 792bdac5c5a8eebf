"""Views of the objects of `import stiffbench` in a terminal and a notebook."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import stiffbench as sb
from stiff_datasets.measured.data_card import new_card
from stiff_datasets.measured.table_reader import sample_table
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BenchmarkData

pytestmark = pytest.mark.xdist_group("screens")  # they share objects of a minute
HOSTILE = "<script>$x$\x1b[2J[red]"
MOST_LINES, WIDTH = 28, 100
WIDE = ("path", "stiffness_map", "simulation", "checks")
"""Objects with sentences or file names in one line."""


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Return objects of every kind by name."""
    folder = tmp_path_factory.mktemp("screens")
    data = sb.load_dataset("kr10-twin", specimen=3)
    data[::4].frame().to_csv(folder / "my.csv", index=False)
    model = sb.make_model("vjm").fit(data)
    results = sb.evaluate(["vjm", "knn"], data, splits=2)
    sb.example_path(folder / "square.csv", points=40)
    with pytest.warns(match="beyond the training range"):
        path = sb.compensate_path(model, folder / "square.csv", folder / "out.csv")
    with pytest.warns(match="extrapolation"):
        stiffness_map = sb.stiffness_map(model, load=(0.0, 0.0, -60.0), grid=8)
    return SimpleNamespace(
        data=data,
        robot=data.robot,
        samples=data.samples,
        measured=sb.load_dataset("fanuc-r2000ic"),
        model=model,
        new_model=sb.make_model("bayes-springs"),
        many_springs=sb.make_model("vjm-full").fit(data),
        interval=model.predict_interval(data.samples.q, data.samples.wrench),
        results=results,
        of_one_model=results["vjm"],
        comparison=results.compare("knn", "vjm"),
        figure=sb.figure("scores", results),
        path=path,
        stiffness_map=stiffness_map,
        validation=sb.validate(folder / "my.csv"),
        checks=sb.check("zero"),
        plan=sb.plan_poses(folder / "plan.csv", poses=20),
        simulation=sb.simulate(folder / "sim.csv", samples=20),
    )


@pytest.mark.slow
def test_every_object_fits_a_screen_and_a_notebook_shows_a_few_kilobytes(given):
    for name, thing in vars(given).items():
        lines = repr(thing).splitlines()
        assert len(lines) <= MOST_LINES, name
        assert name in WIDE or max(map(len, lines)) <= WIDTH, name
        if hasattr(thing, "_repr_html_"):
            page = thing._repr_html_()
            assert page.startswith("<div") and len(page) < 20_000, name


@pytest.mark.slow
def test_a_figure_is_a_picture_of_a_width_that_fits_a_notebook(given):
    image, about = given.figure._repr_png_()
    assert image.startswith(b"\x89PNG") and 200 <= about["width"] <= 900


@pytest.mark.slow
def test_names_in_files_are_printed_without_control_signs(given, tmp_path):
    path = tmp_path / "my.csv"
    table = sample_table(given.data.samples, given.data.robot).iloc[:40]
    moved = np.linspace(0.0, 90.0, len(table))
    table.assign(**{"axis\x1b[2J": "a", "e1 \u202e": moved}).to_csv(path, index=False)
    report = repr(sb.validate(path, robot=given.data.robot))
    assert all(sign.isprintable() or sign == "\n" for sign in report)
    assert r"\x1b[2J" in report
    robot = dataclasses.replace(given.data.robot, name=HOSTILE)
    card = new_card(HOSTILE, BenchmarkData(given.data.samples, robot), {})
    assert "\x1b" not in card and r"\x1b[2J" in card


@pytest.mark.slow
def test_results_of_a_model_are_those_of_its_name_and_an_unknown_name_is_refused(given):
    assert {fit.presentation.model for fit in given.results["knn"].fits} == {"knn"}
    for name in ("gp", 0):
        with pytest.raises(ConfigError, match="knn"):
            given.results[name]


class Broken:
    def fit(self, train, *, robot, validation=None, seed=0):
        raise RuntimeError("no luck")

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))


@pytest.mark.slow
def test_results_show_failures_with_their_reason_and_compare_data_sets_in_a_matrix(given):
    results = sb.evaluate([Broken, "vjm", "knn"], [given.data, given.measured], splits=1)
    models, matrix = results.summary().tables
    assert [str(row[0]) for row in models.rows] == ["vjm", "knn"]
    assert len(matrix.columns) == 1 + 2
    assert any("Broken (2 fits)" in note for note in models.notes)
    assert len(repr(results).splitlines()) <= MOST_LINES
    of_one = sb.evaluate([Broken, "vjm"], given.data, splits=1)
    (table,) = of_one.summary().tables
    assert {"X", "Y", "Z"} <= {column.name for column in table.columns}
    assert any("no luck" in note for note in table.notes)
    assert "Broken" in repr(of_one["Broken"])
    (row,) = of_one.frame().query("model == 'Broken'").itertuples()
    assert row.status == "failed" and "no luck" in row.failure
