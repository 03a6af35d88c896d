"""Pictures of APEL in theory (Figures 3.2 to 3.4)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from apel.theory import closed_forms, curves, selection_aware
from jobs.analysis.plotting import style
from jobs.experiment.figures import Picture

_COLOURS = ("#0072B2", "#D55E00", *style.COLOURS)
_MomentsOf = Callable[[float, int], curves.Moments]


def _pair(plt: Any) -> Any:
    return plt.subplots(1, 2, figsize=(8.6, 4.3))


def draw_growth(plt: Any, picture: Picture) -> Any:
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
            left.vlines(
                rise,
                0,
                0.9 * closed_forms.steady_state_concentration(nu),
                color=look["color"],
                linestyle="--",
                linewidth=0.9,
            )
    left.set_ylim(0, 1.1 * highest)
    left.set_xlim(0, picture.episodes)
    left.set(xlabel="episode", ylabel="concentration α", title="(a) concentration of the best learner")
    _probabilities(right, picture, curves.growth_moments, ("optimal", "suboptimal"))
    _legend_below(left, 3)
    style.title(figure, "Growth of the concentration parameters (theory)", "dashed verticals: 90 % of the steady state")
    return figure


def draw_adaptation(plt: Any, picture: Picture) -> Any:
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
    _probabilities(right, picture, curves.switch_moments, ("old best", "new best"))
    right.set_xlabel("episodes after the switch")
    for axes in (left, right):
        axes.set_xlim(0, picture.episodes)
    style.title(figure, "Adaptation after the best learner has changed (theory)")
    return figure


def draw_design(plt: Any, picture: Picture) -> Any:
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


def _probabilities(axes: Any, picture: Picture, of: _MomentsOf, labels: tuple[str, str]) -> None:
    """Mean and spread over the episodes, for the decay that the picture names."""
    nu = picture.shown_decay
    assert nu is not None  # noqa: S101 - an invariant of Picture
    moments = of(nu, picture.episodes)
    axes.set_title(f"(b) selection probability, ν = {nu:g}")
    episodes = np.arange(len(moments.mean))
    for position, label in enumerate(labels):
        mean, spread = moments.mean[:, position], np.sqrt(moments.variance[:, position])
        look = _look(position)
        axes.plot(mean, label=label, **look)
        axes.fill_between(episodes, mean - spread, mean + spread, color=look["color"], alpha=0.18, linewidth=0)
    axes.set(xlabel="episode", ylabel="probability (mean ± SD)", ylim=(0, 1), xlim=(0, episodes[-1]))
    _legend_below(axes, 2)
