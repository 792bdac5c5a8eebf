"""Standard streams that are closed or full: an error, and nothing written into another file."""

from __future__ import annotations

import subprocess
import sys

import pytest

PRINTS = """
import sys
from stiff_bench.console import print_text, replace_closed_streams, say
from stiff_protocols.contract.errors import StoreError
replace_closed_streams()
file = open(sys.argv[1], "w")
assert file.fileno() > 2
say("a message")
try:
    print_text("a table")
except StoreError as error:
    say(str(error))
    sys.exit(2)
"""


@pytest.mark.parametrize(
    ("streams", "status", "message"),
    [
        *(("", 0, ""), ("2>&-", 0, ""), ("<&-", 0, ""), (">&- 2>&- <&-", 2, "")),
        *((stream, 2, "standard output: cannot be written") for stream in (">&-", ">/dev/full")),
    ],
)
def test_a_result_that_cannot_be_printed_is_an_error(tmp_path, streams, status, message):
    words = [sys.executable, "-c", PRINTS, str(tmp_path / "file")]
    done = subprocess.run(
        ["sh", "-c", f'"$@" {streams}', "sh", *words], capture_output=True, text=True
    )
    assert done.returncode == status, done.stderr
    assert message in done.stderr and "Traceback" not in done.stderr
    assert (tmp_path / "file").read_text() == ""
