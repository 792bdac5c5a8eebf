"""Compare laws of a gear's torsion with measured gears: 28 loops, and a KUKA KR300 R2500.

`python results/gear_law/measured_gears.py` writes the tables of README.md and the picture beside it
(half a minute). The folders of the data have their licences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.optimize import nnls
from scipy.signal import savgol_filter
from tabulate import tabulate

from stiff_bench.figures.style import COLORS, PAGE_INCH, STYLE
from stiff_datasets.twin.gear_law import THRESHOLDS, GearLaw
from stiff_protocols.contract.types import FloatArray

FOLDER = Path(__file__).parent
LOOPS = FOLDER / "cycloidal_hysteresis" / "loops.csv"
RECORDINGS = {name: FOLDER / "kuka_kr300_torsion" / f"recording_{name}.csv.xz" for name in "ABC"}
BREAKPOINTS = [(first, second) for first in (0.05, 0.1, 0.2, 0.3) for second in (0.4, 0.6, 0.8)]
"""Torques between the three slopes, as shares of the largest torque; the best pair counts."""
LOOP_THRESHOLDS = (*THRESHOLDS, 0.6, 0.8)
"""Thresholds of the plays, as shares of the largest torque; the largest are the motor's friction
in the loops of +-4 N m."""
OLD_LOST_MOTION = (0.02, 0.04, 0.08, 0.16, 0.32)
"""Torques of the old law's tanh, as shares of the largest torque; the best counts."""
ARCMIN = np.deg2rad(1.0 / 60.0)
AXES = {"A1": (256.857143, 609.0), "A2": (267.428571, 844.0), "A3": (252.333333, 751.0)}
"""Gear ratio of each axis, and inertia of its motor at the joint [kg m2], by the data's authors."""
STANDING = 0.5
"""Speed in deg/s below which friction changes its sign gradually."""
WINDOW = 25
"""Samples (0.1 s) of the filter that differentiates the speed."""
GRID = 0.2
"""Distance in deg of the angles at which instants are compared."""

Columns = FloatArray
"""(n, k) terms of a law that is linear in its coefficients."""


def slopes(torque: FloatArray, first: float, second: float) -> Columns:
    """Return the terms of three slopes that change at two torques [N m]."""
    one = np.ones((3, 1))
    laws = [GearLaw(one * np.eye(3)[:, [k]], np.array([[first], [second]])) for k in range(3)]
    return np.column_stack([law.angle(torque) for law in laws])


def plays(torque: FloatArray, thresholds: FloatArray) -> Columns:
    """Return the (n, n_plays) plays along a closed cycle of (n,) torques, in its second lap."""
    law = GearLaw(np.ones(3), np.ones(2), thresholds=thresholds, weights=0.0 * thresholds)
    return law.plays_along(torque, law.plays_along(torque)[:, -1]).T


def masing(torque: FloatArray, scale: float) -> FloatArray:
    """Return the old law's lost motion per half of its width: 2 tanh((tau - tau_turn) / (2 tau_0)).

    It begins anew at every reversal of the torque.
    """
    rising = np.gradient(torque) >= 0.0
    starts = np.where(np.diff(rising, prepend=rising[0]))[0]
    turn = torque[np.r_[0, starts]][np.searchsorted(starts, np.arange(len(torque)), "right")]
    jump = np.where(rising, -1.0, 1.0)  # after a full branch the loop is closed
    return np.asarray(jump + 2.0 * np.tanh((torque - turn) / (2.0 * scale)))


def laws(torque: FloatArray) -> Iterator[tuple[str, Columns]]:
    """Yield the candidates of each law along a closed cycle of torques."""
    largest = np.abs(torque).max()
    yield "line", torque[:, None]
    memory = plays(torque, largest * np.array(LOOP_THRESHOLDS))
    for first, second in BREAKPOINTS:
        of_slopes = slopes(torque, first * largest, second * largest)
        yield "three slopes", of_slopes
        yield "plays", np.column_stack([of_slopes, memory])
        for share in OLD_LOST_MOTION:
            yield "old law", np.column_stack([of_slopes, masing(torque, share * largest)])


def fitted(columns: Columns, angle: FloatArray) -> FloatArray:
    """Return the (n,) angles of the best law with coefficients of at least zero, and an offset."""
    one = np.ones(len(angle))
    terms = np.column_stack([one, -one, columns])
    return np.asarray(terms @ nnls(terms, angle)[0])


def rms(residual: FloatArray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(residual**2)))


def best_fits(torque: FloatArray, angle: FloatArray) -> dict[str, FloatArray]:
    """Return the (n,) angles of the best candidate of each law."""
    best: dict[str, FloatArray] = {}
    for name, columns in laws(torque):
        candidate = fitted(columns, angle)
        if name not in best or rms(candidate - angle) < rms(best[name] - angle):
            best[name] = candidate
    return best


def loop_residuals(file: Path) -> pd.DataFrame:
    """Return each law's rms residual over half the range, a row per loop."""
    rows = []
    for number, loop in pd.read_csv(file).sort_values("order").groupby("loop"):
        torque, angle = (
            loop[column].to_numpy() for column in ("motor_torque_Nm", "deflection_deg")
        )
        half = np.ptp(angle) / 2.0
        facts = {"loop": number, **loop.iloc[0][["prototype", "test", "state"]]}
        fits = best_fits(torque, angle)
        rows.append(facts | {name: rms(of_law - angle) / half for name, of_law in fits.items()})
    return pd.DataFrame(rows)


# KUKA KR300


def recorded_joint(file: Path, axis: str) -> pd.DataFrame:
    """Return torsion [arcmin], gear torque [N m], speed [deg/s] and friction, by time.

    The gear's torque is the motor's without the motor's inertia; friction is a sign, whose size is
    fitted.
    """
    data, number, (ratio, inertia) = pd.read_csv(file), axis[1], AXES[axis]
    step = float(np.diff(data["t_s"]).mean())
    motor, link = (data[f"q{number}_{side}_deg"] for side in ("motor", "link"))
    speed = data[f"qd{number}_motor_deg_s"]
    acceleration = savgol_filter(speed.to_numpy(), WINDOW, 2, deriv=1, delta=step)
    return pd.DataFrame(
        {
            "angle": motor,
            "torsion": 60.0 * (motor - link),
            "speed": speed,
            "friction": np.tanh(speed / STANDING),
            "torque": ratio * data[f"tau{number}_motor_Nm"] - inertia * np.deg2rad(acceleration),
        }
    )


def at_equal_angles(joint: pd.DataFrame) -> pd.DataFrame:
    """Return the terms wherever the joint passes an angle of the grid, without the mean there.

    At one angle the transmission error, the offset of the encoders and the curve of the angle are
    the same, so that differences show the gear.
    """
    angle, terms = joint["angle"].to_numpy(), joint.to_numpy()
    rows = []
    for passed in np.arange(np.floor(angle.min()), angle.max(), GRID):
        over = angle - passed
        before = np.flatnonzero(over[:-1] * over[1:] < 0.0)
        share = (over[before] / (over[before] - over[before + 1]))[:, None]
        there = (1.0 - share) * terms[before] + share * terms[before + 1]
        rows.append(there - there.mean(axis=0) if len(there) else there)
    return pd.DataFrame(np.vstack(rows), columns=joint.columns)


EXTRA_TERMS: dict[str, Callable[[FloatArray, float], Columns]] = {
    "line": lambda torque, largest: np.empty((len(torque), 0)),
    "three slopes": lambda torque, largest: slopes(torque, 0.1 * largest, 0.5 * largest)[:, 1:],
    "lost motion": lambda torque, largest: np.tanh(torque / (0.03 * largest))[:, None] / 2.0,
    "plays": lambda torque, largest: plays(torque, largest * np.array(THRESHOLDS)),
}
"""Terms of a law beside those of a line: encoders' delay, friction and torque."""
LINE = ["speed", "friction", "torque"]


def kr300_table() -> pd.DataFrame:
    """Return each axis's stiffness, and the rms residual of each law on the other recordings."""
    rows = []
    for axis in AXES:
        joints = {name: recorded_joint(file, axis) for name, file in RECORDINGS.items()}
        torques = pd.concat([joint["torque"] for joint in joints.values()])
        values: dict[str, list[float]] = {}
        residuals = {}
        for law, extra in EXTRA_TERMS.items():
            if law == "lost motion" and not all(_crosses_zero(joint) for joint in joints.values()):
                continue  # nothing is taken up where the torque keeps its sign
            parts = {}
            for name, joint in joints.items():
                terms = extra(joint["torque"].to_numpy(), torques.abs().max())
                more = pd.DataFrame(terms, columns=[f"term {k}" for k in range(terms.shape[1])])
                parts[name] = at_equal_angles(pd.concat([joint, more], axis=1))
            names, errors = [*LINE, *more.columns], []
            for tested, test in parts.items():
                train = pd.concat([part for name, part in parts.items() if name != tested])
                factors = np.linalg.lstsq(train[names], train["torsion"], rcond=None)[0]
                errors.append(rms((test[names] @ factors - test["torsion"]).to_numpy()))
                values.setdefault(law, []).append(factors[-1])
            residuals[f"rms of {law} [arcmin]"] = f"{np.mean(errors):.3f}"
        stiffness = [1e-6 / (slope * ARCMIN) for slope in values["line"]]
        rows.append(
            {
                "axis": axis,
                "torque [kN m]": f"{torques.min() / 1e3:.1f} to {torques.max() / 1e3:.1f}",
                "stiffness [1e6 N m/rad]": _span(stiffness, ".1f"),
                "lost motion [arcmin]": _span(values.get("lost motion", []), ".2f"),
                **residuals,
            }
        )
    return pd.DataFrame(rows).fillna("-")


def _crosses_zero(joint: pd.DataFrame) -> bool:
    return bool(joint["torque"].min() < 0.0 < joint["torque"].max())


def _span(values: list[float], spec: str) -> str:
    return f"{min(values):{spec}} to {max(values):{spec}}" if values else "-"


# page and picture

SHOWN_LOOPS = (24, 20)
LAW_LINES = {"three slopes": ("--", COLORS[1]), "plays": ("-", COLORS[0])}
PAGE = """# Laws of a gear's torsion, and measured gears

`python results/gear_law/measured_gears.py` writes this page and its picture.

![Two of the measured loops, and the torsion of two axes of a KUKA KR300](measured_gears.png)

## 28 loops of cycloidal gears

Printed gears, output locked ([cycloidal_hysteresis](cycloidal_hysteresis/README.md), CC BY-SA 4.0).
Each law is fitted to each loop with coefficients of at least zero. The table has the rms residual
over half of the range of the angle.

- line: one slope.
- three slopes: slopes that change at two torques.
- old law: three slopes, and the lost motion of the twins of stiffbench 0.2. It gives way at once
  after a reversal of the torque; its best size is zero.
- plays: three slopes, and the plays of `stiff_datasets.twin.gear_law` with thresholds of
  {thresholds} of the largest torque. The two largest belong to the motor's friction, and the twins
  do not have them.

{loops}

## KUKA KR300 R2500 ultra SE

Two encoders at each of three axes, moving ([kuka_kr300_torsion](kuka_kr300_torsion/README.md),
MIT). Instants are compared at which a joint has the same angle, so that the transmission error
cancels. Every law has the encoders' delay and the motor's friction. The range of a number is that
of three pairs of recordings; the residuals (rms) are those on the third recording.

{kr300}

A line is about as good as every other law.

How soft the simulated robots are under small loads, in each world: [softness.md](softness.md).
"""


def loop_table(residuals: pd.DataFrame) -> pd.DataFrame:
    """Return median and range of the residuals, a row per law and a column per test."""
    names = ["line", "three slopes", "old law", "plays"]
    of_test = residuals.groupby("test")[names]
    low, middle, high = of_test.min(), of_test.median(), of_test.max()
    rows = [
        {"law": law}
        | {
            f"{test}, 14 loops": f"{middle[law][test]:.3f} ({low[law][test]:.3f} to "
            f"{high[law][test]:.3f})"
            for test in ("stiff", "play")
        }
        for law in names
    ]
    return pd.DataFrame(rows)


def draw(file: Path) -> None:
    """Draw two loops with their laws, and the torsion of two axes at equal angles."""
    loops = pd.read_csv(LOOPS).sort_values("order")
    with rc_context(STYLE):
        figure = Figure(figsize=(PAGE_INCH, 0.75 * PAGE_INCH), layout="constrained")
        above, below = figure.subplots(2, 2)
        for axes, number in zip(above, SHOWN_LOOPS, strict=True):
            loop = loops[loops["loop"] == number]
            torque, angle = loop["motor_torque_Nm"].to_numpy(), loop["deflection_deg"].to_numpy()
            axes.plot(torque, angle, ".", color="0.6", markersize=2.5, label="measured")
            fits = best_fits(torque, angle)
            for law, (line, color) in LAW_LINES.items():
                axes.plot(torque, fits[law], line, color=color, label=law)
            title = f"loop {number}: {loop.iloc[0]['prototype']}, {loop.iloc[0]['state']}"
            axes.set(title=title, xlabel="torque [N m]", ylabel="angle [deg]")
        above[0].legend()
        for axes, axis in zip(below, ("A1", "A2"), strict=True):
            joints = [at_equal_angles(recorded_joint(file, axis)) for file in RECORDINGS.values()]
            terms = pd.concat(joints)
            factors = np.linalg.lstsq(terms[LINE], terms["torsion"], rcond=None)[0]
            gear = terms["torsion"] - terms[LINE[:2]] @ factors[:2]
            axes.plot(terms["torque"] / 1e3, gear, ".", color="0.6", markersize=2.5)
            ends = np.array([terms["torque"].min(), terms["torque"].max()])
            axes.plot(ends / 1e3, factors[2] * ends, "-", color=COLORS[0], label="line")
            axes.set(
                title=f"KR300, {axis}: differences at equal angles",
                xlabel="torque of the gear [kN m]",
                ylabel="torsion [arcmin]",
            )
        below[0].legend()
        figure.savefig(file)


def main() -> None:
    """Write the page and its picture."""

    def written(table: pd.DataFrame) -> str:
        return tabulate(table, [*table.columns], "github", showindex=False, disable_numparse=True)

    page = PAGE.format(
        thresholds=", ".join(f"{share:g}" for share in LOOP_THRESHOLDS),
        loops=written(loop_table(loop_residuals(LOOPS))),
        kr300=written(kr300_table()),
    )
    (FOLDER / "README.md").write_text(page, encoding="utf-8")
    draw(FOLDER / "measured_gears.png")


if __name__ == "__main__":
    main()
