"""Provide the fixtures that several test files share."""

from __future__ import annotations

import os

# as the command does; OpenMP reads it when the first library that uses it is imported
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
if "PYTEST_XDIST_WORKER" in os.environ:  # `pytest -n`: one process a core
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.quick_models import twin_data
from helpers.run_requests import planned
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.plan import fits
from stiff_bench.plan.fits import FitTask
from stiff_bench.store import database as store
from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.robots.shipped_robots import shipped_chain, shipped_robot
from stiff_datasets.robots.urdf_reader import ChainModel
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples
from stiff_protocols.splits.random_splits import Holdout

KR10_TCP = (0.06, 0.0, 0.08)


SYNCHRONOUS = store.SYNCHRONOUS


@pytest.fixture(scope="session", autouse=True)
def isolated_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Use a separate cache of trainings, and transactions without disk sync."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STIFFBENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(store, "SYNCHRONOUS", "OFF")  # no test cuts the power
        yield


@pytest.fixture()
def durable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Restore the durable transactions that users have."""
    monkeypatch.setattr(store, "SYNCHRONOUS", SYNCHRONOUS)


@pytest.fixture(scope="session")
def kr10() -> Robot:
    return shipped_robot("kr10_r1100_2", tcp=KR10_TCP)


@pytest.fixture(scope="session")
def kr10_chain() -> ChainModel:
    return shipped_chain("kr10_r1100_2", KR10_TCP)


@pytest.fixture(scope="session")
def twin() -> BenchmarkData:
    return twin_data()


@pytest.fixture(scope="session")
def fanuc() -> BenchmarkData:
    return FanucR2000iC().load()


@pytest.fixture(scope="session")
def parts(twin: BenchmarkData) -> tuple[Robot, Samples, Samples, Samples]:
    """Return robot, training, validation and test samples of one KR10 twin split."""
    (split,) = Holdout().splits(twin.samples, n_splits=1, seed=0)
    train, validation, test = (
        twin.samples.take(rows) for rows in (split.train, split.validation, split.test)
    )
    return twin.robot, train, validation, test


@pytest.fixture()
def small_source(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train networks on few source poses, for tests that need no more."""
    monkeypatch.setattr("stiff_models.transfer.source_domain.POSE_BUDGET", 120)


@pytest.fixture()
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out a report's figures, which take seconds; the browser test draws them."""
    monkeypatch.setattr("stiff_bench.page.report.FIGURES", {})


@pytest.fixture()
def empty_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write pictures as empty files: drawing takes seconds, and other tests draw them."""

    def save(self: Prepared, path: Path | str) -> None:
        Path(path).touch(exist_ok=False)

    monkeypatch.setattr(Prepared, "save", save)


@pytest.fixture()
def trainings(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """List the phase of each pre-training that runs instead of coming from the cache."""
    from stiff_models.transfer import pretraining  # torch: few tests need it

    phases: list[str] = []
    train_network = pretraining.train_network

    def recording_train_network(*args: Any, **options: Any) -> Any:
        phases.append(options["phase"])
        return train_network(*args, **options)

    monkeypatch.setattr(pretraining, "train_network", recording_train_network)
    return phases


@pytest.fixture(scope="session")
def written_leaderboard(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the committed leaderboard, written again for the tests of the group "leaderboard"."""
    from helpers.written_leaderboard import write_leaderboard  # figures: few tests need them

    return write_leaderboard(tmp_path_factory.mktemp("written"))


@pytest.fixture()
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


PAGE = Path(__file__).parents[1] / "docs" / "add_a_model.md"


@pytest.fixture()
def plugin_file(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that writes the documented ten-line model under a key."""
    example = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]

    def write(key: str) -> Path:
        path = tmp_path / "my_model.py"
        path.write_text(example.replace('key="mean-deflection"', f'key="{key}"'))
        return path

    return write


@pytest.fixture()
def tasks_of(twin: BenchmarkData) -> Callable[..., list[FitTask]]:
    """Return a function that lists the fits of a run without running them."""

    def list_tasks(
        models: tuple[str, ...] = ("vjm",),
        dataset: str = "kr10-twin",
        protocol: str = "holdout",
        splits: int | None = None,
    ) -> list[FitTask]:
        options = {"models": models, "datasets": (dataset,), "protocols": (protocol,)}
        load = fits.loaded
        with pytest.MonkeyPatch.context() as patch:  # its poses take a second
            patch.setattr(
                fits, "loaded", lambda choice: twin if choice.name == "kr10-twin" else load(choice)
            )
            return list(fits.fit_tasks(planned(**options, splits=splits)))

    return list_tasks
