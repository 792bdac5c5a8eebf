"""Export stored results as records for other programs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from stiff_bench.parameter_types import FilePath
from stiff_bench.results.results import Results
from stiff_bench.store.database import has_results, read_manifests, why_no_results
from stiff_bench.submissions.export import ExportFormat, export_records
from stiff_bench.submissions.record import Record
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import CellResult


def records_of(folder: Path, results: Iterable[CellResult]) -> list[Record]:
    """Return the records of some results of a folder."""
    environments = {run.run_id: run.environment for run in read_manifests(folder)}
    return [Record.of(result, environments.get(result.run_id, {})) for result in results]


def export_results(results: Results, output: FilePath, fmt: ExportFormat = "jsonl") -> int:
    """Write one record per fit: identity, hashes, metrics, predictions and cost.

    Failed fits have a record, too. Lengths are in mm. The fields are described in
    results/schema/record.json, a JSON Schema.

    Args:
        results: results, such as `open_results("results/runs")`.
        output: file to write; an existing one is replaced.
        fmt: format of the file.

    Returns:
        Number of records.

    Raises:
        ConfigError: nothing is selected, or the package for Parquet is not installed.
        StoreError: the folder has no results, or the file cannot be written.
    """
    if not has_results(results.folder):
        raise StoreError(f"{results.folder}: {why_no_results(results.folder)}")
    fits: Sequence[CellResult] = results.every
    if not fits:
        raise ConfigError(f"{results.folder}: no results to export; select other models or data")
    export_records(records_of(results.folder, fits), Path(output), fmt)
    return len(fits)
