"""Where a network runs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

import torch

from stiff_protocols.contract.errors import ConfigError

Device = Literal["auto", "cpu", "cuda"]


@dataclass(kw_only=True, eq=False, repr=False)
class RunsOnDevice:
    """Mixin of the families with a network.

    Attributes:
        device: device that the network runs on.
    """

    device: Device = "auto"

    def check_params(self) -> None:
        """Raise ConfigError where the device is not there."""
        torch_device(self.device)


def torch_device(device: Device) -> torch.device:
    """Return the device a network runs on; "auto" takes a GPU where there is one.

    A GPU's matrix products are told to repeat themselves; `arithmetic` sees to the rest.

    Raises:
        ConfigError: "cuda" was asked for and there is none.
    """
    on_gpu = device != "cpu" and torch.cuda.is_available()
    if device == "cuda" and not on_gpu:
        raise ConfigError("device 'cuda': no CUDA device is available here (valid: auto, cpu)")
    if on_gpu:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS reads it as it starts
    return torch.device("cuda" if on_gpu else "cpu")
