"""Invalid words are refused in one line that names them and the valid words.

`test_command_tree.py` tests nonsense for every option; here each error must help the user.
"""

from __future__ import annotations

import shlex
from importlib.resources import files

import pytest

import stiffbench as sb
from helpers.command_line import assert_refused, bench_here
from helpers.made_robots import arm_lines, gripper_lines, track_lines, tree_urdf
from helpers.made_samples import CSV_HEADER, CSV_ROW

CSV, URDF = (
    str(files("stiff_datasets") / name)
    for name in ("data/fanuc_r2000ic.csv", "robots/fanuc_r2000ic.urdf")
)
RUN = f"run --model vjm --data {CSV} --urdf {URDF}"
FIT = "fit --model vjm --dataset kr10-twin --output"
READ = "fit --model vjm --output new --data good.csv --urdf"
PREDICT = "predict --model vjm.stiff --input good.csv --output"
CORRECT = "path compensate --model vjm.stiff --path path.csv --output c.csv"
HOLD = "path example --urdf track.urdf --load 0,10,-40,0,0,0 --output e.csv"
PLAN = "data plan --output p.csv"

REFUSED = {
    "run": ["--model", "zero, mean"],
    "run --model vjm --splits 2 --splits 3": ["--splits: given more than once"],
    "run vjm": ["unexpected argument 'vjm'", "bench run --model vjm"],
    "run --model vjm --splits": ["--splits: a value is missing"],
    "run --model vjm --set holdout.test_fraction=0.999": ["151 poses", "test_fraction"],
    "run --model vjm --data x.csv": ["x.csv", "--urdf"],
    "run --model vjm --data no.csv --robot ur5": ["no.csv: cannot be"],
    "run --model vjm --output bytes": ["--output bytes", "is a file"],
    "run --model vjm --output bytes/out": ["--output bytes/out", "cannot create"],
    "run --model vjm --tcp 0,0,0": ["--tcp"],
    "run --model vjm --no-isolate --jobs 2": ["--no-isolate: --jobs 2 needs a process"],
    "run --model vjm --jobs 2 --dask tcp://a:1": ["--jobs 2: omit it with --dask"],
    "run --model vjm --memory 8": ["--memory", "'8' (valid: a size", "2GiB"],
    "run --model vjm --dask tcp:here": [
        "--dask 'tcp:here': not an address (valid: tcp://HOST:PORT)"
    ],
    "run --model vjm --no-torque": ["--no-torque", "--data"],
    f"{RUN} --tcp 1,2": ["--tcp", "'1,2'", "in m"],
    f"{RUN} --tcp 80,0,60": ["tcp", "in m"],
    "run --model vjm --data forces.csv --robot kr10-r1100-2": ["missing tx_Nm", "no-torque"],
    "run --model vjm --data plan.csv --robot kr10-r1100-2": [
        "not filled in",
        "1 of 1 row",
        "dx_mm, dy_mm, dz_mm",
    ],
    "run --model vjm --dataset kr10-measured": [
        "bench data register FILE.csv --dataset kr10-measured"
    ],
    f"{READ} bytes": ["bytes: cannot read the URDF", "UTF-8"],
    f"{FIT} vjm.stiff": ["vjm.stiff: exists"],
    f"{FIT} new --data good.csv --robot ur5": ["--dataset", "--data"],
    f"{PREDICT} good.csv": ["good.csv: exists"],
    f"{PREDICT} out.xlsx": [".csv, .parquet"],
    "predict --model bytes --input good.csv --output y": ["bytes: not a model file"],
    "export --model vjm.stiff --output good.csv": ["good.csv: exists"],
    "show vjm@tcp=fit": ["'vjm@tcp=fit'", "'vjm'"],
    "leaderboard --results absent": ["--results absent", "no such folder"],
    "compare a b --results folder": ["--results folder", "no results"],
    "merge absent --output new": ["absent", "no such folder"],
    "table 9 --results none": ["--results none", "bench reproduce"],
    "table 3 --results folder": ["table 3"],
    "figure 9 --results none": ["no such folder", "bench reproduce"],
    "report --results folder --output page.pdf": ["page.pdf", ".html or .htm"],
    "report --results folder --output page.html --metric speed": ["speed"],
    "reproduce intervls": ["unknown study 'intervls'", "did you mean 'intervals'"],
    "reproduce mine.toml": ["mine.toml: cannot be read"],
    "run --study mine.toml --splits 3": ["--splits", "--study", "mine.toml"],
    "figure regresion": ["did you mean 'regression'"],
    "figure 4 --results runs": ["results runs", "figure 4"],
    "data info bytes": ["bytes: not a file of samples", ".csv"],
    "data info bytes.xlsx --robot ur5": ["bytes.xlsx: not an Excel file"],
    "data info good.csv": ["good.csv", "--urdf", "--robot"],
    "data info robot-twin": ["robot-twin@constants=..."],
    "data info kr10-twin --robot ur5": ["kr10-twin: not a file of samples"],
    "data info good.csv --set a.b=1": ["--set 'a.b=1'", "good.csv has no options"],
    f"{PLAN} --robot kr11": ["robot 'kr11'", "kr10-r1100-2"],
    f"{PLAN} --robot ur5 --urdf x": ["--robot ur5", "one of"],
    f"{PLAN} --poses 9 --clearance 5": ["clearance", "5 m"],
    f"{PLAN} --model vjm": ["--after", "model"],
    f"{PLAN} --urdf track.urdf --poses 8": ["--payload", "in kg"],
    f"{PLAN} --urdf arm.urdf --payload 3 --tip hand_tpc": ["--tip", "did you mean 'hand_tcp'"],
    "data plan --output p.parquet": ["p.parquet", ".csv"],
    "data simulate --twin ur6 --output s.csv": ["--twin 'ur6'", "ur5"],
    "data simulate --twin x.toml --output s.csv": ["x.toml: cannot be read"],
    "data simulate --output s.xls": ["s.xls", ".csv or .parquet"],
    f"{CORRECT} --tool 0,0,200,0,0,0": ["--tool", "60,0,80 mm"],
    f"{CORRECT} --tool 0,0,200": ["--tool", "six finite numbers"],
    f"{CORRECT} --load 0,10,-40,0,0,0": ["--load", "has load columns"],
    f"{CORRECT} --load 0,0,1e9,0,0,0": ["--load", "1e+09", "1e+06"],
    f"{CORRECT} --start 0,0,0": ["--start", "3 joint positions", "the 6 of"],
    f"{CORRECT} --coverage 0.99": ["--coverage 0.99", "38 poses"],
    f"{CORRECT} --figure p.gif": ["p.gif", ".png"],
    "path example --model vjm.stiff --robot ur5 --output e.csv": ["--robot", "give only one"],
    "path example --model bytes --output e.csv": ["bytes: not a model file"],
    "path example --model vjm.stiff --size 3000 --points 5 --output e.csv": [
        "3000 mm",
        "smaller size",
    ],
    HOLD: ["--hold none", "to_cart [mm]", "to_a6 [deg]", "valid: 1 of "],
    f"{HOLD} --hold 1=5 --hold J3=0": ["--hold 1, J3 (valid: 1 of "],
    f"{HOLD} --hold to_cart": ["--hold to_cart", "mm"],
    f"{HOLD} --hold to_cart=5000": ["--hold to_cart=5000", "0..4000 mm"],
    f"{HOLD} --hold to_crt=5": ["'to_crt'", "did you mean 'to_cart'"],
    f"{HOLD} --hold to_cart=nan": ["'to_cart=nan'", "JOINT=VALUE"],
}
"""Words of `bench` -> texts that its error must contain."""


@pytest.fixture(scope="module")
def vjm_file(tmp_path_factory, twin):
    path = tmp_path_factory.mktemp("model") / "vjm.stiff"
    sb.make_model("vjm").fit(twin).save(path)
    return path


@pytest.fixture()
def folder(tmp_path, monkeypatch, vjm_file):
    monkeypatch.setenv("STIFFBENCH_HOME", str(tmp_path / "home"))
    (tmp_path / "folder").mkdir()
    names, values = CSV_HEADER.split(","), CSV_ROW.split(",")
    tables = {
        "good.csv": (names, values),
        "forces.csv": (names[:12] + names[15:], values[:12] + values[15:]),
        "plan.csv": (names, [*values[:15], "", "", ""]),
        "path.csv": (
            "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,fx_N,fy_N,fz_N".split(","),
            "700,0,400,180,0,180,0,10,-40".split(","),
        ),
    }
    for name, lines in tables.items():
        (tmp_path / name).write_text("\n".join(map(",".join, lines)) + "\n")
    for name in ("bytes", "bytes.xlsx"):
        (tmp_path / name).write_bytes(b"\xff\x00\x80")
    (tmp_path / "vjm.stiff").write_bytes(vjm_file.read_bytes())
    tree_urdf(tmp_path / "arm.urdf", arm_lines("base", "a", 6) + gripper_lines("a6"))
    tree_urdf(tmp_path / "track.urdf", track_lines())
    return tmp_path


def contents(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize("words", REFUSED)
def test_invalid_words_are_refused_in_one_line_and_nothing_is_written(words, folder):
    before = contents(folder)
    done = bench_here(*shlex.split(words), cwd=folder)
    assert_refused(done, *REFUSED[words])
    assert contents(folder) == before


PLUGIN_HEAD = "from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo, ProtocolInfo\n"


@pytest.mark.parametrize(
    ("body", "words", "parts"),
    [
        (
            "class A:\n    def __init__(self, *, needed): ...\n"
            "MODELS = ModelInfo(key='a', target=A, summary='s')\n",
            ["--model", "a"],
            ["'a' needs", "a@needed=..."],
        ),
        (
            "class A: ...\nMODELS = [ModelInfo(key='a', target=A, summary='s')]\n",
            ["--model", "a"],
            ["'a'", "fit", "predict"],
        ),
        (
            "class D:\n    def load(self): return None\n"
            "DATASETS = [DatasetInfo(key='d', target=D, summary='s', kind='measured')]\n",
            ["--model", "vjm", "--dataset", "d"],
            ["'d'", "NoneType", "BenchmarkData"],
        ),
        (
            "class P: ...\nPROTOCOLS = [ProtocolInfo(key='p', target=P, summary='s')]\n",
            ["--model", "vjm", "--protocol", "p"],
            ["'p'", "splits"],
        ),
    ],
)
def test_a_plugin_that_does_not_meet_the_contract_is_refused_in_one_line(
    tmp_path, body, words, parts
):
    path = tmp_path / "plug.py"
    path.write_text(PLUGIN_HEAD + body)
    assert_refused(bench_here("run", "--plugin", str(path), *words, cwd=tmp_path), *parts)
