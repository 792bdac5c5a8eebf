"""Output of commands is never wider than the terminal."""

from __future__ import annotations

import re
from unittest import mock

import pytest

from helpers.command_line import Stream, bench_here
from helpers.made_results import MadeResults

COMMANDS = (
    "data simulate --twin ur5 --samples 20 --output my.csv",
    "data plan --robot ur5 --poses 12 --candidates 60 --output plan.csv",
    "data plan --robot ur5 --after my.csv --poses 4 --candidates 60 --output more.csv",
    "data validate my.csv --robot ur5",
    "data validate plan.csv --robot ur5",
    "data validate my.csv",
    "data info my.csv --robot ur5",
    "data info fanuc-r2000ic",
    "data register my.csv --robot ur5",
    "data export fanuc-r2000ic --output out",
    "fit --model bayes-springs@groups=joints --data my.csv --robot ur5 --output my.stiff",
    "predict --model my.stiff --input plan.csv --output predicted.csv",
    "path example --robot ur5 --points 11 --output path.csv",
    "path compensate --model my.stiff --path path.csv --output new.csv",
    "check vjm --dataset fanuc-r2000ic",
    "new model my-model",
    "run --model vjm --data plan.csv --robot ur5",
    "run --modle vjm",
    "show vjm-gp",
    "show fanuc-r2000ic",
    "data info kr10-twin",
)
ON_RESULTS = (
    "list models",
    "leaderboard --results runs",
    "compare net vjm --results runs",
    "run --model zero --splits 2 --dataset fanuc-r2000ic --output new",
)


@pytest.mark.slow
@pytest.mark.usefixtures("empty_pictures")
@pytest.mark.parametrize(
    ("width", "commands"), [(80, COMMANDS), (80, ON_RESULTS), (100, COMMANDS[-4:] + ON_RESULTS)]
)
def test_no_line_is_wider_than_the_terminal(tmp_path, width, commands):
    made = MadeResults(tmp_path / "runs")
    for number in range(6):
        made.add_each({"vjm": [0.2, 0.21], "net": [0.1, 0.11]}, f"a-data-set-{number}")
    terminal = mock.patch.object(Stream, "isatty", lambda _: True)
    env = {"COLUMNS": str(width), "TERM": "dumb"}
    for command in commands:
        with terminal:
            done = bench_here(*command.split(), cwd=tmp_path, env=env)
        assert done.returncode in (0, 1, 2), done.stderr
        assert "internal error" not in done.stderr, done.stderr
        lines = re.sub(r"\x1b\[[\d;]*m", "", done.stdout + done.stderr).splitlines()
        assert not any(line.startswith("|--") for line in lines)  # Markdown is for pipes
        assert [line.rstrip() for line in lines if len(line.rstrip()) > width] == [], command
