"""Made-up results of Figure 4.6: Q is mediocre at once, DQN better later; ensembles of both switch, sooner or later."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jobs.analysis.statistics.bootstrap import Floats
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment
from jobs.results.storage import Folder
from jobs.results.store import ResultStore

SPEC = """
name: overtaking
title: Leveraging the strengths of several learners
runs: 10
episodes: 100000
environment: {id: apel/Maze-v0}
learners:
  Q: {type: q_learning}
  DQN: {type: q_learning, learning_rate: 0.2}
arms:
  Q: {learners: [Q]}
  DQN: {learners: [DQN]}
  APEL: {learners: [Q, DQN], selector: {type: apel, decay: 0.01}}
  SSBAS: {learners: [Q, DQN], selector: {type: ssbas}}
  SSBAS_normalised: {learners: [Q, DQN], selector: {type: ssbas, normalise: minmax_window}}
record: all
plots:
"""
PLOT = """
  - {kind: curves, name: overtaking, clock: steps, smooth: 100, panels: [return, probability, concentration],
     learners_of: [APEL], switch: {early: Q, late: DQN, window: 100}}
"""


@dataclass(frozen=True)
class Scale:
    """How much is made up: runs, environment steps of each, and the step at which DQN overtakes."""

    runs: int = 10
    steps: int = 1_000_000
    overtakes: int = 400_000
    latency: tuple[int, int, int] = (300, 2500, 1200)
    """Episodes by which APEL, SSBAS and SSBAS_normalised are late."""


def write_results(path: Path, scale: Scale, plots: str = PLOT) -> tuple[ResultStore, Experiment]:
    """Run rows and recorded episodes below a folder, and the experiment."""
    file = path / "overtaking.yaml"
    file.write_text(SPEC + plots)
    experiment = load_experiment(str(file))
    store = ResultStore(Folder(str(path / "results")))
    store.folder.write("spec.yaml", experiment.to_yaml().encode())
    draws = np.random.default_rng(0)
    latency = dict(zip(("APEL", "SSBAS", "SSBAS_normalised"), scale.latency, strict=True))
    rows = []
    for arm in experiment.arms:
        runs = [_run(draws, arm, run, scale, latency.get(arm)) for run in range(scale.runs)]
        rows += [{"arm": arm, "sweep": "", "run_index": run, "censored": None} for run in range(scale.runs)]
        store.write_table(f"episodes/arm={arm}/000000-000001.parquet", pa.concat_tables(runs))
    store.write_table("runs.parquet", pa.Table.from_pylist(rows))
    return store, experiment


def _run(draws: np.random.Generator, arm: str, run: int, scale: Scale, latency: int | None) -> pa.Table:
    overtakes = scale.overtakes * np.random.default_rng(run).uniform(0.8, 1.2)  # the same in all arms
    lengths = draws.integers(20, 60, scale.steps // 20)
    lengths = lengths[: int(np.searchsorted(np.cumsum(lengths), scale.steps)) + 1]
    ends = np.cumsum(lengths)
    of_q = 5 * (1 - np.exp(-ends / (0.03 * scale.steps)))
    of_dqn = 5 * (ends / overtakes) ** 1.5
    changes = np.searchsorted(ends, overtakes) + (latency or 0) * draws.uniform(0.7, 1.3)
    rest = np.clip((np.arange(len(ends)) - changes) / 60, -30, 30)
    probability = 0.02 + 0.96 / (1 + np.exp(-rest))
    chosen = (draws.uniform(size=len(ends)) < probability).astype(np.int64)
    expected = {"Q": of_q, "DQN": of_dqn}.get(arm, np.where(chosen == 1, of_dqn, of_q))
    selected = chosen if latency is not None else np.zeros_like(chosen)
    columns: dict[str, Any] = {
        "sweep": [""] * len(ends),
        "run_index": np.full(len(ends), run),
        "episode": np.arange(len(ends)),
        "selected": selected,
        "return": draws.poisson(expected).astype(np.float64),
        "length": lengths,
        "probability": _lists(probability, 1.0),
        "concentration": _lists(probability, 60.0),
    }
    return pa.table(columns)


def _lists(late: Floats, size: float) -> Any:
    """Of both learners."""
    values = pa.array((size * np.stack((1 - late, late), axis=1)).ravel())
    return pa.FixedSizeListArray.from_arrays(values, 2).cast(pa.list_(pa.float64()))
