"""Check that the built wheel and source archive are complete and work without a checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
ROOTS = ("bench", "datasets", "models", "protocols")
SHIPPED = ("published", "studies")
"""Folders of results/ that are packages of data."""
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("wheel")]


DOCUMENTS = ("README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff")


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> dict[str, Path]:
    """Return the source archive, and the wheel that is built from its files."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "src"  # a copy, so that no build folder is left in the checkout
    for name in (*ROOTS, *(f"results/{name}" for name in SHIPPED)):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "MANIFEST.in", *DOCUMENTS):
        shutil.copy(ROOT / name, source / name)
    (source / "tests").mkdir()
    shutil.copy(Path(__file__), source / "tests")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, source]
    subprocess.run(build, check=True)
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return {"sdist": sdist, "wheel": wheel}


def test_the_source_archive_holds_the_documents_and_no_tests(built):
    with tarfile.open(built["sdist"]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names >= {"pyproject.toml", *DOCUMENTS}
    assert [name for name in names if name.startswith("tests")] == []


def test_the_wheel_holds_every_module_and_data_file_and_nothing_else(built):
    with zipfile.ZipFile(built["wheel"]) as archive:
        entries = archive.namelist()
    names = {name for name in entries if ".dist-info/" not in name}
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in entries)
    sources = {
        f"{package.name if package.parent.name != 'results' else f'stiff_{package.name}'}/"
        f"{file.relative_to(package).as_posix()}"
        for package in [*ROOT.glob("*/stiff*"), *(ROOT / "results" / name for name in SHIPPED)]
        for file in package.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts and "tests" not in package.parts
    }
    assert names == sources
    some_files = {"stiff_published/tables.toml", "stiff_studies/paper.toml"}
    some_files |= {"stiff_bench/model_tools/templates/model.py.txt"}
    assert names >= some_files | {f"stiff_{name}/py.typed" for name in ("bench", "models")}


def required_distributions(wheel: Path) -> dict[str, Distribution]:
    """Return all distributions that a wheel requires, by name, with their requirements."""
    (metadata,) = (path for path in zipfile.Path(wheel).iterdir() if path.name.endswith("-info"))
    lines = Parser().parsestr((metadata / "METADATA").read_text()).get_all("Requires-Dist")
    distributions: dict[str, Distribution] = {}
    while lines:
        requirement = Requirement(lines.pop())
        if requirement.name not in distributions and (
            not requirement.marker or requirement.marker.evaluate({"extra": ""})
        ):
            distributions[requirement.name] = distribution(requirement.name)
            lines += distributions[requirement.name].requires or []
    return distributions


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_bench_works_with_what_it_requires_in_an_empty_environment(kind, built, tmp_path):
    """Use this environment's packages, because downloading them takes minutes."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    (site,) = (tmp_path / "venv").glob("lib/*/site-packages")
    packages = [*required_distributions(built["wheel"]).values()]
    packages += [distribution("setuptools")] if kind == "sdist" else []  # builds the wheel
    for package in packages:
        for top in {file.parts[0] for file in package.files or []} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(package.locate_file(top))
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps"]
    subprocess.run([*pip, "--no-build-isolation", built[kind]], check=True)
    empty = tmp_path / "empty"
    empty.mkdir()

    def bench(*words: str) -> subprocess.CompletedProcess[str]:
        env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        program = python.with_name("bench")
        return subprocess.run([program, *words], cwd=empty, env=env, capture_output=True, text=True)

    process = bench("run", "--model", "vjm", "--dataset", "fanuc-r2000ic", "--splits", "1")
    assert process.returncode == 0, process.stderr
    assert "| vjm " in process.stdout
    assert "paper-quick" in bench("reproduce", "no-such-study").stderr
    assert [item.name for item in empty.iterdir()] == ["results"]
