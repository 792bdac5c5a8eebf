"""Pages as HTML: hostile texts stay texts; charts, colours and sort keys."""

from __future__ import annotations

import itertools
import re
from html.parser import HTMLParser

import pytest

from stiff_bench.page.page import (
    Figure,
    Link,
    Page,
    Section,
    chart_position,
    html_cell,
    html_page,
)
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table

HOSTILE = (
    "</script><script>hacked()</script><img src=http://evil.example onerror=hacked()>'\"&{{7*7}}"
)
VOID = {"meta", "link", "img", "input", "br", "wbr", "line", "circle"}
PIXEL = "data:image/svg+xml;base64,PHN2Zy8+"


class Reader(HTMLParser):
    """Collects start tags with attributes, and the text of scripts and titles."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.inside: dict[str, list[str]] = {"script": [], "title": []}
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


def made_page(text: str) -> Page:
    columns = [
        Column(text, "text"),
        Column("x", unit=text, format=".1f", group=text),
        Column("y", is_change=True),
        Column(text, is_chart=True, format=".2f"),
    ]
    chart = Quantity(low=0.5, high=2.0, ratio=1.0)
    rows = [[Name(text, text), Quantity(1.0, mark="*", ratio=0.8), 1, chart]]
    table = Table(text, columns, rows, [text])
    content = {
        "texts": [(text, text)],
        "tables": [table],
        "choices": [(text, table), (f"{text} again", table)],
        "figures": [Figure(text, text, PIXEL, text)],
        "notes": [text],
        "command": text,
    }
    folded = Section(text, **content, log=text, is_folded=True)
    links = [Link(text, "a.html")]
    first = Section(text, text, **content, links=links, sections=[folded, folded])
    addresses = {str(rows[0][0]): "b.html"}
    up = Link(text, "../index.html")
    return Page(text, [first, Section("other")], text, addresses, up, {text: text})


@pytest.fixture(scope="module")
def hostile() -> Reader:
    return Reader(html_page(made_page(HOSTILE)))


@pytest.fixture(scope="module")
def plain() -> Reader:
    return Reader(html_page(made_page("plain")))


def test_hostile_texts_add_no_element_no_attribute_and_no_request(hostile, plain):
    def skeleton(reader):
        return [(tag, sorted(attributes)) for tag, attributes in reader.tags]

    assert skeleton(hostile) == skeleton(plain)
    assert hostile.inside["script"] == plain.inside["script"]
    for tag, attributes in hostile.tags:
        for name in ("src", "href"):
            value = attributes.get(name) or ""
            assert not value or value.startswith(("data:", "#")) or value.endswith(".html"), tag


def test_a_name_may_break_before_an_option_and_control_characters_are_written_out():
    page = html_page(made_page("ft-mlp@steps=3@x=<b>\u202e\x1b[31m"))
    assert r"ft-mlp<wbr>@steps=3<wbr>@x=&lt;b&gt;\u202e\x1b[31m [ft-mlp" in page
    assert not any(sign in page for sign in ("<b>", "\u202e", "\x1b"))


def test_headings_references_and_names_can_be_read_by_a_screen_reader(plain):
    assert plain.of("html") == [{"lang": "en"}]
    levels = [int(tag[1]) for tag, _ in plain.tags if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    assert {cell["scope"] for cell in plain.of("th")} == {"col", "row"}
    assert all(image["alt"] for image in plain.of("img"))
    ids = [attributes["id"] for _, attributes in plain.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert all(table["aria-labelledby"] in ids for table in plain.of("table"))
    for link in plain.of("a"):
        assert not link["href"].startswith("#") or link["href"][1:] in ids


def test_the_script_is_in_the_page_or_in_a_file_next_to_it(plain):
    assert "data:text/javascript" in plain.inside["script"][0]
    page = Reader(html_page(made_page("plain"), "tables.js"))
    assert page.of("script")[0] == {"src": "tables.js"} and page.inside["script"][0] == ""


def orders(*cells: Entry, **about: object) -> list[str]:
    """Return the sort keys of the cells of a column."""
    return [html_cell(cell, Column("x", **about)).order for cell in cells]


def test_a_number_is_sorted_by_its_value_its_low_end_or_the_first_number_of_its_share():
    """The printed form does not count; missing values are last."""
    of_cells = {
        "0.1035": Quantity(0.1035, 0.013, mark="*"),
        "-0.5": -0.5,
        "12300": 12_300,
        "72": Quantity(share=(72, 73)),
        "1": Quantity(low=1.0, high=2.5),
    }
    assert orders(*of_cells.values()) == [*of_cells]
    first, *missing = map(float, orders(2.0, None, Quantity(status="FAILED"), ""))
    assert all(order > 1e99 > first for order in missing)
    assert orders(Quantity(low=0.5, high=3.0, ratio=2.0), is_chart=True) == ["2"]


def test_texts_are_sorted_as_people_count():
    ten, five = orders("n = 10", "n = 5", kind="text")
    assert five < ten


def test_a_table_has_headings_cells_and_notes_but_no_hidden_column():
    columns = [Column("model", "text"), Column("sha", "text", hidden=True), Column("x", group="G")]
    notes = [f"note {number}" for number in range(6)]
    table = Table("t", columns, [["m", "0123", 1.0]], notes)
    text = html_page(Page("p", [Section("s", tables=[table])]))
    assert re.findall(r'<th scope="[^"]*"[^>]*>([^<]*)', text) == ["model", "G: x", "m"]
    assert "0123" not in text and ">1.0</td>" in text
    assert re.findall("<li>(note .)</li>", text) == notes


def test_the_best_number_is_bold_and_colours_are_ratios_or_signs():
    best, second = (Quantity(0.2, mark="*", ratio=0.4), Quantity(0.3))
    cells = [html_cell(cell, Column("x", format=".1f")) for cell in (best, second)]
    assert [(cell.is_best, cell.text, cell.style) for cell in cells] == [
        *((True, "0.2", "number less-4"), (False, "0.3", "number"))
    ]
    changes = [html_cell(cell, Column("y", is_change=True)).style for cell in (-1, 1, 0)]
    assert changes == ["number less-2", "number more-2", "number"]
    ratios = [html_cell(Quantity(1, ratio=of), Column("x")).style for of in (0.85, 1.0, 1.5, 9.0)]
    assert ratios == ["number less-1", "number", "number more-2", "number more-4"]


def test_charts_place_ratios_on_a_logarithmic_axis_whose_ends_hold_all_others():
    cell = Quantity(low=0.5, high=2.0, ratio=1.0)
    chart = html_cell(cell, Column("x", is_chart=True)).chart
    low, dot, high = map(chart_position, (0.5, 1.0, 2.0))
    assert chart == (low, dot, high) and high - dot == pytest.approx(dot - low, abs=0.2)
    assert chart_position(0.0) == chart_position(0.01) < chart_position(0.2)
    assert chart_position(9.0) == chart_position(4.0)
