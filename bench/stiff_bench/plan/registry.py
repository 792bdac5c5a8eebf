"""All models, data sets and protocols that can be named: ours, installed plugins', files'."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Literal, TypeVar, cast

from stiff_bench.console import say
from stiff_datasets.dataset_catalog import DATASETS
from stiff_models.model_catalog import FAMILIES, MODELS
from stiff_protocols.contract.errors import ConfigError, describe_error, unknown_name
from stiff_protocols.contract.plugin import (
    DatasetInfo,
    ModelFamily,
    ModelInfo,
    PluginInfo,
    ProtocolInfo,
)
from stiff_protocols.protocol_catalog import PROTOCOLS

OURS = "stiffbench"
"""Origin of the lines that are shipped."""

Info = TypeVar("Info", bound=PluginInfo)
Kind = Literal["model", "dataset", "protocol"]
KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
"""What a key of a catalogue line looks like, so that every command line can name it."""
EVERY_MODEL = "all"
"""The word that stands for every registered model on the command line."""
_PLUGIN = "stiffbench_plugin_"
"""How the modules of plugin files are called."""
_KINDS: dict[str, type[PluginInfo]] = {
    "models": ModelInfo,
    "datasets": DatasetInfo,
    "protocols": ProtocolInfo,
}


@dataclass
class Registry:
    """Catalogue lines by key.

    Attributes:
        models, datasets, protocols: key -> line.
        families: lines of models without number, such as every scikit-learn regressor.
        origins: key -> where the line came from.
    """

    models: dict[str, ModelInfo] = field(default_factory=dict)
    datasets: dict[str, DatasetInfo] = field(default_factory=dict)
    protocols: dict[str, ProtocolInfo] = field(default_factory=dict)
    families: tuple[ModelFamily, ...] = ()
    origins: dict[str, str] = field(default_factory=dict)

    def add(self, infos: Iterable[object], origin: str) -> None:
        """Register catalogue lines.

        Raises:
            ConfigError: a line has another type, or its key is taken or invalid.
        """
        for info in infos:
            if not isinstance(info, ModelInfo | DatasetInfo | ProtocolInfo):
                raise ConfigError(
                    f"{origin}: {info!r} is not a ModelInfo, DatasetInfo or ProtocolInfo"
                )
            if reason := self._key_fault(info.key):
                raise ConfigError(f"{origin}: key {info.key!r} {reason}; rename it")
            (kind,) = (kind for kind, line in _KINDS.items() if isinstance(info, line))
            getattr(self, kind)[info.key] = info
            self.origins[info.key] = origin

    def add_file(self, path: Path) -> None:
        """Import a plugin's file and register its lines.

        Raises:
            ConfigError: it cannot be imported, defines nothing, or a key is taken.
        """
        self.add(_lines_of(import_plugin_file(path), path), str(path))

    def _key_fault(self, key: str) -> str:
        """Return why a key is invalid; "" if it is valid."""
        # one key, one thing: `bench show KEY` and `--set KEY.option` do not name the kind
        if key in self.origins:
            return f"is taken by {self.origins[key]}"
        if key == EVERY_MODEL:
            return "stands for every model"
        if (family := self._family(key)) is not None:
            return f"begins with {family.prefix!r}, which stands for {family.summary}"
        return (
            "" if KEY.fullmatch(key) else "is not a valid key (valid: letters, digits, and . _ -)"
        )

    def model(self, key: str) -> ModelInfo:
        """Return the line of a model's key; see `find`."""
        return cast(ModelInfo, self.find(key, "model"))

    def find(self, key: str, kind: Kind | None = None) -> PluginInfo:
        """Return the line of a key of one kind, or of any; it may be a member of a family.

        Raises:
            ConfigError: there is none.
        """
        kinds: tuple[Kind, ...] = ("model", "dataset", "protocol") if kind is None else (kind,)
        tables: list[Mapping[str, PluginInfo]] = [
            getattr(self, f"{kind_name}s") for kind_name in kinds
        ]
        for table in tables:
            if key in table:
                return table[key]
        families = self.families if "model" in kinds else ()
        if families and (family := self._family(key)) is not None:
            return family.member(key)
        valid_keys = [*chain(*tables), *(f"{family.prefix}..." for family in families)]
        if (head := key.partition("@")[0]) in valid_keys:
            raise ConfigError(f"key {key!r} has options; give the key without them: {head!r}")
        raise unknown_name(kind or "key", key, valid_keys)

    def _family(self, key: str) -> ModelFamily | None:
        fitting = [family for family in self.families if key.startswith(family.prefix)]
        return max(fitting, key=lambda family: len(family.prefix), default=None)


def build_registry() -> Registry:
    """Collect the shipped catalogues and installed plugins; `Registry.add_file` adds a file.

    Invalid plugins are reported and left out: the import fails, a line has another type, or a key
    is taken.
    """
    registry = Registry(families=FAMILIES)
    for infos in (MODELS, DATASETS, PROTOCOLS):
        registry.add(infos, OURS)
    installed = entry_points()  # reads every package, 30 ms
    for kind in _KINDS:
        for point in installed.select(group=f"stiffbench.{kind}"):
            _add_installed(registry, point)
    return registry


@cache
def registry() -> Registry:
    """Return the registry of models, data sets and protocols, including plugins."""
    return build_registry()


def use_plugin(file: Path | str) -> None:
    """Import a plugin file that defines MODELS, DATASETS or PROTOCOLS.

    Raises:
        ConfigError: the file cannot be imported, or a key is already used.
    """
    registry().add_file(Path(file))


def use_only(plugins: Iterable[Path]) -> None:
    """Replace the plugins of files by these."""
    registry.cache_clear()
    for file in plugins:
        use_plugin(file)


def _add_installed(registry: Registry, point: EntryPoint) -> None:
    origin = f"{point.dist.name if point.dist else 'plugin'} ({point.group}: {point.name})"
    lines: list[object] = []
    with _left_out(), _guarded(origin):
        lines = _as_list(point.load())
    for line in lines:
        with _left_out():
            registry.add([line], origin)


@contextlib.contextmanager
def _left_out() -> Iterator[None]:
    try:
        yield
    except ConfigError as error:
        say(f"warning: plugin left out: {error}")


@contextlib.contextmanager
def _guarded(origin: str) -> Iterator[None]:
    """Turn any error of an imported third-party module into a ConfigError.

    Its output goes to standard error: standard output belongs to the tables.
    """
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except (Exception, SystemExit) as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        at = f" ({place.filename}:{place.lineno})"
        at = "" if isinstance(error, SyntaxError) else at  # its text has the place
        raise ConfigError(f"{origin}: cannot be imported: {describe_error(error)}{at}") from error


def _as_list(lines: object) -> list[object]:
    return list(lines) if isinstance(lines, list | tuple) else [lines]


def import_plugin_file(path: Path) -> ModuleType:
    """Import a plugin's file, whose code runs with that.

    Raises:
        ConfigError: it cannot be imported.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: no such file", "plugin")
    # two files may have one name, and each needs a module of its own
    place = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]
    name = f"{_PLUGIN}{path.stem}_{place}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path}: not a Python file (valid: a file that ends in .py)", "plugin")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and type hints look their module up here
    try:
        with _guarded(f"plugin {path}"):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def plugin_files() -> tuple[Path, ...]:
    """Return the plugin files that this process has imported: their classes need them elsewhere."""
    names = [name for name in list(sys.modules) if name.startswith(_PLUGIN)]
    return tuple(Path(str(sys.modules[name].__file__)).resolve() for name in names)


def _lines_of(module: ModuleType, path: Path) -> list[object]:
    lines = [info for kind in _KINDS for info in _as_list(getattr(module, kind.upper(), []))]
    if not lines:
        raise ConfigError(
            f"{path}: defines nothing (valid: a list MODELS, DATASETS or PROTOCOLS of "
            "ModelInfo, DatasetInfo or ProtocolInfo)",
            "plugin",
        )
    return lines
