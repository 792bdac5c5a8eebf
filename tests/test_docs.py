"""The docs: their code runs, their commands are ours, and their site is complete."""

from __future__ import annotations

import doctest
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from helpers.command_line import bench_here
from helpers.command_tree import GROUPS, PARAMETERS
from helpers.run_requests import planned
from stiff_bench.api.registered import list_figures
from stiff_bench.model_tools.plugins import check
from stiff_bench.plan.fits import fit_tasks
from stiff_bench.plan.registry import registry, use_only
from stiff_bench.results.columns import BEST, LIKE_BEST, VERDICT_TEXTS
from stiff_bench.results.comparison import VERDICTS
from stiff_bench.run.execution import compute_fit
from stiff_bench.submissions.sealed_fit import why_not_sealed
from stiff_datasets.measured.table_reader import sample_table
from stiff_protocols.protocol_catalog import PROTOCOLS
from stiff_protocols.scoring.metrics import METRICS

TOP = Path(__file__).parents[1]
DOCS = TOP / "docs"
DEFINITIONS = (DOCS / "definitions.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"?((?:https?:)?//[^\" >]+)")


AGENTS = TOP / "AGENTS.md"
PAGES = (TOP / "README.md", AGENTS, *sorted(DOCS.rglob("*.md")))
GUIDE = (
    "index install tutorial choose-a-model measure-your-robot use-a-model correct-a-path "
    "place-the-work add_a_model submit-a-model add_a_data_set add_a_protocol large-studies "
    "read-the-results python troubleshooting glossary"
).split()
MOST_WORDS, MOST_APPENDIX_WORDS, LONGEST_SENTENCE, MEAN_SENTENCE = 10_000, 20_000, 40, 25
SENTENCE_END = re.compile(r"[.:!?](?:\s|$)|\n\s*\n|\n\s*[-#]|\n\s*\d\.\s")
NO_PROSE = re.compile(r"^```.*?^```|^\|.*?$|^<!--.*?$|^!\[.*?$", re.DOTALL | re.MULTILINE)
SCRIPT = re.compile(r"^```py(?:thon)?\n(?!>>>)(.*?)^```", re.MULTILINE | re.DOTALL)
"""A Python block that prints nothing below its lines; docs/python.md is a doctest."""
BLOCKS = {
    page.relative_to(TOP).as_posix(): blocks
    for page in PAGES
    if (blocks := SCRIPT.findall(page.read_text("utf-8")))
}
KR10 = "fit --model vjm --dataset kr10-twin --output kr10.stiff"
MADE_BY = {
    "docs/use-a-model.md": [KR10],
    "docs/correct-a-path.md": [KR10, "path example --model kr10.stiff --output square.csv"],
    "docs/place-the-work.md": [
        KR10,
        "fit --model vjm-full --dataset fanuc-r2000ic --output fanuc.stiff",
    ],
    "docs/export.md": [KR10, "export --model kr10.stiff --output kr10.c --format c"],
    "docs/large-studies.md": ["run --model zero --splits 1"],
}
"""Commands of the page that make what its Python blocks read."""


def test_every_name_in_a_python_block_is_defined(tmp_path):
    for page, blocks in BLOCKS.items():
        (tmp_path / f"{page.replace('/', '_')}.py").write_text("\n".join(blocks), encoding="utf-8")
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--select", "F821", "."]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


EXAMPLES = DOCS / "assets" / "examples"
PLUGINS = {
    "mean-deflection": BLOCKS["docs/add_a_model.md"][0],
    "bagged-ridge": (EXAMPLES / "bagged_ridge.py").read_text("utf-8"),
    "hall-3": BLOCKS["docs/add_a_data_set.md"][0],
    "six-springs": (EXAMPLES / "six_springs.py").read_text("utf-8"),
    "gap-holdout": BLOCKS["docs/add_a_protocol.md"][0],
}


@pytest.mark.slow
@pytest.mark.parametrize("key", PLUGINS)
def test_a_plugin_of_a_page_passes_its_checks_and_can_be_run(key, fanuc, tmp_path, request):
    request.addfinalizer(registry.cache_clear)
    path = tmp_path / "my_plugin.py"
    path.write_text(PLUGINS[key], encoding="utf-8")
    sample_table(fanuc.samples, fanuc.robot).to_csv(tmp_path / "campaign_2026.csv", index=False)
    use_only([path])
    checked = check(key)
    assert checked.passed and len(checked.checks) > 2, repr(checked)
    words = {"models": ("vjm",), "datasets": ("fanuc-r2000ic",), "protocols": ("holdout",)}
    (kind,) = (name for name in words if key in getattr(registry(), name))
    (task,) = fit_tasks(planned(registry(), **words | {kind: (key,)}, splits=1))
    result = compute_fit(task, "run")
    assert (result.status, result.failure) == ("ok", "")
    assert bool(result.diagnostics) == (key != "mean-deflection")


@pytest.mark.slow
@pytest.mark.filterwarnings("default::stiff_protocols.contract.errors.StiffBenchWarning")
@pytest.mark.parametrize("page", sorted(BLOCKS))
def test_the_python_blocks_of_a_page_run(page, tmp_path, monkeypatch):
    for words in MADE_BY.get(page, ()):
        assert bench_here(*shlex.split(words), cwd=tmp_path).returncode == 0
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(EXAMPLES)
    missing = [word for word in ("gcc",) if shutil.which(word) is None]
    missing += [word for word in ("dask_jobqueue",) if find_spec(word) is None]
    blocks = [block for block in BLOCKS[page] if not any(word in block for word in missing)]
    script = "\n".join(blocks)
    (tmp_path / "page.py").write_text(script, encoding="utf-8")
    runpy.run_path("page.py", run_name="page")  # a main guard's block would start a cluster


@pytest.mark.slow
def test_the_page_on_python_prints_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # it saves a picture
    page, flags = str(DOCS / "python.md"), doctest.NORMALIZE_WHITESPACE
    outcome = doctest.testfile(page, module_relative=False, optionflags=flags)
    assert outcome.attempted > 20
    assert outcome.failed == 0


def _shell(page: Path) -> list[str]:
    """Return the lines of a page's `sh` blocks."""
    return "".join(BLOCK.findall(page.read_text(encoding="utf-8"))).splitlines()


def test_every_metric_and_protocol_is_defined():
    words = [f"**`{key}`**" for key in METRICS]
    words += [f"\n### `{info.key}`\n" for info in PROTOCOLS]
    assert [word for word in words if word not in DEFINITIONS] == []


def test_every_command_of_the_docs_has_its_options():
    lines = [(page.name, line) for page in PAGES for line in _shell(page)]
    commands = [(page, line) for page, line in lines if line.startswith("bench ")]
    assert len(commands) > 50  # that they are found at all
    assert [(page, line) for page, line in commands if _unknown(line)] == []


def test_a_robot_has_one_tcp_in_all_pages():
    given = re.compile(r'(\w+\.urdf)[", ]+(?:--tcp |tcp=\()([\d., ]+)')
    pairs = [pair for page in PAGES for pair in given.findall(page.read_text("utf-8"))]
    assert len(pairs) > 10
    tcps = {(urdf, tuple(map(float, tcp.split(",")))) for urdf, tcp in pairs}
    assert tcps == {("my_robot.urdf", (0.08, 0.0, 0.06))}


def _unknown(line: str) -> str:
    """Return the first word of a command line that bench does not know, "" where there is none."""
    command, *words = shlex.split(line, comments=True)
    while command in GROUPS and words and not words[0].startswith("-"):
        name, *words = words
        command = f"{command} {name}"
        if command not in PARAMETERS:
            return name
    options = {"-h", "--debug", *PARAMETERS[command]}
    given = [word.partition("=")[0] for word in words if word.startswith("-")]
    return next((option for option in given if option not in options), "")


def test_the_guide_is_short_and_so_are_its_sentences():
    texts = {name: (DOCS / f"{name}.md").read_text("utf-8") for name in GUIDE}
    assert sum(len(text.split()) for text in texts.values()) <= MOST_WORDS
    lengths = [
        len(sentence.split())
        for text in texts.values()
        for sentence in SENTENCE_END.split(NO_PROSE.sub("\n\n", text))
    ]
    assert max(lengths) <= LONGEST_SENTENCE
    sentences = [length for length in lengths if length > 1]
    assert sum(sentences) / len(sentences) <= MEAN_SENTENCE


def test_the_pages_outside_the_guide_are_short():
    pages = [page for page in DOCS.glob("*.md") if page.stem not in GUIDE]
    words = {page.name: len(page.read_text("utf-8").split()) for page in pages}
    assert "definitions.md" in words
    assert sum(words.values()) <= MOST_APPENDIX_WORDS, words


def test_every_word_of_a_verdict_is_in_the_glossary():
    rows = (DOCS / "glossary.md").read_text("utf-8").partition("\n## Verdicts\n")[2].splitlines()
    cells = ", ".join(row.split("|")[1] for row in rows if row.startswith("|"))
    explained = {word.strip(" `") for word in cells.split(",")}
    printed = {*VERDICT_TEXTS.values(), *VERDICTS.values(), BEST, LIKE_BEST, "equal"} - {""}
    assert printed - explained == set()


def test_the_gallery_has_every_figure_and_pictures_are_small():
    page = (DOCS / "gallery.md").read_text("utf-8")
    pictures = [f"](assets/gallery/{name}.png)" for name in list_figures().frame()["name"]]
    assert [picture for picture in pictures if picture not in page] == []
    sizes = [path.stat().st_size for path in (DOCS / "assets").rglob("*.png")]
    assert sum(sizes) < 1_500_000


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_with_equations_and_loads_nothing_from_elsewhere(
    tmp_path,
):
    for package in ("mkdocs", "material", "latex2mathml"):
        if find_spec(package) is None:
            pytest.skip(f"{package} is not installed: pip install 'stiffbench[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path]
    built = subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    files = {path.relative_to(tmp_path).as_posix(): path for path in tmp_path.rglob("*.html")}
    pages = {name: path.read_text("utf-8") for name, path in files.items()}
    ours = {page.relative_to(DOCS).with_suffix(".html").as_posix() for page in DOCS.rglob("*.md")}
    assert ours <= pages.keys()
    assert [name for name, text in pages.items() if LOADED.search(text)] == []
    page = pages["definitions.html"]
    equations = re.findall(r"\$\$.*?\$\$|\$[^$\n]+\$", DEFINITIONS, re.DOTALL)
    assert page.count("<math") == len(equations) and "arithmatex" not in page
    text = re.sub(r"<(code|pre)\b.*?</\1>", "", page, flags=re.DOTALL)
    assert re.findall(r"\\[a-zA-Z(\[]", text) == []


CARD = re.compile(r"^```toml\n(.*?)^```", re.MULTILINE | re.DOTALL)
TASKS = {
    "measure-your-robot": ("my.csv: ok", "my.stiff: bayes-springs"),
    "add_a_model": ("0 failed", "| my-model "),
    "submit-a-model": ("0 failed", "| my-model ", "fresh robots: 4"),
}
"""Guides of AGENTS.md, and some of what their commands print."""
TUTORIAL = ("my.csv: ok", "bayes-springs is better than vjm on my.csv", "predicted.csv: 60 rows")
needs_bubblewrap = pytest.mark.skipif(bool(why_not_sealed()), reason=why_not_sealed() or "there")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "prints"),
    [
        pytest.param(name, prints, marks=[needs_bubblewrap] if "submit" in name else [], id=name)
        for name, prints in {"tutorial": TUTORIAL, **TASKS}.items()
    ],
)
def test_the_commands_of_a_guide_run_from_top_to_bottom(name, prints, tmp_path):
    page = DOCS / f"{name}.md"
    for path in (DOCS / "assets").glob("*.*"):
        shutil.copy(path, tmp_path)
    for card in CARD.findall(page.read_text("utf-8")):
        (tmp_path / "card.toml").write_text(card, encoding="utf-8")
    printed = ""
    for program, *words in (shlex.split(line, comments=True) for line in _shell(page)):
        if program == "bench":
            done = bench_here(*words, cwd=tmp_path, env={"STIFFBENCH_HOME": str(tmp_path / "home")})
        else:
            command = [sys.executable, *words]
            done = subprocess.run(
                command, cwd=tmp_path, capture_output=True, text=True, check=False
            )
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        printed += done.stdout
    assert [text for text in prints if text not in printed] == []
    if name == "tutorial":
        assert len((tmp_path / "predicted.csv").read_text("utf-8").splitlines()) == 61


def test_an_agent_is_shown_every_guide_in_a_page_of_at_most_60_lines():
    text = AGENTS.read_text("utf-8")
    assert len(text.splitlines()) <= 60
    assert [name for name in TASKS if f"(docs/{name}.md)" not in text] == []
    targets = re.findall(r"\]\(([^)#]+)", text)
    assert [name for name in targets if not (TOP / name).exists()] == []
