"""Views of every object of `import stiffbench` in a terminal and a notebook."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from stiff_protocols.contract.errors import ConfigError, NotFittedError

HOSTILE = "<script>$x$\x1b[2J[red]"
MOST_CHARACTERS, MOST_LINES, WIDTH = 2000, 28, 100
DOCUMENTS = (sb.Tables, str)
"""Types that are printed in full: the user requested a table or a text."""
BUILT_IN = (str, int, float, bool, bytes, type, np.ndarray, np.generic, pd.DataFrame)


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Return objects of every kind by name."""
    folder = tmp_path_factory.mktemp("screens")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return made(folder)


def made(folder):
    data = sb.load_dataset("kr10-twin", specimen=3)
    data[::4].frame().to_csv(folder / "my.csv", index=False)
    model = sb.make_model("vjm").fit(data)
    results = sb.evaluate(["vjm", "knn"], data, splits=2, output=folder / "runs")
    sb.example_path(folder / "square.csv", points=40)
    with pytest.warns(match="beyond the training range"):
        path = sb.compensate_path(model, folder / "square.csv", folder / "out.csv")
    with pytest.warns(match="extrapolation"):
        stiffness_map = sb.stiffness_map(model, load=(0.0, 0.0, -60.0), grid=8)
    return SimpleNamespace(
        data=data,
        stiffness_map=stiffness_map,
        measured=sb.load_dataset("fanuc-r2000ic"),
        part=data[:3],
        model=model,
        new_model=sb.make_model("gp-springs"),
        many_springs=sb.make_model("vjm-full").fit(data),
        interval=model.predict_interval(data.samples.q, data.samples.wrench),
        results=results,
        of_one_model=results["vjm"],
        scores=results.scores(),
        comparison=results.compare("knn", "vjm"),
        figure=sb.figure("scores", results),
        picture=data.plot(),
        path=path,
        poses=data.robot.forward(data.samples.q),
        validation=sb.validate(folder / "my.csv"),
        checks=sb.check("zero"),
        plan=sb.plan_poses(folder / "plan.csv", poses=20),
        simulation=sb.simulate("sim.csv", samples=20),
        merged=sb.merge([folder / "runs"], folder / "merged"),
        models=sb.list_models(),
        options=sb.show("knn"),
    )


def reachable(given):
    """Yield every object that public attributes lead to, with its name."""
    queue, seen = [*vars(given).items()], set()
    while queue:
        name, thing = queue.pop()
        if id(thing) in seen or isinstance(thing, BUILT_IN) or thing is None:
            continue
        seen.add(id(thing))
        if isinstance(thing, list | tuple | set | frozenset):
            queue += [(f"{name}[]", item) for item in [*thing][:3]]
        elif isinstance(thing, dict):
            queue += [(f"{name}[{key}]", item) for key, item in [*thing.items()][:3]]
        elif type(thing).__module__.startswith("stiff"):
            yield name, thing
            for attribute in [*dir(type(thing)), *vars(thing)]:
                if not attribute.startswith("_"):
                    value = None
                    with suppress(NotFittedError):
                        value = getattr(thing, attribute)
                    if not callable(value) or dataclasses.is_dataclass(value):
                        queue.append((f"{name}.{attribute}", value))


def test_every_object_that_can_be_reached_prints_at_most_2000_characters(given):
    things = {name: thing for name, thing in reachable(given)}
    kinds = {type(thing).__name__ for thing in things.values()}
    assert {"BenchmarkData", "Samples", "CellResult", "Prediction", "ScoredTask"} <= kinds
    assert len(kinds) > 25
    long = {
        name: len(repr(thing))
        for name, thing in things.items()
        if not isinstance(thing, DOCUMENTS) and len(repr(thing)) > MOST_CHARACTERS
    }
    assert long == {}


SHOWN_NAMES = (
    *("data", "measured", "part", "model", "new_model", "many_springs", "results"),
    *("of_one_model", "comparison", "validation", "plan", "simulation", "figure"),
)


@pytest.mark.parametrize("name", SHOWN_NAMES)
def test_what_is_shown_most_fits_a_screen(given, name):
    lines = repr(getattr(given, name)).splitlines()
    assert len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= WIDTH


@pytest.mark.parametrize("name", [name for name in SHOWN_NAMES if name != "figure"])
def test_a_notebook_shows_html_of_a_few_kilobytes(given, name):
    page = getattr(given, name)._repr_html_()
    assert page.startswith("<div") and len(page) < 20_000


def test_a_figure_is_a_picture_of_a_width_that_fits_a_notebook(given):
    image, about = given.figure._repr_png_()
    assert image.startswith(b"\x89PNG") and 200 <= about["width"] <= 900


def test_a_view_has_the_facts_that_an_engineer_needs(given):
    data, robot, model = map(repr, (given.measured, given.data.robot, given.model))
    for part in ("measured", "fanuc_r2000ic", "43 at 43 poses", "1166 N", "3.655 mm", "MIT"):
        assert part in data
    for part in ("A1", "revolute", "-170 deg", "170 deg", "(60.0, 0.0, 80.0) mm"):
        assert part in robot
    for part in ("fitted", given.data.name, "151 samples", "A6 [Nm/rad]"):
        assert part in model
    assert "not fitted" in repr(given.new_model)
    for part in ("vjm", "knn", "3-D error", "mm", "kr10-twin", "2 splits", "instrument noise"):
        assert part in repr(given.results)


def test_names_with_html_formulas_and_control_signs_are_shown_as_they_are(given):
    names = [f"{HOSTILE}{i}" for i in range(151)]
    robot = dataclasses.replace(given.data.robot, name=HOSTILE, joint_names=tuple(names[:6]))
    samples = dataclasses.replace(given.data.samples, pose_id=names)
    hostile = sb.Dataset.from_samples(samples, robot, name=HOSTILE)
    model = sb.make_model("vjm").fit(hostile)
    results = sb.evaluate(["vjm", "knn"], hostile, splits=2)
    for thing in (hostile, samples, robot, model, results, results.compare("vjm", "knn")):
        page = thing._repr_html_()
        assert "<script" not in page and "&lt;script" in page
        assert "mathjax_ignore" in page
        assert "\x1b" not in page + repr(thing)


def test_results_of_a_model_are_those_of_its_name_and_an_unknown_name_is_refused(given):
    assert {fit.presentation.model for fit in given.results["knn"].fits} == {"knn"}
    for name in ("gp", 0):
        with pytest.raises(ConfigError, match="knn"):
            given.results[name]
    with pytest.raises(TypeError):
        iter(given.results)


def test_a_selection_outlives_the_results_that_it_is_of(given):
    part = sb.evaluate(["vjm", "knn"], given.data, splits=1)["knn"]
    assert len(part.fits) == 1 and "knn" in repr(part)


class Broken:
    def fit(self, train, *, robot, validation=None, seed=0):
        raise RuntimeError("no luck")

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))


def test_a_summary_of_one_comparison_has_errors_by_axis_and_failures_with_reasons(given):
    results = sb.evaluate([Broken, "vjm", "knn"], given.data, splits=2)
    (table,) = results.summary().tables
    assert [str(row[0]) for row in table.rows][:3] == ["vjm", "knn", "Broken"]
    assert {"X", "Y", "Z"} <= {column.name for column in table.columns}
    assert any("no luck" in note for note in table.notes)
    assert "FAILED" in repr(results) or "failed" in repr(results)


def test_a_summary_of_several_comparisons_is_each_model_against_the_vjm_and_a_matrix(given):
    data = [given.data, given.measured]
    results = sb.evaluate([Broken, "vjm", "knn"], data, splits=2)
    models, matrix = results.summary().tables
    assert [str(row[0]) for row in models.rows] == ["vjm", "knn"]
    assert len(matrix.columns) == 1 + len(data)
    assert any("Broken (4 fits)" in note for note in models.notes)
    assert len(repr(results).splitlines()) <= MOST_LINES


def test_results_without_a_score_show_why(given):
    assert "Broken" in repr(sb.evaluate([Broken], given.data, splits=1))


def test_the_version_is_the_installed_ones():
    assert sb.__version__.count(".") == 2
