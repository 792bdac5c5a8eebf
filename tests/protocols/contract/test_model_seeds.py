"""A cell's seed may not move: with another one every random model gives other numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stiff_protocols.contract.record import Cell

NOISE = Cell(
    model="knn",
    model_params={"neighbours": 3, "weights": "uniform"},
    dataset="kr10-twin",
    dataset_params={"torques": "hook", "specimen": 9},
    data_sha256="3c" * 32,
    protocol="sensor-noise",
    protocol_params={"levels": "0,1,5,20", "noise": 1.0, "bias": 0.0},
    split_index=1,
    split_sha256="d4" * 32,
    seed=1,
    condition="noise x5",
    rows_sha256="e5" * 32,
)

CELLS = (
    Cell(
        model="vjm",
        model_params={},
        dataset="kr10-twin",
        dataset_params={},
        data_sha256="0f" * 32,
        protocol="holdout",
        protocol_params={},
        split_index=0,
        split_sha256="a1" * 32,
        seed=0,
    ),
    Cell(
        model="gp",
        model_params={"kernel": "rbf", "ard": False, "restarts": 2},
        dataset="kr10-twin",
        dataset_params={"specimen": 3},
        data_sha256="1e" * 32,
        protocol="holdout",
        protocol_params={"test_fraction": 0.2, "validation_fraction": 0.2},
        split_index=0,
        split_sha256="a1" * 32,
        seed=0,
        coverage=0.9,
    ),
    Cell(
        model="ft-mlp",
        model_params={"freeze": "layers:1,2", "epochs": None, "learning_rate": 1e-3},
        dataset="fanuc-r2000ic",
        dataset_params={},
        data_sha256="2d" * 32,
        protocol="kfold",
        protocol_params={"folds": 5},
        split_index=4,
        split_sha256="b2" * 32,
        seed=7,
    ),
    Cell(
        model="mlp-pretrained",
        model_params={"recipe": "paper", "width": 380},
        dataset="fanuc-r2000ic",
        dataset_params={},
        data_sha256="2d" * 32,
        protocol="leave-one-out",
        protocol_params={},
        split_index=42,
        split_sha256="c3" * 32,
        seed=7,
        coverage=0.8,
    ),
    NOISE,
    replace(NOISE, split_sha256="f6" * 32, coverage=0.5, condition="noise x20"),
    Cell(
        model="dt-cnn",
        model_params={"alignment": "coral", "supervision": "none"},
        dataset="kr10-twin",
        dataset_params={"specimen": 1},
        data_sha256="4b" * 32,
        protocol="cross-robot",
        protocol_params={"test_fraction": 0.25},
        split_index=2,
        split_sha256="07" * 32,
        seed=2**32 + 5,
        source_sha256="5a" * 32,
    ),
    Cell(
        model="vjm-gp",
        model_params={"physics": "vjm-full"},
        dataset="my-robot-ü",
        dataset_params={},
        data_sha256="69" * 32,
        protocol="sample-efficiency",
        protocol_params={"sizes": "10,20,40", "folds": 5},
        split_index=11,
        split_sha256="18" * 32,
        seed=3,
        coverage=0.95,
        condition="n = 20",
    ),
    Cell(
        model="sklearn:ensemble.RandomForestRegressor",
        model_params={"n_estimators": 10, "max_depth": None, "bootstrap": True},
        dataset="kr10-twin",
        dataset_params={},
        data_sha256="0f" * 32,
        protocol="nested",
        protocol_params={"grid": "default", "search": "grid", "trials": 20, "inner_folds": 3},
        split_index=0,
        split_sha256="29" * 32,
        seed=0,
    ),
    Cell(
        model="a-plugin",
        model_params={"members": 20, "angles": "sincos"},
        dataset="kr10-twin",
        dataset_params={},
        data_sha256="0f" * 32,
        protocol="extrapolation-load",
        protocol_params={"share": 0.8, "by": None},
        split_index=9,
        split_sha256="3a" * 32,
        seed=123,
        coverage=0.9,
        condition="largest forces",
        rows_sha256="4b" * 32,
        source_sha256="5c" * 32,
    ),
)
SEEDS = (
    1010786622,
    4170104928,
    4068861055,
    1183597059,
    620147820,
    620147820,
    402898232,
    921810196,
    295025881,
    2852163926,
)


@pytest.mark.parametrize(("cell", "seed"), [*zip(CELLS, SEEDS, strict=True)])
def test_a_cell_has_the_seed_that_it_always_had(cell: Cell, seed: int) -> None:
    assert cell.model_seed == seed
