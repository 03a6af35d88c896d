"""Where tensors live."""

from __future__ import annotations

from typing import Annotated

import torch
from pydantic import Field

LANES = 32
"""How many runs are computed in one call, wherever the number of rows may change the rounding (see `Rows`)."""
DeviceName = Annotated[str, Field(pattern=r"^(cpu|cuda(:\d+)?)$")]


def open_device(name: str) -> torch.device:
    """The device of that name.

    Raises
    ------
    ValueError
        If this machine does not have it.
    """
    device = torch.device(name)
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        message = (
            f"device: found {name!r}, expected one that this process sees: cpu or {torch.cuda.device_count()} GPUs"
        )
        raise ValueError(message)
    return device
