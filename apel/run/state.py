"""The book of a shard: for every run, what its selector knows, how far it has come, and whose turn it is.

The book is a pure state machine: `advance` takes in one finished episode of a run and says who plays the next. It is
what makes *streaks* possible. Whoever has seen the same episodes has the same book, value for value; so the host of a
learner can keep playing a run for as long as the book says that its learner is selected, and the coordinator and all
other hosts reach the same state later by replaying the few numbers of each episode.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.experience.trajectory import Episodes
from apel.numerics.compiled import KernelFunction, njit
from apel.run.criterion import criterion_met
from apel.run.floor import take_in_length, under_floor
from apel.run.impossible import ImpossibleStateError
from apel.run.selection import COMMON, Observe, Select, Selector

ANY_STEPS = np.iinfo(np.int64).max
"""Where no number of steps ends a run."""
RUNNING, FINISHED, NOT_FINITE, BAD_SELECTION, FAILED = range(5)
STATUS_NAMES = ("running", "finished", "not finite", "bad selection", "failed")
POSITION = "position in the shard"
"""By this name the facts of an `ImpossibleStateError` tell of a run."""


class Book(NamedTuple):
    """The state of R runs, as arrays (all written in place)."""

    selector_parameters: NDArray[np.float64]
    selector_state: NDArray[np.float64]
    """``float64[R, …]``, see `apel.run.selection`."""
    selector_stream: NDArray[np.uint64]
    """``uint64[R, 2]``."""
    criterion_parameters: NDArray[np.int64]
    """``int64[R, 5]``, see `Criterion.parameters`."""
    threshold: NDArray[np.float64]
    """``float64[R]``."""
    recent: NDArray[np.float64]
    """``float64[R, window]``: the criterion's memory."""
    episode: NDArray[np.int64]
    """``int64[R]``: index of the coming episode."""
    learner: NDArray[np.int64]
    """``int64[R]``: who plays it."""
    status: NDArray[np.int64]
    """``int64[R]``: RUNNING; FINISHED; NOT_FINITE after a performance, or a return, that is no number; BAD_SELECTION
    after a selector named a learner that does not exist; FAILED because of anything else."""
    train_time: NDArray[np.int64]
    """``int64[R]``: episodes until the criterion held; −1 as long as it has not."""
    steps: NDArray[np.int64]
    """``int64[R]``: environment steps so far, greedy evaluations not counted."""
    late_return: NDArray[np.float64]
    """``float64[R]``: sum of the returns from episode ``late_from`` on."""
    floor_stream: NDArray[np.uint64]
    """``uint64[R, 2]``."""
    acting_steps: NDArray[np.int64]
    """``int64[R, learners]``: environment steps that each learner played; only counted where there is a floor."""
    acting_length: NDArray[np.float64]
    """``float64[R, learners + 1]``, see `apel.run.floor.under_floor`."""
    wanted: NDArray[np.float64]
    """``float64[R, learners]``: the selector's own probabilities, where those of its state are raised to a floor."""
    floor: float
    """The least share of the steps that each learner plays; 0 where nobody asks for it."""
    floor_after: int
    """Steps of a run before it has a floor; those are not counted in ``acting_steps``."""
    num_learners: int
    num_episodes: int
    num_steps: int
    late_from: int
    stops_when_met: bool
    pause_every: int
    """Whoever plays a run reports back with the episode in which its steps reach a multiple of this; 0: never."""


def bad_selection_message(book: Book, run: int) -> str:
    """What is wrong with a selection."""
    return f"the selector named learner {book.learner[run]}, expected one from 0 to {book.num_learners - 1}"


@njit
def raise_to_floor(book: Book, run: int) -> None:
    """Let one play that the selector did not choose, where it is its turn."""
    book.wanted[run] = book.selector_state[run, : book.num_learners]
    if book.steps[run] < book.floor_after:
        return
    book.learner[run] = under_floor(
        book.floor,
        book.learner[run],
        book.acting_steps[run],
        book.acting_length[run],
        book.selector_state[run, : book.num_learners],
        book.floor_stream[run],
    )


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
    if not (np.isfinite(performance) and np.isfinite(episode_return)):
        book.status[run] = NOT_FINITE
        return
    state = book.selector_state[run]
    acted_on = state[: book.num_learners].copy()
    observe(book.selector_parameters, book.num_learners, state, book.learner[run], performance)
    if book.floor > 0.0 and np.array_equal(acted_on, state[: book.num_learners]):
        # A selector that does not say anew what it wants shall not take the floor's doing for its own.
        state[: book.num_learners] = book.wanted[run]
    episode = book.episode[run]
    met = criterion_met(book.criterion_parameters[run], book.threshold[run], book.recent[run], episode, measure)
    if met and book.train_time[run] < 0:
        book.train_time[run] = episode + 1
    book.episode[run] = episode + 1
    if book.floor > 0.0:
        take_in_length(book.learner[run], length, book.acting_length[run])
        if book.steps[run] >= book.floor_after:
            book.acting_steps[run, book.learner[run]] += length
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
    elif book.floor > 0.0:
        raise_to_floor(book, run)


class EpisodeRows(NamedTuple):
    """The recorded episodes, one row each, as they stand in the result files (see `apel.EpisodeRecord`)."""

    run: NDArray[np.int64]
    episode: NDArray[np.int64]
    selected: NDArray[np.int64]
    episode_return: NDArray[np.float64]
    length: NDArray[np.int64]
    header: NDArray[np.float64]
    """``float64[rows, 3 · learners]``: the `CommonBlocks` at selection."""

    @classmethod
    def empty(cls, room: int, num_learners: int) -> EpisodeRows:
        """Rows with uninitialised room."""
        whole = [np.empty(room, dtype=np.int64) for _ in range(4)]
        return cls(whole[0], whole[1], whole[2], np.empty(room), whole[3], np.empty((room, COMMON.size(num_learners))))


@njit
def _record(book: Book, episodes: Episodes, index: int, rows: EpisodeRows, row: int) -> None:
    """Write the row of an episode that ``book`` has yet to take in."""
    run = episodes.run[index]
    rows.run[row] = run
    rows.episode[row] = episodes.episode[index]
    rows.selected[row] = book.learner[run]
    rows.episode_return[row] = episodes.episode_return[index]
    rows.length[row] = episodes.length[index]
    rows.header[row] = book.selector_state[run, : rows.header.shape[1]]


@njit
def _replay(
    book: Book, select: Select, observe: Observe, episodes: Episodes, recorded: NDArray[np.bool_], rows: EpisodeRows
) -> int:
    """How many rows were written; −1 − e where episode e of ``episodes`` does not go on where the book stands."""
    count = 0
    for e in range(episodes.run.shape[0]):
        if book.episode[episodes.run[e]] != episodes.episode[e]:
            return -1 - e
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
            return -1 - e
        if recorded[episode]:
            _record(book, episodes, e, rows, count)
            count += 1
        advance_run(book, selector, run, length, episode_return, performance, measure)
    return count


def replay(book: Book, selector: Selector, episodes: Episodes, recorded: NDArray[np.bool_]) -> EpisodeRows:
    """Take in episodes that were played elsewhere; the rows of those that ``recorded`` (``bool[episodes]``) marks.

    Raises
    ------
    ImpossibleStateError
        If the episodes do not go on where the book stands: a bug, never a user's mistake. Its facts name the run by its
        position.
    """
    room = int(np.count_nonzero(recorded[episodes.episode]))
    rows = EpisodeRows.empty(room, book.num_learners)
    if is_compiled(selector):
        # As they arrive from another process, so that one form is compiled.
        count = _replay(book, selector.select, selector.observe, episodes.read_only(), recorded, rows)
    else:
        count = _replay_plain(book, selector, episodes, recorded, rows)
    if count < 0:
        raise _gap(book, episodes, -1 - count)
    return rows


def _gap(book: Book, episodes: Episodes, index: int) -> ImpossibleStateError:
    """An episode that does not go on where the book stands, which has taken in all before it."""
    run = int(episodes.run[index])
    before = episodes.episode[:index][episodes.run[:index] == run].tolist()
    taken_in = f"episodes {before[0]} to {before[-1]} ({len(before)})" if before else "no episode"
    facts: dict[str, int | str] = {
        POSITION: run,
        "expected episode": int(book.episode[run]),
        "found episode": int(episodes.episode[index]),
        "selected learner": int(book.learner[run]),
        "status": STATUS_NAMES[book.status[run]],
    }
    what = "the episodes do not go on where the book of the shard stands"
    return ImpossibleStateError(what, facts, [f"of {len(episodes.run)} episodes, this run's before it: {taken_in}"])


def is_compiled(selector: Selector) -> bool:
    """Whether both functions of a selector may be called from compiled code."""
    return isinstance(selector.select, KernelFunction) and isinstance(selector.observe, KernelFunction)


def advance_run(
    book: Book, selector: Selector, run: int, length: int, episode_return: float, performance: float, measure: float
) -> None:
    """`advance` for any selector: compiled where the selector is, else the same lines as plain Python."""
    function = advance if is_compiled(selector) else advance.py_func
    function(book, selector.select, selector.observe, run, length, episode_return, performance, measure)
