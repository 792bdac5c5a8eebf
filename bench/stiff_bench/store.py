"""Results on disk: one file a cell and one a run, each written whole or not at all.

::

    OUTPUT/cells/<key>.json        a cell: identity, metric values, predictions, timings
    OUTPUT/cells/<key>.failed.json why it failed or was skipped; never in the place of a result
    OUTPUT/runs/<run id>.json      a run's manifest
    OUTPUT/data/<sha256>.npz       the samples (see stored_data.py)

A JSON file is one line, ``{"schema":3,"sha256":"...","content":{...}}``; the checksum is over the
bytes of the content as they stand there, so that nothing need be written anew to check it. Numbers
are in SI units at full precision.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from itertools import islice, starmap
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from stiff_bench.stored_data import write_data
from stiff_protocols.cost import Cost
from stiff_protocols.errors import DataError, StoreError
from stiff_protocols.files import written_whole
from stiff_protocols.record import (
    SCHEMA,
    Cell,
    CellResult,
    Presentation,
    ResultRecord,
    RunManifest,
)
from stiff_protocols.types import BenchmarkData, Interval, Prediction

_CONTENT, _END = b'"content":', b"}\n"
"""What stands before and behind the content of a file."""


class ResultStore:
    """A folder of results.

    Args:
        folder: made if it does not exist.

    Raises:
        StoreError: it cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        """Make the folder and see that it can be written."""
        self.folder = folder
        try:
            for part in ("cells", "runs", "data"):
                (folder / part).mkdir(parents=True, exist_ok=True)
                with tempfile.TemporaryFile(dir=folder / part):
                    pass  # only whether it can be made
        except OSError as error:
            raise StoreError(
                f"--output {folder}: cannot be written: {error.strerror or error}"
            ) from error
        _refuse_other_format(folder)

    def write_cell(self, result: CellResult) -> Path:
        """Store a cell's result, replacing an older one of the same key and status."""
        done = self.folder / "cells" / f"{result.cell.key}.json"
        failed = done.with_suffix(".failed.json")
        path = done if result.status == "ok" else failed
        _write_atomically(path, _cell_content(result))
        if result.status == "ok":
            failed.unlink(missing_ok=True)
        return path

    def write_manifest(self, manifest: RunManifest) -> Path:
        """Store a run's manifest, replacing an older state of it."""
        path = self.folder / "runs" / f"{manifest.run_id}.json"
        _write_atomically(path, _fields(manifest))
        return path

    def write_data(self, data: BenchmarkData) -> None:
        """Store the samples that results belong to, once."""
        write_data(self.folder / "data", data, data.sha256)

    def read_cell(self, key: str) -> CellResult:
        """Read a cell's result.

        Raises:
            StoreError: there is none, or it is damaged.
        """
        return _read_cell(self.folder / "cells" / f"{key}.json")

    def read_manifest(self, run_id: str) -> RunManifest:
        """Read a run's manifest.

        Raises:
            StoreError: there is none, or it is damaged.
        """
        return _manifest(self.folder / "runs" / f"{run_id}.json")


def read_results(folder: Path) -> Iterator[CellResult]:
    """Yield every cell of a folder, failed and skipped ones too, in the order of their keys.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    for path in _stored(folder / "cells"):
        yield _read_cell(path)


def read_manifests(folder: Path) -> Iterator[RunManifest]:
    """Yield every run's manifest of a folder, in the order of their names.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    for path in _stored(folder / "runs"):
        yield _manifest(path)


def _stored(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder by name, none where there is no folder.

    A name that begins with a dot is a temporary file's: of a run that writes it now, or was killed.
    """
    names = sorted(os.listdir(folder)) if folder.is_dir() else []
    for name in names:
        if name.endswith(".json") and not name.startswith("."):
            yield folder / name


def _refuse_other_format(folder: Path) -> None:
    """Keep new results out of a folder of another format: nobody could read both."""
    for path in islice(_stored(folder / "cells"), 1):
        with suppress(OSError, ValueError, KeyError, TypeError):  # a damaged file is found later
            schema = orjson.loads(path.read_bytes())["schema"]
            if schema != SCHEMA:
                raise StoreError(
                    f"--output {folder}: holds results of format {schema}, this stiffbench writes "
                    f"{SCHEMA}; give a new folder"
                )


def _manifest(path: Path) -> RunManifest:
    content = _read_checked(path)
    return RunManifest(**{**content, "cells": tuple(content["cells"])})


def _read_cell(path: Path) -> CellResult:
    content = _read_checked(path)
    try:
        result = _cell_result(content)
    except (KeyError, TypeError, AttributeError, ValueError, DataError) as error:
        raise StoreError(f"{path}: damaged: {type(error).__name__}: {error}") from error
    if result.cell.key != path.name.partition(".")[0]:
        raise StoreError(f"{path}: holds the cell {result.cell.key}, which is another one's file")
    return result


def _cell_content(result: CellResult) -> dict[str, Any]:
    return {
        "cell": _fields(result.cell),
        "shown": _fields(result.shown),
        "run_id": result.run_id,
        "status": result.status,
        "records": result.records,
        "prediction": None if result.prediction is None else _plain(result.prediction),
        "cost": None if result.cost is None else _fields(result.cost),
        # JSON has no infinity (a rigid joint) and no NaN (one that cannot be identified)
        "diagnostics": {
            name: value if math.isfinite(value) else str(value)
            for name, value in result.diagnostics.items()
        },
        "warnings": list(result.warnings),
        "failure": result.failure,
        "cause": result.cause,
        "log": list(result.log),
        "calibration_samples": result.calibration_samples,
        "n_train": result.n_train,
        "n_splits": result.n_splits,
        "chosen": dict(result.chosen),
    }


def _fields(found: Any) -> dict[str, Any]:
    """Return a dataclass's fields as they are; `asdict` copies all that is in them."""
    return {item.name: getattr(found, item.name) for item in fields(found)}


def _plain(prediction: Prediction) -> dict[str, Any]:
    plain = {
        "rows": prediction.rows.tolist(),
        "predicted_m": prediction.predicted.tolist(),
        "measured_m": prediction.measured.tolist(),
    }
    if prediction.reference is not None:
        plain["reference_m"] = prediction.reference.tolist()
    if prediction.interval is not None:  # its coverage is the cell's
        plain["lower_m"] = prediction.interval.lower.tolist()
        plain["upper_m"] = prediction.interval.upper.tolist()
    return plain


def _cell_result(content: dict[str, Any]) -> CellResult:
    cell = Cell(**content["cell"])
    prediction = content["prediction"]
    shown = content["shown"]
    return CellResult(
        cell=cell,
        shown=Presentation(**{**shown, "caveats": tuple(shown["caveats"])}),
        run_id=content["run_id"],
        status=content["status"],
        records=tuple(starmap(ResultRecord, content["records"])),
        prediction=None if prediction is None else _prediction(prediction, cell.coverage),
        cost=None if content["cost"] is None else Cost(**content["cost"]),
        diagnostics={name: float(value) for name, value in content["diagnostics"].items()},
        warnings=tuple(content["warnings"]),
        failure=content["failure"],
        cause=content.get("cause", ""),
        log=tuple(content.get("log", ())),
        calibration_samples=content["calibration_samples"],
        n_splits=content.get("n_splits", 0),
        n_train=content.get("n_train", 0),  # unknown in results from before it was stored
        chosen=content.get("chosen", {}),
    )


def _prediction(content: dict[str, Any], coverage: float | None) -> Prediction:
    interval = None
    if coverage is not None and "lower_m" in content:
        interval = Interval(content["lower_m"], content["upper_m"], coverage)
    return Prediction(
        rows=np.array(content["rows"], dtype=np.int64),
        predicted=content["predicted_m"],
        measured=content["measured_m"],
        interval=interval,
        reference=content.get("reference_m"),
    )


def _write_atomically(path: Path, content: dict[str, Any]) -> None:
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    stored = text.encode(errors="replace")  # a file's name may hold what is no character
    head = f'{{"schema":{SCHEMA},"sha256":"{_checksum(stored)}",'.encode()
    with written_whole(path) as temporary:
        temporary.write_bytes(b"".join((head, _CONTENT, stored, _END)))


def _read_checked(path: Path) -> dict[str, Any]:
    try:
        raw = path.read_bytes()
        stored = orjson.loads(raw)
        content, checksum, schema = stored["content"], stored["sha256"], stored["schema"]
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(f"{path}: damaged: {error}") from error
    if schema != SCHEMA:
        raise StoreError(
            f"{path}: stored format {schema}, this stiffbench reads {SCHEMA}; run again into a new "
            "folder"
        )
    if _checksum(raw.partition(_CONTENT)[2].removesuffix(_END)) != checksum:
        raise StoreError(f"{path}: damaged: its checksum does not match its content")
    return dict(content)


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
