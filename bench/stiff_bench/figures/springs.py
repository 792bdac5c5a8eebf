"""Torque against deflection of each joint, and what the parts of a model contribute.

Segmented springs are drawn as lines, and curves with their bands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count, takewhile

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtri

from stiff_bench.figures.figure_source import FigureSource, setting, subtitle
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import (
    COLUMN_INCH,
    looks,
    name_panels,
    new_figure,
    new_panels,
    share_legend,
    short,
)
from stiff_bench.plan.fits import true_joint_turns
from stiff_bench.plan.registry import build_registry
from stiff_bench.store.database import read_data
from stiff_bench.store.samples import StoredData
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.springs.identification import SPRING_CURVE, contributions, spring_key

ROW_INCH, HEAD_INCH, FRAME_INCH, LINE_INCH = 1.75, 0.3, 0.45, 0.19
SPLIT_ALPHA = 0.75
_POINTS = 200
_SHARES = (0.5, 0.95)
"""Shares of the samples whose torques on a joint are shaded."""
BAND = 0.9
_NEEDS = (
    f"curves of springs; create them with `bench run --model {REFERENCE_MODEL} --model "
    "bayes-springs` (or vjm-multisegment)"
)
Part = tuple[float, float, float]
"""Mean deflection by a part and the ends of its interval, mm; NaN for no interval."""
_NO_PART: Part = (0.0, np.nan, np.nan)
_NEEDS_PARTS = "contributions; create them with `bench run --model bayes-springs`"
Spring = tuple[FloatArray, FloatArray]
"""Torques at the breakpoints of an odd, piecewise linear spring, N m (N), and its stiffnesses.

The stiffness of each segment is in N m/rad (N/m). It is the prior's if it was not identifiable,
and NaN if no training sample's torque reaches the segment.
"""


def springs_figure(
    data: StoredData,
    draw: Callable[[Axes, int], FloatArray],
    linear: Sequence[FitResult],
) -> Figure:
    """Draw a panel per joint.

    `draw` draws the springs of a joint and returns (n,) torques [N m or N]. The springs of the
    `linear` results are drawn at the same torques.
    """
    figure, panels = new_panels(len(data.robot.joint_names), ROW_INCH, HEAD_INCH)
    for joint, axes in enumerate(panels):
        at, key = draw(axes, joint), _stiffness(data, joint)
        stiffnesses = [fit.diagnostics[key] for fit in linear if key in fit.diagnostics]
        if stiffnesses:
            straight = 1e3 * at * np.median(1.0 / np.array(stiffnesses))
            axes.plot(at, straight, **looks(2)[1].connected(), label=REFERENCE_MODEL)
        if at[0] == 0.0:
            axes.set_ylim(bottom=0.0)
        turns = data.torque_units[joint] == "Nm"
        axes.set_xlabel("torque [N m]" if turns else "force [N]")
        axes.set_ylabel("deflection [mrad]" if turns else "deflection [mm]")
        axes.set_title(short(data.robot.joint_names[joint]), loc="left")
    name_panels(panels)
    share_legend(figure, panels)
    return figure


def _draw_segments(
    data: StoredData, torque: FloatArray, results: Sequence[FitResult], axes: Axes, joint: int
) -> FloatArray:
    """Draw a joint's segmented springs for (n, n_joints) torques [N m or N]."""
    blue, top = looks(1)[0], float(torque[:, joint].max()) or 1.0
    at = np.linspace(0.0, top, _POINTS)
    springs = [_spring(result.diagnostics, data, joint) for result in results]
    curves = np.array([1e3 * _deflection(at, spring) for spring in springs])
    median = np.median(curves, axis=0)
    axes.plot(at, curves.T, color=blue.color, linewidth=0.5, alpha=SPLIT_ALPHA)
    model = short(results[0].presentation.model)
    axes.plot(at, median, color=blue.color, linewidth=1.6, label=model)
    bends = np.median([bends for bends, _ in springs], axis=0)
    bends = bends[bends < top]
    heights = np.interp(bends, at, median)
    axes.plot(bends, heights, **blue.points(), markersize=4.5, label="breakpoint", zorder=4)
    for most in np.quantile(torque[:, joint], _SHARES):
        axes.axvspan(0.0, float(most), color="0.5", alpha=0.1, linewidth=0.0)
    axes.set_xlim(0.0, 1.02 * top)
    return at


def _draw_curves(
    data: StoredData,
    results: Sequence[FitResult],
    truth: Callable[[FloatArray], FloatArray] | None,
    axes: Axes,
    joint: int,
) -> FloatArray:
    """Draw a joint's curve of each split, and the band of the first.

    `truth` returns true (n, n_joints) turns [rad or m] by torques [N m or N]; None: not known.
    """
    blue, _, green = looks(3)
    model, reach = short(results[0].presentation.model), float(ndtri(0.5 + BAND / 2.0))
    name = f"{SPRING_CURVE}{data.robot.joint_names[joint]}"
    curves = [result.curves[name] for result in results if name in result.curves]
    for points in curves[1:]:
        axes.plot(
            points[:, 0], 1e3 * points[:, 1], color=blue.color, linewidth=0.5, alpha=SPLIT_ALPHA
        )
    if not curves:
        axes.text(0.5, 0.5, "no torque in the samples", ha="center", transform=axes.transAxes)
        return np.zeros(1)
    at: FloatArray
    at, turn, deviation = curves[0].T
    low, high = 1e3 * (turn - reach * deviation), 1e3 * (turn + reach * deviation)
    axes.fill_between(at, low, high, color=blue.color, alpha=0.2, linewidth=0.0)
    axes.plot(at, 1e3 * turn, color=blue.color, linewidth=1.6, label=model)
    if truth is not None:
        torque = np.zeros((len(at), len(data.robot.joint_names)))
        torque[:, joint] = at
        true = 1e3 * truth(torque)[:, joint]
        axes.plot(at, true, **green.connected(), linewidth=0.9, label="true (simulation)")
    axes.set(xlim=(at[0], at[-1]))
    return at


def springs(source: FigureSource) -> Prepared:
    """Show torque and deflection of each joint, with the springs identified on each split."""

    def has_curves(result: FitResult) -> bool:
        return any(name.startswith(SPRING_CURVE) for name in result.curves)

    def has_springs(result: FitResult) -> bool:
        segmented = any(name.startswith("breakpoint ") for name in result.diagnostics)
        return segmented or has_curves(result)

    task = source.task(has_springs, _NEEDS)
    results = sorted(source.results(task, has_springs), key=has_curves, reverse=True)
    model = results[0].presentation.model
    results = [result for result in results if result.presentation.model == model]
    stored = read_data(source.folder, task.name.data_sha256)
    linear = task.results(REFERENCE_MODEL) if REFERENCE_MODEL in task.models else ()
    if has_curves(results[0]):
        truth = true_joint_turns(results[0].fit, build_registry())
        truth_note = ", next to the simulated robot's true deflection" if truth else ""
        about = (
            f"Deflection of each joint by a torque that loads it from rest, as predicted by {model}"
            f"{truth_note} (thin: other splits; band: {BAND:.0%} interval of the first). A panel "
            "covers the torques of load and weight in the training samples."
        )
        draw = partial(_draw_curves, stored, results, truth)
    else:
        torque, torque_source = _torques(stored, results[0])
        about = (
            f"Deflection of each joint against the torque on it, as {model} identified it (thin: "
            f"each split, thick: median), for both signs alike; dashed: {REFERENCE_MODEL}. Shaded: "
            f"torques ({torque_source}) that {_SHARES[0]:.0%} and {_SHARES[1]:.0%} of the samples "
            "stay below; a panel ends at the largest."
        )
        draw = partial(_draw_segments, stored, np.abs(torque), results)
    caption = f"{about} {setting([task], [model], [len(results)])}"
    paint = partial(springs_figure, stored, draw, linear)
    return Prepared("Torque and deflection of each joint", caption, paint, subtitle(task))


def what_bends(source: FigureSource) -> Prepared:
    """Show how far each part of a robot and its rig moves the tool, as a model identified it."""
    task = source.task(_contributions, _NEEDS_PARTS)
    results = source.results(task, _contributions)
    model = results[0].presentation.model
    results = [result for result in results if result.presentation.model == model]
    fits = [_contributions(result) for result in results]
    largest = {part: max(fit.get(part, _NO_PART)[0] for fit in fits) for part in fits[0]}
    absent = "; ".join(part for part, size in largest.items() if not size)
    none = f"None found: {absent}. " if absent else ""
    parts = sorted(filter(largest.get, largest), key=largest.__getitem__)
    caption = (
        f"Mean deflection of the training samples by each part, as {model} identified it (dots: "
        f"splits; bar: {BAND:.0%} interval of the first). Parts may act against each other, so "
        f"they do not add up. {none}"
        f"{setting([task], [model], [len(results)])}"
    )
    return Prepared("What bends", caption, partial(_parts_figure, fits, parts), subtitle(task))


def _contributions(result: FitResult) -> dict[str, Part]:
    return contributions(result.diagnostics)


def _parts_figure(fits: Sequence[Mapping[str, Part]], parts: Sequence[str]) -> Figure:
    """Draw a line per part, from the bottom."""
    blue = looks(1)[0]
    height = HEAD_INCH + FRAME_INCH + LINE_INCH * len(parts)
    figure = new_figure(COLUMN_INCH, height)
    axes = figure.add_subplot()
    for place, part in enumerate(parts):
        _, *ends = fits[0].get(part, _NO_PART)
        axes.plot(ends, [place, place], color=blue.color, linewidth=3.0, alpha=0.3)
        values = [fit[part][0] for fit in fits if part in fit]
        axes.plot(values, [place] * len(values), **blue.points())
    axes.set_yticks(range(len(parts)), [short(part) for part in parts])
    axes.set_xlim(left=0.0)
    axes.set_xlabel("mean deflection [mm]")
    return figure


def _stiffness(data: StoredData, joint: int, segment: str = "") -> str:
    """Return the key of a joint's stiffness, or of a segment's, in the diagnostics."""
    name = f"{data.robot.joint_names[joint]}{segment}"
    return spring_key("stiffness", name, data.stiffness_units[joint])


def _spring(diagnostics: Mapping[str, float], data: StoredData, joint: int) -> Spring:
    name, unit = data.robot.joint_names[joint], data.torque_units[joint]
    numbered = (spring_key("breakpoint", f"{name} {number}", unit) for number in count(1))
    bends = [diagnostics[key] for key in takewhile(diagnostics.__contains__, numbered)]
    stiffness = []
    for number in range(1, len(bends) + 2):
        key = _stiffness(data, joint, f" segment {number}")
        prior = diagnostics.get(f"prior {key}", np.nan)
        identified = diagnostics.get(key, np.nan)
        stiffness.append(prior if np.isnan(identified) else identified)
    return np.array(bends), np.array(stiffness)


def _deflection(torque: FloatArray, spring: Spring) -> FloatArray:
    """Return a spring's (n,) deflection [rad or m] under torques [N m or N] that rise from 0."""
    bends, stiffness = spring
    nodes = np.array([0.0, *bends, max(torque[-1], *bends)])
    heights = np.cumsum(np.diff(nodes) / stiffness)
    return np.asarray(np.interp(torque, nodes, [0.0, *heights]))


def _torques(stored: StoredData, result: FitResult) -> tuple[FloatArray, str]:
    """Return the (n, n_joints) torques on the model's springs, and their source in words."""
    if not result.fit.model_params.get("gravity"):
        return stored.torque, "of the loads"
    weights = stored.robot.gravity_torque(stored.samples.q)
    return stored.torque + weights, "of loads and the links' weights"
