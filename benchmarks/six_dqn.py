"""What the ensembles of six DQN configurations recommend, and what each of them alone comes to, as greedy returns.

::

    apel run docs/examples/six-dqn-cartpole.yaml
    python -m benchmarks.six_dqn results/six-dqn-cartpole/*

An arm recommends one learner in each run: by its selector's estimates at the end, which costs nothing; or by ten greedy
episodes of each learner, which `apel export` plays, and whose steps are counted. "best alone" is whoever of the six
that were trained alone with a run's seed had the highest mean return over the last tenth of its steps: it costs all
their steps.
`benchmarks.six_dqn_asha` is Ray Tune's answer.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from apel.agents import Agent
from jobs.agents.exporting import agent_of
from jobs.films.scenes import Wish, find_scene
from jobs.results.manifest import arm_timings, versions
from jobs.results.store import ResultStore

RESULTS = Path("benchmarks/results")
_COMPARED = 10


def main() -> None:
    """Print and store."""
    parser = argparse.ArgumentParser()
    parser.add_argument("results", nargs="+")
    parser.add_argument("--episodes", type=int, default=50, help="Greedy ones of what is recommended.")
    arguments = parser.parse_args()
    for folder in arguments.results:
        store = ResultStore.at(folder)
        found = measured(store, arguments.episodes)
        name = store.experiment().name.replace("-", "_")
        (RESULTS / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n")
        print(f"{name}\n" + "\n".join(summary(found["runs"])))


def measured(store: ResultStore, episodes: int) -> dict[str, Any]:
    """Each arm's recommendations, run by run, and what they are worth over ``episodes`` greedy episodes."""
    runs = [
        {**recommended(store, row["arm"], row["run_index"], episodes), "last_tenth_return": row["last_tenth_return"]}
        for row in store.runs().to_pylist()
    ]
    timings = {arm: {"seconds": took, "steps": steps} for arm, (took, steps) in arm_timings(store.manifest()).items()}
    return {"versions": versions(), "greedy_episodes": episodes, "arms": timings, "runs": runs}


def recommended(store: ResultStore, arm: str, run: int, episodes: int) -> dict[str, Any]:
    """What an arm recommends at the end of a run."""
    agent = agent_of(store, find_scene(store, Wish(arm, run=run)), None, lambda _: None, trust=False).agent
    found = {"arm": arm, "run": run, "steps": agent.content.origin["steps"], "learner": agent.best}
    found["greedy_return"] = greedy_return(agent, agent.best, episodes)
    if len(agent.names) > 1:
        compared = [one for one in agent.evaluate(episodes=_COMPARED, seed=1).played if one.mode == "greedy"]
        by_name = {one.learner: one for one in compared if one.learner in agent.names}
        best = max(agent.names, key=lambda name: by_name[name].mean)
        found["compared_learner"] = best
        found["compared_greedy_return"] = greedy_return(agent, best, episodes)
        found["comparison_steps"] = int(sum(one.length.sum() for one in by_name.values()))
    return found


def greedy_return(agent: Agent, learner: str, episodes: int) -> float:
    """Mean over episodes that are none of the comparison's."""
    return agent.only(learner).evaluate(episodes=episodes, seed=0).of(learner).mean


def summary(runs: list[dict[str, Any]]) -> list[str]:
    """A line for each way to a recommendation: greedy return (mean, least, largest over runs), steps of a run."""
    ways: dict[str, list[tuple[float, int]]] = {}
    alone: dict[int, list[dict[str, Any]]] = {}
    for one in runs:
        ways.setdefault(one["arm"], []).append((one["greedy_return"], one["steps"]))
        if "comparison_steps" in one:
            steps = one["steps"] + one["comparison_steps"]
            ways.setdefault(f"{one['arm']}, compared", []).append((one["compared_greedy_return"], steps))
        else:
            alone.setdefault(one["run"], []).append(one)
    for ones in alone.values():
        best = max(ones, key=lambda one: one["last_tenth_return"])
        ways.setdefault("best alone", []).append((best["greedy_return"], sum(one["steps"] for one in ones)))
    return [line(way, *np.array(pairs).T) for way, pairs in ways.items()]


def line(way: str, returns: np.ndarray, steps: np.ndarray) -> str:
    """One row of a table."""
    spread = f"{returns.min():.1f} to {returns.max():.1f}"
    return f"| {way} | {len(returns)} | {returns.mean():.1f} | {spread} | {steps.mean():,.0f} |"


if __name__ == "__main__":
    main()
