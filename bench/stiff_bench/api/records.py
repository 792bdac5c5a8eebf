"""Export stored results as records for other programs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

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


def export_results(results: Results, file: Path | str, fmt: ExportFormat) -> int:
    """Write one record per fit, including failed fits, and return their number.

    Args:
        results: results, such as `open_results("results/runs")`.
        file: file to write; an existing file is replaced.
        fmt: "jsonl", "csv" or "parquet". Each line of "jsonl" follows the JSON Schema in
            results/schema/record.json.

    Raises:
        ConfigError: nothing is selected, or the package for Parquet is not installed.
        StoreError: the folder has no results, or the file cannot be written.
    """
    if not has_results(results.folder):
        raise StoreError(f"{results.folder}: {why_no_results(results.folder)}")
    fits: Sequence[CellResult] = results.every
    if not fits:
        raise ConfigError(f"{results.folder}: no results to export; select other models or data")
    export_records(records_of(results.folder, fits), Path(file), fmt)
    return len(fits)
