"""Data between a protocol and the engine: a split, as input of model and scorer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stiff_protocols.contract.protocol_base import EvaluationProtocol
from stiff_protocols.contract.types import (
    TRUTH,
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
    """Input of a fit and its prediction, without deflections of scored rows.

    Attributes:
        train, validation: samples to learn from, and samples that may choose an epoch.
        robot: measured robot.
        q, wrench: (n, n_joints) rad or m and (n, 6) N and N m of the reported rows, as given to the
            model.
        levers: (n, 3) of the reported rows as `Samples.levers`; empty: they were read at the TCP.
        seed: seed of the model.
        coverage: nominal coverage of its intervals; None: no intervals.
        source: data of another robot or specimen to learn from; None: no such data.
        make_protocol: function that makes the protocol. The fit uses a new object, because an older
            object may store data that the model must not use.
        path_q, path_wrench: points of tool paths whose commands the model also corrects, like `q`
            and `wrench`; None: no tool paths.
        of_readings: True to predict readings of the rig: no truth is known.
    """

    train: Samples
    validation: Samples | None
    robot: Robot
    q: FloatArray
    wrench: FloatArray
    levers: FloatArray
    seed: int
    coverage: float | None
    source: BenchmarkData | None
    make_protocol: MakeProtocol
    path_q: FloatArray | None = None
    path_wrench: FloatArray | None = None
    of_readings: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation:
    """A split of a data set under a protocol, with the truth. Models' processes never get it.

    Attributes:
        make_protocol: function that makes the protocol with its options; it can be pickled.
        data: whole data set, as prepared by the protocol.
        split: row numbers of the split.
        source: data of another robot or specimen for simulated source domains; None: the training
            rows.
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
        """Rows of the training side, with validation rows unless they are test rows."""
        return _training_rows(self.split, self.protocol.selects_on_test)

    def fit_input(self, *, chooses_epoch: bool, seed: int, coverage: float | None) -> FitInput:
        """Return the input of a model's fit."""
        samples, (path_q, path_wrench) = self.data.samples, self.data.paths or (None, None)
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
            levers=samples.levers[self.split.reported] if samples.levers.size else samples.levers,
            seed=seed,
            coverage=coverage,
            source=self.source and self.source.without_truth(),
            make_protocol=self.make_protocol,
            path_q=path_q,
            path_wrench=path_wrench,
            of_readings=TRUTH not in self.data.bound_deflections,
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
        """Return the scored values with the measured deflections, which are read last.

        Args:
            predicted: (n, 3) m, at the (n, n_joints) commands.
            commands: (n, n_joints) rad or m, as `EvaluationProtocol.commanded` returned them.
            interval: interval of the predictions; it moves with them.
            reference: (n, 3) m, scored values of the reference model; None: it cannot be fitted.
        """
        rows, samples = self.split.reported, self.data.samples
        measured = samples.deflection[rows]
        values = self.scored(predicted, commands)
        if interval is not None and values is not predicted:
            shift = values - predicted
            interval = Interval(interval.lower + shift, interval.upper + shift, interval.coverage)
        # a simulation has no true values for other loads
        as_measured = np.array_equal(self.split.told_wrench(samples), samples.wrench[rows])
        bound_deflections = (
            {name: deflection[rows] for name, deflection in self.data.bound_deflections.items()}
            if as_measured
            else {}
        )
        directions = samples.directions[rows] if samples.directions.size else samples.directions
        return Prediction(
            rows, values, measured, interval, reference, bound_deflections, directions
        )


def training_side(
    samples: Samples, split: Split, *, chooses_epoch: bool, selects_on_test: bool = False
) -> tuple[Samples, Samples | None]:
    """Return training and validation samples of a model.

    A model that does not choose an epoch learns from the whole training side, with validation rows.
    Validation rows that are test rows (`selects_on_test`) are never used for training.
    """
    if not chooses_epoch:
        return samples.take(_training_rows(split, selects_on_test)), None
    validation = samples.take(split.validation) if len(split.validation) else None
    return samples.take(split.train), validation


def _training_rows(split: Split, selects_on_test: bool) -> IntArray:
    if selects_on_test:
        return split.train
    return np.sort(np.concatenate([split.train, split.validation]))
