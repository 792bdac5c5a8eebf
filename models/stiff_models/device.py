"""Choose a network's device and the arithmetic of its matrix products.

The accuracy of a processor's matrix products is measured before they are used.
"""

from __future__ import annotations

import os
import timeit
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
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
        """Raise ConfigError if the device is not available."""
        torch_device(self.device)


def torch_device(device: Device) -> torch.device:
    """Return the device of a network; "auto" takes a GPU if one is available.

    On a GPU, matrix products are set to be repeatable; `arithmetic` sets the other operations.

    Raises:
        ConfigError: "cuda" was requested and no CUDA device is available.
    """
    on_gpu = device != "cpu" and torch.cuda.is_available()
    if device == "cuda" and not on_gpu:
        raise ConfigError("device 'cuda': no CUDA device is available (valid: auto, cpu)")
    if on_gpu:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS reads it as it starts
    return torch.device("cuda" if on_gpu else "cpu")


FLOAT32_ERROR = 2.0**-21  # of a product, against the product of its factors' lengths
BFLOAT16_ERROR = 2.0**-8  # bfloat16 has 8 bits
FASTER = 1.1  # least speed-up; processors take about half or twice the time


@dataclass(frozen=True)
class Arithmetic:
    """Settings of matrix products during a training.

    Attributes:
        float32_route: torch's name. "medium" is oneDNN on a processor, which is faster there. The
            name allows rounding to bfloat16; if the processor does so, "highest" is used.
        bfloat16: multiply in bfloat16 while the training is in low precision.
        deterministic: torch's deterministic mode, which a GPU needs to repeat itself.
    """

    float32_route: Literal["highest", "medium"]
    bfloat16: bool
    deterministic: bool = False

    @contextmanager
    def in_force(self) -> Iterator[None]:
        """Set route and mode inside the `with` block and restore them afterwards."""
        route = torch.get_float32_matmul_precision()
        mode = torch.get_deterministic_debug_mode()
        torch.set_float32_matmul_precision(self.float32_route)
        if self.deterministic:
            torch.use_deterministic_algorithms(True)
        try:
            yield
        finally:
            torch.set_float32_matmul_precision(route)
            torch.set_deterministic_debug_mode(mode)


def arithmetic(device: torch.device, *, mixed_precision: bool) -> Arithmetic:
    """Return the fastest arithmetic of a device with the accuracy of its name."""
    return Arithmetic(
        "medium" if device.type == "cpu" and medium_is_float32() else "highest",
        mixed_precision and has_fast_bfloat16(device),
        deterministic=device.type == "cuda",
    )


@cache
def medium_is_float32() -> bool:
    """Return whether the processor's "medium" products have float32's accuracy."""
    with Arithmetic("medium", bfloat16=False).in_force():
        return _relative_error(torch.float32, torch.device("cpu")) <= FLOAT32_ERROR


@cache
def has_fast_bfloat16(device: torch.device) -> bool:
    """Return whether bfloat16 products run in hardware, sum in float32 and are faster."""
    if device.type == "cuda":
        in_hardware = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        names = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
        in_hardware = any(getattr(torch.cpu, name, lambda: False)() for name in names)
    if not in_hardware or _relative_error(torch.bfloat16, device) > BFLOAT16_ERROR:
        return False
    # an Intel processor without its matrix unit has the instructions, and is slower with them
    return device.type == "cuda" or _seconds(torch.bfloat16) < _seconds(torch.float32) / FASTER


def _seconds(dtype: torch.dtype) -> float:
    """Return the shortest time of a few products of the base network's size."""
    left_factor, right_factor = (torch.ones(n, 380, dtype=dtype) for n in (1024, 380))
    with Arithmetic("medium", bfloat16=False).in_force():
        return min(timeit.repeat(lambda: left_factor @ right_factor, number=1, repeat=10))


def _relative_error(dtype: torch.dtype, device: torch.device) -> float:
    """Return the largest error of a product of the base network's size, against float64.

    Each element's error is relative to the lengths of its row and its column.
    """
    generator = torch.Generator().manual_seed(0)
    left_factor, right_factor = torch.randn(2, 380, 380, generator=generator).to(device, dtype)
    computed = (left_factor @ right_factor).double()
    left_factor, right_factor = left_factor.double(), right_factor.double()
    lengths = left_factor.norm(dim=1)[:, None] * right_factor.norm(dim=0)
    return float((computed - left_factor @ right_factor).abs().div(lengths).max())
