"""Networks for tables: `realmlp` and `tabm` of the package pytabkit, `tabpfn` and `tabicl`."""

from __future__ import annotations

import io
import logging
import random
import warnings
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from annotated_types import Ge
from sklearn.multioutput import MultiOutputRegressor

from stiff_models.device import RunsOnDevice, torch_device
from stiff_models.model_catalog import missing_tabicl, missing_tabpfn
from stiff_models.networks.encoded_model import StandardisedRows
from stiff_models.regressors.regressor_model import RegressorModel, for_three_outputs
from stiff_protocols.contract.errors import ConfigError, DataError, NotSavable
from stiff_protocols.contract.types import FloatArray

FEWEST_ROWS = 3
"""Training samples that pytabkit can divide into batches."""


@dataclass(kw_only=True, eq=False, repr=False)
class PytabkitModel(RunsOnDevice, RegressorModel):
    """Base of the pytabkit families.

    Validation rows choose the epoch; without them pytabkit reserves a random fifth of the training
    rows for it.

    Attributes:
        epochs: number of epochs; None: pytabkit's default.
    """

    epochs: Annotated[int, Ge(1)] | None = None

    def save(self, path: Path) -> None:
        """Raise NotSavable: a fitted pytabkit object can only be pickled."""
        raise NotSavable(
            f"a {type(self).__name__} cannot be saved: pytabkit's models can only be pickled"
        )

    @abstractmethod
    def _network(self, **settings: Any) -> Any:
        """Return pytabkit's regressor with the shared settings."""

    def _regressor(self, seed: int) -> Any:
        with _quiet():
            return self._network(
                device=torch_device(self.device).type,
                random_state=seed,
                n_epochs=self.epochs,
                n_threads=torch.get_num_threads(),  # pytabkit sets torch's own, for good
            )

    def _learn(self, train: StandardisedRows, validation: StandardisedRows | None) -> None:
        inputs, targets = train
        if len(inputs) < FEWEST_ROWS:
            raise DataError(
                f"pytabkit's models need at least {FEWEST_ROWS} training samples, "
                f"there are {len(inputs)}"
            )
        chosen = {}
        if validation is not None:
            chosen["val_idxs"] = np.arange(len(inputs), len(inputs) + len(validation[0]))
            inputs, targets = (np.vstack(parts) for parts in zip(train, validation, strict=True))
        with _quiet():
            self.regressor_.fit(inputs, targets, **chosen)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        with _quiet():
            return super()._predict(q, wrench).astype(np.float64)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress output and warnings of pytabkit and lightning, and restore random states."""
    logger = logging.getLogger("pytorch_lightning")
    level = logger.level
    logger.setLevel(logging.ERROR)
    states = random.getstate(), np.random.get_state()  # noqa: NPY002
    try:
        with (
            warnings.catch_warnings(),
            redirect_stdout(io.StringIO()),
            torch.random.fork_rng(),
        ):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002


@dataclass(kw_only=True, eq=False, repr=False)
class RealMlp(PytabkitModel):
    """RealMLP-TD with pytabkit's defaults, one network of three outputs."""

    def _network(self, **settings: Any) -> Any:
        from pytabkit import RealMLP_TD_Regressor

        return RealMLP_TD_Regressor(**settings)


@dataclass(kw_only=True, eq=False, repr=False)
class TabM(PytabkitModel):
    """TabM with pytabkit's defaults, one ensemble per axis because it has only one output."""

    def _network(self, **settings: Any) -> Any:
        from pytabkit import TabM_D_Regressor

        return MultiOutputRegressor(TabM_D_Regressor(**settings))


@dataclass(kw_only=True, eq=False, repr=False)
class InContextModel(RunsOnDevice, RegressorModel):
    """Base of the families that predict in context: fitting keeps the training rows.

    There is one context per axis. The package's weights are never downloaded here.

    Attributes:
        model_path: file of weights of the package's regressor (.ckpt); empty: the package's default
            file in its cache folder.
    """

    model_path: str = ""

    @abstractmethod
    def missing(self) -> str:
        """Return why it cannot be used here: no package, or no weights; "" if it can."""

    @abstractmethod
    def _in_context(self, **settings: Any) -> Any:
        """Return the package's regressor with the shared settings."""

    def save(self, path: Path) -> None:
        """Raise NotSavable: the weights' licence does not allow copies in our files."""
        raise NotSavable(
            f"a {type(self).__name__} cannot be saved: its weights may not be redistributed"
        )

    def _regressor(self, seed: int) -> Any:
        if reason := self.missing():  # the package would start a download
            raise ConfigError(f"{type(self).__name__.lower()}: {reason}")
        regressor = self._in_context(device=torch_device(self.device).type, random_state=seed)
        return for_three_outputs(regressor)


@dataclass(kw_only=True, eq=False, repr=False)
class TabPfn(InContextModel):
    """TabPFN with the package's defaults."""

    def missing(self) -> str:
        """Return why it cannot be used here: no package, or no weights; "" if it can."""
        return missing_tabpfn(self.model_path)

    def _in_context(self, **settings: Any) -> Any:
        from tabpfn import TabPFNRegressor

        return TabPFNRegressor(model_path=self.model_path or "auto", **settings)


@dataclass(kw_only=True, eq=False, repr=False)
class TabIcl(InContextModel):
    """TabICL with the package's defaults."""

    def missing(self) -> str:
        """Return why it cannot be used here: no package, or no weights; "" if it can."""
        return missing_tabicl(self.model_path)

    def _in_context(self, **settings: Any) -> Any:
        from tabicl import TabICLRegressor

        path = self.model_path or None
        return TabICLRegressor(model_path=path, allow_auto_download=False, **settings)
