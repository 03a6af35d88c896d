"""Networks without a body over one-hot states: their heads are tables, so that every number can be worked by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from apel.learners.deep.networks import ActorCritic, NetworkOptions, QNetwork

NO_BODY = NetworkOptions(hidden=())


def q_table_network(num_states: int, num_actions: int) -> QNetwork:
    """Q(s, ·) is row s of a table, plus a bias."""
    return QNetwork((num_states,), num_actions, NO_BODY, (), dueling=False)


def actor_critic_tables(num_states: int, num_actions: int) -> ActorCritic:
    """The logits and Q(s, ·) are rows of two tables, plus biases."""
    return ActorCritic((num_states,), num_actions, NO_BODY)


def rows_of(network: QNetwork | ActorCritic, *runs: Sequence[NDArray[np.float64]]) -> Tensor:
    """``float64[R, P]``: the rows of parameters that hold these tables, for each run as many as it has heads."""
    rows = torch.zeros(len(runs), sum(network.layout.sizes), dtype=torch.float64)
    variables = network.layout.unpack(rows)
    for run, tables in enumerate(runs):
        for head, table in enumerate(tables):
            variables[2 * head][run] = torch.as_tensor(np.asarray(table, dtype=np.float64))
    return rows


def one_hot(states: NDArray[np.int64], num_states: int) -> Tensor:
    """``float64[…, states]``."""
    return torch.as_tensor(np.eye(num_states)[states])
