"""Where networks are computed."""

from __future__ import annotations

import os
from typing import Annotated, Any

from numpy.typing import NDArray
from pydantic import Field

from apel.numerics import threads

LANES = 32
"""How many runs are computed in one call, wherever the number of rows may change the rounding (see `Rows`)."""
_WORKSPACE = "CUBLAS_WORKSPACE_CONFIG"
DeviceName = Annotated[str, Field(pattern=r"^(cpu|cuda(:\d+)?)$")]


def is_compiled_for(device: str) -> bool:
    """Whether this project's own code computes networks there, and PyTorch is not needed."""
    return device == "cpu"


def open_device(name: str) -> Any:
    """PyTorch's device of that name, for a learner to compute on.

    Raises
    ------
    ValueError
        If this machine does not have it.
    """
    import torch

    threads.settle()
    device = torch.device(name)
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        message = (
            f"device: found {name!r}, expected one that this process sees: cpu or {torch.cuda.device_count()} GPUs"
        )
        raise ValueError(message)
    if device.type == "cuda":
        _settle_gpu()
    return device


def quick_to_reach(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """The same array in memory that a GPU reads by itself, page-locked: without a copy by the processor before."""
    if is_compiled_for(name):
        return array
    import torch

    found: NDArray[Any] = torch.from_numpy(array).pin_memory().numpy()
    return found


def _settle_gpu() -> None:
    """What the same rows need on a GPU, before it multiplies for the first time.

    It is products alone whose rounding is a matter of settings; nothing here calls cuDNN. In TF32, which other code may
    have turned on, they have 10 bits of a fraction instead of 23. And cuBLAS promises the same bits from call to call,
    whatever else the GPU does, where its workspace has a fixed size (NVIDIA's manual of cuBLAS, *Results
    reproducibility*).
    """
    import torch

    os.environ.setdefault(_WORKSPACE, ":4096:8")
    torch.set_float32_matmul_precision("highest")
