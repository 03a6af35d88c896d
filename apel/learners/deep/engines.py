"""What a learner asks of its networks, whichever engine computes them.

An algorithm is written once: as compiled code it runs on compiled networks (`compiled_network`), one run at a time, and
the same function as plain Python on PyTorch's stacked networks (`stacked_network`), several runs at a time. These few
functions are where both meet. The rows of all arrays are those of ``runs``; inputs and outputs are
``float32[A, B, …]``, of which the first ``count`` of B count.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import overload

from apel.dynamics.batched_environment import Runs
from apel.learners.deep import compiled_network
from apel.learners.deep.compiled_network import ACTING, ONLINE, OTHER, NetworkArrays

__all__ = ["ACTING", "ONLINE", "OTHER", "descend", "evaluate", "evaluate_both", "follow", "predict"]


def evaluate(network: Any, which: int, runs: Runs, count: int, inputs: Any, outputs: Any) -> None:
    """Write the outputs of one of each run's networks: the one that learns, the other one, or the one that acts."""
    network.evaluate(which, runs, count, inputs, outputs)


def evaluate_both(
    network: Any, one: int, other: int, runs: Runs, count: int, inputs: Any, outputs: Any, other_outputs: Any
) -> None:
    """Write the outputs of two of each run's networks for the same inputs, which go to a GPU once."""
    network.evaluate_both(one, other, runs, count, inputs, outputs, other_outputs)


def predict(network: Any, runs: Runs, count: int, inputs: Any, outputs: Any) -> None:
    """Write the outputs of the networks that learn, and remember what `descend` needs."""
    network.predict(runs, count, inputs, outputs)


def descend(network: Any, runs: Runs, count: int, inputs: Any, gradient: Any) -> None:
    """One step of the optimiser, against ``gradient`` ``[A, B, outputs]`` of a loss in what was predicted last."""
    network.descend(runs, count, inputs, gradient)


def follow(network: Any, runs: Runs, share: float) -> None:
    """Move the other networks by a share of the way to those that learn."""
    network.follow(runs, share)


def _is_compiled(network: Any) -> bool:
    return isinstance(network, types.BaseNamedTuple) and network.instance_class is NetworkArrays


# numba wants plain functions.
# ruff: noqa: PLW0108


@overload(evaluate, strict=False)
def _evaluate(network: Any, which: Any, runs: Any, count: Any, inputs: Any, outputs: Any) -> Any:
    if not _is_compiled(network):
        return None
    return lambda network, which, runs, count, inputs, outputs: compiled_network.evaluate(
        network, which, runs, count, inputs, outputs
    )


@overload(evaluate_both, strict=False)
def _evaluate_both(
    network: Any, one: Any, other: Any, runs: Any, count: Any, inputs: Any, outputs: Any, other_outputs: Any
) -> Any:
    if not _is_compiled(network):
        return None

    def compiled(network, one, other, runs, count, inputs, outputs, other_outputs):  # type: ignore[no-untyped-def]
        compiled_network.evaluate(network, one, runs, count, inputs, outputs)
        if one == other:
            other_outputs[: runs.shape[0], :count] = outputs[: runs.shape[0], :count]
        else:
            compiled_network.evaluate(network, other, runs, count, inputs, other_outputs)

    return compiled


@overload(predict, strict=False)
def _predict(network: Any, runs: Any, count: Any, inputs: Any, outputs: Any) -> Any:
    if not _is_compiled(network):
        return None
    return lambda network, runs, count, inputs, outputs: compiled_network.predict(network, runs, count, inputs, outputs)


@overload(descend, strict=False)
def _descend(network: Any, runs: Any, count: Any, inputs: Any, gradient: Any) -> Any:
    if not _is_compiled(network):
        return None
    return lambda network, runs, count, inputs, gradient: compiled_network.descend(
        network, runs, count, inputs, gradient
    )


@overload(follow, strict=False)
def _follow(network: Any, runs: Any, share: Any) -> Any:
    if not _is_compiled(network):
        return None
    return lambda network, runs, share: compiled_network.follow(network, runs, share)
