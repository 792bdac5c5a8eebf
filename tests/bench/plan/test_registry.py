"""The registry: built-in, files, packages, families; conflicts and broken plugins."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stiff_bench.plan.registry import Registry, build_registry, plugin_files
from stiff_models.model_catalog import MODELS
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import ModelFamily, ModelInfo

THIRD_PARTY = Path(__file__).parents[2] / "third_party"


def test_the_shipped_entries_are_all_there_and_can_be_imported():
    registry = build_registry()
    assert list(registry.models) == [info.key for info in MODELS]
    assert {"vjm", "mlp", "mlp-pretrained", "ft-mlp"} <= set(registry.models)
    assert {"kr10-twin", "fanuc-r2000ic"} <= set(registry.datasets)
    assert {"holdout", "paper-holdout", "leave-one-out"} <= set(registry.protocols)
    for table in (registry.models, registry.datasets, registry.protocols):
        usable = [info for info in table.values() if not info.missing()]
        assert all(isinstance(info.load(), type) for info in usable)


def test_two_plugin_files_of_one_name_add_their_models_and_do_not_disturb_each_other(
    tmp_path, plugin_file
):
    first_path, second_path = (tmp_path / folder / "my_model.py" for folder in ("one", "other"))
    for key, path in (("first", first_path), ("second", second_path)):
        path.parent.mkdir()
        plugin_file(key).rename(path)
    registry = build_registry()
    registry.add_file(first_path)
    registry.add_file(second_path)
    classes = [registry.models[key].load() for key in ("first", "second")]
    assert [cls.__name__ for cls in classes] == ["MeanDeflection"] * 2
    modules = {cls.__module__ for cls in classes}
    assert len(modules) == 2 and modules <= set(sys.modules)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = (", r"cannot be imported: SyntaxError"),
        ("import not_there", r"ModuleNotFoundError: No module named 'not_there' .*bad\.py:1\)"),
        ("\n1 / 0", r"ZeroDivisionError: division by zero .*bad\.py:2\)"),
        ("raise SystemExit(3)", r"SystemExit: 3"),
        (None, "no such file"),
        ("x = 1", "defines nothing"),
        ("MODELS = [3]", "3 is not a ModelInfo"),
    ],
)
def test_a_plugin_file_that_cannot_be_used_is_refused(tmp_path, text, message):
    path = tmp_path / "bad.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        build_registry().add_file(path)
    imported = text in ("x = 1", "MODELS = [3]")
    assert (path in plugin_files()) == imported  # only imported files are sent to processes


def test_what_a_plugin_prints_on_import_does_not_get_between_the_tables(
    tmp_path, plugin_file, capsys
):
    path = plugin_file("talks")
    path.write_text("print('hello')\n" + path.read_text())
    build_registry().add_file(path)
    assert capsys.readouterr() == ("", "hello\n")


def member(key: str) -> ModelInfo:
    """Return the model of a family's key."""
    if not key[1:]:
        raise ConfigError(f"{key!r} names nothing")
    return ModelInfo(key=key, target=dict, summary="of a family")


@pytest.fixture()
def registry() -> Registry:
    """Return a registry of one model and one family."""
    family = ModelFamily(
        prefix="~", target=f"{__name__}:member", example="~a", summary="every letter"
    )
    registry = Registry(families=(family,))
    registry.add([ModelInfo(key="vjm", target=dict, summary="springs")], "stiffbench")
    return registry


def test_a_key_of_a_family_is_resolved_by_its_beginning_and_an_unknown_key_is_refused_with_it(
    registry,
):
    assert registry.model("~abc").key == registry.find("~abc").key == "~abc"
    with pytest.raises(ConfigError, match="'~' names nothing"):
        registry.model("~")
    for look_up in (registry.model, registry.find):
        with pytest.raises(ConfigError, match=r"'vjn'; did you mean 'vjm'\? \(valid: vjm, ~\.\.\."):
            look_up("vjn")


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> dict[str, str]:
    """Install the example package next to stiffbench and return the environment."""
    folder = tmp_path_factory.mktemp("third_party")
    package = shutil.copytree(THIRD_PARTY, folder / "package")  # a build leaves files behind
    site = folder / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", site, package],
        check=True,
    )
    python_path = os.environ.get("PYTHONPATH", "")
    return {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{python_path}".rstrip(os.pathsep)}


def bench_with(installed, folder, *words):
    return subprocess.run(
        [sys.executable, "-m", "stiffbench.main", *words],
        env=installed,
        cwd=folder,
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
def test_an_installed_package_adds_its_model_and_its_broken_parts_are_reported(installed, tmp_path):
    done = bench_with(installed, tmp_path, "run", "--model", "cartesian-spring", "--model", "vjm")
    assert done.returncode == 0, done.stderr
    assert "| cartesian-spring " in done.stdout and "| vjm " in done.stdout
    raised, taken = (line for line in done.stderr.splitlines() if "plugin left out" in line)
    assert "cartesian-spring (stiffbench.models: raises)" in raised and "'not_there'" in raised
    assert "cartesian-spring (stiffbench.models: taken)" in taken and "key 'vjm'" in taken


@pytest.mark.slow
def test_a_good_line_next_to_a_taken_one_is_listed_and_passes_the_conformance_suite(
    installed, tmp_path
):
    done = bench_with(
        installed, tmp_path, "check", "force-spring", "--set", "force-spring.torques=false"
    )
    assert done.returncode == 0, done.stderr + done.stdout
    assert done.stdout.startswith("force-spring (torques=False) on fanuc-r2000ic")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        *(("version", v, "not valid (use 1, 2") for v in (0, -1, 1.0, "1", True, None)),
        ("library", None, "not a text"),
    ],
)
def test_a_version_is_a_positive_integer_and_a_library_a_distributions_name(field, value, message):
    with pytest.raises(ConfigError, match=re.escape(f"'m': {field} {value!r} is {message}")):
        ModelInfo(key="m", target=dict, summary="", **{field: value})


def test_a_model_whose_module_raises_when_it_is_used_is_a_config_error(tmp_path, monkeypatch):
    (tmp_path / "raises_late.py").write_text("raise RuntimeError('no licence')\n")
    monkeypatch.syspath_prepend(tmp_path)
    info = ModelInfo(key="late", target="raises_late:Late", summary="")
    with pytest.raises(ConfigError, match=r"'late': cannot import .*RuntimeError: no licence"):
        info.load()


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("vjm", "key 'vjm' is taken by stiffbench"),
        ("Bad Key!", r"key 'Bad Key!' is not a valid key \(valid: letters"),
        ("all", "key 'all' stands for every model"),
        ("~x", "begins with '~', which stands for every letter"),
    ],
)
def test_an_invalid_key_is_refused(key, message, registry):
    with pytest.raises(ConfigError, match=f"mine.py: key .*{message[4:]}"):
        registry.add([ModelInfo(key=key, target=dict, summary="")], "mine.py")
