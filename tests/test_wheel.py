"""The built wheel: everything inside, and it works where no checkout is near."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("wheel")]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split("\0")
    for name in filter(None, listed):  # a copy, so that no build folder is left in the checkout
        if (ROOT / name).is_file():
            (folder / "src" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / "src" / name)
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--outdir", folder, folder / "src"], check=True
    )
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_holds_every_module_and_data_file_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        listed = archive.namelist()
    names = {name for name in listed if ".dist-info/" not in name}
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in listed)
    sources = {
        f"{package.name if package.name != 'published' else 'stiff_published'}/"
        f"{file.relative_to(package).as_posix()}"
        for package in [*ROOT.glob("*/stiff*"), ROOT / "results" / "published"]
        for file in package.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts and "tests" not in package.parts
    }
    assert names == sources
    needed = {"stiff_published/table_10.csv", "stiff_bench/model_tools/templates/model.py.txt"}
    assert names >= needed | {f"stiff_{name}/py.typed" for name in ("bench", "models")}


def test_bench_works_from_the_wheel_in_an_empty_folder(wheel, tmp_path):
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    constraints = ROOT / "constraints.txt"
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "--constraint", constraints, wheel], check=True
    )
    empty = tmp_path / "empty"
    empty.mkdir()
    done = subprocess.run(
        [python.with_name("bench"), "run", "--model", "vjm", "--dataset", "fanuc-r2000ic"],
        cwd=empty,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "| vjm " in done.stdout
    assert [item.name for item in empty.iterdir()] == ["results"]
