"""One style for all figures: legible in print, in grey and to the colour-blind; the same data give the same file."""

from __future__ import annotations

import io
import itertools
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from jobs.experiment.spec import Experiment
from jobs.results.storage import Folder

# Okabe & Ito (2008): colours that remain distinct to the colour-blind; their yellow is too light for a line, and on
# their black no interval could be seen. The last two are those of the families below, taken where nothing else is left.
COLOURS = ("#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#882255", "#7F7F7F", "#0072B2", "#D55E00")
LINESTYLES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
GREY = "#555555"
# What most figures compare looks the same in all of them.
_FAMILIES = {"APEL": "#0072B2", "SSBAS": "#D55E00"}
_FIXED = {**_FAMILIES, "Q_full": "#009E73", "Q_red": "#E69F00"}
_KINDS = {"single learners": "#999999", "hindsight": "#CC79A7", "other selectors": "#56B4E9"}
_STYLE: Any = {
    "figure.constrained_layout.use": True,
    "figure.dpi": 150,
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelsize": 9.5,
    "axes.titlesize": 9.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "figure.titlesize": 10,
    "hatch.linewidth": 0.8,
    "svg.hashsalt": "apel",
}


@contextmanager
def pyplot() -> Iterator[Any]:
    """Matplotlib without a screen, in this style; what is left open is closed."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    with _in_style():
        try:
            yield plt
        finally:
            plt.close("all")


@contextmanager
def apart() -> Iterator[Any]:
    """What makes figures in this style that are the caller's, beside whatever is open and on whatever screen."""
    with _in_style():
        yield _Apart


class _Apart:
    """As much of pyplot as the figures need."""

    @staticmethod
    def subplots(rows: int, columns: int, *, figsize: tuple[float, float], **options: Any) -> tuple[Any, Any]:
        """A figure that no window is waiting for, and its axes."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=figsize)
        return figure, figure.subplots(rows, columns, **options)


@contextmanager
def _in_style() -> Iterator[None]:
    import matplotlib as mpl

    with mpl.rc_context():
        # Not what a `matplotlibrc` of the working directory says, which comes before all others.
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def colours(experiment: Experiment) -> dict[str, str]:
    """A colour for each arm and hindsight arm, the same in all figures of an experiment."""
    names = [*experiment.arms, *experiment.hindsight]
    if len(names) > len(COLOURS):
        return {name: _by_kind(experiment, name) for name in names}
    taken = {_FIXED[name] for name in names if name in _FIXED}
    free = itertools.cycle([colour for colour in COLOURS if colour not in taken])
    return {name: _FIXED.get(name) or next(free) for name in names}


def learner_colours(experiment: Experiment, arm: str) -> list[str]:
    """A colour for each learner of an arm: that of the arm which plays it alone, where there is one.

    Learners of which there are several each have their own, as those have that no arm plays alone.
    """
    palette, names = colours(experiment), experiment.arms[arm].learner_names
    alone = dict(_FIXED)
    if not kinds(experiment):
        singles = [(one, spec.learner_names) for one, spec in experiment.arms.items() if len(spec.learner_names) == 1]
        alone |= {learner: palette[one] for one, (learner,) in singles}
    known = {name: alone[name] for name in names if names.count(name) == 1 and name in alone}
    free = itertools.cycle([colour for colour in COLOURS if colour not in known.values()])
    return [known.get(name) or next(free) for name in names]


def _by_kind(experiment: Experiment, name: str) -> str:
    """Of many arms: those of the two main families, single learners, hindsight, and all others."""
    for family, colour in _FAMILIES.items():
        if name == family or name.startswith(f"{family}_"):
            return colour
    if name in experiment.hindsight:
        return _KINDS["hindsight"]
    return _KINDS["single learners" if len(experiment.arms[name].learner_names) == 1 else "other selectors"]


def kinds(experiment: Experiment) -> dict[str, str]:
    """What the colours of `colours` stand for, where several arms share one; otherwise nothing."""
    found = colours(experiment)
    if len(set(found.values())) == len(found):
        return {}
    named = {**{f"{family} and its variants": colour for family, colour in _FAMILIES.items()}, **_KINDS}
    return {name: colour for name, colour in named.items() if colour in found.values()}


def title(figure: Any, first: str, second: str = "") -> None:
    """A title over the whole figure, wrapped to its width; a second, smaller line says how to read it."""
    characters = int(figure.get_figwidth() * 11.5)
    lines = [textwrap.fill(first, characters)] + ([textwrap.fill(second, characters)] if second else [])
    figure.suptitle("\n".join(lines), linespacing=1.35)


def legend(figure: Any, axes: Any, num_columns: int | None = None) -> None:
    """One legend for a figure, below it, of everything in ``axes`` that has a label."""
    handles: dict[str, Any] = {}
    for one in axes:
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if not handles:
        return
    widest = max(map(len, handles))
    fitting = max(1, int(figure.get_figwidth() * 13.5) // (widest + 7))
    count = num_columns or min(len(handles), fitting)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=count)


def _take_literally(figure: Any) -> None:
    """Titles and labels are text, also where a user's holds dollar signs, between which matplotlib would read TeX.

    The numbers at an axis are matplotlib's own, and stay formulas.
    """
    from matplotlib.text import Text

    of_axes = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    numbers = {
        id(label) for axis in of_axes for which in ("major", "minor") for label in axis.get_ticklabels(which=which)
    }
    numbers |= {id(axis.offsetText) for axis in of_axes}
    for text in figure.findobj(Text):
        if id(text) not in numbers:
            text.set_parse_math(False)


def save(folder: Folder, figure: Any, name: str) -> list[str]:
    """Write a figure as PNG and SVG; returns where they are."""
    written = []
    _take_literally(figure)
    # Without dates and versions, so that the same results give the same file.
    for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None, "Creator": None})):
        buffer = io.BytesIO()
        figure.savefig(buffer, format=kind, metadata=metadata)
        folder.write(f"{name}.{kind}", buffer.getvalue())
        written.append(folder.location(f"{name}.{kind}"))
    return written
