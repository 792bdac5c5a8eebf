"""Compile exported models with gcc and call them on arrays."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stiff_models.c_export.c_source import export_c
from stiff_protocols.contract.types import FloatArray, IntArray

NEEDS_GCC = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
FLAGS = "-std=c99 -Wall -Wextra -Werror -pedantic -O2 -fPIC -shared".split()
ROWS = """
#include "model.h"
void deflections(long n, const double *q, const double *wrench, double *d)
{
    long i;
    for (i = 0; i < n; i++) deflection(q + STIFF_JOINTS * i, wrench + 6 * i, d + 3 * i);
}
void corrections(long n, const double *q, const double *wrench, double *command, int *status)
{
    long i, k;
    for (i = 0; i < n; i++) {
        k = STIFF_JOINTS * i;
        status[i] = correct(q + k, wrench + 6 * i, command + k);
    }
}
"""
"""A loop over rows: calls from Python take longer than the prediction."""


@dataclass(frozen=True)
class CompiledModel:
    """A model's C functions; `library` is the file that gcc wrote."""

    functions: ctypes.CDLL
    library: Path

    @property
    def header(self) -> str:
        return self.library.with_name("model.h").read_text("ascii")

    def deflection(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return (n, 3) m."""
        d = np.full((len(q), 3), np.nan)
        self.functions.deflections(ctypes.c_long(len(q)), *map(_pointer, (q, wrench)), _pointer(d))
        return d

    def correct(self, q: FloatArray, wrench: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the (n, n_joints) commands and the (n,) statuses."""
        command, status = np.full(q.shape, np.nan), np.zeros(len(q), dtype=np.intc)
        arguments = [_pointer(array) for array in (q, wrench, command, status)]
        self.functions.corrections(ctypes.c_long(len(q)), *arguments)
        return command, status


def _pointer(array: FloatArray | IntArray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def compiled(model: Any, folder: Path, name: str = "vjm") -> CompiledModel:
    """Export and compile a fitted model; `folder` holds one model."""
    export_c(model, folder / "model.c", name=name, data="made")
    (folder / "rows.c").write_text(ROWS)
    library = folder / "model.so"
    sources = [str(folder / file) for file in ("model.c", "rows.c")]
    subprocess.run(["gcc", *FLAGS, *sources, "-o", str(library), "-lm"], check=True)
    return CompiledModel(ctypes.CDLL(str(library)), library)
