"""A cell's seed may not move: with another one every random model gives other numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stiff_protocols.contract.record import Cell


def cell(model, dataset, data, protocol, split_index, split, seed, **others):
    """A cell whose hashes are two digits, repeated."""
    others = {
        name: value * 32 if name.endswith("sha256") else value for name, value in others.items()
    }
    options = {f"{name}_params": {} for name in ("model", "dataset", "protocol")}
    return Cell(
        **options | others,
        model=model,
        dataset=dataset,
        data_sha256=data * 32,
        protocol=protocol,
        split_index=split_index,
        split_sha256=split * 32,
        seed=seed,
    )


NOISE = cell(
    *("knn", "kr10-twin", "3c", "sensor-noise", 1, "d4", 1),
    model_params={"neighbours": 3, "weights": "uniform"},
    dataset_params={"torques": "hook", "specimen": 9},
    protocol_params={"levels": "0,1,5,20", "noise": 1.0, "bias": 0.0},
    condition="noise x5",
    rows_sha256="e5",
)
CELLS = (
    cell("vjm", "kr10-twin", "0f", "holdout", 0, "a1", 0),
    NOISE,
    replace(NOISE, split_sha256="f6" * 32, coverage=0.5, condition="noise x20"),
    cell(
        *("dt-cnn", "kr10-twin", "4b", "cross-robot", 2, "07", 2**32 + 5),
        model_params={"alignment": "coral", "supervision": "none"},
        dataset_params={"specimen": 1},
        protocol_params={"test_fraction": 0.25},
        source_sha256="5a",
    ),
    cell(
        *("vjm-gp", "my-robot-ü", "69", "sample-efficiency", 11, "18", 3),
        model_params={"physics": "vjm-full"},
        protocol_params={"sizes": "10,20,40", "folds": 5},
        coverage=0.95,
        condition="n = 20",
    ),
    cell(
        *("a-plugin", "kr10-twin", "0f", "extrapolation-load", 9, "3a", 123),
        model_params={"members": 20, "angles": "sincos"},
        protocol_params={"share": 0.8, "by": None},
        coverage=0.9,
        condition="largest forces",
        rows_sha256="4b",
        source_sha256="5c",
    ),
)
SEEDS = (1010786622, 620147820, 620147820, 402898232, 921810196, 2852163926)


@pytest.mark.parametrize(("cell", "seed"), [*zip(CELLS, SEEDS, strict=True)])
def test_a_cell_has_the_seed_that_it_always_had(cell: Cell, seed: int) -> None:
    assert cell.model_seed == seed
