"""Figures that need no runs: APEL in theory (Figures 3.2 to 3.4), and mazes (4.1)."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from apel.configs import EnvironmentConfig
from apel.environments.factory import make_world
from apel.seeding import run_seeds
from apel.theory import closed_forms, curves, selection_aware
from jobs.analysis.plotting import style
from jobs.plots import Picture
from jobs.spec import Gallery

_COLOURS = ("#0072B2", "#D55E00", *style.COLOURS)
_SHOWN_DECAY = 0.01
_MAZES_PER_ROW = 3


def draw(plt: Any, picture: Picture, gallery: Gallery) -> Any:
    """The figure of a picture."""
    if picture.kind == "mazes":
        return _mazes(plt, picture, gallery)
    return {"growth": _growth, "adaptation": _adaptation, "design": _design}[picture.kind](plt, picture)


def _pair(plt: Any) -> Any:
    return plt.subplots(1, 2, figsize=(8.6, 4.3))


def _growth(plt: Any, picture: Picture) -> Any:
    """Figure 3.2: concentrations from 1 on, with the time to 90 % of the steady state; probabilities for one ν."""
    figure, (left, right) = _pair(plt)
    highest = 1.0
    for number, nu in enumerate(picture.decays):
        concentration = curves.growth(nu, picture.episodes)
        if nu > 0:
            highest = max(highest, concentration.max())
        look = _look(number)
        left.plot(concentration, label=f"ν = {nu:g}", **look)
        if nu > 0 and (rise := closed_forms.rise_time(nu)) <= picture.episodes:
            left.vlines(rise, 0, 0.9 * (1 / nu - 1), color=look["color"], linestyle="--", linewidth=0.9)
    left.set_ylim(0, 1.1 * highest)
    left.set_xlim(0, picture.episodes)
    left.set(xlabel="episode", ylabel="concentration α", title="(a) concentration of the best learner")
    _probabilities(right, curves.growth_moments(_SHOWN_DECAY, picture.episodes), ("optimal", "suboptimal"))
    right.set_title(f"(b) selection probability, ν = {_SHOWN_DECAY:g}")
    _legend_below(left, 3)
    style.title(figure, "Growth of the concentration parameters (theory)", "dashed verticals: 90 % of the steady state")
    return figure


def _adaptation(plt: Any, picture: Picture) -> Any:
    """Figure 3.3: after a switch, concentrations over their steady state, and probabilities for one ν."""
    figure, (left, right) = _pair(plt)
    for number, nu in enumerate(picture.decays):
        pair = curves.normalised_switch(nu, picture.episodes)
        look = _look(number)
        left.plot(pair.new_best, label=f"ν = {nu:g}", **look)
        left.plot(pair.old_best, **look | {"alpha": 0.55})
    left.set(xlabel="episodes after the switch", ylabel="concentration / steady state")
    left.set_title("(a) concentrations: old best from 1, new best from about ν")
    _legend_below(left, 4)
    _probabilities(right, curves.switch_moments(_SHOWN_DECAY, picture.episodes), ("old best", "new best"))
    right.set_title(f"(b) selection probability, ν = {_SHOWN_DECAY:g}")
    right.set_xlabel("episodes after the switch")
    for axes in (left, right):
        axes.set_xlim(0, picture.episodes)
    style.title(figure, "Adaptation after the best learner has changed (theory)")
    return figure


def _design(plt: Any, picture: Picture) -> Any:
    """Figure 3.4: adaptation and rise time by ν, of the formulas and of the model that heeds selection."""
    figure, (left, right) = _pair(plt)
    decays = sorted(nu for nu in picture.decays if nu > 0)
    fine = np.geomspace(decays[0], decays[-1], 40)
    # From 1/3 on neither of two learners keeps a lead: there is nothing to wait for.
    aware = [nu for nu in fine if nu < 1 / 3]
    panels = (
        (
            left,
            "Eq. 3.11",
            curves.adaptation_times(list(fine)),
            [selection_aware.adaptation_time(nu, 2) for nu in aware],
        ),
        (right, "Eq. 3.12", curves.rise_times(list(fine)), [selection_aware.rise_time(nu, 2) for nu in aware]),
    )
    for axes, equation, formula, model in panels:
        axes.plot(fine, formula, color=_COLOURS[0], linewidth=1.7, label=f"formula ({equation})")
        axes.plot(aware, model, color=_COLOURS[1], linewidth=1.7, linestyle="--", label="selection-aware, two learners")
        marks = np.interp(decays, fine, formula)
        axes.plot(decays, marks, linestyle="", marker="o", ms=4.5, color=_COLOURS[0])
        axes.set(xscale="log", yscale="log", xlabel="decay ν", ylabel="episodes")
        axes.grid(visible=True, which="major", color="#DDDDDD", linewidth=0.6)
        axes.legend(loc="upper right")
    left.set_title("(a) adaptation time")
    right.set_title("(b) rise time, to 90 % of the steady state")
    style.title(figure, "Choosing the decay ν (theory)")
    return figure


def _legend_below(axes: Any, num_columns: int) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=num_columns)


def _look(number: int) -> dict[str, Any]:
    linestyle = style.LINESTYLES[number % len(style.LINESTYLES)]
    return {"color": _COLOURS[number % len(_COLOURS)], "linestyle": linestyle, "linewidth": 1.6}


def _probabilities(axes: Any, moments: curves.Moments, labels: tuple[str, str]) -> None:
    episodes = np.arange(len(moments.mean))
    for position, label in enumerate(labels):
        mean, spread = moments.mean[:, position], np.sqrt(moments.variance[:, position])
        look = _look(position)
        axes.plot(mean, label=label, **look)
        axes.fill_between(episodes, mean - spread, mean + spread, color=look["color"], alpha=0.18, linewidth=0)
    axes.set(xlabel="episode", ylabel="probability (mean ± SD)", ylim=(0, 1), xlim=(0, episodes[-1]))
    _legend_below(axes, 2)


def _mazes(plt: Any, picture: Picture, gallery: Gallery) -> Any:
    """Figure 4.1: the mazes of the first runs, with start, goal and the shortest path."""
    columns = min(_MAZES_PER_ROW, picture.count)
    rows = math.ceil(picture.count / columns)
    figure, all_axes = plt.subplots(rows, columns, figsize=(2.5 * columns, 2.65 * rows + 0.9), squeeze=False)
    described = gallery.environment
    if described is None:
        message = f"{picture.name}: found no environment, expected one to draw"
        raise ValueError(message)
    config = EnvironmentConfig(**described.model_dump())
    for number, seed in enumerate(run_seeds(gallery.seed, picture.count)):
        _maze(all_axes.flat[number], make_world(config, seed).environment.unwrapped)
    for axes in all_axes.flat:
        axes.set_axis_off()
    style.legend(figure, [all_axes[0, 0]])
    style.title(figure, picture.title or gallery.title or gallery.name)
    return figure


def _maze(axes: Any, maze: Any) -> None:
    from matplotlib.collections import LineCollection

    size, start, goal = maze.size, maze.start_cell, maze.goal_cell
    cells = np.array(_shortest_path(maze.passages, size, start, goal))
    x, y = cells // size + 0.5, cells % size + 0.5
    axes.add_collection(LineCollection(_walls(maze.passages, size), colors="black", linewidths=1.3, capstyle="round"))
    axes.plot(x, y, color="#D55E00", linewidth=1.5, label="shortest path")
    axes.plot(x[:1], y[:1], "o", ms=8, color="#0072B2", linestyle="", label="start")
    axes.plot(x[-1:], y[-1:], "s", ms=8, color="#009E73", linestyle="", label="goal")
    axes.set(xlim=(-0.1, size + 0.1), ylim=(size + 0.1, -0.1), aspect="equal")
    axes.set_title(f"{len(cells) - 1} moves", fontsize=9, pad=2)


def _walls(passages: Any, size: int) -> list[Any]:
    """Every closed side of every cell, from corner to corner."""
    sides = (((0, 0), (1, 0)), ((1, 0), (1, 1)), ((0, 1), (1, 1)), ((0, 0), (0, 1)))  # up, right, down, left
    return [
        [(cell // size + x, cell % size + y) for x, y in sides[direction]]
        for cell, direction in zip(*np.nonzero(~passages), strict=True)
    ]


def _shortest_path(passages: Any, size: int, start: int, goal: int) -> list[int]:
    """Cells from start to goal, by breadth-first search."""
    offsets = (-1, size, 1, -size)  # up, right, down, left
    came_from = {start: start}
    queue = deque([start])
    while goal not in came_from:
        cell = queue.popleft()
        for offset, is_open in zip(offsets, passages[cell], strict=True):
            if is_open and cell + offset not in came_from:
                came_from[cell + offset] = cell
                queue.append(cell + offset)
    path = [goal]
    while path[-1] != start:
        path.append(came_from[path[-1]])
    return path[::-1]
