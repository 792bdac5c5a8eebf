"""The table widget is the one that was taken from npm."""

from __future__ import annotations

import pytest

from stiff_bench.report import page as widget
from stiff_protocols.contract.errors import StoreError


def test_the_widget_has_the_recorded_hash_and_its_licence_beside_it():
    assert f"DataTables {widget.VERSION}" in widget.widget_code()[:60]
    assert "Permission is hereby granted" in (widget.FOLDER / "LICENSE.txt").read_text()
    readme = (widget.FOLDER / "README.md").read_text()
    assert widget.VERSION in readme
    assert widget.SHA256 in readme


def test_a_changed_widget_is_refused():
    with pytest.raises(StoreError, match="expected 3801"):
        widget.checked_code(widget.SCRIPT.read_bytes() + b";alert(1)")


def test_the_widget_cannot_end_its_script_element_or_change_when_it_is_parsed():
    code = widget.widget_code()
    assert "</script" not in code.lower()
    assert "<!--" not in code
    assert "\r" not in code
