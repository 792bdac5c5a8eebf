"""The page "Add a model": its code blocks are models that keep the contract and can be run."""

from __future__ import annotations

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
BLOCKS = dict(
    zip(
        ("mean-deflection", "bagged-ridge"),
        re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL),
        strict=True,
    )
)


@pytest.fixture(params=BLOCKS)
def key(request) -> str:
    return request.param


@pytest.fixture()
def registry(key, tmp_path):
    path = tmp_path / "my_model.py"
    path.write_text(BLOCKS[key], encoding="utf-8")
    return build_registry([path])


def test_a_model_of_the_page_keeps_the_contract(key, registry):
    info = registry.models[key]
    cls = info.load()
    checks = check_model(
        lambda: cls(**info.quick), FanucR2000iC().load(), uses_validation=info.uses_validation
    )
    assert [str(check) for check in checks if check.status == "failed"] == []


def test_a_model_of_the_page_can_be_run(key, registry):
    plan = planned(
        registry,
        models=(key,),
        datasets=("fanuc-r2000ic",),
        settings=("bagged-ridge.members=3",) if key == "bagged-ridge" else (),
    )
    (task,) = cell_tasks(plan)
    result = compute_cell(task, "run")
    assert (result.status, result.failure) == ("ok", "")
    assert bool(result.diagnostics) == (key == "bagged-ridge")
