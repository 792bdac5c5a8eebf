"""`tabpfn`: TabPFN, a transformer that learned to predict from small tables.

N. Hollmann et al.: Accurate predictions on small data with a tabular foundation model.
Nature 637 (2025) 319-326. The package brings no weights, their newest ones may not be used
commercially, and nothing is downloaded here: the file must be there.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiff_models.networks import Device, torch_device
from stiff_models.optional_packages import missing_tabpfn
from stiff_models.regressor_model import RegressorModel, for_three_outputs
from stiff_protocols.errors import ConfigError, NotSavable


@dataclass(kw_only=True, eq=False, repr=False)
class TabPfn(RegressorModel):
    """TabPFN in context: fitting keeps the training rows; one context an axis.

    Attributes:
        model_path: file of weights of a TabPFN regressor (.ckpt); empty: the package's default
            file in its own cache folder.
        device: where the network runs.
    """

    model_path: str = ""
    device: Device = "auto"

    def check_params(self) -> None:
        """Check what a single option's type cannot.

        Raises:
            ConfigError: the device is not there.
        """
        torch_device(self.device)

    def missing(self) -> str:
        """Return why it cannot be used here: no package, or no weights; "" where it can."""
        return missing_tabpfn(self.model_path)

    def save(self, path: Path) -> None:
        """Refuse: the weights' licence is not ours to pass on.

        Raises:
            NotSavable: always.
        """
        raise NotSavable("a TabPFN cannot be saved: its weights are not ours to pass on")

    def _regressor(self, seed: int) -> Any:
        if reason := self.missing():  # the package would go for a download
            raise ConfigError(f"tabpfn: {reason}")
        from tabpfn import TabPFNRegressor

        return for_three_outputs(
            TabPFNRegressor(
                model_path=self.model_path or "auto",
                device=torch_device(self.device).type,
                random_state=seed,
            )
        )
