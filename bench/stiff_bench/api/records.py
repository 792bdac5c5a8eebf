"""Export stored results for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from stiff_bench.parameter_types import FilePath
from stiff_bench.results.results import Results
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import written_whole

ExportFormat = Literal["jsonl", "csv", "parquet"]


def export_results(
    results: Results,
    output: FilePath,
    fmt: ExportFormat = "jsonl",
    *,
    predictions: bool = False,
) -> int:
    """Write a row per fit: identity, hashes, metrics and cost; lengths are in mm.

    They are the rows of `open_results().frame()`. Failed fits have a row, too.

    Args:
        results: results, such as `open_results("results/runs")`.
        output: file to write; an existing one is replaced.
        fmt: format of the file.
        predictions: write a row per test sample instead, with measured and predicted deflection.

    Returns:
        Number of rows.

    Raises:
        ConfigError: nothing is selected, or the package for Parquet is not installed.
        StoreError: the folder has no results, or the file cannot be written.
    """
    frame = results.predictions() if predictions else results.frame()
    if frame.empty:
        raise ConfigError(f"{results.folder}: no results to export; select other models or data")
    if fmt == "parquet":
        require("--format parquet", "pyarrow")
    with written_whole(Path(output)) as temporary:
        if fmt == "jsonl":
            frame.to_json(temporary, orient="records", lines=True, double_precision=15)
        elif fmt == "csv":
            frame.to_csv(temporary, index=False, lineterminator="\r\n")
        else:
            frame.to_parquet(temporary, index=False)
    return len(frame)
