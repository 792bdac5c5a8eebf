"""What a model costs: time and memory of one fit and of its predictions."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """Wall times and memory; they differ from run to run and are no part of a result's identity.

    Attributes:
        fit_s: of the fit, s. A pre-training that was taken from the cache costs nothing.
        predict_s: of predicting the test rows together, s.
        latency_s: of predicting one row alone, median of several, s.
        throughput_per_s: rows predicted a second in one large call.
        memory_bytes: how far the fit and the prediction of the test rows raised the process's
            resident memory above what it was; None where the system does not tell.
    """

    fit_s: float
    predict_s: float
    latency_s: float
    throughput_per_s: float
    memory_bytes: int | None
