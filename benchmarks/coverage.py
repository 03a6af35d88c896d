"""How often four kinds of 95 % interval miss what they are to hold: percentile, expanded, BCa and Student's.

python -m benchmarks.coverage [--samples 2000] [--resamples 2000]

The statistics are those of the summary and of the ledger: means, paired differences, ratios of means, ratios of
standard deviations. Student's interval takes the jackknife's standard error, which of a mean is the usual one. The
acceleration of BCa is the jackknife's, too (Efron & Tibshirani 1993, ch. 14). Everything is computed of weighted
moments, so that one product of matrices gives a resample of all samples. An interval is everything where a resample has
no finite value, as in the ledger. Written to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from apel.numerics.intervals import CONFIDENCE, expanded_levels
from jobs.results.manifest import versions

Floats = NDArray[np.float64]
RUNS = (5, 10, 20, 40, 100)
METHODS = ("percentile", "expanded", "BCa", "t")
TAIL = (1 - CONFIDENCE) / 2
_CHUNK = 100
"""Samples that share their resamples."""
_NUM_TRUE = 4_000_000
"""Runs from which a true value is taken that has no formula."""


@dataclass(frozen=True)
class Case:
    """What is drawn, ``float64[…, arms]``, and the statistic, of means and mean squares ``float64[…, arms]``."""

    draw: Callable[[np.random.Generator, tuple[int, ...]], Floats]
    statistic: Callable[[Floats, Floats], Floats]


def _mean(means: Floats, _: Floats) -> Floats:
    return means[..., 0]


def _difference(means: Floats, _: Floats) -> Floats:
    return means[..., 0] - means[..., 1]


def _ratio(means: Floats, _: Floats) -> Floats:
    return means[..., 0] / means[..., 1]


def _deviation_ratio(means: Floats, squares: Floats) -> Floats:
    variance = np.maximum(squares - means**2, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):  # the same run five times over has no spread
        return np.sqrt(variance[..., 0] / variance[..., 1])


def _two_arms(rng: np.random.Generator, shape: tuple[int, ...], spread: float) -> Floats:
    """Lognormal times of two arms that share the maze, the first a tenth slower."""
    maze = rng.normal(0, spread / 2, (*shape, 1))
    return np.exp(maze + rng.normal(0, spread, (*shape, 2))) * [1.1, 1.0]


CASES = {
    "mean of normal values": Case(lambda rng, shape: rng.normal(10, 2, (*shape, 1)), _mean),
    "mean of exponential times": Case(lambda rng, shape: rng.exponential(1.0, (*shape, 1)), _mean),
    "mean of lognormal times (σ = 1)": Case(lambda rng, shape: rng.lognormal(0, 1, (*shape, 1)), _mean),
    "mean of times of which a tenth are at the cap": Case(
        lambda rng, shape: np.where(rng.random((*shape, 1)) < 0.1, 5000.0, 300 + rng.exponential(300, (*shape, 1))),
        _mean,
    ),
    "paired difference of lognormal times": Case(lambda rng, shape: _two_arms(rng, shape, 0.8), _difference),
    "paired difference, a tenth at the cap": Case(
        lambda rng, shape: np.minimum(_two_arms(rng, shape, 0.8), 3.0), _difference
    ),
    "ratio of two means of lognormal times": Case(lambda rng, shape: _two_arms(rng, shape, 0.8), _ratio),
    "ratio of two standard deviations, normal": Case(
        lambda rng, shape: rng.normal(0, [2.0, 1.0], (*shape, 2)), _deviation_ratio
    ),
    "ratio of two standard deviations, lognormal (σ = ½)": Case(
        lambda rng, shape: rng.lognormal(0, 0.5, (*shape, 2)) * [2.0, 1.0], _deviation_ratio
    ),
}


def statistic_of(case: Case, weights: Floats, values: Floats) -> Floats:
    """``float64[resamples, samples]`` of weights ``float64[resamples, runs]`` and values ``[samples, runs, arms]``."""
    means = np.einsum("br,sra->bsa", weights, values, optimize=True)
    return case.statistic(means, np.einsum("br,sra->bsa", weights, values**2, optimize=True))


def intervals(case: Case, values: Floats, weights: Floats) -> Iterator[tuple[str, Floats, Floats]]:
    """Of each method the ends, ``float64[samples]``."""
    num_runs = values.shape[1]
    point = statistic_of(case, np.full((1, num_runs), 1 / num_runs), values)[0]
    drawn = statistic_of(case, weights, values)
    yield "percentile", *np.quantile(drawn, [TAIL, 1 - TAIL], axis=0)
    yield "expanded", *np.quantile(drawn, expanded_levels(num_runs), axis=0)
    left_out = statistic_of(case, (1 - np.eye(num_runs)) / (num_runs - 1), values)
    influence = left_out.mean(axis=0) - left_out
    yield "BCa", *_bca(point, drawn, influence)
    error = np.sqrt((num_runs - 1) / num_runs * np.sum(influence**2, axis=0))
    reach = stats.t.ppf(1 - TAIL, num_runs - 1) * error
    yield "t", point - reach, point + reach


def _bca(point: Floats, drawn: Floats, influence: Floats) -> tuple[Floats, Floats]:
    below = np.mean(drawn < point, axis=0) + np.mean(drawn == point, axis=0) / 2
    bias = stats.norm.ppf(np.clip(below, 1 / len(drawn), 1 - 1 / len(drawn)))
    acceleration = np.sum(influence**3, axis=0) / (6 * np.sum(influence**2, axis=0) ** 1.5)
    ends = []
    for tail in (TAIL, 1 - TAIL):
        shifted = bias + stats.norm.ppf(tail)
        levels = stats.norm.cdf(bias + shifted / (1 - acceleration * shifted))
        ends.append(np.array([np.quantile(column, level) for column, level in zip(drawn.T, levels, strict=True)]))
    return ends[0], ends[1]


def errors(case: Case, num_runs: int, num_samples: int, num_resamples: int) -> dict[str, list[float]]:
    """Of each method the shares of intervals that lie wholly above, and wholly below the true value."""
    rng = np.random.default_rng([2015, num_runs])
    many = case.draw(rng, (_NUM_TRUE,))
    truth = float(case.statistic(many.mean(axis=0), (many**2).mean(axis=0)))
    missed = {name: np.zeros(2) for name in METHODS}
    for _ in range(num_samples // _CHUNK):
        values = case.draw(rng, (_CHUNK, num_runs))
        weights = rng.multinomial(num_runs, np.full(num_runs, 1 / num_runs), num_resamples) / num_runs
        for name, low, high in intervals(case, values, weights):
            missed[name] += [np.sum(low > truth), np.sum(high < truth)]
    return {name: (count / (num_samples // _CHUNK * _CHUNK)).tolist() for name, count in missed.items()}


def main() -> None:
    """Print a table of errors in percent, and write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=2000)
    parser.add_argument("--resamples", type=int, default=2000)
    options = parser.parse_args()
    found = []
    print(f"| | runs | {' | '.join(METHODS)} |\n|---|---|{'---|' * len(METHODS)}")
    for title, case in CASES.items():
        for num_runs in RUNS:
            missed = errors(case, num_runs, options.samples, options.resamples)
            found.append({"case": title, "runs": num_runs, "above_and_below": missed})
            print(
                f"| {title} | {num_runs} | {' | '.join(f'{100 * sum(missed[name]):.1f}' for name in METHODS)} |",
                flush=True,
            )
    content = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {name: versions()[name] for name in ("apel", "numpy", "scipy")},
        "samples": options.samples,
        "resamples": options.resamples,
        "errors": found,
    }
    target = Path(__file__).with_name("results") / "coverage.json"
    target.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
