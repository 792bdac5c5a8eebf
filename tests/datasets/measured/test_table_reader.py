"""Check that files return the same bits, and that errors name the place."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from stiff_datasets.measured.sample_columns import ID_COLUMNS
from stiff_datasets.measured.sample_file import check_sheet, read_samples, samples_of
from stiff_datasets.measured.table_reader import read_sheet, sample_table, write_table
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.types import Samples


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("files")


def assert_identical(samples, expected):
    for name in expected.columns:
        actual_values, expected_values = getattr(samples, name), getattr(expected, name)
        if expected_values.dtype.kind == "f":
            assert actual_values.tobytes() == expected_values.tobytes(), name  # minus zero too
        else:
            assert actual_values.tolist() == expected_values.tolist()
    assert samples.instrument_noise == expected.instrument_noise


@pytest.mark.slow
def test_other_si_numbers_are_written_as_the_nearest_and_are_exact_from_then_on(folder, rng, kr10):
    n = 2000
    pose, same = np.arange(n).astype(str), np.full(n, "1")
    q = rng.uniform(np.maximum(kr10.lower, -2), np.minimum(kr10.upper, 2), size=(n, 6))
    deflection = rng.uniform(-0.05, 0.05, size=(n, 3))
    made = Samples(q, rng.normal(size=(n, 6)), deflection, pose, same, same)
    write_table(folder / "made.csv", [sample_table(made, kr10)])
    read = read_samples(folder / "made.csv", kr10)
    assert read.wrench.tobytes() == made.wrench.tobytes()
    for name in ("q", "deflection"):
        np.testing.assert_array_max_ulp(getattr(read, name), getattr(made, name), maxulp=1)
    table = sample_table(read, kr10)
    for name in ("again.csv", "again.parquet"):
        write_table(folder / name, [table.iloc[:1500], table.iloc[1500:]])
        assert_identical(read_samples(folder / name, kr10), read)


@pytest.fixture()
def table(kr10):
    """Return three valid rows of a KR10."""
    n = 3
    q = np.deg2rad([[10.0, -60, 70, 0, 40, 0], [20, -50, 60, 0, 30, 0], [30, -40, 50, 0, 20, 5]])
    wrench, deflection = np.full((n, 6), 5.0), np.full((n, 3), 1e-4)
    pose, same = np.array(["P1", "P2", "P3"]), np.full(n, "1")
    return sample_table(Samples(q, wrench, deflection, pose, same, same), kr10)


def test_all_problems_are_collected_and_the_first_says_how_many_there_are(tmp_path, kr10, table):
    table = table.astype(object)
    table.loc[0, "fx_N"], table.loc[1, "q2_deg"], table.loc[1, "group"] = "abc", 50.0, ""
    table.to_csv(tmp_path / "my.csv", index=False)
    problems = check_sheet(read_sheet(tmp_path / "my.csv"), kr10).problems
    assert [(p.row, p.column) for p in problems] == [(2, "fx_N"), (3, "group"), (3, "q2_deg")]
    message = r"row 2, column fx_N: 'abc', .* \(and 2 more; bench data validate lists them\)"
    with pytest.raises(DataError, match=message):
        read_samples(tmp_path / "my.csv", kr10)


@pytest.mark.parametrize("dtype", ["float32", "int64"])
def test_a_parquet_file_holds_numbers_as_they_are_and_counts_rows_from_one(
    tmp_path, kr10, table, dtype
):
    path = tmp_path / "my.parquet"
    table["fx_N"] = np.array([999999.0, 0.1, -3.0]).astype(dtype)
    table["load_id"] = [1, 2, 3]
    table.to_parquet(path)
    samples = read_samples(path, kr10)
    assert samples.wrench[:, 0].tolist() == table["fx_N"].astype(float).tolist()
    assert samples.load_id.tolist() == ["1", "2", "3"]
    table.assign(fx_N=[1.0, np.nan, 1.0]).to_parquet(path)
    with pytest.raises(DataError, match=r"my\.parquet: row 2, column fx_N: 'nan'"):
        read_samples(path, kr10)


@pytest.mark.parametrize("name", ["", " P1", "P\n1", "P1\x85", "\ud800", "#1"])
def test_names_that_would_not_come_back_from_a_file_are_refused(tmp_path, kr10, table, name):
    names = pd.Series([name, "P2", "P3"], dtype=object)
    table = table.assign(**dict.fromkeys(ID_COLUMNS, names))
    with pytest.raises(DataError, match=r"my\.csv: row 0, column pose_id: .* expected a name"):
        samples_of(tmp_path / "my.csv", table, kr10, "")


def test_what_cannot_be_written_is_named(tmp_path, kr10, table):
    assert (table.loc[0, "q2_deg"], table.loc[0, "dx_mm"]) == (-60.0, 0.1)  # a file's units
    with pytest.raises(StoreError, match=r"copy\.csv: cannot be written"):
        write_table(tmp_path / "absent" / "copy.csv", [table])
    five_joint_samples = Samples(*(np.ones((1, n)) for n in (5, 6, 3)), *[np.array(["1"])] * 3)
    with pytest.raises(DataError, match="samples have 5 joint angles"):
        sample_table(five_joint_samples, kr10)
