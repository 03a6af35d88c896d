"""What must be settled before PyTorch multiplies, so that results do not depend on where numbers lie.

MKL, with which PyTorch multiplies matrices on x86-64, chooses its instructions by where in memory a matrix begins, and
so rounds a run's numbers differently beside other runs. In its reproducible mode it does not (Intel's *conditional
numerical reproducibility*); no cost could be measured. MKL reads the mode once, when it is first used, from a variable
of the environment: one that is set already stays as it is.
"""

from __future__ import annotations

import ctypes
import os
import sys
import warnings
from contextlib import suppress

VARIABLE = "MKL_CBWR"
_MODE = "AUTO,STRICT"
_BRANCH, _BRANCH_OFF = 1, 1  # MKL_CBWR_BRANCH and MKL_CBWR_BRANCH_OFF of mkl_types.h
# PyTorch's own MKL has the first name alone; MKL's library, which other builds of PyTorch load, has the second, too.
_GETTERS = "mkl_serv_cbwr_get", "MKL_CBWR_Get"


_REMEDY = (
    f"make the first deep learner before anything multiplies with PyTorch, or start this process (in a notebook: the "
    f"kernel) anew with {VARIABLE}={_MODE} in its environment"
)


class RoundingWarning(RuntimeWarning):
    """PyTorch had multiplied before its rounding could be settled."""


class RoundingError(RuntimeError):
    """The same where it must not be."""


def settle() -> None:
    """Ask for the reproducible mode, unless somebody has asked for another."""
    os.environ.setdefault(VARIABLE, _MODE)


def warn_if_too_late() -> None:
    """To be called when a learner is made that multiplies, after `settle`: warn if MKL has not heard of it."""
    if fault := _fault():
        warnings.warn(f"{fault}; {_REMEDY}", RoundingWarning, stacklevel=2)


def refuse_if_too_late() -> None:
    """The same where results are stored, which must depend on nothing but the experiment.

    Raises
    ------
    RoundingError
        If PyTorch is loaded, and its MKL has not heard of `settle`.
    """
    if "torch" in sys.modules and (fault := _fault()):
        message = f"{fault}; {_REMEDY}, or choose a placement in processes of its own: actors or packed"
        raise RoundingError(message)


def _fault() -> str:
    """What is wrong; empty if nothing is, or if somebody has asked for another mode."""
    if os.environ.get(VARIABLE) != _MODE or is_reproducible() is not False:
        return ""
    return (
        f"found that this process multiplied with PyTorch before {VARIABLE}={_MODE} was set, so that the last digits "
        "of what a deep learner computes, and all that follows from them, may depend on where its numbers lie in memory"
    )


def is_reproducible() -> bool | None:
    """Whether MKL is in a reproducible mode, by its own account; None where PyTorch has no MKL that can be asked.

    To be asked settles the mode, as any other first use of MKL does.
    """
    import torch

    library = ctypes.CDLL(torch._C.__file__)  # and all that it is linked with
    for name in _GETTERS:
        with suppress(AttributeError):
            return bool(library[name](_BRANCH) != _BRANCH_OFF)
    return None
