"""Check plugins (`bench check`) and write new ones (`bench new`)."""

from __future__ import annotations

import copy
import importlib.util
import keyword
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any
from unittest import mock

from stiff_bench.console import printable, wrapped
from stiff_bench.parameter_types import Folder, Setting
from stiff_bench.plan.fits import loaded
from stiff_bench.plan.options import Choice, chosen, chosen_dataset
from stiff_bench.plan.registry import OURS, Info, Kind, registry
from stiff_bench.run.progress import display
from stiff_models.io.cache_folder import OFF, VARIABLE
from stiff_models.io.model_file import load, save
from stiff_protocols.conformance.checks import Check, Status
from stiff_protocols.conformance.data_and_protocol_checks import check_dataset, check_protocol
from stiff_protocols.contract.errors import ConfigError, ModelError, NotSavable
from stiff_protocols.contract.files import check_new_file, make_folder, written_whole
from stiff_protocols.contract.plugin import DatasetInfo, ModelInfo
from stiff_protocols.contract.types import BenchmarkData, Robot

_MARKS: dict[Status, str] = {"passed": "✓", "failed": "✗", "not applicable": "–"}  # noqa: RUF001


@dataclass(frozen=True, repr=False)
class CheckResults:
    """Outcomes of the checks of a plugin.

    Attributes:
        where: the checked entry and its data.
        checks: checks with their outcomes.
    """

    where: str
    checks: Sequence[Check]

    @property
    def passed(self) -> bool:
        """Return True if no check failed."""
        return all(check.status != "failed" for check in self.checks)

    def __repr__(self) -> str:
        """Return the checklist for people."""
        lines = [self.where, ""]
        for check in self.checks:
            head = f"{_MARKS[check.status]} {check.name}"
            lines.append(f"{head}: {check.reason}" if check.reason else head)
            if advice := check.advice[:1].lower() + check.advice[1:]:
                lines.append(wrapped(f"to fix it: {advice}", "    ", "    "))
        statuses = [check.status for check in self.checks]
        counts = [f"{statuses.count(status)} {status}" for status in _MARKS]
        return printable("\n".join([*lines, "", ", ".join(counts)]))


def check(key: str, *, dataset: str = "fanuc-r2000ic", settings: Setting = ()) -> CheckResults:
    """Check the interface of a model, data set or protocol.

    Exit status of the command: 0 no check failed; 1 a check failed; 2 it cannot be checked.

    Args:
        key: model, data set or protocol; one of a plugin file needs the plugin.
        dataset: data set to check a model or protocol on.
        settings: option of the model, protocol or data set; may be repeated.

    Returns:
        Printable outcomes of the checks; `passed` is True if nothing failed.

    Raises:
        ConfigError: a key, option or value is wrong, or the plugin cannot be used here.
        DataError: the data set cannot be loaded or is too small.
    """
    info = registry().find(key)
    if isinstance(info, DatasetInfo):
        choice = chosen_dataset(key, settings, registry())
        _refuse_missing(choice)
        with display():
            return CheckResults(_named(choice), check_dataset(choice.make))
    kind: Kind = "model" if isinstance(info, ModelInfo) else "protocol"
    choices_by_kind = chosen({kind: (key,), "dataset": (dataset,)}, settings, registry())
    (subject,), (on,) = choices_by_kind.values()
    if isinstance(info, ModelInfo):
        subject = replace(subject, params={**info.quick, **subject.params})
    _refuse_missing(subject)
    with display():
        data = loaded(on)
        if isinstance(info, ModelInfo):
            checks = model_checks(subject, data)
        else:
            checks = check_protocol(subject.make, data)
    return CheckResults(f"{_named(subject)} on {_named(on)}", checks)


def model_checks(subject: Choice[ModelInfo], data: BenchmarkData) -> Sequence[Check]:
    """Return the checks of a model with its options on some data."""
    from stiff_protocols.conformance.model_checks import check_model  # 1 s: scikit-learn

    key = subject.info.key
    ours = registry().origins.get(key, OURS) == OURS
    with mock.patch.dict(os.environ, {VARIABLE: OFF}):  # a kept training repeats itself
        return check_model(
            subject.make,
            data,
            uses_validation=subject.info.uses_validation,
            save=None if ours else partial(_save_plugin, subject, data.robot),
            load=partial(load, plugins=None if ours else {key: subject.cls}),
        )


def _save_plugin(choice: Choice[Any], robot: Robot, model: Any, path: Path) -> None:
    """Write a plugin's fitted model as `bench fit` does; NotSavable where that refuses it."""
    fitted = copy.copy(model)
    if not hasattr(fitted, "robot_"):
        fitted.robot_ = robot
    try:
        save(fitted, path, {choice.info.key: choice.params})
    except ModelError as error:
        raise NotSavable(f"`bench fit` refuses it: {error}") from error


def _refuse_missing(choice: Choice[Any]) -> None:
    if reason := choice.missing():
        raise ConfigError(f"{choice.info.key!r} cannot be checked here: {reason}")


def _named(choice: Choice[Info]) -> str:
    return f"{choice.info.key} ({choice.options_text or 'default options'})"


def _names(name: str) -> dict[str, str]:
    """Return `key` on the command line, `module` of the file, and `cls` of the class.

    Raises:
        ConfigError: no Python module can be called so.
    """
    module = name.lower().replace("-", "_")
    plain = module.isascii() and module.isidentifier() and module[0].isalpha()
    if not plain or keyword.iskeyword(module):
        raise ConfigError(
            f"{name!r} is not a valid model name (valid: letters, digits, '-' and '_', a letter "
            "first, and no Python keyword)"
        )
    words = [word for word in module.split("_") if word]
    camel = "".join(word.capitalize() for word in words)
    return {"key": "-".join(words), "module": module, "cls": camel}


def new_model(name: str, output: Folder = Path()) -> str:
    """Write a small working model and its test.

    Args:
        name: name of the model.
        output: folder to write to.

    Returns:
        Text with the commands to type next.

    Raises:
        ConfigError: the name cannot be used, or is taken.
        StoreError: a file exists or cannot be written.
    """
    names, folder = _names(name), Path(output)
    key, module = names["key"], names["module"]
    if key in registry().origins:
        raise ConfigError(f"key {key!r} is taken by {registry().origins[key]}; give another name")
    make_folder(folder)
    plugin, test = folder / f"{module}.py", folder / f"test_{module}.py"
    for path in (plugin, test):
        check_new_file(path)
    if importlib.util.find_spec(module) is not None:
        raise ConfigError(f"Python already has a module {module!r}; give another name")
    for path, template in ((plugin, "model.py.txt"), (test, "test.py.txt")):
        text = (files("stiff_bench.model_tools") / "templates" / template).read_text("utf-8")
        with written_whole(path) as temporary:
            temporary.write_text(Template(text).substitute(names), encoding="utf-8")
    at = shlex.quote(str(plugin))
    return "\n".join(
        [
            f"written: {plugin} and {test}; the model's key is {key}. Next:",
            f"  python -m pytest {shlex.quote(str(test))}",
            f"  bench check {key} --plugin {at}",
            f"  bench run --model {key} --model vjm --plugin {at}",
        ]
    )
