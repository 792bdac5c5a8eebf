"""Which mistake would explain measured samples: a table of hypotheses.

A wrench in the wrong frame or a joint of the wrong sign fits no model, and nothing in the file
says why. Each hypothesis undoes one mistake; the linear virtual joint model (one spring a joint, no
negative compliance, no prior) is cross-validated by pose on what it makes of the samples.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from stiff_datasets.measured.identifiability import jacobians
from stiff_datasets.robots.robot import ChainModel, robot_of
from stiff_protocols.contract.types import AXES, FloatArray, IntArray, Samples

BETTER_RMS = 0.05
"""Share by which a hypothesis must lower the RMS residual."""
CLEARLY = 2.0
"""Standard errors over poses by which it must lower the squared residual."""
AS_GOOD, NEARLY_AS_GOOD = 1.02, 1.06
"""Of hypotheses that leave so many times the lowest RMS residual, the likeliest is named; and those
that cannot be told apart from it with certainty are named beside it."""
FOLDS, FEWEST_POSES = 10, 10
BLOCKS, BLOCK_ROWS = 10, 100
"""Of a longer file so many blocks of rows are compared, spread evenly: a mistake shows in them."""
STEPS = 4
"""Of Gauss-Newton; the free numbers enter the model almost linearly."""
GRAVITY = 9.81  # m/s2


@dataclass(frozen=True, eq=False)
class Reading:
    """Samples as a hypothesis reads them; SI, base frame.

    Attributes:
        chain: the robot.
        q: (n, n_joints) rad or m.
        force, torque: (n, 3) N and N m at the TCP.
        deflection: (n, 3) m.
        jacobian: (n, 6, n_joints) at the TCP, linear part first.
        flange: (n, 3, 3) orientation of the last link.
        lever: (n, 3) from the last link's origin to the TCP, m.
        tcp: (n, 3) position of the TCP, m.
    """

    chain: ChainModel
    q: FloatArray
    force: FloatArray
    torque: FloatArray
    deflection: FloatArray
    jacobian: FloatArray
    flange: FloatArray
    lever: FloatArray
    tcp: FloatArray

    def at(self, q: FloatArray) -> Reading:
        """Return the same samples at other joint positions."""
        return reading(self.chain, q, np.hstack([self.force, self.torque]), self.deflection)

    def take(self, rows: NDArray[np.bool_]) -> Reading:
        """Return some of the samples."""
        arrays = {name: value for name, value in vars(self).items() if name != "chain"}
        return Reading(self.chain, **{name: value[rows] for name, value in arrays.items()})

    def regressor(self) -> FloatArray:
        """Return (n, 3, n_joints) the deflection by each joint at unit compliance."""
        wrench = np.hstack([self.force, self.torque])
        return self.jacobian[:, :3] * (wrench[:, None] @ self.jacobian)


def reading(
    chain: ChainModel, q: FloatArray, wrench: FloatArray, deflection: FloatArray
) -> Reading:
    """Return samples, as their file has them, with the kinematics of their joint positions."""
    poses = robot_of(chain).forward(q)
    return Reading(
        chain=chain,
        q=q,
        force=wrench[:, :3],
        torque=wrench[:, 3:],
        deflection=deflection,
        jacobian=jacobians(chain, q),
        flange=poses.rotation @ chain.flange.rotation,
        lever=poses.rotation @ (chain.tcp - chain.flange.translation),
        tcp=poses.points[:, -1],
    )


@dataclass(frozen=True)
class Fitted:
    """A hypothesis with free numbers.

    Attributes:
        text: with places for them in a unit that a user knows.
        change: what (n_free,) of them, SI, make of the samples.
        n_free: how many.
        must_gain: share by which it must lower the RMS residual; more than without free numbers,
            which also take up what joint springs leave of data without a mistake.
        unit: factor from SI to the unit of the text.
    """

    text: str
    change: Callable[[Reading, FloatArray], Reading]
    n_free: int
    must_gain: float
    unit: float = 1.0


@dataclass(frozen=True, eq=False)
class Fit:
    """The virtual joint model cross-validated under a hypothesis.

    Attributes:
        text: the hypothesis.
        squares: (n,) squared length of each residual, m2.
        reading: the samples as it reads them.
        must_gain: share by which it must lower the RMS residual.
    """

    text: str
    squares: FloatArray
    reading: Reading
    must_gain: float = BETTER_RMS

    @property
    def rms(self) -> float:
        """Root mean square length of the residual, m."""
        return float(np.sqrt(self.squares.mean()))

    @property
    def explained(self) -> float:
        """Share of the squared deflection that is explained; 0 where that is worse than none."""
        size = (self.reading.deflection**2).sum()
        return max(float(1.0 - self.squares.sum() / size), 0.0) if size else 0.0


@dataclass(frozen=True)
class Diagnosis:
    """What cross-validation says of samples.

    Attributes:
        given: under no hypothesis.
        best: under one that explains them clearly better; None: there is none.
        ties: texts of others that explain them as well.
    """

    given: Fit
    best: Fit | None = None
    ties: tuple[str, ...] = ()


def diagnose(samples: Samples, chain: ChainModel) -> Diagnosis:
    """Compare the samples as they are with every hypothesis.

    The best must lower the RMS residual by more than 5 % (more with free numbers) and the
    squared residual by more than two standard errors of the difference, summed by pose, because
    the loads of a pose share their errors: the test of Q. Vuong (Econometrica 57, 1989) between
    models that do not contain each other. Of those that are as good, the likeliest comes first.

    Args:
        samples: the data; fewer than ten poses are compared with nothing.
        chain: the robot that was measured.
    """
    some = samples
    if len(samples) > BLOCKS * BLOCK_ROWS:
        starts = np.linspace(0, len(samples) - BLOCK_ROWS, BLOCKS).astype(np.int64)
        some = samples.take((starts[:, None] + np.arange(BLOCK_ROWS)).reshape(-1))
    pose = np.asarray(np.unique(some.pose_id, return_inverse=True)[1])
    data = reading(chain, some.q, some.wrench, some.deflection)
    n_poses = int(pose.max()) + 1
    fold = np.random.default_rng(0).permutation(n_poses)[pose] % FOLDS
    given = Fit("", _squares(data, fold), data)
    if n_poses < FEWEST_POSES:
        return Diagnosis(given)
    fits = [
        *(Fit(text, _squares(each, fold), each) for text, each in readings(data)),
        *(_fit(each, data, fold) for each in FITTED),
    ]
    better = [fit for fit in fits if _clearly_better(fit, given, pose)]
    lowest = min((fit.rms for fit in better), default=0.0)
    best = next((fit for fit in better if fit.rms <= AS_GOOD * lowest), None)
    close = (fit for fit in better if fit is not best and fit.rms <= NEARLY_AS_GOOD * lowest)
    return Diagnosis(given, best, tuple(fit.text for fit in close))


def compliances(data: Reading) -> FloatArray:
    """Return (n_joints,) compliances by least squares, none negative; rad/(N m), m/N."""
    return _solved(*_normal_equations(data.regressor(), data.deflection))


def _clearly_better(fit: Fit, given: Fit, pose: IntArray) -> bool:
    gain = np.bincount(pose, given.squares - fit.squares)  # (n_poses,)
    clear = gain.sum() > CLEARLY * np.sqrt(len(gain)) * gain.std(ddof=1)
    return bool(clear and fit.rms < (1.0 - fit.must_gain) * given.rms)


def _squares(data: Reading, fold: IntArray) -> FloatArray:
    """Return (n,) the squared length of each residual when its fold (n,) is left out."""
    matrix = data.regressor()
    parts = [_normal_equations(matrix[fold == i], data.deflection[fold == i]) for i in range(FOLDS)]
    grams, rights = (np.array(each) for each in zip(*parts, strict=True))
    found = [_solved(grams.sum(0) - grams[i], rights.sum(0) - rights[i]) for i in range(FOLDS)]
    predicted = (matrix @ np.array(found)[fold][:, :, None])[:, :, 0]
    return np.asarray(((data.deflection - predicted) ** 2).sum(axis=1))


def _fit(hypothesis: Fitted, data: Reading, fold: IntArray) -> Fit:
    """Cross-validate a hypothesis whose numbers are fitted on the training folds, too."""
    numbers = _fitted(hypothesis, data, np.zeros(hypothesis.n_free))
    squares = np.empty(len(fold))
    for i in np.unique(fold):
        training = data.take(fold != i)
        of_fold = _fitted(hypothesis, training, numbers)
        found = compliances(hypothesis.change(training, of_fold))
        tested = hypothesis.change(data.take(fold == i), of_fold)
        squares[fold == i] = ((tested.deflection - tested.regressor() @ found) ** 2).sum(axis=1)
    text = hypothesis.text.format(*(numbers * hypothesis.unit))
    return Fit(text, squares, hypothesis.change(data, numbers), hypothesis.must_gain)


def _fitted(hypothesis: Fitted, data: Reading, numbers: FloatArray) -> FloatArray:
    """Return (n_free,) the numbers that fit best, by Gauss-Newton from `numbers`."""
    step = 1e-3
    for _ in range(STEPS):
        changed = hypothesis.change(data, numbers)
        matrix, found = changed.regressor(), compliances(changed)
        slopes = [
            (hypothesis.change(data, numbers + step * unit).regressor() - matrix) @ found / step
            for unit in np.eye(hypothesis.n_free)
        ]
        design = np.concatenate([np.stack(slopes, axis=-1), matrix], axis=-1)
        design = design.reshape(-1, design.shape[-1])
        size = np.linalg.norm(design, axis=0)
        size[size == 0.0] = 1.0
        residual = (data.deflection - matrix @ found).reshape(-1)
        change = np.linalg.lstsq(design / size, residual)[0] / size
        numbers = numbers + change[: hypothesis.n_free]
    return numbers


def _normal_equations(matrix: FloatArray, deflection: FloatArray) -> tuple[FloatArray, FloatArray]:
    flat = matrix.reshape(-1, matrix.shape[-1])
    return flat.T @ flat, flat.T @ deflection.reshape(-1)


def _solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Return what solves normal equations without a negative number."""
    size = np.sqrt(np.diagonal(gram))
    if not size.any():  # no load
        return np.zeros_like(right)
    size = np.where(size > 0.0, size, 1.0)
    values, axes = np.linalg.eigh(gram / np.outer(size, size))
    kept = values > 1e-12 * values[-1]
    root, axes = np.sqrt(values[kept]), axes[:, kept]
    return np.asarray(nnls((axes * root).T, (axes / root).T @ (right / size))[0] / size)


def readings(data: Reading) -> Iterator[tuple[str, Reading]]:
    """Yield every hypothesis without free numbers, and what it makes of the samples.

    The likeliest come first.
    """
    yield from _wrenches(data)
    yield from _axes(data)
    yield from _joints(data)
    yield from _shifted_rows(data)


def _wrenches(data: Reading) -> Iterator[tuple[str, Reading]]:
    force, torque = data.force, data.torque
    yield (
        "the wrench looks as if it had the opposite sign (the reaction? or is the deflection "
        "unloaded minus loaded?)",
        replace(data, force=-force, torque=-torque),
    )
    yield (
        "the wrench looks as if it were expressed in the flange frame",
        replace(data, force=_turned(data.flange, force), torque=_turned(data.flange, torque)),
    )
    torques = {
        "had the opposite sign": -torque,
        "were in N mm": torque / 1000.0,
        "were taken about the flange, not the TCP": torque - np.cross(data.lever, force),
        "were taken about the base, not the TCP": torque - np.cross(data.tcp, force),
        "did not belong to the forces": np.zeros_like(torque),
    }
    if torque.any():
        for words, changed in torques.items():
            yield f"the torques look as if they {words}", replace(data, torque=changed)
        yield "the forces look as if they were in kg", replace(data, force=force * GRAVITY)
        yield "the forces look as if they were in kN", replace(data, force=force * 1000.0)


def _axes(data: Reading) -> Iterator[tuple[str, Reading]]:
    force, torque, deflection = data.force, data.torque, data.deflection
    for matrix in _signed_permutations():
        read = f"had to be read {_words(matrix)}"
        to = matrix.T
        yield (
            f"the wrench looks as if it {read}",
            replace(data, force=force @ to, torque=torque @ to),
        )
        yield f"the forces look as if they {read}", replace(data, force=force @ to)
        yield f"the torques look as if they {read}", replace(data, torque=torque @ to)
        yield f"the deflections look as if they {read}", replace(data, deflection=deflection @ to)
        yield (
            f"wrench and deflections look as if they {read}",
            replace(data, force=force @ to, torque=torque @ to, deflection=deflection @ to),
        )
        tool = data.flange @ matrix
        in_base = replace(data, force=_turned(tool, force), torque=_turned(tool, torque))
        text = f"the wrench looks as if it were expressed in the flange frame and {read}"
        yield text, in_base
        if torque.any():
            about = in_base.torque - np.cross(data.lever, in_base.force)
            yield f"{text}, its torque about the flange", replace(in_base, torque=about)
    yield (
        "the deflections look as if they were expressed in the flange frame",
        replace(data, deflection=_turned(data.flange, deflection)),
    )


def _joints(data: Reading) -> Iterator[tuple[str, Reading]]:
    names = list(data.chain.model.names)[1:]
    unit = np.eye(len(names))
    for name, row in zip(names, unit, strict=True):
        yield f"joint {name} looks as if it had the opposite sign", data.at(data.q * (1 - 2 * row))
    revolute = [kind == "revolute" for kind in robot_of(data.chain).joint_types]
    for name, row, turns in zip(names, unit, revolute, strict=True):
        for degrees in (90, -90, 180) if turns else ():
            yield (
                f"joint {name} looks as if it were {degrees:+d} deg off",
                data.at(data.q - row * np.deg2rad(degrees)),
            )
    for i, j in itertools.combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[i, j]] = j, i
        yield (
            f"joints {names[i]} and {names[j]} look as if they were swapped",
            data.at(data.q[:, order]),
        )
    if any(revolute):
        yield (
            "the joint angles look as if they were in rad",
            data.at(np.where(revolute, np.rad2deg(data.q), data.q)),
        )


def _shifted_rows(data: Reading) -> Iterator[tuple[str, Reading]]:
    for step, where in ((-1, "down"), (1, "up")):
        words = f"look as if they were shifted {where} by one row"
        yield (
            f"the deflections {words}",
            replace(data, deflection=np.roll(data.deflection, step, 0)),
        )
        force, torque = (np.roll(part, step, 0) for part in (data.force, data.torque))
        yield f"the wrenches {words}", replace(data, force=force, torque=torque)
        yield f"the joint angles {words}", data.at(np.roll(data.q, step, 0))


def _moved_tcp(data: Reading, shift: FloatArray) -> Reading:
    """Return the samples of a TCP that lies elsewhere by (3,) m, flange frame."""
    linear, angular = data.jacobian[:, :3], data.jacobian[:, 3:]
    lever = data.flange @ shift  # (n, 3)
    linear = linear + np.cross(angular, lever[:, :, None], axis=1)
    return replace(data, jacobian=np.concatenate([linear, angular], axis=1))


OFFSET_GAIN, TCP_GAIN = 0.15, 0.2
"""The most seen in clean data are 0.08, of the KR10's twin, and 0.17, of the FANUC measurement."""
FITTED = (
    Fitted(
        "the forces look as if the weight of a tool of {:.2g} kg were in them (not tared)",
        lambda data, weight: replace(data, force=data.force + weight * np.array([0.0, 0.0, 1.0])),
        n_free=1,
        must_gain=OFFSET_GAIN,
        unit=1.0 / GRAVITY,
    ),
    Fitted(
        "the forces look as if they had a constant offset of ({:.2g}, {:.2g}, {:.2g}) N",
        lambda data, offset: replace(data, force=data.force - offset),
        n_free=3,
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the force sensor looks as if it had an offset of ({:.2g}, {:.2g}, {:.2g}) N in the flange "
        "frame",
        lambda data, offset: replace(data, force=data.force - data.flange @ offset),
        n_free=3,
        must_gain=OFFSET_GAIN,
    ),
    Fitted(
        "the TCP looks as if it lay ({:.0f}, {:.0f}, {:.0f}) mm from the given one, in the flange "
        "frame",
        _moved_tcp,
        n_free=3,
        must_gain=TCP_GAIN,
        unit=1000.0,
    ),
)


def _signed_permutations() -> list[FloatArray]:
    """Return the 47 (3, 3) signed permutations but the identity, the least change first."""
    found = [
        np.diag(signs)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return sorted(found, key=lambda matrix: -float(np.trace(matrix)))[1:]


def _words(matrix: FloatArray) -> str:
    """Say in words what a signed permutation makes of the axes of a file."""
    diagonal, proper = np.diag(matrix), np.linalg.det(matrix) > 0.0
    if (diagonal == -1.0).all():
        return "with the opposite sign"
    if diagonal.all() and proper:
        axis = int(np.argmax(diagonal))
        return f"turned by 180 deg about {AXES[axis]}" + ("" if axis == 2 else " (z down?)")
    if diagonal.all():
        axis = int(np.argmin(diagonal))
        return f"with the sign of {AXES[axis]} flipped" + (" (z down?)" if axis == 2 else "")
    if proper and diagonal.sum() == 1.0:
        axis = int(np.argmax(diagonal))
        sine = matrix[(axis + 2) % 3, (axis + 1) % 3]
        return f"turned by {90 * sine:+.0f} deg about {AXES[axis]}"
    if not proper and (matrix >= 0.0).all():
        first, second = (name for name, kept in zip(AXES, diagonal, strict=True) if not kept)
        return f"with {first} and {second} swapped"
    sources = np.abs(matrix).argmax(axis=1)
    signs = ("-" if row.sum() < 0.0 else "" for row in matrix)
    read = ", ".join(sign + AXES[source] for sign, source in zip(signs, sources, strict=True))
    return f"with x, y, z taken from its columns {read}"


def _turned(rotation: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return (n, 3) vectors turned by (n, 3, 3)."""
    return np.asarray((rotation @ vectors[:, :, None])[:, :, 0])
