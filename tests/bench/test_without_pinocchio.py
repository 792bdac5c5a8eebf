"""Without Pinocchio, which has no wheel for Windows, what reads no URDF works."""

from __future__ import annotations

import shlex
import subprocess
import sys

import pytest

from helpers.command_line import bench_here
from stiff_datasets.robots import urdf_reader
from stiff_protocols.contract.errors import ConfigError

BLOCKED = """
import shlex, sys
sys.modules["pinocchio"] = None  # as if it could not be imported
from stiffbench.main import main
for line in sys.stdin.read().splitlines():
    try:
        main(shlex.split(line))
    except SystemExit as end:
        print(f"status {end.code}: {line}")
import stiffbench as sb
robot = sb.load_model("kr10.stiff").fitted.robot_
data = sb.read_samples("shared/kr10-twin.csv", robot=robot)
errors = sb.evaluate(["vjm-full"], data, splits=1).frame().set_index("model")["norm_mm"]
assert errors["vjm-full"] < errors["vjm"]
assert sb.make_model("vjm").fit(data).predict(data).shape == (151, 3)
"""
MADE_BEFORE = """\
run --model vjm-full --splits 2
fit --model vjm-full --dataset kr10-twin --output kr10.stiff
path example --model kr10.stiff --output square.csv
data export kr10-twin --output shared
"""
WORK = """\
--version
list models
list datasets
show bayes-springs
new model my-model
compare vjm-full vjm
leaderboard
report --output report.html
figure scores --output scores.png
results export --format csv --output results.csv
predict --model kr10.stiff --input shared/kr10-twin.csv --output predicted.csv
path compensate --model kr10.stiff --path square.csv --output corrected.csv
export --model kr10.stiff --format c --output kr10.c
"""
NEED_IT = """\
run --model vjm --dataset fanuc-r2000ic
data validate shared/kr10-twin.csv --robot ur5
"""


@pytest.mark.slow
def test_results_models_and_files_are_used_and_what_reads_a_urdf_names_wsl(
    tmp_path,
):
    for line in MADE_BEFORE.splitlines():
        assert bench_here(*shlex.split(line), cwd=tmp_path).returncode == 0
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED],
        cwd=tmp_path,
        input=WORK + NEED_IT,
        capture_output=True,
        text=True,
        check=True,
    )
    statuses = [line for line in done.stdout.splitlines() if line.startswith("status ")]
    expected = {0: WORK.splitlines(), 2: NEED_IT.splitlines()}
    assert statuses == [f"status {code}: {line}" for code in expected for line in expected[code]]
    errors = [line for line in done.stderr.splitlines() if line.startswith("bench: error: ")]
    assert len(errors) == 2 and all("WSL" in line for line in errors)


def test_a_urdf_is_refused_with_the_cause(monkeypatch, tmp_path):
    monkeypatch.setattr(urdf_reader, "pin", None)
    monkeypatch.setattr(urdf_reader, "WHY_MISSING", "no such library", raising=False)
    with pytest.raises(ConfigError, match=r"no such library .*WSL 2"):
        urdf_reader.read_robot(tmp_path / "any.urdf")
