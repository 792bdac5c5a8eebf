"""Refuse hard words and names without a noun in this checkout: `python tests/plain_words.py`."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

TOP = Path(__file__).parents[1]
BARE_NAMES = frozenset(
    "asked both each found heard kept known left meant one other others own rest said shown some "
    "told wanted whole why".split()
)
"""Names that need a noun: `stored_results`, not `found`."""
PLAIN_WORDS = {
    "anew": "again",
    "but for": "except",
    "so (?:many|long)": "a number",
    "mend(?:s|ed|ing)?": "fix",
    "lack(?:s|ed|ing)?": "has no, needs",
    "g(?:ives?|ave|iving) way": "deflect",
    "outlasts?": "is robust to",
    "foretells?": "predict",
    "strangers?": "third-party",
    "whoever": "who",
    "beneath": "below",
    "thereof": "of it",
    "wherein": "where",
    "blamed": "the cause",
    "innocent": "not the cause",
}
"""Hard word, as a regular expression -> the plain one."""
HARD_WORD = re.compile("|".join(rf"\b{word}\b" for word in PLAIN_WORDS), re.IGNORECASE)


def problems_of(path: Path) -> Iterator[str]:
    """Yield `line: problem` of a Python file's names and texts, or of a document's words."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        for number, line in enumerate(text.splitlines(), 1):
            yield from (f"{number}: {problem}" for problem in _hard_words(line))
        return
    for node in ast.walk(ast.parse(text)):
        line = getattr(node, "lineno", 1)
        if (name := _bound_name(node).strip("_")) in BARE_NAMES:
            yield f"{line}: {name}: add a noun"
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from (f"{line}: {problem}" for problem in _hard_words(node.value))


def _bound_name(node: ast.AST) -> str:
    """Return the name that a node binds; "" if it binds none."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()) | ast.arg(arg=name):
            return name
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            return name
    return ""


def _hard_words(text: str) -> Iterator[str]:
    """Yield the hard words of a text with the plain word of each."""
    for match in HARD_WORD.finditer(text):
        plain = next(p for word, p in PLAIN_WORDS.items() if re.fullmatch(word, match[0], re.I))
        yield f"{match[0]!r}: write {plain!r}"


def checked_files() -> list[Path]:
    """Return the tracked Python files and documents, without results and this file."""
    command = ["git", "ls-files", "*.py", "*.md"]
    names = subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=True).stdout
    paths = [TOP / name for name in names.splitlines() if not name.startswith("results/")]
    return [path for path in paths if path.is_file() and path != Path(__file__)]


if __name__ == "__main__":
    problems = [
        f"{path.relative_to(TOP)}:{problem}"
        for path in checked_files()
        for problem in problems_of(path)
    ]
    print("\n".join(problems) or "plain words: all checks passed")
    sys.exit(bool(problems))
