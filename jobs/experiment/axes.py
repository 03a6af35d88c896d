"""Axes of a sweep: what they may set, and which arms they may touch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jobs.experiment.yaml_schema import MAX_DEPTH, is_name, shown

LABEL = "label"
"""In an axis: no path, but what its places are called."""
_NOT_SWEPT = {"name", "runs", "seed", "sweep", "arms", "hindsight", "plots"}
_MAX_LABEL = 1_000


def axis_columns(axis: str, values: Any) -> Mapping[str, Sequence[Any]]:
    """The values of each path of an axis, and its labels, where it has some.

    >>> axis_columns("seed", [1, 2])
    {'seed': [1, 2]}
    """
    return values if isinstance(values, dict) else {axis: values}


def axis_paths(axis: str, values: Any) -> list[str]:
    """The paths of the fields that an axis sets."""
    return [path for path in axis_columns(axis, values) if path != LABEL]


def check_axis(axis: str, columns: Mapping[str, Sequence[Any]], labels: Sequence[Any]) -> None:
    """Refuse an axis that cannot be swept; ``columns`` are the values of each of its paths, ``labels`` what stands for
    its places.

    Raises
    ------
    ValueError
        The message says what is wrong with it.
    """
    if not axis:
        message = "found an axis without a name, expected the path of a field, or a name"
        raise ValueError(message)
    for path in set(columns) - {LABEL}:
        if path.split(".")[0] in _NOT_SWEPT and not path.startswith("arms."):
            message = f"found the path {path!r}, expected a field that may differ between sweep points"
            raise ValueError(message)
        if not all(path.split(".")) or path.count(".") > MAX_DEPTH:
            message = f"found the path {shown(path)}, expected the names of fields with dots between them"
            raise ValueError(message)
    lengths = [len(column) for column in columns.values()]
    labels = list(map(str, labels))
    if len(set(lengths)) != 1 or not lengths[0]:
        message = f"{axis}: found {lengths} values, expected equally many, and at least one"
        raise ValueError(message)
    if set(columns) == {LABEL}:
        message = f"{axis}: found nothing but labels, expected the values of at least one field"
        raise ValueError(message)
    if len(set(labels)) != len(labels):
        message = f"{axis}: found {shown(labels)} as labels, expected the values of its first path to differ"
        raise ValueError(message)
    for label in labels:
        if not is_name(label) or len(label) > _MAX_LABEL:
            message = f"{axis}: found the label {shown(label)}, expected a short one, without control characters"
            raise ValueError(message)


def may_touch(axis: str, values: Any, arm: str) -> bool:
    """Whether an axis of the sweep may change an arm: not where all that it sets are fields of other arms.

    >>> may_touch("nu", {"arms.A.selector.decay": [0.1, 0.2]}, "B"), may_touch("episodes", [10, 20], "B")
    (False, True)
    """
    paths = axis_paths(axis, values)
    return any(path.split(".")[0] != "arms" or path.split(".")[1:2] in ([], [arm]) for path in paths)
