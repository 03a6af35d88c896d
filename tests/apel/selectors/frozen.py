"""APEL and SSBAS as they were first written, without options: what the defaults must go on giving, bit for bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from apel.numerics.streams import categorical, dirichlet, integer


def select_apel(n: int, state: Any, stream: Any) -> int:
    probability = state[:n]
    dirichlet(stream, state[2 * n : 3 * n], probability)
    return categorical(stream, probability)


def observe_apel(decay: float, n: int, state: Any, selected: int, performance: float) -> None:
    estimate, concentration = state[n : 2 * n], state[2 * n : 3 * n]
    estimate[selected] = performance
    best = True
    for other in range(n):
        if other != selected and not performance > estimate[other]:
            best = False
    if best:
        concentration[selected] += 1.0
    for i in range(n):
        concentration[i] = max(concentration[i] * (1.0 - decay), 1.0)


def select_ssbas(exploration: float, n: int, state: Any, stream: Any) -> int:
    first = 3 * n + 1
    in_window = int(state[first - 1]) // 2
    logarithm = math.log(in_window) if in_window > 0 else 0.0
    index = np.full(n, np.inf)
    for k in range(n):
        count = state[first + k]
        if count > 0.0:
            index[k] = state[first + n + k] / count + math.sqrt(exploration * logarithm / count)
    best = [k for k in range(n) if index[k] == index.max()]
    state[:n] = 0.0
    state[best] = 1.0 / len(best)
    return best[integer(stream, len(best))]


def observe_ssbas(n: int, state: Any, selected: int, performance: float) -> None:
    first = 3 * n + 1
    ring = state[first + 2 * n :]
    capacity = ring.shape[0] // 2
    state[n + selected] = performance
    past = int(state[first - 1])
    ring[2 * (past % capacity)] = selected
    ring[2 * (past % capacity) + 1] = performance
    state[first + selected] += 1.0
    state[first + n + selected] += performance
    state[first - 1] = past + 1
    for dropped in range(past - past // 2, past + 1 - (past + 1) // 2):
        learner = int(ring[2 * (dropped % capacity)])
        state[first + learner] -= 1.0
        state[first + n + learner] -= ring[2 * (dropped % capacity) + 1]
        if state[first + learner] == 0.0:
            state[first + n + learner] = 0.0


def ssbas_state(n: int, num_episodes: int) -> Any:
    head = np.concatenate([np.full(n, 1.0 / n), np.full(2 * n, np.nan)])
    return np.concatenate([head, np.zeros(1 + 2 * n + 2 * (num_episodes // 2 + 2))])
