"""Check that the project's files agree with its code and with each other."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
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
    assert job["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]
    assert versions and versions <= {*job["strategy"]["matrix"]["python"]}


WORKFLOWS = {path.stem: path for path in (TOP / ".github" / "workflows").iterdir()}


@pytest.mark.parametrize("name", WORKFLOWS)
def test_a_workflow_is_listed_writes_only_where_it_publishes_and_runs_what_is_there(name):
    workflow = read(WORKFLOWS[name])
    assert f"| `{name}.yml` |" in (TOP / "CONTRIBUTING.md").read_text("utf-8")
    assert workflow["permissions"] == {"contents": "read"}
    goals = re.findall(r"^(\w+):", (TOP / "Makefile").read_text("utf-8"), re.MULTILINE)
    for key, job in workflow["jobs"].items():
        assert ("permissions" in job) == ("environment" in job)
        assert job.get("needs", key) in workflow["jobs"]
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step)
            command, *words = step.get("run", "none").split()
            assert command != "make" or {*words} <= {*goals}


def test_a_release_needs_one_version_in_all_files_and_a_readme_without_relative_links(tmp_path):
    steps = {
        step.get("name"): step for step in read(WORKFLOWS["release"])["jobs"]["build"]["steps"]
    }
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md", "README.md"):
        shutil.copy(TOP / name, tmp_path)
    tag = f"v{PROJECT['version']}"

    def status(step: str, tag: str) -> int:
        environment = {**os.environ, "GITHUB_REPOSITORY": "a/b", "GITHUB_REF_NAME": tag}
        command = ["bash", "-e", "-c", steps[step]["run"]]
        return subprocess.run(command, cwd=tmp_path, env=environment, check=False).returncode

    (same,) = (name for name in steps if name and "one version" in name)
    assert (status(same, tag), status(same, f"{tag}1")) == (0, 1)
    (links,) = (name for name in steps if name and "README" in name)
    assert status(links, tag) == 0
    targets = re.findall(r"\]\(([^)]+)", (tmp_path / "README.md").read_text("utf-8"))
    assert len(targets) > 10
    assert [target for target in targets if not target.startswith("https://")] == []


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
    existing_files = {path.name for path in TOP.glob("[!.]*/**/*.py")}
    assert named_files - existing_files == set() != named_files


def test_a_change_opens_at_most_three_files_beside_its_test():
    table = (TOP / "CONTRIBUTING.md").read_text("utf-8").partition("## To change X, open Y")[2]
    rows = [line for line in table.splitlines() if line.startswith("| ")][1:]
    for row in rows:
        named = re.findall(r"`([^` ]*[./][^` ]*)`", row)
        assert len([name for name in named if not name.startswith("tests/")]) <= 3, row
    assert len(rows) > 20
