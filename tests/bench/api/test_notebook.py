"""The notebook of the docs, executed in a kernel, and its outputs."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parents[3] / "docs" / "notebook.ipynb"
LARGEST_TEXT, LARGEST_PICTURE = 25_000, 500_000
"""Most characters of an output: as text or HTML, and as a picture in base 64."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("notebook"),  # it is executed once
]


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    """Return the outputs of each code cell by its last line."""
    folder = tmp_path_factory.mktemp("notebook")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR"):
            patch.setenv(name, str(folder / name.lower()))
        NotebookClient(
            notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": folder}}
        ).execute()
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return {cell.source.splitlines()[-1]: cell.outputs for cell in code}


def test_the_notebook_is_kept_without_outputs():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells)


@pytest.mark.parametrize(
    "line",
    [
        *("data", "data.robot", "model", "results", 'results["vjm-full"]'),
        *('results.compare("vjm-full", "vjm")', 'sb.validate("my.csv", robot="kr10-r1100-2")'),
    ],
)
def test_an_object_shows_a_table(cells, line):
    assert "<table" in cells[line][-1].data["text/html"]


@pytest.mark.parametrize("line", ["data.plot()", 'sb.figure("scores", results)'])
def test_a_figure_shows_a_picture(cells, line):
    (output,) = cells[line]
    assert output.data["image/png"] and "\n" not in output.data["text/plain"]
    assert output.metadata["image/png"]["width"] <= 900


def test_only_progress_is_written_to_a_stream_and_no_output_is_large(cells):
    for outputs in cells.values():
        stream = "".join(output.get("text", "") for output in outputs)
        assert all(re.search(r": \d+/\d+ \[", line) for line in stream.splitlines())
        for output in outputs:
            for kind, content in output.get("data", {}).items():
                assert len(content) <= (LARGEST_PICTURE if kind == "image/png" else LARGEST_TEXT)
