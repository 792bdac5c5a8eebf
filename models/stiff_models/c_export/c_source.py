"""Write fitted spring models and plain networks as C99, with the C files next to this module.

Spring 6 j + k is number k of `virtual_jacobian` at joint j; the base's come last. SI: rad, N, m.
"""

from __future__ import annotations

import textwrap
from datetime import date
from importlib.metadata import version
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiff_models.networks.encoded_model import encoded_joints
from stiff_models.physics.curve_springs import SPRINGS_PER_JOINT, WIDTHS, CurveSprings
from stiff_models.physics.fourier_springs import SHOULDER_AND_ELBOW, FourierSprings
from stiff_models.physics.full_vjm import FullVjm, spring_columns
from stiff_models.physics.multi_segment_vjm import MultiSegmentVjm
from stiff_models.physics.vjm import VirtualJointModel
from stiff_models.regressors.arm_loads import OWN_AXIS, ArmLoads
from stiff_models.regressors.bayes_springs import BayesSprings
from stiff_models.regressors.spring_groups import LoadCurves, LostMotion
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.types import FloatArray, Robot
from stiff_protocols.kinematics import serial_chain
from stiff_protocols.kinematics.chain_formulas import Chain
from stiff_protocols.kinematics.straight_line import Program, half_angle, tape_with
from stiff_protocols.paths import compensation

NETWORKS = ("mlp", "mlp-pretrained", "ft-mlp")  # one fully connected network, without a teacher
STEPS = {"add": "{} + {}", "subtract": "{} - {}", "multiply": "{} * {}", "divide": "{} / {}"}
STEPS |= {"negative": "-{}", "tan": "tan({})"}
ACTIVATIONS = {
    "relu": "((x) < 0.0 ? 0.0 : (x))",
    "tanh": "tanh(x)",
    "sigmoid": "(1.0 / (1.0 + exp(-(x))))",
    "gelu": "(0.5 * (x) * (1.0 + erf((x) * sqrt(0.5))))",
    "sharp-gelu": "(0.5 * (x) * (1.0 + erf((x) * sqrt(8.0))))",
}


def export_c(model: Any, path: Path, *, name: str, data: str) -> None:
    """Write a fitted model as a C99 file, and next to it its header, which says `name` and `data`.

    Raises:
        ConfigError: the suffix is not .c, or the model has no C form.
        StoreError: a file cannot be written.
    """
    if path.suffix != ".c":
        raise ConfigError(f"{path} (valid: a name that ends in .c)", "output")
    robot, geometry = model.robot_, getattr(model, "geometry_", None)
    measured = robot if geometry is None else geometry.robot
    if tables := spring_tables(model):
        lever = np.zeros(3) if geometry is None else geometry.lever
        body = _springs(model, *tables, [measured.tcp - robot.tcp, lever])
    elif name.partition("@")[0] in NETWORKS and getattr(model, "teacher_", None) is None:
        body = _network(model)
    else:
        raise ConfigError(
            f"{name} has no C form (valid: vjm, vjm-full, vjm-multisegment, fourier-springs, "
            "curve-springs, bayes-springs, mlp, mlp-pretrained, ft-mlp@anchor=none)"
        )
    about = {
        "model": name,
        "data": data,
        "robot": f"{robot.joints_text}: {', '.join(robot.joint_names)}",
        "TCP": f"{robot.tcp_on_flange.tolist()} m in the frame of the last link",
        "measured": f"{measured.tcp_on_flange.tolist()} m in this frame, the point of `deflection`",
        "written": f"{date.today()} by stiffbench {version('stiffbench')}",
    }
    lines = "\n   ".join(f"{word + ':':10}{ascii(text)[1:-1]}" for word, text in about.items())
    header = _file("header.h").replace("N_JOINTS", str(robot.n_joints))
    header = header.replace("ABOUT", lines.translate({ord("*"): "_", ord("?"): "_"}))  # no "*/"
    for file, code in (path.with_suffix(".h"), ""), (path, body + _file("correction.c")):
        with written_whole(file) as temporary:
            temporary.write_text(header + code, encoding="ascii")


def _springs(model: Any, lines: FloatArray, curves: FloatArray, measured: ArrayLike) -> str:
    return (
        _kinematics(model, LINES=len(lines), CURVES=len(curves))
        + _table("short", "LINE_AT", lines[:, :4])
        + _table("double", "LINE", lines[:, 4])
        + _table("short", "CURVE_AT", curves[:, :3])
        + _table("double", "CURVE", curves[:, 3:])
        + _table("double", "POINT", measured)
        + _file("springs.c")
    )


def _network(model: Any) -> str:
    linear = [layer for layer in model.network_ if hasattr(layer, "weight")]
    layers = [[part.detach().cpu().numpy() for part in (m.bias, m.weight)] for m in linear]
    sizes = [layers[0][1].shape[1], *(len(bias) for bias, _ in layers)]
    turned = encoded_joints(model.robot_, model.angle_encoding)
    angles, slides = ([f"q[{k}]" for k in np.flatnonzero(part)] for part in (turned, ~turned))
    features = [f"{function}({angle})" for function in ("sin", "cos") for angle in angles]
    features += [*slides, *(f"wrench[{k}]" for k in range(6))]
    encoding = "".join(f"    x[{k}] = {text};\n" for k, text in enumerate(features))
    macros = {"ACTIVATION(x)": ACTIVATIONS[model.hidden_activation]}
    return (
        _kinematics(model, LAYERS=len(layers), WIDEST=max(sizes), **macros)
        + _table("short", "SIZE", sizes)
        + _table("float", "NETWORK", np.concatenate([np.column_stack(of).ravel() for of in layers]))
        + _table("double", "INPUT", [model.input_scaler_.mean, model.input_scaler_.scale])
        + _table("double", "OUTPUT", [model.output_scaler_.mean, model.output_scaler_.scale])
        + "\nstatic void encode(const double q[], const double wrench[], double x[])\n"
        + f"{{\n{encoding}}}\n\n{_file('network.c')}"
    )


def _kinematics(model: Any, **macros: object) -> str:
    """Return the macros, and the function that fills a frame, described in `vectors.c`."""
    robot = model.robot_
    factors = model.rig_.weight_factor if hasattr(model, "rig_") else np.ones(robot.n_joints)
    tape, (q,) = tape_with(robot.n_joints)
    chain = Chain.of(robot, half_angle)
    x, y, z, *rotation = chain.tool(q)[:12]
    axes = np.reshape(np.array(rotation, dtype=object), (3, 3)).T.ravel()
    twists = np.array(chain.virtual_jacobian(q), dtype=object).reshape(6, -1).T.ravel()
    base = [0.0, -z, y, 1.0, 0.0, 0.0, z, 0.0, -x, 0.0, 1.0, 0.0, -y, x, 0.0, 0.0, 0.0, 1.0]
    base += np.eye(3, 6).ravel().tolist()
    torques = np.repeat(factors, 6) * np.array(chain.virtual_gravity_torque(q), dtype=object)
    program = Program.of(tape, [x, y, z, *axes, *twists, *base, *torques, *[0.0] * 6])
    places = [f"q[{k}]" for k in range(robot.n_joints)]
    places += [f"v[{k}]" if c is None else repr(c) for k, c in enumerate(program.other_contents)]
    body = f"    double v[{len(program.other_contents)}];\n"
    for function, (*operands, value) in program.steps:
        text = STEPS[function.__name__].format(*(places[k] for k in operands))
        body += f"    {places[value]} = {text};\n"
    body += "".join(f"    frame[{k}] = {places[at]};\n" for k, at in enumerate(program.results))
    for name in ("STEPS", "PATIENCE", "REACHED_M", "REACHED_RAD", "LARGEST_TURN", "LENGTH"):
        macros[name] = getattr(serial_chain, name)
    macros |= {"ITERATIONS": compensation.MAX_ITERATIONS, "TOLERANCE_M": compensation.TOLERANCE_M}
    return (
        "".join(f"#define {name} {value}\n" for name, value in macros.items())
        + _file("vectors.c")
        + _table("double", "END", np.transpose([robot.lower, robot.upper]))
        + _table("short", "OWN", _own_springs(robot))
        + f"\nstatic void kinematics(const double q[], double frame[])\n{{\n{body}}}\n\n"
    )


def _table(kind: str, name: str, values: ArrayLike) -> str:
    """Return a static table of numbers that C reads back exactly; of none it has a zero."""
    digits, numbers = 9 if kind == "float" else 17, np.ravel(values).tolist() or [0]
    texts = (f"{number:.{digits}g}".replace("inf", "INFINITY") for number in numbers)
    return f"static const {kind} {name}[] = {{\n{textwrap.fill(', '.join(texts), 96)}\n}};\n"


def _file(name: str) -> str:
    return (files("stiff_models.c_export") / name).read_text(encoding="ascii")


def _own_springs(robot: Robot) -> list[int]:
    return [6 * joint + (2 if turns else 5) for joint, turns in enumerate(robot.turns)]


def spring_tables(model: Any) -> tuple[FloatArray, FloatArray] | None:
    """Return the (n, 5) lines and (m, 5) curves of a fitted model; None: it has no springs.

    A line (turned spring, loaded spring, wave, wave, c) adds c wave wave load to a turn. Wave 0 is
    1; 4 j + 1 to 4 j + 4 are cos, sin, cos 2, sin 2 of joint j. A curve (spring, preloaded, clips,
    width, height) adds height [f(g + load) - f(g)]: g is 0 or the weights' torque, f(t) is t
    clipped at the width, or atan(t / width).
    """
    robot, gears, kind, curves = model.robot_, _own_springs(model.robot_), type(model), []
    if kind is VirtualJointModel:
        lines = _rows(gears, gears, 0, 0, model.springs_.compliance)
    elif kind is FullVjm:
        springs = spring_columns(robot, model.springs)
        lines = _rows(springs, springs, 0, 0, model.compliance_)
    elif kind is MultiSegmentVjm:  # the last slope, and clipped steps of the slopes
        lines = _rows(gears, gears, 0, 0, model.slopes_[:, -1])
        steps = zip(model.breakpoints_.T, -np.diff(model.slopes_).T, strict=True)
        curves += [_rows(gears, model.gravity, True, end, step) for end, step in steps]
    elif kind is CurveSprings:
        springs, n = spring_columns(robot, SPRINGS_PER_JOINT), len(model.typical_)
        lines = _rows(springs, springs, 0, 0, model.coefficients_[:n] * model.typical_)
        typical = model.typical_[np.isin(springs, gears)]
        heights = model.coefficients_[n:].reshape(-1, len(gears)) * typical
        widths, n_ends = [*model.ends_, *np.outer(WIDTHS, model.torque_)], len(model.ends_)
        heights[n_ends:] *= model.torque_
        for k, sizes in enumerate(zip(widths, heights, strict=True)):
            curves.append(_rows(gears, True, k < n_ends, *sizes))
    elif kind is FourierSprings:  # products of 1, 1 + cos, 1 - cos, 1 + sin, 1 - sin
        sums = np.array([[1, 0, 0], [1, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1]])
        turning = 1 + np.flatnonzero(robot.turns[SHOULDER_AND_ELBOW])
        first, second, *_ = [*([0, 4 * j + 1, 4 * j + 2] for j in turning.tolist()), [0], [0]]
        basis = [np.ones((1, 1)), sums, np.kron(sums, sums)][len(turning)]
        parts = zip(product(first, second), (model.coefficients_ @ basis).T, strict=True)
        lines = np.vstack([_rows(gears, gears, a, b, values) for (a, b), values in parts])
    elif kind is BayesSprings:
        lines, curves = _groups(model)
    else:
        return None
    bends = np.vstack([np.empty((0, 5)), *curves])
    return lines[lines[:, -1] != 0.0], bends[bends[:, -1] != 0.0]


def _rows(*columns: ArrayLike) -> FloatArray:
    return np.column_stack(np.broadcast_arrays(*columns)).astype(np.float64)


def _groups(model: BayesSprings) -> tuple[FloatArray, list[FloatArray]]:
    """Return what the groups that are linear in the load do under unit loads, and the curves."""
    robot, sizes, first, curves = model.robot_, model.sizes_, 0, []
    kinds = np.where(robot.turns[:, None], np.arange(6), [3, 4, 5, 0, 1, 2])  # own kind first
    at = np.vstack([np.arange(6), kinds]) + 6 * np.roll(np.arange(len(kinds) + 1), 1)[:, None]
    n_angles, n = 5, at.size  # angles of a whole Fourier series with two harmonics
    angle, turned, loaded = np.indices((n_angles, n, n)).reshape(3, -1)
    unit, twist = np.eye(n).reshape(n, -1, 6), np.zeros((len(angle), 6, *at.shape))
    twist[:, 0], load, none = unit[turned], unit[loaded], np.empty(0)
    q = np.tile(2.0 * np.pi / n_angles * angle[:, None], robot.n_joints)
    loads = ArmLoads(q, none, none, none, twist, load, np.zeros_like(load), robot.turns)
    turns = np.zeros(len(angle))
    for group in model._linear:
        columns = group.columns(loads, sizes)[:, 0]
        coefficients = model.coefficients_[first : first + columns.shape[1]]
        first += len(coefficients)
        if isinstance(group, LostMotion | LoadCurves):
            is_lost, axes = isinstance(group, LostMotion), getattr(group, "axes", (OWN_AXIS,))
            width = (sizes.torque[1:, axes] * (1.0 if is_lost else 2.0)).ravel()
            height = width * sizes.compliance[1:, axes].ravel() * coefficients
            curves.append(_rows(at[1:, axes].ravel(), is_lost, False, group.width * width, height))
        else:
            turns += columns @ coefficients
    series = np.fft.rfft(turns.reshape(n_angles, n, n), axis=0) * (2.0 / n_angles)
    _, cos, cos_2 = series.real
    waves = np.stack([0.5 * series[0].real, cos, -series[1].imag, cos_2, -series[2].imag])
    is_there = np.abs(waves) > 1e-13 * np.abs(waves).max(axis=0)  # else it is rounding
    wave, turned, loaded = np.nonzero(is_there)
    of_joint = np.where(wave > 0, 4 * (at.flat[turned] // 6) + wave, 0)
    values = waves[wave, turned, loaded]
    return _rows(at.flat[turned], at.flat[loaded], of_joint, 0, values), curves
