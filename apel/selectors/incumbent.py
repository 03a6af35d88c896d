"""An incumbent, and rehearsals of the others: the selector to recommend. The rule is ours.

The *incumbent* plays. The n − 1 others are *rehearsed* now and then, and one that does better goes on in a *duel*,
whose winner is the incumbent. Two quantities are stated: ρ, the share of the episodes that rehearsals may cost, and δ,
the probability that a rehearsal of a learner that is no better ends in a takeover. All else follows, from ranks and
deviations alone, so that neither unit nor origin of the performances matters, nor how long the run will be:

* **Score.** An episode of a challenger scores P(r > X) − P(r < X), X one of the incumbent's last m performances: in
  [−1, 1], 0 on average for a learner that is as good, whatever the distribution, and 2 p − 1 for one that beats the
  incumbent with probability p.
* **Duel.** S ← S + score, from 0: over at S ≤ 0, a takeover at S ≥ b. Against scores of mean 0 or less S is a
  supermartingale that stops at −1 or above, so that 0 ≥ b P(takeover) − (1 − P(takeover)): P(takeover) ≤ 1/(b + 1),
  and b = 1/δ − 1 keeps it at δ. A challenger that always wins takes over after b episodes; after m a duel is over.
* **Memory.** m performances leave a standard error of 1/√(3 m) in the mean score of an equal learner; over the 1/δ
  episodes of a duel that is one step in all where m = 1/(3 δ²). A smaller m would let that error take over.
* **Interval.** Another learner is rehearsed I = B √z episodes after the last time, B = (n − 1)/ρ: what is z of its own
  deviations behind costs z/I per episode, what a change costs grows as I, and their sum is least at an I in proportion
  to √z. z = (incumbent's median − mean of its last 5)/their standard deviation, at least 1, so that rehearsals are a
  share of at most ρ, and at most 1 + u/B, u the age of the incumbency: in u episodes a hopeless learner is rehearsed at
  most 2 (√(1 + u/B) − 1) times, and I then is √(B u): what is spent and what a change may cost both grow as √u (Li,
  Hsieh & Huang 2024, arXiv 2410.05734; at a constant rate the one grows as u, at a rate of 1/u the other). No interval
  is longer than the run was at its beginning: at first they double. All are scaled by one factor from ½ to 3/2, drawn
  anew after each burst, against beats with what is periodic.
* **Tie.** A learner whose last 5 performances, and all that are remembered of the incumbent, are one and the same
  number takes turns with it: that costs nothing, and where nobody has succeeded yet all try.
* **Burst.** Along with a learner that is due go those whose time is half over and no shorter than B: where many
  episodes in a row must be good, all exceptions come at once.

**Delay.** Where a challenger comes to beat the incumbent with probability p, d = 2 p − 1, a rehearsal ends in a
takeover with a probability of about d: about I/2 + I (1/d − 1) + b/d episodes pass, I/2 + b where it always wins.
**Cost.** At most ρ of the episodes, and duels that are lost: 1/(1 − 2 q) episodes for one that wins with probability q.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.streams import integer, uniform
from apel.numerics.views import REST, Layout, Row, named_numbers
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, compiled_select, new_state
from apel.selectors.comparing import are_tied, deviations_behind, score

NOBODY = -1.0
_FEW = 5  # performances of a challenger, of which its deviation is taken


class IncumbentOptions(NamedTuple):
    """What the rule goes by."""

    rehearsal_share: float
    """ρ."""
    bound: float
    """b."""
    memory: float
    """m."""


class IncumbentState(NamedTuple):
    """The common blocks, then what the rule remembers; ``float64[1]`` where nothing is said."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    num_selections: Row
    """``float64[learners]``: episodes that each has played."""
    num_compared: Row
    """``float64[learners]``: how many of its latest performances stand for what it is worth as the incumbent."""
    last_played: Row
    """``float64[learners]``: the number of the episode after its last one."""
    clock: Row
    """Episodes so far."""
    incumbent: Row
    since: Row
    """Episodes when it took over."""
    challenger: Row
    """Who is in a duel, or `NOBODY`."""
    lead: Row
    """S."""
    pace: Row
    """The factor of all intervals."""
    rehearses: Row
    """Whether the latest episode was not the incumbent's."""
    ring: Row
    """``float64[learners · m]``: the latest performances of each, its e-th at place e mod m."""


_ONE = ("clock", "incumbent", "since", "challenger", "lead", "pace", "rehearses")
LAYOUT = Layout(IncumbentState, **dict.fromkeys(_ONE, 1), ring=REST)
_options, _view = named_numbers(IncumbentOptions), LAYOUT.view


@njit
def _ring_of(options: IncumbentOptions, state: IncumbentState, learner: int) -> Row:
    memory = int(options.memory)
    return state.ring[learner * memory : (learner + 1) * memory]


@njit
def _latest(options: IncumbentOptions, state: IncumbentState, learner: int, most: int) -> Row:
    """Up to ``most`` of the latest performances of a learner, the latest first."""
    ring, played = _ring_of(options, state, learner), int(state.num_selections[learner])
    count = min(played, most, ring.shape[0])
    latest = np.empty(count)
    for i in range(count):
        latest[i] = ring[(played - 1 - i) % ring.shape[0]]
    return latest


@njit
def _incumbents(options: IncumbentOptions, state: IncumbentState) -> Row:
    """The performances that a challenger is compared with."""
    incumbent = int(state.incumbent[0])
    return _latest(options, state, incumbent, int(state.num_compared[incumbent]))


@njit
def _overdue(options: IncumbentOptions, state: IncumbentState, num_learners: int, learner: int) -> float:
    """By how much of its interval a learner was not played: due from 1 on; in a burst, never before the shortest."""
    last, shortest = state.last_played[learner], (num_learners - 1) / options.rehearsal_share
    elapsed, incumbent = state.clock[0] - last, int(state.incumbent[0])
    if state.performance_estimate[learner] == state.performance_estimate[incumbent] and are_tied(
        _latest(options, state, learner, _FEW), _incumbents(options, state)
    ):
        # In turns: that costs nothing, and whoever would learn by playing shall play.
        before = elapsed - (state.clock[0] - state.last_played[incumbent])
        return 1.0 + before if before > 0.0 else 0.0
    if elapsed < min(shortest, last) * state.pace[0]:
        return 0.0
    most = 1.0 + (state.clock[0] - state.since[0]) / shortest
    few = _latest(options, state, learner, _FEW)
    behind = deviations_behind(few, _incumbents(options, state), most)
    return elapsed / (min(shortest * math.sqrt(behind), last) * state.pace[0])


@njit
def _rehearsed(options: IncumbentOptions, state: IncumbentState, num_learners: int) -> int:
    """Whose turn it is where nobody is in a duel: the most overdue of those that are due, or the incumbent."""
    selected = int(state.incumbent[0])
    best = 0.5 if state.rehearses[0] != 0.0 else 1.0
    for k in range(num_learners):
        if k != int(state.incumbent[0]):
            overdue = _overdue(options, state, num_learners, k)
            if overdue >= best:
                best, selected = overdue, k
    return selected


@njit
def _untried(state: IncumbentState, stream: NDArray[np.uint64]) -> int:
    """One of those that were never selected, uniformly at random; −1 where there is none. Writes the probabilities."""
    untried = 0
    for k in range(state.probability.shape[0]):
        untried += state.num_selections[k] == 0.0
    if untried == 0:
        return -1
    pick, selected = integer(stream, untried), 0
    for k in range(state.probability.shape[0]):
        if state.num_selections[k] == 0.0:
            state.probability[k] = 1.0 / untried
            if pick == 0:
                selected = k
            pick -= 1
    return selected


@compiled_select
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """Each learner once; then the challenger of a duel, whoever is due, or the incumbent."""
    options, state = _options(parameters), _view(row, num_learners)
    state.probability[:] = 0.0
    selected = _untried(state, stream)
    if selected >= 0:
        return selected
    selected = int(state.challenger[0])
    if selected < 0:
        selected = _rehearsed(options, state, num_learners)
        if state.rehearses[0] != 0.0 and selected == int(state.incumbent[0]):
            state.pace[0] = 0.5 + uniform(stream)
    state.probability[selected] = 1.0
    return selected


@njit
def _take_over(state: IncumbentState, learner: int) -> None:
    state.incumbent[0] = learner
    state.since[0] = state.clock[0]


@njit
def _take_in_challenge(options: IncumbentOptions, state: IncumbentState, selected: int, scored: float) -> None:
    """An episode of one that is not the incumbent: its duel begins, goes on, or is over."""
    challenger = int(state.challenger[0])
    if challenger >= 0 and challenger != selected:
        return  # a floor under acting has let it play: a duel of another is under way
    if challenger < 0:
        state.challenger[0] = selected
        state.lead[0] = 0.0
        state.num_compared[selected] = 1.0
    state.lead[0] += scored
    if state.lead[0] >= options.bound:
        _take_over(state, selected)
    # One lucky episode and nothing but ties would be a duel without an end.
    if not 0.0 < state.lead[0] < options.bound or state.num_compared[selected] >= options.memory:
        state.challenger[0] = NOBODY


@compiled_observe
def _observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Remember the performance; score it if it is not the incumbent's."""
    options, state = _options(parameters), _view(row, num_learners)
    incumbent, ring = int(state.incumbent[0]), _ring_of(options, state, selected)
    scored = 0.0
    if incumbent >= 0 and selected != incumbent:
        scored = score(performance, _incumbents(options, state))
    state.performance_estimate[selected] = performance
    ring[int(state.num_selections[selected]) % ring.shape[0]] = performance
    state.num_selections[selected] += 1.0
    state.num_compared[selected] = min(state.num_compared[selected] + 1.0, options.memory)
    state.clock[0] += 1.0
    state.last_played[selected] = state.clock[0]
    if state.num_selections[selected] == 1.0:
        # Nothing else is known of it: the best of all first episodes makes the first incumbent.
        if incumbent < 0 or scored > 0.0:
            _take_over(state, selected)
        return
    state.rehearses[0] = 1.0 if selected != incumbent else 0.0
    if selected != incumbent:
        _take_in_challenge(options, state, selected, scored)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Incumbent:
    """An incumbent plays; the others are rehearsed, and take over by winning a duel.

    Attributes
    ----------
    rehearsal_share:
        ρ, 0 < ρ < 1: rehearsals are at most this share of the episodes in the long run, and far fewer where the others
        are far behind. A change is noticed after about (n − 1)/ρ episodes.
    takeover_error:
        δ, 0.01 ≤ δ ≤ 0.5: the probability that a rehearsal of a learner that is no better ends in a takeover. A duel
        takes 1/δ − 1 episodes; 1/(3 δ²) performances are remembered of each learner.
    """

    rehearsal_share: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.01
    takeover_error: Annotated[float, Field(ge=0.01, le=0.5)] = 0.05

    layout: ClassVar[Layout[Any]] = LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    @property
    def bound(self) -> float:
        """The lead that takes over: b = 1/δ − 1."""
        return 1.0 / self.takeover_error - 1.0

    @property
    def memory(self) -> int:
        """Performances per learner: m = ⌈1/(3 δ²)⌉, at least those of which a deviation is taken."""
        return max(math.ceil(1.0 / (3.0 * self.takeover_error**2)), _FEW)

    def parameters(self) -> Row:
        """``float64[3]``: ρ, b, m."""
        return np.array(IncumbentOptions(self.rehearsal_share, self.bound, float(self.memory)))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[(6 + m) · learners + 7]``."""
        ring = np.zeros(num_learners * self.memory)
        return new_state(self.layout, num_learners, incumbent=NOBODY, challenger=NOBODY, pace=1.0, ring=ring)
