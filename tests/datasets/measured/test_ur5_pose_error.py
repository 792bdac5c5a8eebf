"""The fetched UR5 pose errors: how the files come, what is refused, what the numbers mean."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import replace
from hashlib import sha256
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from stiff_datasets.measured import ur5_pose_error
from stiff_datasets.measured.ur5_pose_error import COMMIT, FILES, TCP, Ur5PoseError, fetch, missing
from stiff_protocols.contract.errors import DataError

SHARED = Path(__file__).parents[4] / "shared" / "data" / "ur5_wam_jacobi"
HEADER = "step_order,x_t,y_t,z_t,x_dif,y_dif,z_dif,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6"
GRID, RANDOM = (file.name for file in FILES)

real_data = pytest.mark.skipif(
    not SHARED.is_dir(), reason="the UR5 readings are not beside this checkout"
)


@pytest.fixture(autouse=True)
def home(monkeypatch, tmp_path):
    monkeypatch.setenv("STIFFBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("NO_PROXY", "*")  # the only server is on this machine
    return tmp_path / "home"


@pytest.fixture()
def published(monkeypatch, tmp_path):
    """A small stand-in for the source's folder, and its checksums in place of the real ones."""
    folder = tmp_path / "published"
    (folder / "UR5").mkdir(parents=True)
    small = []
    for file, rows in zip(FILES, (3, 2), strict=True):
        lines = [f"{i},-400,0,100,-2,{i},0.5,10,20,30,40,50,180" for i in range(rows)]
        content = "\n".join([HEADER, *lines, ""]).encode()
        (folder / "UR5" / file.name).write_bytes(content)
        small.append(replace(file, sha256=sha256(content).hexdigest()))
    monkeypatch.setattr(ur5_pose_error, "FILES", tuple(small))
    return folder


class Handler(SimpleHTTPRequestHandler):
    """Keeps the paths that were asked for; may stop in the middle of a file."""

    asked: ClassVar[list[str]]
    stops_halfway = False

    def do_GET(self):
        self.asked.append(self.path)
        if not self.stops_halfway:
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Length", "1000")
        self.end_headers()
        self.wfile.write(b"step_order,x_t")
        self.close_connection = True

    def log_message(self, *args):
        pass


@pytest.fixture()
def server(published):
    """A web server on this machine with the stand-in files: (base URL, its handler class)."""

    class Served(Handler):
        asked: ClassVar[list[str]] = []

        def __init__(self, *args):
            super().__init__(*args, directory=str(published))

    with ThreadingHTTPServer(("127.0.0.1", 0), Served) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}/", Served
        running.shutdown()
        thread.join()


def test_a_download_brings_both_files_and_a_second_one_what_is_wrong_alone(home, server):
    url, handler = server
    assert missing() == "not fetched: bench data fetch ur5-pose-error"
    paths = fetch(None, base_url=url)
    assert [path.name for path in paths] == [GRID, RANDOM]
    assert all(path.parent == home / "ur5_pose_error" for path in paths)
    assert sorted(handler.asked) == [f"/UR5/{GRID}", f"/UR5/{RANDOM}"]
    assert missing() == ""
    assert fetch(None, base_url=url) == paths and len(handler.asked) == 2
    good = paths[1].read_bytes()
    paths[1].write_bytes(good[:-5])
    fetch(None, base_url=url)
    assert paths[1].read_bytes() == good and handler.asked[2:] == [f"/UR5/{RANDOM}"]


@pytest.mark.parametrize("inside", ["UR5", "."])
def test_files_are_taken_from_a_folder_or_its_ur5_folder(home, published, inside):
    fetch(published / inside)
    assert missing() == ""
    for name in (GRID, RANDOM):
        copied = home / "ur5_pose_error" / name
        assert copied.read_bytes() == (published / "UR5" / name).read_bytes()


@pytest.mark.parametrize("way", ["download", "folder"])
def test_a_wrong_checksum_is_named_and_leaves_nothing(home, server, published, way):
    changed = b"something else"
    (published / "UR5" / RANDOM).write_bytes(changed)
    with pytest.raises(DataError) as caught:
        fetch(None, base_url=server[0]) if way == "download" else fetch(published)
    message = str(caught.value)
    for part in (
        RANDOM,
        sha256(changed).hexdigest(),
        ur5_pose_error.FILES[1].sha256,
        "bench data fetch ur5-pose-error --from DIR",
    ):
        assert part in message
    assert "\n" not in message
    assert not home.exists()


def test_a_missing_file_is_named_with_the_places_looked_at(home, published):
    (published / "UR5" / RANDOM).unlink()
    with pytest.raises(DataError, match=rf"{RANDOM}: no such file, nor .*--from DIR"):
        fetch(published)
    with pytest.raises(DataError, match="no such file"):
        fetch(published / "absent")
    assert not home.exists()


@pytest.mark.parametrize("why", ["elsewhere", "stops", "no network"])
def test_a_download_that_fails_is_one_clear_error_and_leaves_nothing(home, server, why):
    url, handler = server
    handler.stops_halfway = why == "stops"
    if why == "elsewhere":
        url += "elsewhere/"
    elif why == "no network":
        with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as closed:
            url = f"http://127.0.0.1:{closed.server_port}/"
    with pytest.raises(DataError, match=rf"{GRID}: .*--from DIR") as caught:
        fetch(None, base_url=url)
    assert "\n" not in str(caught.value)
    assert ("cannot be downloaded" in str(caught.value)) or why == "stops"
    assert not home.exists()


def test_the_columns_become_si_units_with_no_wrench_and_unique_poses(published):
    fetch(published)
    data = Ur5PoseError().load()
    samples = data.samples
    assert samples.group.tolist() == ["grid"] * 3 + ["random"] * 2
    assert samples.pose_id.tolist() == ["grid-0", "grid-1", "grid-2", "random-0", "random-1"]
    np.testing.assert_allclose(np.rad2deg(samples.q[0]), [10, 20, 30, 40, 50, 180])
    np.testing.assert_allclose(samples.deflection[1], [-2e-3, 1e-3, 0.5e-3])
    assert not samples.wrench.any()
    assert data.robot.name == "ur5"
    np.testing.assert_allclose(data.robot.tcp, np.add(TCP, [0, 0, 0.0823]))  # last joint's frame


def test_a_file_that_is_not_fetched_or_changed_since_is_refused(published):
    with pytest.raises(DataError, match=r"not fetched; run: bench data fetch ur5-pose-error$"):
        Ur5PoseError().load()
    _, path = fetch(published)
    path.write_bytes(path.read_bytes().replace(b"-2,1,", b"-9,1,"))
    with pytest.raises(DataError, match=rf"{RANDOM}: sha256 .*expected .*run: bench data fetch"):
        Ur5PoseError().load()


def test_asking_what_is_missing_imports_nothing_heavy(home):
    program = (
        "import sys; from stiff_datasets.measured import registered, ur5_pose_error as u; "
        "print(u.missing(), registered.missing(), sep='|'); "
        "print(sorted({'numpy', 'pandas', 'pinocchio', 'pooch', 'tomli_w'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "STIFFBENCH_HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    )
    reasons, heavy = done.stdout.splitlines()
    assert reasons.split("|")[0].startswith("not fetched")
    assert reasons.split("|")[1].startswith("no file registered")
    assert heavy == "[]"


def test_the_data_card_names_source_licence_checksums_and_that_it_is_no_stiffness():
    card = (files("stiff_datasets") / "data" / "ur5_pose_error.md").read_text(encoding="utf-8")
    for fact in (
        COMMIT,
        *(file.name for file in FILES),
        *(file.sha256 for file in FILES),
        "Copyright (c) 2025 Paul Jacobi",
        "Permission is hereby granted",
        "NO stiffness data",
        str(TCP),
    ):
        assert fact in card


@real_data
def test_the_real_files_give_1000_grid_and_20_random_poses():
    fetch(SHARED)
    samples = Ur5PoseError().load().samples
    assert [(samples.group == part).sum() for part in ("grid", "random")] == [1000, 20]
    assert len(set(samples.pose_id)) == 1020
    error_mm = np.linalg.norm(samples.deflection, axis=1) * 1000
    assert (error_mm.min(), error_mm.max()) == pytest.approx((2.04, 4.41), abs=0.005)
    assert error_mm[samples.group == "random"].mean() == pytest.approx(2.5664, abs=0.002)


@real_data
def test_the_error_is_measured_minus_target_because_the_sum_is_a_reading_of_six_decimals():
    for name in (GRID, RANDOM):
        table = pd.read_csv(SHARED / "UR5" / name)
        target = table[["x_t", "y_t", "z_t"]].to_numpy()
        error = table[["x_dif", "y_dif", "z_dif"]].to_numpy()
        measured, other = target + error, target - error
        assert np.abs(measured - measured.round(6)).max() < 1e-12
        assert (np.abs(other - other.round(6)) > 1e-9).mean() > 0.99
