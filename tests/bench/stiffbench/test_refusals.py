"""Invalid words are refused in one line that names them and the valid words.

`test_command_tree.py` tests nonsense for every option; here each error must help the user.
"""

from __future__ import annotations

import shlex
from importlib.resources import files

import pytest

from helpers.command_line import assert_refused, bench_here
from helpers.made_robots import track_lines, tree_urdf
from helpers.made_samples import CSV_HEADER, CSV_ROW

CSV, URDF = (
    str(files("stiff_datasets") / name)
    for name in ("data/fanuc_r2000ic.csv", "robots/fanuc_r2000ic.urdf")
)
RUN = f"run --model vjm --data {CSV} --urdf {URDF}"
FIT = "fit --model vjm --dataset kr10-twin --output"
PREDICT = "predict --model vjm.stiff --input good.csv --output"
CORRECT = "path compensate --model vjm.stiff --path path.csv --output c.csv"
HOLD = "path example --urdf track.urdf --load 0,10,-40,0,0,0 --output e.csv"
OWN_FILE = "run --model vjm --data good.csv"
PLAN = "data plan --output p.csv"

REFUSED = {
    "run": ["--model", "zero, mean"],
    "run --model vjm --splits 2 --splits 3": ["--splits specified multiple times"],
    "run vjm": ["'vjm'", "bench run --model vjm"],
    "run --model vjm --splits": ["--splits requires an argument"],
    "run --model vjm --data x.csv": ["x.csv", "--urdf"],
    "run --model vjm --output bytes": ["--output bytes", "is a file"],
    "run --model vjm --no-isolate --jobs 2": ["--no-isolate: --jobs 2 needs a process"],
    "run --model vjm --jobs 2 --dask tcp://a:1": ["--jobs 2: omit it with --dask"],
    "run --model vjm --no-torque": ["--no-torque", "--data"],
    f"{RUN} --tcp 1,2": ["--tcp", "'1,2'", "in m"],
    f"{RUN} --tcp 80,0,60": ["tcp", "in m"],
    "run --model vjm --data forces.csv --robot kr10-r1100-2": ["missing tx_Nm", "no-torque"],
    "run --model vjm --dataset kr10-measured": [
        "bench data register FILE.csv --dataset kr10-measured"
    ],
    f"{FIT} new --data good.csv --robot ur5": ["--dataset", "--data"],
    f"{PREDICT} out.xlsx": [".csv, .parquet"],
    "show vjm@tcp=fit": ["'vjm@tcp=fit'", "'vjm'"],
    "compare a b --results folder": ["--results folder", "no results"],
    "table 3 --results folder": ["table 3 is fitted here and reads none"],
    "table 9 --results none": ["--results none", "bench reproduce"],
    "report --results folder --output page.pdf": ["page.pdf", ".html or .htm"],
    "reproduce intervls": ["unknown study 'intervls'", "did you mean 'intervals'"],
    "run --study mine.toml --splits 3": ["--splits", "--study", "mine.toml"],
    "figure 4 --results runs": ["results runs", "figure 4"],
    "data info good.csv": ["good.csv", "--urdf", "--robot"],
    "data info robot-twin": ["robot-twin@constants=..."],
    "data info kr10-twin --robot ur5": ["kr10-twin: not a file of samples"],
    "data info good.csv --set a.b=1": ["--set 'a.b=1'", "good.csv has no options"],
    f"{PLAN} --model vjm": ["--after", "model"],
    f"{PLAN} --urdf track.urdf --poses 8": ["--payload", "in kg"],
    f"{CORRECT} --tool 0,0,200,0,0,0": ["--tool", "60,0,80 mm"],
    f"{CORRECT} --load 0,10,-40,0,0,0": ["--load", "has load columns"],
    f"{CORRECT} --load 0,0,1e9,0,0,0": ["--load", "1e+09", "1e+06"],
    f"{CORRECT} --start 0,0,0": ["--start", "3 joint positions", "the 6 of"],
    f"{CORRECT} --coverage 0.99": ["--coverage 0.99", "38 poses"],
    "path example --model vjm.stiff --robot ur5 --output e.csv": ["--robot", "give only one"],
    HOLD: ["--hold none", "to_cart [mm]", "to_a6 [deg]", "valid: 1 of "],
    f"{HOLD} --hold 1=5 --hold J3=0": ["track cannot drive", "held joints"],
    f"{HOLD} --hold to_cart": ["--hold to_cart", "mm"],
    f"{HOLD} --hold to_cart=5000": ["--hold to_cart=5000", "0..4000 mm"],
    f"{HOLD} --hold to_cart=nan": ["'to_cart=nan'", "JOINT=VALUE"],
    f"{HOLD} --hold to_cart=1 --hold to_cart=2": ["--hold", "to_cart", "twice"],
    f"{OWN_FILE} --urdf track.urdf": ["--hold to_cart=VALUE"],
    f"{OWN_FILE} --urdf track.urdf --hold rail=1": ["--hold", "'rail'", "to_cart"],
    f"{OWN_FILE} --urdf track.urdf --hold 1=5000": ["--hold 1=5000", "0..4000 mm"],
    f"{OWN_FILE} --urdf track.urdf --base chart": ["--base", "'chart'", "did you mean 'cart'"],
    f"{OWN_FILE} --robot ur5 --hold J1=0": ["--hold J1 requires --urdf"],
    f"{OWN_FILE} --robot ur5 --base base": ["--base base requires --urdf"],
    "data register good.csv --robot ur5 --hold J1=0": ["--hold J1 requires --urdf"],
}
"""Words of `bench` -> texts that its error must contain."""


@pytest.fixture()
def folder(tmp_path, monkeypatch, vjm_file):
    monkeypatch.setenv("STIFFBENCH_HOME", str(tmp_path / "home"))
    (tmp_path / "folder").mkdir()
    names, values = CSV_HEADER.split(","), CSV_ROW.split(",")
    tables = {
        "good.csv": (names, values),
        "forces.csv": (names[:12] + names[15:], values[:12] + values[15:]),
        "path.csv": (
            "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,fx_N,fy_N,fz_N".split(","),
            "700,0,400,180,0,180,0,10,-40".split(","),
        ),
    }
    for name, lines in tables.items():
        (tmp_path / name).write_text("\n".join(map(",".join, lines)) + "\n")
    (tmp_path / "bytes").write_bytes(b"\xff\x00\x80")
    (tmp_path / "vjm.stiff").write_bytes(vjm_file.read_bytes())
    tree_urdf(tmp_path / "track.urdf", track_lines())
    return tmp_path


def contents(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.slow
@pytest.mark.parametrize("words", REFUSED)
def test_invalid_words_are_refused_in_one_line_and_nothing_is_written(words, folder):
    before = contents(folder)
    done = bench_here(*shlex.split(words), cwd=folder)
    assert_refused(done, *REFUSED[words])
    assert contents(folder) == before


PLUGIN_HEAD = "from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, ProtocolInfo\n"


BAD_PLUGINS = {
    "model": ("class Own: ...", "MODELS = [ModelInfo(", ["fit", "predict"]),
    "dataset": (
        "class Own:\n    def load(self): return None",
        "DATASETS = [DatasetInfo(kind='measured', ",
        ["NoneType", "BenchmarkData"],
    ),
    "protocol": ("class Own: ...", "PROTOCOLS = [ProtocolInfo(", ["splits"]),
}


@pytest.mark.parametrize("kind", BAD_PLUGINS)
def test_a_plugin_that_does_not_meet_the_contract_is_refused_in_one_line(kind, tmp_path):
    class_text, entry, parts = BAD_PLUGINS[kind]
    text = f"{PLUGIN_HEAD}{class_text}\n{entry}key='own', target=Own, summary='s')]\n"
    (tmp_path / "plug.py").write_text(text)
    words = ["--model", "own" if kind == "model" else "vjm"]
    words += [] if kind == "model" else [f"--{kind}=own"]
    done = bench_here("run", "--plugin", "plug.py", *words, cwd=tmp_path)
    assert_refused(done, "'own'", *parts)
