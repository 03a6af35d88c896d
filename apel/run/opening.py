"""The book of a shard before its first episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.numerics.seeding import Role, make_stream
from apel.run.criterion import NO_CRITERION, Criterion
from apel.run.floor import ActingFloor
from apel.run.selection import Selector
from apel.run.state import ANY_STEPS, RUNNING, Book, bad_selection_message, raise_to_floor


def open_book(
    selector: Selector,
    num_learners: int,
    num_episodes: int,
    criterion: Criterion | None,
    run_seeds: Sequence[int],
    run_infos: Sequence[dict[str, float]],
    *,
    run_variables: Sequence[Mapping[str, Any]] = (),
    num_steps: int | None = None,
    stops_when_met: bool = True,
    steady_state_episodes: int = 0,
    acting_floor: ActingFloor | None = None,
    pause_every: int = 0,
) -> Book:
    """The book of runs before their first episode; the learner of that episode is already selected.

    ``run_variables`` were drawn for each run, for a criterion that names one of them.
    A run ends after ``num_episodes``, or with the episode in which its steps reach ``num_steps``.
    ``steady_state_episodes`` is over how many episodes before the cap the steady state is measured. For a single
    learner there is no ``acting_floor``; for ``pause_every`` see `Book`.

    Raises
    ------
    ValueError
        If there is no learner or no episode, if the selector names a learner that does not exist, if the criterion
        counts too few episodes to be met, or if the floor cannot be kept, see `check_floor`.
    """
    _check_counts(num_learners, num_episodes)
    check_floor(acting_floor, num_learners, num_steps)
    floor = acting_floor if num_learners > 1 else None
    criteria = _criteria(criterion, run_variables or [{}] * len(run_seeds), num_episodes)
    num_runs = len(run_seeds)
    window = criterion.window if criterion else 1
    state = selector.initial_state(num_learners, num_episodes)
    parameters = [one.parameters() if one else NO_CRITERION for one in criteria]
    thresholds = [criterion.threshold(info) if criterion else -np.inf for info in run_infos]
    book = Book(
        selector_parameters=selector.parameters(),
        selector_state=np.tile(state, (num_runs, 1)),
        selector_stream=_streams(run_seeds, Role.SELECTOR),
        criterion_parameters=np.array(parameters, dtype=np.int64).reshape(num_runs, NO_CRITERION.size),
        threshold=np.array(thresholds, dtype=np.float64),
        recent=np.zeros((num_runs, window)),
        episode=np.zeros(num_runs, dtype=np.int64),
        learner=np.zeros(num_runs, dtype=np.int64),
        status=np.full(num_runs, RUNNING, dtype=np.int64),
        train_time=np.full(num_runs, -1, dtype=np.int64),
        steps=np.zeros(num_runs, dtype=np.int64),
        late_return=np.zeros(num_runs),
        floor_stream=_streams(run_seeds, Role.FLOOR),
        acting_steps=np.zeros((num_runs, num_learners), dtype=np.int64),
        acting_length=np.zeros((num_runs, num_learners + 1)),
        wanted=np.zeros((num_runs, num_learners)),
        floor=floor.steps if floor else 0.0,
        floor_after=floor.after if floor else 0,
        num_learners=num_learners,
        num_episodes=num_episodes,
        num_steps=ANY_STEPS if num_steps is None else num_steps,
        late_from=num_episodes - steady_state_episodes,
        stops_when_met=stops_when_met,
        pause_every=pause_every,
    )
    for run in range(num_runs):
        _select_first(book, selector, run)
    return book


def _select_first(book: Book, selector: Selector, run: int) -> None:
    arguments = book.selector_parameters, book.num_learners, book.selector_state[run], book.selector_stream[run]
    book.learner[run] = selector.select(*arguments)
    if not 0 <= book.learner[run] < book.num_learners:
        raise ValueError(bad_selection_message(book, run))
    if book.floor > 0.0:
        raise_to_floor(book, run)


def _streams(run_seeds: Sequence[int], role: Role) -> NDArray[np.uint64]:
    return np.array([make_stream(seed, role) for seed in run_seeds], dtype=np.uint64).reshape(len(run_seeds), 2)


def _criteria(
    criterion: Criterion | None, run_variables: Sequence[Mapping[str, Any]], num_episodes: int
) -> list[Criterion | None]:
    """That of each run."""
    if criterion is None:
        return [None] * len(run_variables)
    criteria = [criterion.of_run(variables) for variables in run_variables]
    for first in {one.after for one in criteria if isinstance(one.after, int)}:
        if first and first + criterion.window > num_episodes:
            message = (
                f"found {num_episodes} episodes, expected at least {first + criterion.window}: a window of "
                f"{criterion.window} after episode {first}"
            )
            raise ValueError(message)
    return [*criteria]


def _check_counts(num_learners: int, num_episodes: int) -> None:
    if num_learners < 1 or num_episodes < 1:
        message = f"found {num_learners} learners and {num_episodes} episodes, expected at least one of each"
        raise ValueError(message)


def check_floor(floor: ActingFloor | None, num_learners: int, num_steps: int | None) -> None:
    """See that there are enough steps for so many learners to play their share each, and any after the floor begins.

    Raises
    ------
    ValueError
        If there are not.
    """
    if floor is None:
        return
    if floor.steps * num_learners > 1.0:
        most = f"at most {1.0 / num_learners:.3g}"
        message = (
            f"acting_floor: found {floor.steps:g} of the steps for each of {num_learners} learners, expected {most}"
        )
        raise ValueError(message)
    if num_steps is not None and floor.after >= num_steps:
        message = f"acting_floor: after: found {floor.after}, expected less than the {num_steps} steps of a run"
        raise ValueError(message)
