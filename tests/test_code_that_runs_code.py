"""Nothing runs code of a file but what is listed here."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted(
    path
    for top in ("bench", "models", "datasets", "protocols")
    for path in (ROOT / top).rglob("*.py")
)

MODULES = frozenset(
    "pickle cPickle marshal shelve dill cloudpickle joblib yaml ruamel lxml xml subprocess "
    "importlib runpy imp code codeop ctypes pty dbm pickletools multiprocessing".split()
)
"""Modules that can run code, start programs, or read formats that do."""
HARMLESS = {"importlib.metadata", "importlib.resources"}
CALLS = {*"eval exec compile __import__ read_pickle loads_pickle system popen execv spawnv".split()}
LOADERS = {*"torch.load np.load numpy.load pd.eval pd.read_pickle pd.read_xml pd.read_html".split()}

ALLOWED = {
    "bench/stiffbench/__init__.py": "importlib: modules of ours alone",
    "bench/stiff_bench/plan/registry.py": "importlib: --plugin files, which the user names",
    "bench/stiff_bench/run/execution.py": "importlib: asks whether a package is there",
    "bench/stiff_bench/model_tools/plugins.py": "importlib: asks whether a name is free",
    "bench/stiff_bench/run/provenance.py": "subprocess: git status of our own checkout",
    "bench/stiff_bench/report/page.py": "subprocess: npm, for developers who take a newer widget",
    "bench/stiff_bench/store/samples.py": "np.load with allow_pickle=False",
    "bench/stiff_bench/run/cell_process.py": "pickle, ctypes: what the run sends it; prctl(2)",
    "bench/stiff_bench/run/isolate.py": "pickle, multiprocessing: processes of ours",
    "bench/stiff_bench/run/dask_cluster.py": "multiprocessing: a worker may have children",
    "models/stiff_models/networks/cache.py": "joblib: the user's cache, refused if others write",
    "models/stiff_models/regressors/sklearn_model.py": "importlib: modules of sklearn alone",
    "models/stiff_models/io/saved.py": "importlib: modules of ours alone",
    "datasets/stiff_datasets/robots/robot.py": "xml: ElementTree, which reads no external entities",
    "protocols/stiff_protocols/contract/extras.py": "importlib: is a package there?",
    "protocols/stiff_protocols/contract/plugin.py": "importlib: targets of catalogue lines",
}
"""File -> what it uses, and why a stranger's file cannot make it run anything."""


def _risks(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        else:
            names = []
        yield from (
            name for name in names if name not in HARMLESS and name.partition(".")[0] in MODULES
        )
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            plain = isinstance(node.func, ast.Name) or called.startswith(("os.", "pd."))
            if called in LOADERS or (plain and called.rpartition(".")[2] in CALLS):
                yield called


def test_what_can_run_code_is_used_only_where_the_list_says_why():
    risky = {
        path.relative_to(ROOT).as_posix()
        for path in SOURCES
        if any(_risks(ast.parse(path.read_text(encoding="utf-8"))))
    }
    assert sorted(risky - ALLOWED.keys()) == []


@pytest.mark.parametrize("text", ["from yaml import load", "import xml.sax", "os.system('x')"])
def test_the_walk_finds_what_the_packages_do_not_have(text):
    assert list(_risks(ast.parse(text)))
