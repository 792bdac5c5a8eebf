"""Pages with measured numbers, and the modules that have changed since.

After a measurement, or a change that cannot move a page's numbers, this writes the page's hashes:
``python tests/helpers/measured_pages.py results/performance.md``.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

TOP = Path(__file__).parents[2]
PAGES = TOP / "results" / "measured_pages.json"


def code_hash(source: str) -> str:
    """Return a hash of Python code without imports, comments and docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [entry for entry in body if not _is_silent(entry)]  # type: ignore[attr-defined]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()[:16]


def _is_silent(node: ast.stmt) -> bool:
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return is_text or isinstance(node, ast.Import | ast.ImportFrom)


def changed_modules(page: dict[str, Any]) -> list[str]:
    """Return the modules of a page whose code is not the measured one."""
    return [name for name, measured in page["modules"].items() if hash_of(name) != measured]


def hash_of(module: str) -> str:
    file = TOP / module
    return code_hash(file.read_text("utf-8")) if file.is_file() else "missing"


def pages() -> dict[str, Any]:
    """Return each page's command and its modules with the hash of their measured code."""
    measured: dict[str, Any] = json.loads(PAGES.read_text("utf-8"))
    return measured


if __name__ == "__main__":
    document = pages()
    for name in sys.argv[1:]:
        document[name]["modules"] = {
            module: hash_of(module) for module in document[name]["modules"]
        }
    PAGES.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
