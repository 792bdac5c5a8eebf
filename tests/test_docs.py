"""Pages with code: "Add a model" has models that can be run, "In Python" prints what it says."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

from run_requests import planned
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.registry import build_registry
from stiff_bench.run.cell import compute_cell
from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_protocols.conformance.suite import check_model

PAGE = (Path(__file__).parents[1] / "docs" / "add_a_model.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
BLOCKS = dict(zip(("mean-deflection", "bagged-ridge"), PYTHON, strict=True))


@pytest.mark.parametrize("key", BLOCKS)
def test_a_model_of_the_page_keeps_the_contract_and_can_be_run(key, tmp_path):
    path = tmp_path / "my_model.py"
    path.write_text(BLOCKS[key], encoding="utf-8")
    registry = build_registry([path])
    info = registry.models[key]
    cls, data = info.load(), FanucR2000iC().load()
    checks = check_model(lambda: cls(**info.quick), data, uses_validation=info.uses_validation)
    assert [str(check) for check in checks if check.status == "failed"] == []
    settings = ("bagged-ridge.members=3",) if key == "bagged-ridge" else ()
    plan = planned(registry, models=(key,), datasets=("fanuc-r2000ic",), settings=settings)
    (task,) = cell_tasks(plan)
    result = compute_cell(task, "run")
    assert (result.status, result.failure) == ("ok", "")
    assert bool(result.diagnostics) == (key == "bagged-ridge")


@pytest.mark.slow
def test_the_page_on_python_prints_what_it_says():
    page = Path(__file__).parents[1] / "docs" / "python.md"
    found = doctest.testfile(
        str(page), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE
    )
    assert found.attempted > 20
    assert found.failed == 0
