"""The order of names in swept values: where it means something, and how a label writes names where it means nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from jobs.experiment.axes import LABEL, axis_columns

_CUSTOMARY = (
    "type", "id", "options", "run_seed", "max_episode_steps", "observations", "measure", "window", "below", "factor",
    "info", "plus", "at_least", "before", "start", "end", "steps", "episode", "after", "evaluation", "exclude", "bins",
    "low", "high", "count", "channel", "stack", "convolutions", "hidden", "activation", "layout",
)  # fmt: skip
"""Fields in the order in which they are declared, and mostly written; to be added to at the end alone, and never to be
reordered, since the labels of stored results follow from it.
"""
_RANKS = {name: rank for rank, name in enumerate(_CUSTOMARY)}


def swept_orders(sweep: Mapping[str, Any]) -> dict[str, list[str]]:
    """Place in a sweep → names in their order, wherever it is one that means something and not the sorted one.

    >>> swept_orders({"arms.A.learners": [{"Q": 1, "S": 2}, {"S": 2, "Q": 1}]})
    {'arms.A.learners: arms.A.learners.1': ['S', 'Q']}
    """
    return {
        f"{axis}: {path}.{level}{inner}": names
        for axis, values in sweep.items()
        for path, column in axis_columns(axis, values).items()
        if path != LABEL
        for level, value in enumerate(column)
        for inner, names in _orders(value, tuple(path.split(".")))
        if names != sorted(names)
    }


def axis_labels(columns: Mapping[str, Sequence[Any]]) -> list[Any]:
    """What stands for each place of an axis with such columns: its label, or the value of its first path."""
    path = LABEL if columns.get(LABEL) else next(iter(columns))
    return [label_of_value(path, value) for value in columns[path]]


def label_of_value(path: str, value: Any) -> Any:
    """The value with the names of its mappings in one order, whichever they stand in, save where it means something.

    Fields that experiment files have known for long stand in their customary order, other names after them, sorted.

    >>> label_of_value("learners.Q.exploration", {"steps": 100, "start": 1.0, "end": 0.1})
    {'start': 1.0, 'end': 0.1, 'steps': 100}
    >>> label_of_value("arms.A.learners", {"S": 1, "Q": 2})
    {'S': 1, 'Q': 2}
    """
    return _in_one_order(value, tuple(path.split(".")))


def _orders(value: Any, place: tuple[str, ...], inner: str = "") -> Iterator[tuple[str, list[str]]]:
    if isinstance(value, dict):
        if _order_counts(place):
            yield inner, list(value)
        for name, one in value.items():
            yield from _orders(one, (*place, name), f"{inner}.{name}")


def _in_one_order(value: Any, place: tuple[str, ...]) -> Any:
    if isinstance(value, list):
        return [_in_one_order(one, (*place, str(position))) for position, one in enumerate(value)]
    if not isinstance(value, dict):
        return value
    names = list(value) if _order_counts(place) else sorted(value, key=_rank)
    return {name: _in_one_order(value[name], (*place, name)) for name in names}


def _order_counts(place: tuple[str, ...]) -> bool:
    """Whether streams follow from the order of the names there, as `jobs.experiment.spec.Experiment.identity` has it
    of the file's own fields: of variables, and of the counted learners of an arm.
    """
    return place == ("variables",) or (len(place) == 3 and place[0] == "arms" and place[2] == "learners")


def _rank(name: str) -> tuple[int, str]:
    return _RANKS.get(name, len(_RANKS)), name
