"""Stiffness of a loaded robot: the conservative congruence transformation.

A load turns with no joint, so its torque on a joint changes when joints turn:
``J(q + dtheta)^T w = J^T w + K_g dtheta`` to first order, with ``K_g,ij = (dJ_i/dq_j)^T w``. The
balance ``K_theta dtheta = J(q + dtheta)^T w`` of springs and load then is
``(K_theta - K_g) dtheta = J^T w`` (Chen and Kao, "Conservative congruence transformation for joint
and Cartesian stiffness matrices of robotic hands and fingers", 2000). K_g holds the wrench alone,
not the links' weights.

With compliances ``C = K_theta^-1`` it reads ``(I - C K_g) dtheta = C J^T w``, which also holds for
a rigid joint. SI: rad, N, N m, m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import joint_torque
from stiff_protocols.kinematics.straight_line import CHUNK
from stiff_protocols.springs.identification import least_compliance

MAX_STEPS = 50
MAX_HALVINGS = 20
CONVERGED = 1e-8  # relative step of the compliances; the step after it would be far below that


@dataclass(frozen=True, eq=False)
class LoadedRobot:
    """What samples do to a robot, whatever its springs are.

    Attributes:
        rows: (n, 6, n_joints) Jacobian at the TCP, base frame.
        torque: (n, n_joints) J^T w, N m (N at a prismatic joint).
        congruence: (n, n_joints, n_joints) K_g, N m/rad.
    """

    rows: FloatArray
    torque: FloatArray
    congruence: FloatArray

    @classmethod
    def of(cls, robot: Robot, q: FloatArray, wrench: FloatArray) -> LoadedRobot:
        """Return it for (n, n_joints) `q` and (n, 6) `wrench` at the TCP, base frame."""
        rows = robot.jacobian(q)
        congruence = np.empty((len(q), robot.n_joints, robot.n_joints))
        for start in range(0, len(q), CHUNK):  # a Hessian is six times as large as its K_g
            part = slice(start, start + CHUNK)
            hessian = kinematic_hessian(rows[part])
            np.einsum("nkij,nk->nij", hessian, wrench[part], out=congruence[part])
        return cls(rows, joint_torque(rows, wrench), congruence)

    def beyond_buckling(self, compliance: FloatArray) -> IntArray:
        """Return the row numbers of the samples that the springs cannot hold.

        There K_theta - K_g is not positive definite: its symmetric part is looked at, as a moment
        that keeps its direction in the base frame makes K_g unsymmetric. Rigid joints hold all.
        """
        root = np.sqrt(compliance)  # I - C^1/2 K_g C^1/2 has the signs of K_theta - K_g
        scaled = root[:, None] * self.congruence * root
        # no eigenvalue exceeds the Frobenius norm, which for most loads is far below 1
        large = np.flatnonzero(np.einsum("nij,nij->n", scaled, scaled) >= 1.0)
        symmetric = (scaled[large] + scaled[large].transpose(0, 2, 1)) / 2
        return large[np.linalg.eigvalsh(symmetric)[:, -1] >= 1.0]

    def turn(self, compliance: FloatArray) -> FloatArray:
        """Return dtheta, (n, n_joints) rad, of springs that hold every sample."""
        turn = np.linalg.solve(self._balance(compliance), (compliance * self.torque)[..., None])
        return np.asarray(turn[..., 0])

    def deflection(self, turn: FloatArray) -> FloatArray:
        """Return J_v dtheta, (n, 3) m, base frame."""
        return np.asarray((self.rows[:, :3] @ turn[..., None])[..., 0])

    def regressor(self, compliance: FloatArray, turn: FloatArray) -> FloatArray:
        """Return the (n, 3, n_joints) derivative of the deflection by the compliances.

        It is the linear model's with the torque on the turned joints, carried on by the balance.
        """
        torque = self.torque + (self.congruence @ turn[..., None])[..., 0]
        move = self.rows[:, :3] @ np.linalg.inv(self._balance(compliance))
        return np.asarray(move * torque[:, None, :])

    def _balance(self, compliance: FloatArray) -> FloatArray:
        """Return I - C K_g."""
        return np.asarray(np.eye(len(compliance)) - compliance[:, None] * self.congruence)


def loaded_deflection(
    robot: Robot, compliance: FloatArray, q: FloatArray, wrench: FloatArray
) -> FloatArray:
    """Return the (n, 3) deflection [m] of springs with `compliance` (n_joints,) rad/(N m).

    Raises:
        ModelError: a sample's load is beyond buckling; the message names its row.
    """
    loaded = LoadedRobot.of(robot, q, wrench)
    unstable = loaded.beyond_buckling(compliance)
    if len(unstable):
        first = int(unstable[0])
        raise ModelError(
            f"row {first}: the load buckles the joint springs, K_theta - K_g is not positive "
            f"definite at q = {np.round(q[first], 4).tolist()} under the wrench "
            f"{np.round(wrench[first], 3).tolist()} ({len(unstable)} such rows of {len(q)})"
        )
    return loaded.deflection(loaded.turn(compliance))


@dataclass(frozen=True, eq=False)
class Linearised:
    """Least squares near some compliances (n_joints,): target (3 n,) m = matrix @ new compliances.

    `matrix` (3 n, n_joints) is the derivative of the deflections, `error` the sum of squared
    residuals [m2] at `compliance`.
    """

    compliance: FloatArray
    matrix: FloatArray
    target: FloatArray
    error: float


def linearised_at_best(robot: Robot, samples: Samples) -> Linearised:
    """Return the linear problem whose solution is that of the nonlinear one.

    Gauss-Newton steps with compliances >= 0: the first one leads to the linear model's solution.
    A step is halved until the springs hold every sample and the residual does not grow.
    """
    loaded = LoadedRobot.of(robot, samples.q, samples.wrench)
    measured = samples.deflection.reshape(-1)
    best = _linearised(loaded, np.zeros(robot.n_joints), measured)  # a rigid robot holds all
    for _ in range(MAX_STEPS):
        step = least_compliance(best.matrix, best.target) - best.compliance
        trials = (best.compliance + step / 2**halving for halving in range(MAX_HALVINGS))
        held = (trial for trial in trials if not len(loaded.beyond_buckling(trial)))
        found = (_linearised(loaded, trial, measured) for trial in held)
        better = next((problem for problem in found if problem.error <= best.error), None)
        if better is None:  # only rounding is left to gain
            break
        best = better
        if (np.abs(step) <= CONVERGED * best.compliance).all():
            break
    return best


def _linearised(loaded: LoadedRobot, compliance: FloatArray, measured: FloatArray) -> Linearised:
    turn = loaded.turn(compliance)
    matrix = loaded.regressor(compliance, turn).reshape(len(measured), -1)
    residual = measured - loaded.deflection(turn).reshape(-1)
    return Linearised(
        compliance, matrix, residual + matrix @ compliance, float(residual @ residual)
    )


def kinematic_hessian(rows: FloatArray) -> FloatArray:
    """Return the derivatives of Jacobians by the joint positions.

    A turn about axis a_i moves all that it carries: column j changes by a_i x J_j for j >= i, and
    the TCP's second derivatives are symmetric; axes do not turn with the joints that they carry
    (Hourtash, "The kinematic Hessian and higher derivatives", 2005).

    Returns:
        (n, 6, n_joints, n_joints): [:, :, i, j] is dJ_i / dq_j.
    """
    n, _, n_joints = rows.shape
    move, axis = rows[:, :3].transpose(1, 2, 0), rows[:, 3:].transpose(1, 2, 0)
    hessian = np.zeros((6, n_joints, n_joints, n))
    for i in range(n_joints):
        for j in range(i, n_joints):
            _cross(hessian[:3, i, j], axis[:, i], move[:, j])
            hessian[:3, j, i] = hessian[:3, i, j]
            if j > i:
                _cross(hessian[3:, j, i], axis[:, i], axis[:, j])
    return hessian.transpose(3, 0, 1, 2)


def _cross(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Write the cross product of two (3, n) arrays; `numpy.cross` is several times slower."""
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[j], b[k], out=out[i])
        out[i] -= a[k] * b[j]
