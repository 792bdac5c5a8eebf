"""The command line as a table, without the library that reads the words.

`command_tree.json` has the arguments and options of every command, each with its kind of value:
flag, text, path, number or integer with bounds, or its choices; and "required" if it has no
default. A changed command line changes this file.
"""

from __future__ import annotations

import json
from pathlib import Path

PARAMETERS: dict[str, dict[str, str]] = json.loads(
    Path(__file__).with_suffix(".json").read_text("utf-8")
)
"""Command or group -> argument or option -> kind of its values."""
GROUPS = [
    name
    for name in PARAMETERS
    if any(longer_name.startswith(f"{name} ") for longer_name in PARAMETERS)
]
COMMANDS = [name for name in PARAMETERS if name not in GROUPS]
