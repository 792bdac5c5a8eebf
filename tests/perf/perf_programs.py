"""Compare correcting a robot program of 10,000 targets with correcting a path file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from uuid import uuid4

import numpy as np
import pandas as pd
import pytest

import stiffbench as sb
from helpers.perf_case import OURS, ours_or_peer

TARGETS, PATH_FILE = 10_000, "path file"
LOAD = (0.0, 0.0, -20.0)
HEAD = {
    ".src": "$BASE={X 450,Y 0,Z 250,A 0,B 0,C 0}\n$TOOL={X 60,Y 0,Z 80,A 0,B 0,C 0}\n",
    ".mod": "PERS tooldata t1:=[TRUE,[[60,0,80],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    'PERS wobjdata w1:=[FALSE,TRUE,"",[[450,0,250],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\nConfL\\Off;\n',
}
LINE = {
    ".src": "LIN {{X {:.3f},Y {:.3f},Z {:.3f},A 180.0,B 0.0,C 180.0}} C_DIS\n",
    ".mod": "MoveL [[{:.3f},{:.3f},{:.3f}],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v50,z1,"
    "t1\\WObj:=w1;\n",
}


@pytest.fixture(scope="module")
def vjm():
    return sb.make_model("vjm").fit(sb.load_dataset("kr10-twin"))


def spiral() -> np.ndarray:
    """Return the points of a spiral pocket, mm."""
    angle = np.linspace(0.0, 40.0 * np.pi, TARGETS)
    return np.column_stack([100 * np.cos(angle), 100 * np.sin(angle), np.linspace(0, 50, TARGETS)])


@pytest.mark.benchmark(group="Correction of 10,000 points, from file to file")
@pytest.mark.filterwarnings("ignore:.*beyond the training range")
@pytest.mark.parametrize("who", [f"{OURS}: KRL", f"{OURS}: RAPID", PATH_FILE])
def test_program(benchmark, vjm, tmp_path: Path, who):
    points, source = spiral(), tmp_path / "points.csv"
    if who == PATH_FILE:
        table = pd.DataFrame(
            points + np.array([450.0, 0.0, 250.0]), columns=["x_mm", "y_mm", "z_mm"]
        )
        table.assign(a_deg=180, b_deg=0, c_deg=180).to_csv(source, index=False)
    else:
        suffix = ".src" if who.endswith("KRL") else ".mod"
        source = tmp_path / f"points{suffix}"
        rows = "".join(LINE[suffix].format(*point) for point in points)
        source.write_text(HEAD[suffix] + rows)
    correct: Callable[..., object] = (
        sb.compensate_path if who == PATH_FILE else sb.compensate_program
    )

    def run() -> None:
        correct(vjm, source, tmp_path / f"{uuid4()}{source.suffix}", load=LOAD)

    ours_or_peer(benchmark, who, {PATH_FILE: 0.1}, work=TARGETS, unit="target")
    benchmark.pedantic(run, rounds=3, warmup_rounds=1)
