"""Names that a file gives: which characters they have, and which of them would collide in the results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from jobs.experiment.yaml_schema import is_name, shown

RUN_COLUMNS = (
    "experiment", "arm", "sweep", "run_index", "seed", "train_time", "censored", "adaptation_time", "steady_state",
    "episodes", "steps",
)  # fmt: skip
"""That every run has."""
_DERIVED_COLUMNS = ("chosen", "position", "last_tenth_return")
"""That some results have, or have while they are made."""


def _one_line(text: str) -> str:
    if not is_name(text):
        message = f"found {shown(text)}, expected text without control characters"
        raise ValueError(message)
    return text


Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$", max_length=80)]
Text = Annotated[str, Field(max_length=1_000), AfterValidator(_one_line)]
"""Of one line, that may be shown as it is."""


def check_arms(arms: Iterable[str]) -> None:
    """Refuse arms whose folders of the results are one number to those who guess types from names (Arrow, DuckDB).

    Raises
    ------
    ValueError
        The message opens with the field to be changed.
    """
    numbers: dict[float, str] = {}
    for arm in arms:
        number = _number(arm)
        if number is None:
            continue
        if number in numbers:
            message = f"arms.{arm}: found the number that {numbers[number]!r} is too, expected names of another kind"
            raise ValueError(message)
        numbers[number] = arm


def _number(name: str) -> float | None:
    try:
        return None if "_" in name else float(name)
    except ValueError:
        return None


def check_columns(variables: Iterable[str], sweep: Mapping[str, Any]) -> None:
    """Refuse variables and named axes that would be columns of the results that are there already.

    Upper and lower case are one, as for DuckDB. An axis that is a field's path needs no column: it is in ``sweep``.

    Raises
    ------
    ValueError
        The message opens with the field to be changed.
    """
    taken = dict.fromkeys((*RUN_COLUMNS, *_DERIVED_COLUMNS), "a column of the results")
    places = [("variables", name) for name in variables]
    places += [("sweep", axis) for axis, values in sweep.items() if isinstance(values, dict) or axis not in taken]
    for field, name in places:
        if name.casefold() in taken:
            message = f"{field}.{name}: found the name of {taken[name.casefold()]}, expected another one"
            raise ValueError(message)
        taken[name.casefold()] = f"another one in {field}"


def shadows(info: Iterable[str], variables: Iterable[str], axes: Iterable[str]) -> list[tuple[str, str]]:
    """The fields of variables and axes that would take the place of a number that the environment reports.

    >>> shadows(["optimal_length"], ["dropped"], ["Optimal_length"])
    [('sweep', 'Optimal_length')]
    """
    reported = {name.casefold() for name in info}
    places = [("variables", name) for name in variables] + [("sweep", axis) for axis in axes]
    return [place for place in places if place[1].casefold() in reported]
