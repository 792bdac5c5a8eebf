"""Pre-training on the source domain: once per robot if possible, else once per training part.

The deflection of linear joint springs is a sum over the joints, ``d = sum_i c_i u_i(q, w)``. A
network with one output per joint and axis learns each joint's deflection at a reference compliance.
The sum of its outputs, weighted with the compliances of a training part, is the usual network with
three outputs for this part's source domain. Reference compliances are powers of four, which nearly
all training parts of a robot share.
"""

from __future__ import annotations

import platform
import time
from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.device import arithmetic, torch_device
from stiff_models.io.training_cache import remembered
from stiff_models.networks.encoded_model import NO_DEFLECTION, Scaler, encode
from stiff_models.networks.network_model import EncodedNetworkModel
from stiff_models.networks.training import (
    PRETRAINING_VERSION,
    Curve,
    Loss,
    Rows,
    TrainingPlan,
    train_network,
)
from stiff_models.transfer.alignment import TargetObjective
from stiff_models.transfer.source_domain import SourceDomain, simulate
from stiff_models.transfer.source_model import SourceModel
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.types import AXES, BenchmarkData, FloatArray, Robot, Samples

SOURCE_TRAIN_SHARE = 0.7  # source paper: 70 % train, 30 % test, at random
JUDGED_ROWS = 4096  # rows of each part of the source, for the errors on it
CONSTANT = 1e-9  # an axis with a smaller share of the other axes' spread does not move
SOURCE_ERRORS = (
    *(f"test MAE {axis.upper()}" for axis in AXES),
    "training MAE",
    "training STDE",
    "test MAE",
    "test STDE",
)


@dataclass(frozen=True, eq=False)
class Trained:
    """The result of a training: the network's state, its curve, and the wall time.

    `judged` holds the numbers computed with the network right after, by name.
    """

    weights: dict[str, np.ndarray[Any, Any]]
    curve: Curve
    seconds: float
    judged: dict[str, FloatArray]


def remembered_training(
    network: torch.nn.Module,
    plan: TrainingPlan,
    seed: int,
    arrays: Iterable[FloatArray],
    compute: Callable[[], Trained],
    *,
    actors: Iterable[object],
    about: str,
) -> Trained:
    """Return a training from the cache, or compute and store it (except with 0 steps).

    Args:
        network: network with its initial weights.
        plan: settings of the training.
        seed: seed of the batches' order.
        arrays: training data and constants.
        compute: function that trains the network.
        actors: objects that take part, such as the model. Their third-party code, and the code of
            the network's parts, enters the key.
        about: further settings as text.
    """
    if not plan.steps:
        return compute()
    device = next(network.parameters()).device
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.machine()
    shaped_by = (
        *(repr(network), repr(plan), seed, about),
        f"{device.type} {name} {torch.get_num_threads()} threads",
        repr(arithmetic(device, mixed_precision=plan.mixed_precision)),
        f"{PRETRAINING_VERSION} torch {torch.__version__}",
        sorted({code_of(type(thing)) for thing in (*network.modules(), *actors)}),
        [*arrays, *(tensor.cpu().numpy() for tensor in network.state_dict().values())],
    )
    return remembered(shaped_by, compute)


@dataclass(kw_only=True, eq=False, repr=False)
class PretrainedModel(SourceModel, EncodedNetworkModel):
    """Base of the families whose network learns the source domain.

    Attributes:
        pretrain_steps: number of pre-training steps; none: the recipe's.
        pretrain_seed: seed of a pre-training that training parts share. If each part has its own
            pre-training, it is added to the seed of the fit.
    """

    pretrain_steps: Annotated[int, Ge(0)] | None = None
    pretrain_seed: Annotated[int, Ge(0)] = 0

    @property
    def shares_pretraining(self) -> bool:
        """True if all training parts of a robot share a pre-training."""
        return self.source_teacher == "vjm"

    @abstractmethod
    def _recipe_plan(self) -> TrainingPlan:
        """Return the pre-training's plan, before `pretrain_steps` is applied."""

    def _pretraining_plan(self) -> TrainingPlan:
        plan = self._recipe_plan()
        return plan if self.pretrain_steps is None else replace(plan, steps=self.pretrain_steps)

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        """Set a network that is pre-trained on the source domain."""
        origin = self._origin(train, robot)
        if self.shares_pretraining:
            trained, n_samples, residual = self._learn_parts(origin)
        else:
            trained, n_samples = self._learn_sum(train, origin, seed + self.pretrain_seed)
            residual = trained.judged["residual"]
        self.curves_ = {"pre-training": trained.curve.points}
        self.source_errors_ = source_errors(residual)
        errors = zip(SOURCE_ERRORS, (1000.0 * self.source_errors_).tolist(), strict=True)
        self.diagnostics_ = {
            "source samples": float(n_samples),
            "pre-training time, also of a cached one [s]": trained.seconds,
            **{f"source {name} [mm]": error for name, error in errors},
        }
        self.robot_ = robot  # predictions are for the target from here on

    def _learn_sum(self, train: Samples, origin: BenchmarkData, seed: int) -> tuple[Trained, int]:
        """Train the network of one training part."""
        domain = self._simulated(origin.samples, origin.robot, seed)
        learn, test = divided(domain, seed)
        self._start(origin.robot, learn.q, learn.wrench, learn.deflection, seed)
        rows = self._rows(learn.q, learn.wrench, learn.deflection)

        def judge() -> dict[str, FloatArray]:
            parts = some_of(learn, test)
            residual = [
                self._predicted_by(self.network_, part.q, part.wrench) - part.deflection
                for part in parts
            ]
            return {"residual": np.stack(residual)}

        plan = self._pretraining_plan()
        objective = self._objective(train, plan.loss, seed)
        made_of = objective.made_of if objective else ()
        trained = remembered_training(
            self.network_,
            plan,
            seed,
            [tensor.cpu().numpy() for tensor in (rows.inputs, rows.targets, *made_of)],
            partial(self._pretrain, rows, plan, seed, judge, objective),
            actors=[self, objective] if objective else [self],
            about=objective.about if objective else "",
        )
        self.network_.load_state_dict(
            {name: torch.from_numpy(array.copy()) for name, array in trained.weights.items()}
        )
        return trained, len(domain)

    def _objective(self, train: Samples, loss: Loss, seed: int) -> TargetObjective | None:
        """Return the objective instead of the source's loss; `train` are the target's samples."""
        return None

    def _pretrain(
        self,
        rows: Rows,
        plan: TrainingPlan,
        seed: int,
        judge: Callable[[], dict[str, FloatArray]],
        objective: TargetObjective | None = None,
    ) -> Trained:
        """Train the network in place, and measure it once with `judge`."""
        start = time.perf_counter()
        moving = [*self.network_.parameters(), *(objective.parameters() if objective else ())]
        curve = train_network(
            self.network_,
            rows,
            plan,
            seed=seed,
            phase="pre-train",
            trainable=moving,
            objective=objective,
        )
        state = self.network_.state_dict()
        weights = {name: tensor.cpu().numpy() for name, tensor in state.items()}
        return Trained(weights, curve, time.perf_counter() - start, judge())

    def _learn_parts(self, origin: BenchmarkData) -> tuple[Trained, int, FloatArray]:
        """Train outputs per joint and axis, or load them from the cache, and add the joints."""
        robot, seed = origin.robot, self.pretrain_seed
        self.robot_ = robot
        compliance = self._source_compliance(origin.samples, robot)
        reference = power_of_four(compliance)
        design = self._design(origin.samples, robot, seed)
        n_samples = len(design.q) * design.wrench.shape[1]
        n_inputs = encode(robot, design.q[:1], np.zeros((1, 6)), self.angle_encoding).shape[1]
        network = self._new_network(n_inputs, seed, n_outputs=3 * robot.n_joints)
        network = network.to(torch_device(self.device))
        plan = self._pretraining_plan()

        def compute() -> Trained:
            learn, test = divided(simulate(robot, reference, design), seed)
            self._take_statistics(robot, learn.q, learn.wrench, learn.deflection)
            self.network_ = network
            scale = self.output_scaler_.scale[:, None]  # for the sum of all joints
            mean = learn.parts.mean(axis=0)  # (3, n_joints)
            targets = ((learn.parts - mean) / scale).reshape(len(learn), -1)
            inputs = self._inputs(learn.q, learn.wrench)
            rows = Rows(inputs, torch.as_tensor(targets, dtype=torch.float32, device=inputs.device))

            def judge() -> dict[str, FloatArray]:
                residual = []
                for part in some_of(learn, test):
                    outputs = self._outputs(network, part.q, part.wrench).reshape(part.parts.shape)
                    residual.append(outputs * scale + mean - part.parts)
                scaled = targets.reshape(learn.parts.shape)
                return {
                    "residual": np.stack(residual).astype(np.float32),
                    "mean": mean,
                    "scale": scale,
                    "covariance": np.einsum("nai,naj->aij", scaled, scaled) / len(learn),
                    "input_mean": self.input_scaler_.mean,
                    "input_scale": self.input_scaler_.scale,
                }

            return self._pretrain(rows, plan, seed, judge)

        trained = remembered_training(
            network,
            plan,
            seed,
            (design.q, design.wrench, reference, robot.placements, robot.axes, robot.tcp),
            compute,
            actors=[self],
            about=f"an output a joint, {self.angle_encoding}, {robot.joint_types}"
            + f", endless {robot.endless}" * bool(robot.endless.any())
            + f"{robot.mimics or ''}",
        )
        weights = compliance / np.where(reference > 0.0, reference, 1.0)
        self._add_up(trained, weights)
        return trained, n_samples, trained.judged["residual"] @ weights

    def _add_up(self, trained: Trained, weights: FloatArray) -> None:
        """Set scalers and the network whose outputs are weighted sums of the joints'."""
        measured = trained.judged
        self.input_scaler_ = Scaler(measured["input_mean"], measured["input_scale"])
        spread = np.sqrt(np.einsum("aij,i,j->a", measured["covariance"], weights, weights))
        spread = measured["scale"][:, 0] * spread
        size = float(np.sqrt(np.mean(spread**2))) or NO_DEFLECTION
        spread = np.where(spread > CONSTANT * size, spread, size)
        self.output_scaler_ = Scaler(measured["mean"] @ weights, spread)
        factors = measured["scale"] / spread[:, None] * weights  # (3, n_joints)
        weight, bias = list(trained.weights)[-2:]  # of the output layer
        parts = {
            weight: trained.weights[weight].reshape(*factors.shape, -1),
            bias: trained.weights[bias].reshape(*factors.shape, 1),
        }
        state = trained.weights | {
            name: np.einsum("ai,aih->ah", factors, layer) for name, layer in parts.items()
        }
        state[bias] = state[bias][:, 0]
        self.network_ = self._new_network(len(measured["input_mean"]), self.pretrain_seed)
        self.network_.load_state_dict(
            {name: torch.from_numpy(np.array(array)) for name, array in state.items()}
        )
        self.network_ = self.network_.to(torch_device(self.device)).eval()


def power_of_four(compliance: FloatArray) -> FloatArray:
    """Return the powers of four nearest to compliances by ratio; 0 for a rigid joint."""
    elastic = compliance > 0.0
    exponent = np.round(np.emath.logn(4.0, np.where(elastic, compliance, 1.0)))
    return np.where(elastic, 4.0**exponent, 0.0)


def divided(domain: SourceDomain, seed: int) -> tuple[SourceDomain, SourceDomain]:
    """Return a random 70 % of a source domain for training, and the other 30 % for tests."""
    order = np.random.default_rng(seed).permutation(len(domain))
    n_train = round(SOURCE_TRAIN_SHARE * len(domain))
    return domain.take(order[:n_train]), domain.take(order[n_train:])


def some_of(learn: SourceDomain, test: SourceDomain) -> tuple[SourceDomain, SourceDomain]:
    """Return equally many samples of both parts, for the errors on the source."""
    rows = np.arange(min(len(learn), len(test), JUDGED_ROWS))
    return learn.take(rows), test.take(rows)


def source_errors(residual: FloatArray) -> FloatArray:
    """Return the (7,) errors on the source, m, of (2, n, 3) residuals: training part, test part.

    `SOURCE_ERRORS` names them. Errors without an axis are over all samples and axes, as in the
    source paper's Tables 6 and 7.
    """
    learned, tested = np.abs(residual)
    together = [value for errors in (learned, tested) for value in (errors.mean(), errors.std())]
    return np.array([*tested.mean(axis=0), *together])
