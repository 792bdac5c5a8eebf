"""Which stiffbench and which libraries made results."""

from __future__ import annotations

from stiff_bench.store.versions import differing_libraries
from stiff_protocols.contract.record import RunManifest


def run(name: str, **libraries: str) -> RunManifest:
    environment = {"numpy": "2.3.0", "scipy": "1.17.0", **libraries}
    return RunManifest(name, "bench run", "now", "finished", environment, ())


RUNS = [run("r1"), run("r2", numpy="2.4.0"), run("r3", scipy="1.18.0")]


def test_models_of_the_same_library_versions_need_no_note():
    assert list(differing_libraries(RUNS, {"a": ["r1"], "b": ["r1"]})) == []
    assert list(differing_libraries(RUNS, {"a": ["r1", "r2"], "b": ["r2", "r1"]})) == []


def test_a_library_whose_versions_differ_is_named_with_those_of_each_model():
    (line,) = differing_libraries(RUNS, {"a": ["r1"], "b": ["r1", "r2"]})
    assert all(part in line for part in ("numpy", "a: 2.3.0", "b: 2.3.0, 2.4.0"))


def test_a_run_without_a_manifest_has_unknown_versions():
    lines = list(differing_libraries(RUNS, {"a": ["r1"], "b": ["lost"]}))
    assert lines and all("b: unknown" in line for line in lines)
