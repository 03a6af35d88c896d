"""Where networks are computed."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from apel.numerics import threads

LANES = 32
"""How many runs are computed in one call, wherever the number of rows may change the rounding (see `Rows`)."""
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
    return device
