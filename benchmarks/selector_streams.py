"""Selectors on performances that are drawn, with no learner behind them: ``python -m benchmarks.selector_streams``.

What the experiments of ``benchmarks/selectors`` ask, in minutes instead of hours: episodes are about as long as those
of learners in the mazes, but nobody learns. The defaults of `Incumbent` were chosen on a forerunner, with other
lengths and other seeds. Written to benchmarks/results/selector_streams.json.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from apel.numerics.compiled import njit
from apel.numerics.streams import stream_of_seed
from apel.numerics.views import Row
from apel.run.selection import Observe, Select, Selector
from apel.selectors import Apel, Incumbent, Ssbas, SwUcb

Floats = NDArray[np.float64]
Task = Callable[[np.random.Generator, int, int], Floats]
"""``(draws, switch, episodes) → float64[learners, episodes]``: what each would get, whoever plays."""
SHORTEST, LONGEST, WINDOW, MET = 34.0, 1000.0, 50, 37.4
SELECTORS: Mapping[str, Selector] = {
    "incumbent": Incumbent(),
    "APEL": Apel(),
    "SSBAS": Ssbas(),
    "SSBAS, normalised": Ssbas(normalise="minmax_window"),
    "SW-UCB": SwUcb(),
}


@njit
def select_all(
    select: Select, observe: Observe, parameters: Row, row: Row, stream: NDArray[np.uint64], table: Floats, played: Row
) -> None:
    """Play a run; ``played``, ``float64[episodes]``, becomes who did."""
    for episode in range(table.shape[1]):
        selected = select(parameters, table.shape[0], row, stream)
        observe(parameters, table.shape[0], row, selected, table[selected, episode])
        played[episode] = selected


def able(draws: np.random.Generator, episodes: int) -> Floats:
    """Of a learner that walks the shortest way, but for a slip here and there."""
    return -(SHORTEST + draws.binomial(1, 0.3, episodes) + draws.binomial(1, 0.05, episodes)).astype(float)


def middling(draws: np.random.Generator, episodes: int) -> Floats:
    """Of one that explores with ε = .4."""
    return -np.clip(draws.normal(57.0, 12.0, episodes), SHORTEST, LONGEST)


def poor(draws: np.random.Generator, episodes: int) -> Floats:
    """Of one with ε = .8 that the better one has taught."""
    return -np.minimum(SHORTEST + draws.gamma(2.0, 75.0, episodes), LONGEST)


def lost(draws: np.random.Generator, episodes: int) -> Floats:
    """Of one that hardly ever gets there."""
    return -np.where(draws.random(episodes) < 0.95, LONGEST, draws.uniform(300.0, LONGEST, episodes))


def learning(draws: np.random.Generator, episodes: int, until: int) -> Floats:
    """Of one that learns for so many episodes."""
    mean = np.interp(np.arange(episodes), [0, until], [LONGEST, SHORTEST])
    return -np.clip(draws.normal(mean, np.maximum(0.4 * (mean - SHORTEST), 0.5)), SHORTEST, LONGEST)


TASKS: Mapping[str, tuple[Task, int, int]] = {
    "switch": (lambda d, s, n: np.array([middling(d, n), np.r_[poor(d, s), able(d, n - s)]]), 1, 6_000),
    "switch, late": (lambda d, s, n: np.array([middling(d, n), np.r_[poor(d, s), able(d, n - s)]]), 10, 10_000),
    "pinned": (lambda d, s, n: np.array([middling(d, n), np.r_[lost(d, s), able(d, n - s)]]), 1, 6_000),
    "pinned, late": (lambda d, s, n: np.array([middling(d, n), np.r_[lost(d, s), able(d, n - s)]]), 10, 10_000),
    "degrading": (lambda d, s, n: np.array([np.r_[able(d, s), poor(d, n - s)], able(d, n) - 0.5]), 1, 6_000),
    "degrading, late": (lambda d, s, n: np.array([np.r_[able(d, s), poor(d, n - s)], able(d, n) - 0.5]), 10, 10_000),
    "late bloomer": (lambda d, _, n: np.array([middling(d, n), learning(d, n, 4_000)]), 0, 10_000),
    "one of 6": (lambda d, _, n: np.array([learning(d, n, 400), *(lost(d, n) for _ in range(5))]), 0, 5_000),
    "one of 20": (lambda d, _, n: np.array([learning(d, n, 400), *(lost(d, n) for _ in range(19))]), 0, 5_000),
}
"""How performances are drawn, about how many thousand episodes come before a switch, and how many after it at most."""


def played_by(selector: Selector, table: Floats, seed: int) -> NDArray[np.int64]:
    """``int64[episodes]``: who played each."""
    played = np.empty(table.shape[1])
    row = selector.initial_state(*table.shape)
    select_all(selector.select, selector.observe, selector.parameters(), row, stream_of_seed(seed), table, played)
    return played.astype(np.int64)


def time_to_criterion(selector: Selector, task: str, seed: int) -> float:
    """Episodes, counted from the switch, until the mean length of the last 50 is below 1.1 × the shortest way."""
    draw, thousands, after = TASKS[task]
    draws = np.random.default_rng(seed)
    switch = 1_000 * thousands + int(draws.integers(0, 997)) if thousands else 0
    table = draw(draws, switch, switch + after)
    played = played_by(selector, table, seed)
    lengths = -table[played, np.arange(table.shape[1])][switch:]
    met = np.flatnonzero(np.convolve(lengths, np.full(WINDOW, 1.0 / WINDOW), "valid") < MET)
    return float(met[0] + WINDOW if len(met) else after)


def steady_loss(selector: Selector, seed: int) -> float:
    """What the last 5 000 of 20 317 episodes lose per episode in return, .1 a step, beside one that never gets there.

    Over many of all windows that rules remember, and an end that none of them divides.
    """
    draws, episodes = np.random.default_rng(seed), 20_317
    table = np.array([able(draws, episodes), np.full(episodes, -LONGEST)])
    played = played_by(selector, table, seed)
    return float(np.mean(0.1 * (table[0] - table[played, np.arange(episodes)])[-5_000:]))


def share_of_best(selector: Selector, num_learners: int, wins: float, seed: int) -> float:
    """Of the last 5 000 of 10 000 episodes, with normal performances, the best of which beats another so often."""
    table = np.random.default_rng(seed).normal(size=(num_learners, 10_000))
    table[0] += np.sqrt(2.0) * NormalDist().inv_cdf(wins)
    return float(np.mean(played_by(selector, table, seed)[5_000:] == 0))


def measure(selector: Selector, runs: int, first: int) -> dict[str, tuple[float, float]]:
    """Mean and standard error of everything."""
    asked: dict[str, Callable[[int], float]] = {
        task: lambda seed, task=task: time_to_criterion(selector, task, seed)  # type: ignore[misc]
        for task in TASKS
    }
    asked["steady state"] = lambda seed: -steady_loss(selector, seed)
    for n, wins in ((2, 0.6), (2, 0.7), (2, 0.8), (2, 0.95), (5, 0.6), (5, 0.8)):
        asked[f"best of {n}, wins {wins}"] = lambda seed, n=n, wins=wins: share_of_best(selector, n, wins, seed)  # type: ignore[misc]
    found = {name: [one(first + run) for run in range(runs)] for name, one in asked.items()}
    return {name: (float(np.mean(f)), float(np.std(f, ddof=1) / np.sqrt(runs))) for name, f in found.items()}


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    path = Path(__file__).parent / "results" / "selector_streams.json"
    record: dict[str, object] = {"runs": options.runs, "seed": options.seed, "mean_and_standard_error": {}}
    for name, selector in SELECTORS.items():
        record["mean_and_standard_error"][name] = measure(selector, options.runs, 1_000_000 * options.seed)  # type: ignore[index]
        path.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
