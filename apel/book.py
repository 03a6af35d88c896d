"""The book of a shard: for every run, what its selector knows, how far it has come, and whose turn it is.

The book is a pure state machine: `advance` takes in one finished episode of a run and says who plays the next. It is
what makes *streaks* possible. Whoever has seen the same episodes has the same book, value for value; so the host of a
learner can keep playing a run for as long as the book says that its learner is selected, and the coordinator and all
other hosts reach the same state later by replaying the few numbers of each episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.compiled import KernelFunction, njit
from apel.metrics import NO_CRITERION, Criterion, criterion_met
from apel.seeding import Role, make_stream
from apel.selection import Observe, Select, Selector
from apel.trajectory import Episodes

ANY_STEPS = np.iinfo(np.int64).max
"""Where no number of steps ends a run."""
RUNNING, FINISHED, NOT_FINITE, BAD_SELECTION, FAILED = range(5)


class Book(NamedTuple):
    """The state of R runs, as arrays (all written in place)."""

    selector_parameters: NDArray[np.float64]
    selector_state: NDArray[np.float64]
    """``float64[R, …]``, see `apel.selection`."""
    selector_stream: NDArray[np.uint64]
    """``uint64[R, 2]``."""
    criterion_parameters: NDArray[np.int64]
    threshold: NDArray[np.float64]
    """``float64[R]``."""
    recent: NDArray[np.float64]
    """``float64[R, window]``: the criterion's memory."""
    episode: NDArray[np.int64]
    """``int64[R]``: index of the coming episode."""
    learner: NDArray[np.int64]
    """``int64[R]``: who plays it."""
    status: NDArray[np.int64]
    """``int64[R]``: RUNNING; FINISHED; NOT_FINITE after a performance that is no number; BAD_SELECTION after a selector
    named a learner that does not exist; FAILED because of anything else."""
    train_time: NDArray[np.int64]
    """``int64[R]``: episodes until the criterion held; −1 as long as it has not."""
    steps: NDArray[np.int64]
    """``int64[R]``: environment steps so far, greedy evaluations not counted."""
    late_return: NDArray[np.float64]
    """``float64[R]``: sum of the returns from episode ``late_from`` on."""
    num_learners: int
    num_episodes: int
    num_steps: int
    late_from: int
    stops_when_met: bool


def open_book(
    selector: Selector,
    num_learners: int,
    num_episodes: int,
    criterion: Criterion | None,
    run_seeds: Sequence[int],
    run_infos: Sequence[dict[str, float]],
    *,
    num_steps: int | None = None,
    stops_when_met: bool = True,
    steady_state_episodes: int = 0,
) -> Book:
    """The book of runs before their first episode; the learner of that episode is already selected.

    A run ends after ``num_episodes``, or with the episode in which its steps reach ``num_steps``.
    ``steady_state_episodes`` is over how many episodes before the cap the steady state is measured.

    Raises
    ------
    ValueError
        If there is no learner or no episode, if the selector names a learner that does not exist, or if the criterion
        counts too few episodes to be met.
    """
    if num_learners < 1 or num_episodes < 1:
        message = f"found {num_learners} learners and {num_episodes} episodes, expected at least one of each"
        raise ValueError(message)
    if criterion and criterion.after and criterion.after + criterion.window > num_episodes:
        message = (
            f"found {num_episodes} episodes, expected at least {criterion.after + criterion.window}: a window of "
            f"{criterion.window} after episode {criterion.after}"
        )
        raise ValueError(message)
    num_runs = len(run_seeds)
    window = criterion.window if criterion else 1
    state = selector.initial_state(num_learners, num_episodes)
    parameters = criterion.parameters() if criterion else NO_CRITERION
    thresholds = [criterion.threshold(info) if criterion else -np.inf for info in run_infos]
    book = Book(
        selector_parameters=selector.parameters(),
        selector_state=np.tile(state, (num_runs, 1)),
        selector_stream=np.array([make_stream(seed, Role.SELECTOR) for seed in run_seeds]).reshape(num_runs, 2),
        criterion_parameters=parameters,
        threshold=np.array(thresholds, dtype=np.float64),
        recent=np.zeros((num_runs, window)),
        episode=np.zeros(num_runs, dtype=np.int64),
        learner=np.zeros(num_runs, dtype=np.int64),
        status=np.full(num_runs, RUNNING, dtype=np.int64),
        train_time=np.full(num_runs, -1, dtype=np.int64),
        steps=np.zeros(num_runs, dtype=np.int64),
        late_return=np.zeros(num_runs),
        num_learners=num_learners,
        num_episodes=num_episodes,
        num_steps=ANY_STEPS if num_steps is None else num_steps,
        late_from=num_episodes - steady_state_episodes,
        stops_when_met=stops_when_met,
    )
    for run in range(num_runs):
        arguments = book.selector_parameters, num_learners, book.selector_state[run], book.selector_stream[run]
        book.learner[run] = selector.select(*arguments)
        if not 0 <= book.learner[run] < num_learners:
            raise ValueError(bad_selection_message(book, run))
    return book


def bad_selection_message(book: Book, run: int) -> str:
    """What is wrong with a selection."""
    return f"the selector named learner {book.learner[run]}, expected one from 0 to {book.num_learners - 1}"


@njit
def advance(
    book: Book,
    select: Select,
    observe: Observe,
    run: int,
    length: int,
    episode_return: float,
    performance: float,
    measure: float,
) -> None:
    """Take in the finished episode of ``run``; select for the next unless the run is over."""
    if not np.isfinite(performance):
        book.status[run] = NOT_FINITE
        return
    state = book.selector_state[run]
    observe(book.selector_parameters, book.num_learners, state, book.learner[run], performance)
    episode = book.episode[run]
    met = criterion_met(book.criterion_parameters, book.threshold[run], book.recent[run], episode, measure)
    if met and book.train_time[run] < 0:
        book.train_time[run] = episode + 1
    book.episode[run] = episode + 1
    book.steps[run] += length
    if episode >= book.late_from:
        book.late_return[run] += episode_return
    is_over = episode + 1 >= book.num_episodes or book.steps[run] >= book.num_steps
    if is_over or (met and book.stops_when_met):
        book.status[run] = FINISHED
        return
    selected = select(book.selector_parameters, book.num_learners, state, book.selector_stream[run])
    book.learner[run] = selected
    if not 0 <= selected < book.num_learners:
        book.status[run] = BAD_SELECTION


class EpisodeRows(NamedTuple):
    """The recorded episodes, one row each, as they stand in the result files (see `apel.EpisodeRecord`)."""

    run: NDArray[np.int64]
    episode: NDArray[np.int64]
    selected: NDArray[np.int64]
    episode_return: NDArray[np.float64]
    length: NDArray[np.int64]
    header: NDArray[np.float64]
    """``float64[rows, 3 · learners]``: probability, performance estimate and concentration at selection."""

    @classmethod
    def empty(cls, room: int, num_learners: int) -> EpisodeRows:
        """Rows with uninitialised room."""
        whole = [np.empty(room, dtype=np.int64) for _ in range(4)]
        return cls(whole[0], whole[1], whole[2], np.empty(room), whole[3], np.empty((room, 3 * num_learners)))


@njit
def _record(book: Book, episodes: Episodes, index: int, rows: EpisodeRows, row: int) -> None:
    """Write the row of an episode that ``book`` has yet to take in."""
    run = episodes.run[index]
    rows.run[row] = run
    rows.episode[row] = episodes.episode[index]
    rows.selected[row] = book.learner[run]
    rows.episode_return[row] = episodes.episode_return[index]
    rows.length[row] = episodes.length[index]
    rows.header[row] = book.selector_state[run, : 3 * book.num_learners]


@njit
def _replay(
    book: Book, select: Select, observe: Observe, episodes: Episodes, recorded: NDArray[np.bool_], rows: EpisodeRows
) -> int:
    count = 0
    for e in range(episodes.run.shape[0]):
        if book.episode[episodes.run[e]] != episodes.episode[e]:
            return -1
        if recorded[episodes.episode[e]]:
            _record(book, episodes, e, rows, count)
            count += 1
        run, length, episode_return = episodes.run[e], episodes.length[e], episodes.episode_return[e]
        advance(book, select, observe, run, length, episode_return, episodes.performance[e], episodes.measure[e])
    return count


def _replay_plain(
    book: Book, selector: Selector, episodes: Episodes, recorded: NDArray[np.bool_], rows: EpisodeRows
) -> int:
    """`_replay` for selectors that are not compiled."""
    count = 0
    columns = zip(*(column.tolist() for column in episodes), strict=True)
    for e, (run, episode, length, episode_return, performance, measure, _) in enumerate(columns):
        if book.episode[run] != episode:
            return -1
        if recorded[episode]:
            _record(book, episodes, e, rows, count)
            count += 1
        advance_run(book, selector, run, length, episode_return, performance, measure)
    return count


def replay(book: Book, selector: Selector, episodes: Episodes, recorded: NDArray[np.bool_]) -> EpisodeRows:
    """Take in episodes that were played elsewhere; the rows of those that ``recorded`` (``bool[episodes]``) marks.

    Raises
    ------
    RuntimeError
        If the episodes do not go on where the book stands: a bug, never a user's mistake.
    """
    room = int(np.count_nonzero(recorded[episodes.episode]))
    rows = EpisodeRows.empty(room, book.num_learners)
    if is_compiled(selector):
        count = _replay(book, selector.select, selector.observe, episodes, recorded, rows)
    else:
        count = _replay_plain(book, selector, episodes, recorded, rows)
    if count != room:
        message = "the episodes do not go on where the book of the shard stands"
        raise RuntimeError(message)
    return rows


def is_compiled(selector: Selector) -> bool:
    """Whether both functions of a selector may be called from compiled code."""
    return isinstance(selector.select, KernelFunction) and isinstance(selector.observe, KernelFunction)


def advance_run(
    book: Book, selector: Selector, run: int, length: int, episode_return: float, performance: float, measure: float
) -> None:
    """`advance` for any selector: compiled where the selector is, else the same lines as plain Python."""
    function = advance if is_compiled(selector) else advance.py_func
    function(book, selector.select, selector.observe, run, length, episode_return, performance, measure)
