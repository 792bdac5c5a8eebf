"""The page: one file without requests or active text; sort keys of its columns."""

from __future__ import annotations

import base64
import hashlib
import itertools
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from stiff_bench.report.first_screen import (
    Chart,
    FirstScreen,
    MatrixCell,
    MatrixPart,
    ModelRow,
)
from stiff_bench.report.html_page import (
    MOST_ROWS,
    Block,
    Link,
    Part,
    Picture,
    page_table,
    render_page,
)
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table

HOSTILE = (
    "</script><script>hacked()</script><img src=http://evil.example onerror=hacked()>'\"&{{7*7}}"
)
VOID = {"meta", "link", "img", "input", "br", "wbr", "line", "circle"}


class Reader(HTMLParser):
    """Collects start tags with attributes, and the text of scripts and styles."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.inside: dict[str, list[str]] = {"script": [], "style": [], "title": []}
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag in self.inside:
            self.inside[tag].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        if self.open and self.open[-1] in self.inside:
            self.inside[self.open[-1]][-1] += data

    def of(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def made_page(text: str) -> str:
    table = Table(
        text,
        [Column(text, "text"), Column("x", unit=text, format=".1f"), Column("y", by_sign=True)],
        [[Name(text, text), Quantity(1.0, mark=text), 1], ["b", None, -1]],
        [text],
    )
    picture = Picture(text, text, "image/svg+xml", f"<svg>{text}</svg>".encode(), text)
    pictures = [picture, picture._replace(dataset=text, protocol=text)]
    block = Block(text, [text], [table], pictures, [(text, text)], [text], text)
    part = Part(
        text,
        made_screen(text),
        headline=text,
        sentences=[(text, text)],
        reason=text,
        notes=[text],
        blocks=[block, replace(block, is_detail=True)],
    )
    return render_page({text: part, "other": Part("other", blocks=[Block("plain")])}, text)


def made_screen(text: str) -> FirstScreen:
    rows = [ModelRow(text, text, text, Chart(1.0, 0.5, 2.0, text), text, text, text)] * 11
    cells = [MatrixCell(text, "less-1", True), MatrixCell(text)]
    columns = [[(text, 2)], [(text, 1), (text, 1)], [text, text], [text, text]]
    matrix = MatrixPart(*columns, [(text, cells)] * 11, cells)
    ticks = [(0.5, "1x")]
    answer = [(text, text)]
    return FirstScreen(text, answer, [text], text, text, ticks, rows, text, [matrix] * 2, text)


@pytest.fixture(scope="module")
def hostile() -> Reader:
    return Reader(made_page(HOSTILE))


@pytest.fixture(scope="module")
def plain() -> Reader:
    return Reader(made_page("plain"))


def test_hostile_texts_add_no_element_no_attribute_and_no_request(hostile, plain):
    def skeleton(reader):
        return [(tag, sorted(attributes)) for tag, attributes in reader.tags]

    assert skeleton(hostile) == skeleton(plain)
    assert hostile.inside["script"] == plain.inside["script"]
    for tag, attributes in hostile.tags:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            value = attributes.get(name) or ""
            assert not value or value.startswith(("data:", "#")), (tag, value)
        assert not any(name == "style" or name.startswith("on") for name in attributes)
    assert not re.search(r"@import|url\(", hostile.inside["style"][0])


def test_a_name_may_break_before_an_option_and_control_characters_are_written_out():
    page = made_page("ft-mlp@steps=3@x=<b>\u202e\x1b[31m")
    assert r"ft-mlp<wbr>@steps=3<wbr>@x=&lt;b&gt;\u202e\x1b[31m [ft-mlp" in page
    assert not any(sign in page for sign in ("<b>", "\u202e", "\x1b"))


def test_the_policy_allows_only_the_scripts_and_the_style_of_the_page(hostile):
    (policy,) = (
        meta["content"]
        for meta in hostile.of("meta")
        if meta.get("http-equiv") == "Content-Security-Policy"
    )
    directives = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    assert directives["default-src"] == "'none'"
    assert directives["img-src"] == "data:"

    def hashes(kind):
        digests = (hashlib.sha256(text.encode()).digest() for text in hostile.inside[kind])
        return " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)

    assert directives["script-src"] == hashes("script")
    assert directives["style-src"] == hashes("style")
    assert "unsafe" not in policy


def test_language_title_and_headings_in_order(plain):
    assert plain.of("html") == [{"lang": "en"}]
    assert plain.inside["title"] == ["stiffbench report: plain, other"]
    levels = [int(tag[1]) for tag, _ in plain.tags if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


def test_tables_pictures_boxes_and_references_can_be_read_by_a_screen_reader(plain):
    assert len(plain.of("caption")) == len(plain.of("table"))
    assert {cell["scope"] for cell in plain.of("th")} == {"col", "colgroup", "row"}
    assert all(image["alt"] for image in plain.of("img"))
    boxes = [box for box in plain.of("div") if box.get("class") == "scroll"]
    assert boxes and {box["tabindex"] for box in boxes} == {"0"}
    assert all(box.get("aria-labelledby") or box.get("aria-label") for box in boxes)
    ids = [attributes["id"] for _, attributes in plain.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in plain.tags:
        for name in ("href", "aria-labelledby"):
            value = attributes.get(name) or ""
            assert value.removeprefix("#") in ids or not value or value.startswith("data:")


def orders(*cells: Entry, **about: str) -> list[str]:
    """Return the sort keys of the cells of a number column."""
    table = Table("t", [Column("x", **about)], [[cell] for cell in cells])
    return [row[0][1] for row in page_table(table)["rows"]]


def test_a_number_is_sorted_by_its_value_its_low_end_or_the_first_number_of_its_share():
    """The printed form does not count; missing values are last."""
    of_cells = {
        "0.1035": Quantity(0.1035, 0.013, mark="*"),
        "-0.5": -0.5,
        "12300": 12_300,
        "72": Quantity(share=(72, 73)),
        "1": Quantity(low=1.0, high=2.5),
        "0.5": Quantity(0.5, share=(2, 5), status="FAILED"),
    }
    assert orders(*of_cells.values()) == [*of_cells]
    assert orders(2.0, None, Quantity(status="FAILED"), "") == ["2", "", "", ""]
    assert orders(2e-4, 0.1, format=lambda value: "< 0.001") == ["0.0002", "0.1"]


def test_a_column_of_texts_is_sorted_as_people_count_though_it_begins_with_numbers():
    table = page_table(Table("t", [Column("x", "text")], [["n = 10"], ["n = 5"]]))
    assert table["styles"] == ["text"]
    assert table["rows"][1][0][1] < table["rows"][0][0][1]


def test_a_long_table_is_cut_with_a_note():
    rows = [[f"m{number}", 1] for number in range(MOST_ROWS + 7)]
    table = page_table(Table("t", [Column("model", "text"), Column("x")], rows, ["kept"]))
    assert len(table["rows"]) == MOST_ROWS
    assert table["notes"][0] == "kept"
    assert f"first {MOST_ROWS} of {MOST_ROWS + 7} rows" in table["notes"][1]


def test_a_table_of_the_page_has_what_its_readers_can_see():
    """No hidden column, the group above a column, and all notes."""
    columns = [Column("model", "text"), Column("sha", "text", hidden=True), Column("x", group="G")]
    notes = [f"note {number}" for number in range(6)]
    laid = page_table(Table("t", columns, [["m", "0123", 1.0]], notes, brief=True))
    assert laid["headings"] == ["model", "G: x"]
    assert [[text for text, _, _ in row] for row in laid["rows"]] == [["m", "1.0"]]
    assert laid["notes"] == notes


def test_a_cell_is_coloured_by_the_sign_of_its_number():
    table = Table("t", [Column("x", by_sign=True)], [[-1], [-0.0], [0], [1e-20], [None]])
    styles = [row[0][2] for row in page_table(table)["rows"]]
    assert styles == ["number worse", "number", "number", "number better", "number"]


def test_links_lead_to_other_pages_and_their_texts_are_escaped():
    text = "<b>model</b>@size=2"
    table = Table("t", [Column("model", "text"), Column("x")], [[text, 1.0]])
    block = Block("links", tables=[table], links=[Link(text, "a.html")])
    page = render_page(
        {"p": Part("p", blocks=[block])},
        "bench",
        title=text,
        addresses={text: "b.html"},
        back=Link("up", "../index.html"),
    )
    hrefs = [address for address in re.findall(r'<a href="([^"]+)"', page) if address[0] != "#"]
    assert sorted(hrefs) == ["../index.html", "a.html", "b.html"]
    assert "<b>model" not in page
