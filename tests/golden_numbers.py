"""Make and compare golden numbers, which detect a changed model without a new version.

`models/test_golden_numbers.py` fits every built-in model with few rows, small networks and five
steps. It compares predictions, bounds of intervals, training plans and a short pre-training.
`python tests/golden_numbers.py` makes the numbers. It does not replace numbers that changed
while their version did not. If you change what is fitted here, but no model, delete the model's
lines in the file first. Do the same for models with intervals of their own if you raise
`INTERVAL_VERSION`.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import typing
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from helpers.quick_models import twin_data
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models import device
from stiff_models.model_catalog import MODELS, model_info
from stiff_models.networks import network_model, training
from stiff_models.networks.fully_connected import build_network
from stiff_models.networks.network_model import EncodedNetworkModel
from stiff_models.networks.training import (
    PRETRAINING_VERSION,
    Curve,
    Rows,
    TrainingPlan,
    train_network,
)
from stiff_models.regressors import gaussian_process as likelihood
from stiff_models.regressors.tabular import InContextModel, PytabkitModel
from stiff_models.transfer import dt_cnn, ft_mlp
from stiff_models.transfer.alignment import AlignedObjective, uses_target
from stiff_models.transfer.cnn import Cnn, build_cnn
from stiff_models.transfer.pretrained_mlp import PRETRAINING
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import BenchmarkData, FloatArray

GOLDEN_FILE = Path(__file__).parent / "models" / "golden_numbers.json"
COMMAND = "python tests/golden_numbers.py"
PRETRAINING_KEY = "the pre-training"
KEYS = (
    *(info.key for info in MODELS),
    # one member of each family that rounding does not change: a tree's split flips
    *("sklearn:linear_model.SGDRegressor", "vjm+sklearn:linear_model.Ridge"),
    PRETRAINING_KEY,
)

CLOSED_FORM_M, NETWORK_M = 1e-9, 1e-6
"""Largest difference between a predicted deflection and the stored number."""
NETWORKS = (EncodedNetworkModel, PytabkitModel, InContextModel)
DEVIATION_M = 5e-4
"""Standard deviation of these deflections. Losses and outputs of networks are multiplied by it,
so that the same tolerance holds."""
SEARCH_STEPS = 5
"""Steps of the search for many hyperparameters of a Gaussian process. 40 rows do not determine
them, and the end of a full search depends on rounding (2e-4 m)."""

TRAIN, VALIDATION, TEST = np.arange(0, 120, 3), np.arange(1, 31, 3), np.arange(2, 146, 18)
SEED = 20261122
COVERAGE = 0.9

Options = Mapping[str, Any]

SMALL: Options = {
    "device": "cpu",
    "width": 16,
    "epochs": 5,
    "pretrain_steps": 5,
    "trees": 20,
    "members": 2,
}
"""Options of every model that has them, unless a variant sets them."""
OTHER_SOURCE = {"source": "specimen 1"}
"""Stands for a call of `use_source`; it is not an option."""
LEARNS = {"training": "normal", "learning_rate": 0.03}
"""Options of a fine-tuning that moves far enough to show its details."""
ALIGNMENT_WEIGHTS = {
    **{name: 1.0 for name in ("none", "adabn", "mk-mmd", "dann")},
    "coral": 1000.0,
}
"""Weights that make a distance visible in the loss, but keep its rounding from dominating."""
PHYSICS = ({}, {"physics": "vjm-multisegment"}, {"physics": "vjm-full"})

VARIANTS: dict[str, tuple[Options, ...]] = {
    "knn": ({}, {"weights": "uniform", "neighbours": 3}, {"angle_encoding": "raw"}),
    "vjm-multisegment": (
        *({"segments": number} for number in (2, 3, 4)),
        {"breakpoints": "search", "segments": 3},
        {"breakpoints": "given", "given_breakpoints": "5,30", "segments": 3},
        {"gravity": False},
        {"tcp": "fit"},
    ),
    "vjm-full": tuple(
        {"springs": springs, "solver": solver} for springs in (3, 6) for solver in ("nnls", "ridge")
    ),
    "curve-springs": ({}, {"weights": "student"}, {"tcp": "fit"}),
    "bayes-springs": ({}, {"groups": "joints+bearings+lost motion"}),
    "mlp": (
        {},
        {"training": "normal"},
        *({"activation": name} for name in ("tanh", "sigmoid")),
        {"angle_encoding": "raw", "layers": 2},
    ),
    "mlp-pretrained": (
        *({"recipe": recipe} for recipe in ("fast", "paper")),
        {"source_poses": "sobol", "source_wrenches": "sobol"},
        {"source_stiffness": "nominal", "preset": "paper"},
        {"source_teacher": "vjm-full", "pretrain_seed": 1},
        OTHER_SOURCE,
    ),
    "ft-mlp": (
        {},
        {"training": "best"},
        {"recipe": "paper"},
        *({"anchor": name} | LEARNS for name in ("none", "vjm-full")),
        OTHER_SOURCE | LEARNS,
        *({"freeze": name} | LEARNS for name in ("layers:1,2", "layers:3,out", "full", "lp-ft")),
    ),
    # the distances themselves: in `pretrained`
    "dt-cnn": (
        *({"alignment": name, "alignment_weight": 1.0} for name in ("none", "adabn", "dann")),
        {"supervision": "fine-tune", "alignment": "none"},
        {"preset": "udtl", "alignment": "none"},
        {"preset": "paper"},
    ),
    "adann-2r": ({}, {"supervision": "labels"}, OTHER_SOURCE),
    "compliance-net": (
        LEARNS,
        {"recipe": "paper"},
        OTHER_SOURCE | LEARNS,
    ),
    "deep-ensemble": (LEARNS,),
    "residual-mlp": PHYSICS,
    "gp": ({}, {"kernel": "rbf"}, {"ard": False}, {"restarts": 0, "search_rows": 20}),
    "vjm-gp": PHYSICS,
    # without vjm-full: with it, rounding flips a tree's split
    "vjm-boosting": (*PHYSICS[:2], {"leaves": 3, "leaf_samples": 2, "learning_rate": 0.2}),
}
"""Key of a model -> the options of each fit; every other model has one fit by default options."""


def current_numbers(key: str) -> dict[str, Any]:
    """Return a model's current golden numbers, with a network's plan per recipe."""
    if key == PRETRAINING_KEY:
        return {
            "version": PRETRAINING_VERSION,
            "library": "",
            "numbers": pretraining_numbers(),
            "plans": {},
        }
    info = model_info(key)
    with few_steps():
        numbers = {
            " ".join(f"{name}={value}" for name, value in options.items()): fit_and_predict(
                key, options
            )
            for options in VARIANTS.get(key, ({},))
        }
    is_network = issubclass(info.load(), EncodedNetworkModel)
    return {
        "version": info.version,
        "library": library(key),
        "numbers": numbers,
        "plans": {recipe: plans(key, recipe) for recipe in recipes(key)} if is_network else {},
    }


def library(key: str) -> str:
    """Return name and version of the library behind a model; "" for none."""
    name = "" if key == PRETRAINING_KEY else model_info(key).library
    return f"{name} {version(name)}" if name else ""


@cache
def other_source() -> BenchmarkData:
    return Kr10Twin(specimen=1).load()


def fit_model(key: str, options: Options) -> Any:
    """Return a fitted model, as small as its options allow."""
    info, data = model_info(key), twin_data()
    defaults = info.load()().get_params()
    small = {name: value for name, value in SMALL.items() if name in defaults}
    variant_options = {name: value for name, value in options.items() if name != "source"}
    model = info.load()(**small | variant_options)
    if "source" in options:
        model.use_source(other_source())
    validation = data.samples.take(VALIDATION) if info.uses_validation else None
    train = data.samples.take(TRAIN)
    return model.fit(train, robot=data.robot, validation=validation, seed=SEED)


def fit_and_predict(key: str, options: Options) -> list[float]:
    """Return deflections of the test rows, bounds of own intervals, and last losses, m."""
    model, test = fit_model(key, options), twin_data().samples.take(TEST)
    arrays = [model.predict(test.q, test.wrench)]
    if offers(model, "predict_interval"):
        interval = model.predict_interval(test.q, test.wrench, COVERAGE)
        arrays += [interval.lower, interval.upper]
    numbers = np.concatenate(arrays).ravel().tolist()
    for curve in getattr(model, "curves_", {}).values():
        numbers += losses(curve)
    return numbers


def losses(curve: FloatArray) -> list[float]:
    """Return the last training loss of a curve, and the validation loss if any."""
    last = curve[-1:, 1:]  # none of no steps
    return (last[np.isfinite(last)] * DEVIATION_M).tolist()


def recipes(key: str) -> tuple[str, ...]:
    """Return the valid recipes of a model; "" for one without."""
    kinds = typing.get_type_hints(model_info(key).load())
    return typing.get_args(kinds["recipe"]) if "recipe" in kinds else ("",)


def plans(key: str, recipe: str) -> list[dict[str, Any]]:
    """Return the plan and learning rates of each phase that a fit trains under a recipe.

    Nothing is trained. The rates are taken at every twentieth of the steps.
    """
    phases: list[dict[str, Any]] = []

    def longest_length(samples: Any, lengths: Any, *_: Any) -> Any:
        return lengths[-1]

    def record_plan(run: Any, phase: str, visits: Any) -> Curve:
        plan: TrainingPlan = run.plan
        steps = range(0, plan.steps, max(1, plan.steps // 20))
        rates = [round(plan.rate(step), 12) for step in steps]
        phase_plan = {"phase": phase, **asdict(plan), "rates": rates}
        if phase_plan not in phases:
            phases.append(phase_plan)
        return Curve(np.empty((0, 3)), plan.steps, np.nan)

    defaults = model_info(key).load()().get_params()
    options = {name: defaults[name] for name in ("epochs", "pretrain_steps") if name in defaults}
    options |= {"recipe": recipe} if recipe else {}
    options |= {"supervision": "fine-tune"} if key == "dt-cnn" else {}
    with (
        same_everywhere(),
        mock.patch.object(training._Run, "steps", record_plan),
        mock.patch.object(network_model, "chosen_epochs", longest_length),
    ):
        fit_model(key, options)
    return phases


def pretraining_numbers() -> dict[str, list[float]]:
    """Return networks' outputs and losses after a few steps of each plan and alignment."""
    angles = np.arange(64)[:, None] * np.arange(1, 9) * 0.7
    inputs = torch.as_tensor(np.sin(angles), dtype=torch.float32)
    rows = Rows(inputs[:48], torch.sin(3.0 * inputs[:48, :3]) + inputs[:48, 3:6])
    numbers = {}
    with same_everywhere(), torch.random.fork_rng():
        torch.manual_seed(SEED)  # of dropout
        for recipe in ("fast", "paper"):  # "best" differs by its steps
            for activation in ("relu", "gelu", "sharp-gelu"):
                mlp = build_network(8, layers=4, width=16, activation=activation, seed=SEED)
                short = replace(PRETRAINING[recipe], steps=15, batch=32)
                curve = train_network(mlp, rows, short, seed=SEED, phase=recipe)
                numbers[f"{recipe} {activation}"] = outputs(mlp, inputs) + losses(curve.points)
        for alignment, weight in ALIGNMENT_WEIGHTS.items():
            cnn = without_noise(8, pool="none", dropout=0.0, per_sample=False, seed=SEED)
            objective, moving = None, [*cnn.parameters()]
            if uses_target(alignment):
                objective = AlignedObjective(
                    cnn, inputs[20:60], alignment=alignment, weight=weight, loss="huber", seed=SEED
                )
                moving += objective.parameters()
            curve = train_network(
                cnn,
                rows,
                replace(dt_cnn.FAST, steps=5, batch=24),
                seed=SEED,
                phase=alignment,
                trainable=moving,
                objective=objective,
            )
            numbers[f"cnn {alignment}"] = outputs(cnn, inputs) + losses(curve.points)
    return numbers


def without_noise(*sizes: int, **options: Any) -> Cnn:
    """Return `build_cnn`'s network with constant convolution biases while batches are normalised.

    The gradient of a bias before a batch normalisation is only rounding, which Adam scales up to
    full steps. Another processor's predictions would differ by 5e-7 m to 5e-6 m.
    """
    network = build_cnn(*sizes, **options)

    def zero_gradient(gradient: torch.Tensor) -> torch.Tensor:
        return gradient if network.statistics_frozen else torch.zeros_like(gradient)

    for module in network.body:
        if isinstance(module, torch.nn.Conv1d) and module.bias is not None:
            module.bias.register_hook(zero_gradient)
    return network


def outputs(network: torch.nn.Module, inputs: torch.Tensor) -> list[float]:
    with torch.no_grad():
        return (network(inputs[::10]).double().flatten() * DEVIATION_M).tolist()


@contextlib.contextmanager
def same_everywhere() -> Iterator[None]:
    """Use one thread and float32 everywhere, ignore the cache of trainings, hide warnings."""
    threads = torch.get_num_threads()
    with (
        threadpool_limits(1),
        mock.patch.dict(os.environ, {"STIFFBENCH_CACHE": "off"}),
        mock.patch.object(device, "has_fast_bfloat16", lambda device: False),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


@contextlib.contextmanager
def few_steps() -> Iterator[None]:
    """Add short trainings to `same_everywhere`, if no option shortens them."""

    def search(loss: Any, start: Any, **options: Any) -> Any:
        options["options"] = {"maxiter": SEARCH_STEPS} if len(start) > 3 else {}
        return minimize(loss, start, **options)

    with (
        same_everywhere(),
        mock.patch.object(network_model, "LENGTHS", (0, 2)),
        mock.patch.dict(ft_mlp.FINE_TUNING, fast=replace(ft_mlp.FINE_TUNING["fast"], steps=5)),
        mock.patch.object(dt_cnn, "FINE_TUNING", replace(dt_cnn.FINE_TUNING, steps=5)),
        mock.patch.object(dt_cnn, "build_cnn", without_noise),
        mock.patch.object(likelihood, "minimize", search),
    ):
        yield


def describe_changes(key: str, stored: Mapping[str, Any], current: Mapping[str, Any]) -> list[str]:
    """Return advice and a line per differing variant and recipe, or nothing."""
    is_network = key == PRETRAINING_KEY or issubclass(model_info(key).load(), NETWORKS)
    tolerance = NETWORK_M if is_network else CLOSED_FORM_M
    lines = []
    for variant in stored["numbers"].keys() & current["numbers"].keys():
        before, after = (np.array(numbers["numbers"][variant]) for numbers in (stored, current))
        if before.shape != after.shape or not np.allclose(after, before, rtol=0.0, atol=tolerance):
            lines.append(f"{variant or 'as it comes'}: {before} became {after}")
    for recipe in stored["plans"].keys() & current["plans"].keys():
        before, after = stored["plans"][recipe], current["plans"][recipe]
        if before != after:
            lines.append(f"plans of recipe {recipe or '(none)'}: {before} became {after}")
    version_name = "PRETRAINING_VERSION" if key == PRETRAINING_KEY else "its version"
    return [f"numbers of {key} changed: raise {version_name}", *sorted(lines)] if lines else []


def describe_problem(key: str, stored: Mapping[str, Any], current: Mapping[str, Any]) -> str:
    """Return what is wrong with a model's stored numbers and how to fix it; "" for nothing.

    `stored` has the `current_numbers` of each model at that time, `current` this model's now.
    """
    stored_entry = stored.get(key)
    if stored_entry is None or stored_entry["version"] != current["version"]:
        suffix = "" if stored_entry is None else f" of version {current['version']}"
        return f"no golden numbers{suffix} of {key}: make them by `{COMMAND}`"
    if lines := describe_changes(key, stored_entry, current):
        return "\n".join(lines)
    for part in ("numbers", "plans"):
        if different := stored_entry[part].keys() ^ current[part].keys():
            return f"{key}, {part}: {sorted(different)} not in both: make them by `{COMMAND}`"
    return ""


def main(path: Path = GOLDEN_FILE, keys: Iterable[str] = KEYS) -> str:
    """Rewrite the file and return "", or return why it stays unchanged.

    Numbers that did not change stay to the digit. So do the numbers of models not usable here.
    """
    stored = json.loads(path.read_text()) if path.is_file() else {}
    entries, messages = {}, []
    for key in KEYS:
        stored_entry = stored.get(key)
        if key not in keys or (key != PRETRAINING_KEY and model_info(key).missing()):
            entries |= {} if stored_entry is None else {key: stored_entry}
            continue
        current = entries[key] = current_numbers(key)
        if stored_entry is None or any(
            stored_entry[part] != current[part] for part in ("version", "library")
        ):
            continue
        if lines := describe_changes(key, stored_entry, current):
            messages.append("\n  ".join(lines))
        current["numbers"] |= {
            n: stored_entry["numbers"][n]
            for n in stored_entry["numbers"]
            if n in current["numbers"]
        }
    if not messages:
        path.write_text(text_of(entries) + "\n")
    return "\n".join(messages)


def text_of(content: Any) -> str:
    """Return JSON with a line per list, so that differences are easy to read."""
    if not content or not isinstance(content, dict):
        return json.dumps(content)
    lines = [f"{json.dumps(name)}: {text_of(entry)}" for name, entry in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}"


if __name__ == "__main__":
    sys.exit(main())
