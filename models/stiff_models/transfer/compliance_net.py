"""`compliance-net`: a network of joint compliances inside the virtual joint model's equation.

``d = J_v diag(c(q, tau)) tau`` with ``tau = J^T w`` and ``c = c0 softplus(network) / softplus(0)``:
no load gives no deflection, and the compliance matrix is positive semi-definite at every pose. A
constant network is the VJM; training begins there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, cast

import numpy as np
import torch
from annotated_types import Ge

from stiff_models.device import torch_device
from stiff_models.networks.encoded_model import Scaler, encode
from stiff_models.networks.fully_connected import ChosenActivation, linear_layers
from stiff_models.networks.onnx_export import EncodedNetwork, Springs
from stiff_models.transfer.ft_mlp import FtMlp
from stiff_models.transfer.pretrained_mlp import Anchor
from stiff_models.transfer.source_domain import SourceDomain
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import joint_torque

_SOFTPLUS_0 = math.log(2.0)


class ComplianceNetwork(torch.nn.Module):
    """Network from features and the VJM's regressor to deflections.

    `body` maps (n, n_features) to (n, n_joints); its output layer starts at zero.
    """

    def __init__(self, body: torch.nn.Module, n_joints: int) -> None:
        """Store the body, and set its initial outputs to the constant compliances."""
        super().__init__()
        self.body = body
        self.n_joints = n_joints
        output = linear_layers(body)[-1]
        torch.nn.init.zeros_(output.weight)
        torch.nn.init.zeros_(output.bias)

    def compliance(self, features: torch.Tensor) -> torch.Tensor:
        """Return the (n, n_joints) compliances, in units of the constant compliances."""
        return torch.nn.functional.softplus(self.body(features)) / _SOFTPLUS_0

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return (n, 3) deflections of inputs: features, then the regressor row by row."""
        n_regressor = 3 * self.n_joints
        regressor = inputs[:, -n_regressor:].reshape(-1, 3, self.n_joints)
        compliance = self.compliance(inputs[:, :-n_regressor])
        return (regressor * compliance[:, None, :]).sum(dim=2)


@dataclass(kw_only=True, eq=False, repr=False)
class ComplianceNet(FtMlp):
    """Structure-preserving network.

    Its constant case is the teacher of the source domain. So pre-training on a source with
    identified stiffnesses has no effect and is off by default; it has an effect with
    source_stiffness=nominal. Another robot's source supplies the initial compliances, and its
    pre-training uses that robot's kinematics. Predictions and fine-tuning use the kinematics of the
    fitted robot.
    """

    anchor: Anchor = field(default="none", init=False)
    freeze: str = "full"
    activation: ChosenActivation = "relu"
    pretrain_steps: Annotated[int, Ge(0)] | None = 0

    @property
    def shares_pretraining(self) -> bool:
        """False: the model's equation uses the compliances of the training part."""
        return False

    def compliance(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, n_joints) joint compliances, rad/(N m); arguments as in `predict`."""
        features = self._inputs(*self._checked(q, wrench))[:, : -3 * self.robot_.n_joints]
        with torch.no_grad():
            relative = cast(ComplianceNetwork, self.network_).compliance(features)
        return np.asarray(relative.cpu().double().numpy() * self.reference_compliance_)

    def _simulated(self, samples: Samples, robot: Robot, seed: int) -> SourceDomain:
        compliance = self._source_compliance(samples, robot)
        # a joint that the VJM identified as rigid must still be able to deflect
        typical = np.median(compliance[compliance > 0.0])
        self.reference_compliance_ = np.where(compliance > 0.0, compliance, typical)
        return super()._simulated(samples, robot, seed)

    def _take_statistics(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, deflection: FloatArray
    ) -> None:
        _, torque = _translation_and_torque(robot, q, wrench)
        self.input_scaler_ = Scaler.of(encode(robot, q, torque, self.angle_encoding))
        size = np.sqrt((deflection**2).mean(axis=0))
        # no shift of the outputs: no load must give no deflection
        self.output_scaler_ = Scaler(np.zeros(3), np.where(size > 0.0, size, 1.0))

    def _new_network(self, n_inputs: int, seed: int, n_outputs: int = 3) -> torch.nn.Module:
        n_joints = self.robot_.n_joints  # the body has one output per joint
        body = super()._new_network(n_inputs, seed, n_outputs=n_joints)
        return ComplianceNetwork(body, n_joints)

    def _torch_module(self) -> torch.nn.Module:
        body = cast(ComplianceNetwork, self.network_).body
        unit = self.reference_compliance_ / _SOFTPLUS_0
        compliance = torch.nn.Sequential(body, torch.nn.Softplus())
        scaler = Scaler(np.zeros(len(unit)), unit)
        return _NonlinearSprings(self.robot_, self._encoded(compliance, scaler))

    def _inputs(self, q: FloatArray, wrench: FloatArray) -> torch.Tensor:
        """Return features of pose and joint torque, then the regressor in the network's units."""
        translation, torque = _translation_and_torque(self.robot_, q, wrench)
        features = encode(self.robot_, q, torque, self.angle_encoding)
        regressor = translation * (torque * self.reference_compliance_)[:, None, :]
        regressor /= self.output_scaler_.scale[:, None]
        inputs = np.hstack([self.input_scaler_.apply(features), regressor.reshape(len(q), -1)])
        return torch.as_tensor(inputs, dtype=torch.float32, device=torch_device(self.device))


class _NonlinearSprings(Springs):
    """Joint springs whose compliance is a module's output."""

    def __init__(self, robot: Robot, compliance: EncodedNetwork) -> None:
        super().__init__(robot)
        self.compliance = compliance

    def turn(self, q: torch.Tensor, load: torch.Tensor) -> torch.Tensor:
        turn: torch.Tensor = self.compliance(q, load) * load
        return turn


def _translation_and_torque(
    robot: Robot, q: FloatArray, wrench: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return J_v (n, 3, n_joints) and J^T w (n, n_joints)."""
    rows = robot.jacobian(q)
    return rows[:, :3], joint_torque(rows, wrench)
