"""An evaluation, for people and as JSON."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from apel.agents import Agent, Evaluation


def evaluation_table(evaluation: Evaluation) -> Table:
    """A row for each learner and way of acting."""
    table = Table(box=None, header_style="bold", pad_edge=True)
    table.title, table.title_justify = evaluation.environment, "left"
    for name in ("learner", "acts", "episodes", "mean return", "95 % interval", "mean length"):
        table.add_column(name, justify="left" if name in ("learner", "acts") else "right")
    for one in evaluation.played:
        low, high = one.interval
        table.add_row(
            one.learner,
            one.mode,
            f"{len(one.episode_return):,}",
            f"{one.mean:,.4g}",
            f"{low:,.4g} to {high:,.4g}",
            f"{one.length.mean():,.1f}",
        )
    return table


def evaluation_json(evaluation: Evaluation, agent: Agent) -> dict[str, Any]:
    """All of it."""
    return {
        "environment": evaluation.environment,
        "seed": evaluation.seed,
        "agent": agent.digest,
        "best": agent.best,
        "by": agent.content.score_name,
        "played": [
            {
                "learner": one.learner,
                "mode": one.mode,
                "mean": one.mean,
                "interval": list(one.interval),
                "returns": one.episode_return.tolist(),
                "lengths": one.length.tolist(),
                "cut": one.num_cut,
            }
            for one in evaluation.played
        ],
    }
