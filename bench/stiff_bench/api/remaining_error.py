"""stub"""

from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from stiff_bench.api.model import Model
from stiff_protocols.contract.types import FloatArray


@dataclass(frozen=True, eq=False)
class ExpectedError:
    values: FloatArray | None
    source: str

    def __str__(self) -> str:
        return f"{1e3 * self.values.mean():.3g} mm ({self.source})"


def expected_error(
    model: Model, q: FloatArray, wrench: FloatArray, coverage: float | None
) -> ExpectedError:
    errors = model.left_out_errors
    mean = np.linalg.norm(errors, axis=1).mean()
    return ExpectedError(np.full(len(q), mean), "stub")
