"""What passes between a protocol and the engine: a division, as model and scorer see it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stiff_protocols.contract.protocol_base import EvaluationProtocol
from stiff_protocols.contract.types import (
    BenchmarkData,
    FloatArray,
    IntArray,
    Interval,
    Prediction,
    Robot,
    Samples,
    Split,
)

MakeProtocol = Callable[[], EvaluationProtocol]


@dataclass(frozen=True, eq=False, kw_only=True)
class FitInput:
    """Everything that a fit sees and is asked: no deflection that it is scored on.

    Attributes:
        train, validation: samples to learn from, and samples that may choose an epoch.
        robot: the robot that was measured.
        q, wrench: (n, n_joints) rad or m and (n, 6) N and N m of the reported rows, as the model
            is told.
        seed: of the model.
        coverage: nominal coverage of its intervals; None: no intervals.
        source: data of another robot or specimen that it may learn from; None: no such data.
        make_protocol: makes the protocol. A new object serves the fit: what an older one
            remembers of the data is not for the model.
        path_q, path_wrench: points of tool paths whose commands the model corrects beside, as `q`
            and `wrench`; None: it corrects none.
    """

    train: Samples
    validation: Samples | None
    robot: Robot
    q: FloatArray
    wrench: FloatArray
    seed: int
    coverage: float | None
    source: BenchmarkData | None
    make_protocol: MakeProtocol
    path_q: FloatArray | None = None
    path_wrench: FloatArray | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation:
    """One division of a data set under a protocol. It holds the truth: no model's process has it.

    Attributes:
        make_protocol: makes the protocol with its options; it can be pickled.
        data: the whole data set, as the protocol prepared it.
        split: row numbers of the division.
        source: data of the other robot or specimen that simulated source domains come from; None:
            the training rows.
    """

    make_protocol: MakeProtocol
    data: BenchmarkData
    split: Split
    source: BenchmarkData | None = None

    @cached_property
    def protocol(self) -> EvaluationProtocol:
        """The protocol, which scores in the run's own process."""
        return self.make_protocol()

    @property
    def training_rows(self) -> IntArray:
        """Rows of the training side, with those that choose an epoch unless they are test rows."""
        return _training_rows(self.split, self.protocol.selects_on_test)

    def fit_input(self, *, chooses_epoch: bool, seed: int, coverage: float | None) -> FitInput:
        """Return what the fit of a model sees and is asked."""
        samples, paths = self.data.samples, self.data.paths
        train, validation = training_side(
            samples,
            self.split,
            chooses_epoch=chooses_epoch,
            selects_on_test=self.protocol.selects_on_test,
        )
        return FitInput(
            train=train,
            validation=validation,
            robot=self.data.robot,
            q=samples.q[self.split.reported],
            wrench=self.split.told_wrench(samples),
            seed=seed,
            coverage=coverage,
            source=self.source and self.source.without_truth(),
            make_protocol=self.make_protocol,
            path_q=None if paths is None else paths.q,
            path_wrench=None if paths is None else paths.wrench,
        )

    def scored(self, predicted: FloatArray, commands: FloatArray) -> FloatArray:
        """Return the (n, 3) values [m] that are compared with the measured deflections."""
        return self.protocol.scored(predicted, commands, self.data, self.split.reported)

    def path_error(self, commands: FloatArray) -> float:
        """Return the mean 3-D error [m] that corrected commands leave on the tool paths."""
        return float(np.linalg.norm(self.protocol.path_errors(commands, self.data), axis=1).mean())

    def prediction(
        self,
        predicted: FloatArray,
        commands: FloatArray,
        interval: Interval | None,
        reference: FloatArray | None,
    ) -> Prediction:
        """Return what is scored, with the measured deflections: they are looked at last.

        Args:
            predicted: (n, 3) m, at the (n, n_joints) commands.
            commands: (n, n_joints) rad or m, as `EvaluationProtocol.commanded` returned them.
            interval: of the predictions; it moves with them.
            reference: (n, 3) m, scored values of the reference model; None: it cannot be fitted.
        """
        rows, samples = self.split.reported, self.data.samples
        measured = samples.deflection[rows]
        values = self.scored(predicted, commands)
        if interval is not None and values is not predicted:
            shift = values - predicted
            interval = Interval(interval.lower + shift, interval.upper + shift, interval.coverage)
        # a simulation knows nothing of loads that it never had
        as_measured = np.array_equal(self.split.told_wrench(samples), samples.wrench[rows])
        known = {name: one[rows] for name, one in self.data.known.items()} if as_measured else {}
        return Prediction(rows, values, measured, interval, reference, known)


def training_side(
    samples: Samples, split: Split, *, chooses_epoch: bool, selects_on_test: bool = False
) -> tuple[Samples, Samples | None]:
    """Return training and validation samples of a model.

    A model that chooses no epoch has no use for validation rows: it learns from the whole training
    side instead. Validation rows that are test rows (`selects_on_test`) are never learned from.
    """
    if not chooses_epoch:
        return samples.take(_training_rows(split, selects_on_test)), None
    validation = samples.take(split.validation) if len(split.validation) else None
    return samples.take(split.train), validation


def _training_rows(split: Split, selects_on_test: bool) -> IntArray:
    if selects_on_test:
        return split.train
    return np.sort(np.concatenate([split.train, split.validation]))
