"""How often the test of `jobs.analysis.statistics.sequential` names a wrong arm, and how many runs it takes.

python -m benchmarks.deciding [--repetitions 2000]
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable

import numpy as np

from jobs.analysis.statistics import sequential

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]
DRAWS: dict[str, Draw] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "t, 2 degrees": lambda rng, shape: rng.standard_t(2.0, size=shape),
    "normal, runs share half of the variance": lambda rng, shape: (
        np.sqrt(0.5) * (rng.normal(size=shape) + rng.normal(size=(shape[0], 1)))
    ),
}
CASES = [
    ([0.0, 0.0], "normal", 30),
    ([0.0, 0.0], "t, 2 degrees", 30),
    ([0.0] * 6, "normal", 30),
    ([0.0, 0.0, -0.5, -0.5, -0.5, -0.5], "normal", 30),
    ([0.3, 0.0, 0.0], "normal", 30),
    ([1.0, 0.0], "normal", 30),
    ([1.0, 0.0], "normal, runs share half of the variance", 30),
    ([2.0, 0.0], "normal", 30),
    ([1.5, 0.0, 0.0, 0.0, 0.0, 0.0], "normal", 30),
]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repetitions", type=int, default=2000)
    repetitions = parser.parse_args().repetitions
    sequential._signs = functools.lru_cache(maxsize=None)(sequential._signs)
    print("| means | performances | runs at most | wrong | decided | after runs |\n|---|---|---|---|---|---|")
    for means, kind, num_runs in CASES:
        best = set(np.flatnonzero(np.array(means) == max(means)))
        named, wrong = [], 0
        for repetition in range(repetitions):
            rng = np.random.default_rng([repetition, len(means)])
            values = DRAWS[kind](rng, (num_runs, len(means))) + means
            found = sequential.decide(values, smaller_is_better=False, seed=repetition % 20)
            if found.best is not None:
                named.append(found.num_runs)
                wrong += best != {found.best}
        mean = f"{np.mean(named):.1f}" if named else "-"
        row = (f"{wrong / repetitions:.4f}", f"{len(named) / repetitions:.3f}", mean)
        print(f"| {', '.join(f'{one:g}' for one in means)} | {kind} | {num_runs} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
