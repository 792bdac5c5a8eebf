"""Messages and results on standard streams, as wide as the terminal."""

from __future__ import annotations

import io
import re

import pytest

from stiff_bench.console import (
    escape_missing_characters,
    print_markdown,
    print_prose,
    print_text,
    wrapped,
    wrapped_lines,
)


def test_sentences_are_broken_between_words_as_wide_as_the_terminal_and_tables_are_not(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    table = "model" + 20 * "  column"
    sentence = "- the model vjm-multisegment has springs of two slopes in each of its joints"
    lines = wrapped_lines(f"{table}\n{sentence}\n").split("\n")
    assert lines[0] == table and lines[-1] == ""
    assert len(lines) > 3 and max(map(len, lines[1:])) <= 60
    assert lines[1].startswith("- the") and lines[2].startswith("  ")
    assert " ".join(" ".join(lines[1:]).split()) == sentence


def test_texts_are_at_most_a_hundred_characters_wide_in_a_wide_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert 90 < max(map(len, wrapped("word " * 200).splitlines())) <= 100


def test_prose_is_wrapped_for_a_terminal_and_unwrapped_for_a_pipe(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    sentence = "word " * 40 + "end"
    print_prose(sentence)
    assert capsys.readouterr().out == f"{sentence}\n"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    print_text(sentence)
    assert capsys.readouterr().out == f"{sentence}\n"
    print_prose(sentence)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 60


def test_markdown_is_laid_out_on_a_terminal_and_harmless(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    text = "# Card\n\n| key | what |\n|---|---|\n| a | " + "word " * 30 + "|\n\n[red]\x1b[31m"
    print_markdown(text)
    assert "| a | word" in capsys.readouterr().out
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    print_markdown(text)
    out = capsys.readouterr().out
    assert "[red]" in out and r"\x1b[31m" in out
    lines = re.sub(r"\x1b\[[\d;]*m", "", out).splitlines()
    assert max(map(len, lines)) <= 60 and "|---|" not in out


@pytest.mark.parametrize(("encoding", "printed"), [("ascii", b"? ?"), ("cp1252", b"\xb1 ?")])
def test_a_character_that_the_console_does_not_have_is_replaced(encoding, printed, monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding, write_through=True)
    escape_missing_characters(stream)
    monkeypatch.setattr("sys.stdout", stream)
    print_text("± ≈")
    assert stream.buffer.getvalue() == printed + b"\n"
