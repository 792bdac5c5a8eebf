"""Check that the project's files agree with its code and with each other."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

yaml = pytest.importorskip("yaml")  # comes with mkdocs

TOP = Path(__file__).parents[1]
SETTINGS = tomllib.loads((TOP / "pyproject.toml").read_text("utf-8"))
PROJECT = SETTINGS["project"]


def read(name: str | Path):
    return yaml.safe_load((TOP / name).read_text("utf-8"))


def test_the_citation_names_this_version_its_licence_and_the_source_paper():
    citation = read("CITATION.cff")
    assert citation["cff-version"] == "1.2.0"
    for name, ours in (("title", "name"), ("version", "version"), ("license", "license")):
        assert citation[name] == PROJECT[ours]
    for work in (citation, *citation["references"]):
        assert work["authors"] and work["title"]
    assert citation["references"][0]["doi"] == "10.1007/s00170-024-14794-z"
    assert all((TOP / name).is_file() for name in PROJECT["license-files"])


def test_the_workflow_runs_what_a_developer_runs_on_every_supported_python():
    job = read(".github/workflows/ci.yml")["jobs"]["checks"]
    assert "bash .ci/run" in [step.get("run") for step in job["steps"]]
    versions = {line.rpartition(" ")[2] for line in PROJECT["classifiers"] if ":: 3." in line}
    assert set(job["strategy"]["matrix"]["python"]) == versions


def test_the_engines_rooms_are_described_in_the_order_of_their_imports():
    page = (TOP / "bench" / "README.md").read_text("utf-8")
    lines = [line for line in page.splitlines() if line.startswith("| `")]
    described_packages = [re.findall(r"`(\w+)/`", line.split("|")[1]) for line in lines]
    contracts = SETTINGS["tool"]["importlinter"]["contracts"]
    (layers,) = (
        contract["layers"]
        for contract in contracts
        if contract.get("containers") == ["stiff_bench"]
    )
    packages = [sorted(layer.split(" | ")) for layer in layers if "console" not in layer]
    assert [sorted(names) for names in described_packages] == packages


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "bench/README.md", "docs/performance.md"])
def test_every_python_file_that_a_page_names_is_there(page):
    named_files = set(re.findall(r"`(?:[\w/]*/)?(\w+\.py)`", (TOP / page).read_text("utf-8")))
    existing_files = {path.name for path in TOP.glob("*/**/*.py")}
    assert named_files - existing_files == set() != named_files


def test_a_change_opens_at_most_three_files_beside_its_test():
    table = (TOP / "CONTRIBUTING.md").read_text("utf-8").partition("## To change X, open Y")[2]
    rows = [line for line in table.splitlines() if line.startswith("| ")][1:]
    for row in rows:
        named = re.findall(r"`([^` ]*[./][^` ]*)`", row)
        assert len([name for name in named if not name.startswith("tests/")]) <= 3, row
    assert len(rows) > 20
