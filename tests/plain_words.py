"""Refuse hard words and names without a noun in this checkout: `python tests/plain_words.py`."""

import ast
import io
import re
import subprocess
import sys
import tokenize
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
    "so many": "a number",
    "so long": "until",
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
HARD_WORD = re.compile(
    "|".join(rf"\b{word}\b".replace(" ", r"\s+") for word in PLAIN_WORDS), re.IGNORECASE
)
GENERATED = re.compile(r"results/(?!README|scripts/|calibration/|published/|submissions/README)")
NEW_LINE = "\n"


def problems_of(path: Path) -> Iterator[str]:
    """Yield `line: problem` of a Python file's names, texts and comments, or of a document."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield from _hard_words(text, 1)
        return
    for node in ast.walk(ast.parse(text)):
        line = getattr(node, "lineno", 1)
        if (name := _bound_name(node)).strip("_").lower() in BARE_NAMES:
            yield f"{line}: {name}: add a noun"
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from _hard_words(node.value, line)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield from _hard_words(token.string, token.start[0])


def _bound_name(node: ast.AST) -> str:
    """Return the name that a node binds; "" if it binds none."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()) | ast.arg(arg=name):
            return name
        case ast.Attribute(attr=name, ctx=ast.Store()):
            return name
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            return name
    return ""


def _hard_words(text: str, first_line: int) -> Iterator[str]:
    """Yield the hard words of a text, each with its line and its plain word."""
    for match in HARD_WORD.finditer(text):
        words = " ".join(match[0].split())
        plain = next(p for word, p in PLAIN_WORDS.items() if re.fullmatch(word, words, re.I))
        yield f"{first_line + text.count(NEW_LINE, 0, match.start())}: {words!r}: write {plain!r}"


def checked_files() -> list[Path]:
    """Return Python files and documents of the checkout, except generated pages and this file.

    Raises:
        SystemExit: this folder is not a git checkout with these files.
    """
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(
        [*command, "*.py", "*.md", "*.jinja"], cwd=TOP, capture_output=True, text=True, check=False
    )
    paths = [TOP / name for name in listed.stdout.split("\0") if not GENERATED.match(name)]
    if TOP / "README.md" not in paths:
        sys.exit(f"{TOP} is not a git checkout: {listed.stderr.strip() or 'no README.md'}")
    return [path for path in paths if path.is_file() and path != Path(__file__)]


if __name__ == "__main__":
    problems = [
        f"{path.relative_to(TOP)}:{problem}"
        for path in checked_files()
        for problem in problems_of(path)
    ]
    print("\n".join(problems) or "plain words: all checks passed")
    sys.exit(bool(problems))
