"""Voting (§2.5.1; Wiering & van Hasselt 2008): preferences and policies by hand, and as laws."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from apel.experience.representations import Representation, View
from apel.learners import Voting, VotingOptions
from apel.learners.base import Transition
from apel.learners.tabular.voting import Member, boltzmann, preferences
from apel.numerics.streams import stream_of_seed

METHODS = ("majority", "rank", "boltzmann_addition", "boltzmann_multiplication")
SPACE, ACTIONS = spaces.Discrete(2), spaces.Discrete(4)
LOG2, LOG3 = math.log(2.0), math.log(3.0)


class Opinion:
    """A learner that always thinks the same, and notes what it is given."""

    off_policy: ClassVar[bool] = True

    def __init__(self, values: Sequence[float]) -> None:
        self.values = np.array(values, dtype=np.float64)
        self.seen: list[Any] = []
        self.episodes = 0

    def act(self, observation: Any) -> tuple[int, None]:
        raise NotImplementedError

    def action_values(self, observation: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
        return self.values

    def learn(self, transition: Transition) -> None:
        self.seen.append(transition)

    def end_episode(self) -> None:
        self.episodes += 1

    def state(self) -> dict[str, Any]:
        return {"values": self.values.tolist()}

    def restore(self, state: dict[str, Any]) -> None:
        self.values = np.array(state["values"])


def voting(opinions: Sequence[Sequence[float]], start: int = 0, seed: int = 5, **options: Any) -> Voting:
    """A vote of members with these values."""
    actions = spaces.Discrete(len(opinions[0]), start=start)
    members = [Member(Opinion(values), View(Representation(), SPACE)) for values in opinions]
    return Voting(SPACE, actions, seed, members, **options)


def probability_of(opinions: Sequence[Sequence[float]], **options: Any) -> list[float]:
    return voting(opinions, **options).act(0)[1].tolist()


def test_majority_by_hand() -> None:
    """p(a) is the number of members whose best action it is: 2, 0, 1; with τ = 1/2 π ∝ e⁴, e⁰, e²."""
    opinions = [[3.0, 1.0, 2.0], [0.5, -1.0, 0.4], [-5.0, -4.0, -3.0]]
    assert voting(opinions).action_values(0).tolist() == [2.0, 0.0, 1.0]
    total = math.exp(4) + 1 + math.exp(2)
    expected = [math.exp(4) / total, 1 / total, math.exp(2) / total]
    assert probability_of(opinions, temperature=0.5) == pytest.approx(expected)


def test_dissertations_two_voters() -> None:
    """Two voters at τ = 0.1: where they agree, the action has 1 / (1 + 3 e⁻²⁰); where not, both have almost a half."""
    agreed = probability_of([[1.0, 0.0, 0.0, 0.0], [9.0, 8.0, 7.0, 6.0]])
    assert agreed[0] == pytest.approx(1 / (1 + 3 * math.exp(-20)), rel=1e-12)
    parted = probability_of([[1.0, 0.0, 0.0, 0.0], [8.0, 9.0, 7.0, 6.0]])
    # Preferences 1, 1, 0, 0: π ∝ e¹⁰, e¹⁰, 1, 1.
    assert parted[:2] == pytest.approx([1 / (2 + 2 * math.exp(-10))] * 2, rel=1e-12)


def test_rank_by_hand() -> None:
    """Worst 1 … best m, summed: (3, 1, 2) + (3, 1, 2) + (1, 2, 3) = (7, 4, 7); with τ = 2 π ∝ e^3.5, e², e^3.5."""
    opinions = [[3.0, 1.0, 2.0], [0.5, -1.0, 0.4], [-5.0, -4.0, -3.0]]
    assert voting(opinions, method="rank").action_values(0).tolist() == [7.0, 4.0, 7.0]
    total = 2 * math.exp(3.5) + math.exp(2)
    expected = [math.exp(3.5) / total, math.exp(2) / total, math.exp(3.5) / total]
    assert probability_of(opinions, method="rank", temperature=2.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("values", "ranks"),
    [
        ([0.0, 0.0, 0.0, 0.0], [2.5, 2.5, 2.5, 2.5]),  # (1 + 2 + 3 + 4) / 4
        ([1.0, 0.0, 1.0, 2.0], [2.5, 1.0, 2.5, 4.0]),  # the places 2 and 3 are shared
        ([5.0, 5.0, 5.0, -1.0], [3.0, 3.0, 3.0, 1.0]),  # (2 + 3 + 4) / 3
        ([0.0, 7.0, 7.0, 0.0], [1.5, 3.5, 3.5, 1.5]),
    ],
)
def test_equal_values_share_their_mean_rank(values: list[float], ranks: list[float]) -> None:
    """Ranks do not depend on the order in which equal actions are numbered, and their sum is always m (m + 1) / 2."""
    found = voting([values], method="rank").action_values(0)
    assert found.tolist() == ranks
    assert found.sum() == 10.0


def test_boltzmann_addition_by_hand() -> None:
    """With τₘ = 1 the values (ln 2, 0, 0) and (0, 0, ln 3) are the policies (2, 1, 1) / 4 and (1, 1, 3) / 5.

    Their sum is (10 + 4, 5 + 4, 5 + 12) / 20 = (14, 9, 17) / 20; at τ = 1 that is π up to its sum of 2, and at τ = 1/2
    its squares 196, 81, 289 of 566.
    """
    opinions = [[LOG2, 0.0, 0.0], [0.0, 0.0, LOG3]]
    options = {"method": "boltzmann_addition", "member_temperature": 1.0}
    preference = voting(opinions, **options).action_values(0)
    assert np.exp(preference) == pytest.approx([0.7, 0.45, 0.85])
    assert probability_of(opinions, temperature=1.0, **options) == pytest.approx([14 / 40, 9 / 40, 17 / 40])
    assert probability_of(opinions, temperature=0.5, **options) == pytest.approx([196 / 566, 81 / 566, 289 / 566])


def test_boltzmann_multiplication_by_hand() -> None:
    """The product of the same policies is (2 · 1, 1 · 1, 1 · 3) / 20: π = (2, 1, 3) / 6 at τ = 1.

    At τ = 1/2 the squares (4, 1, 9) of 14. With τₘ = 1/2 the policies are (4, 1, 1) / 6 and (1, 1, 9) / 11.
    """
    opinions = [[LOG2, 0.0, 0.0], [0.0, 0.0, LOG3]]
    options = {"method": "boltzmann_multiplication", "member_temperature": 1.0}
    assert np.exp(voting(opinions, **options).action_values(0)) == pytest.approx([0.1, 0.05, 0.15])
    assert probability_of(opinions, temperature=1.0, **options) == pytest.approx([2 / 6, 1 / 6, 3 / 6])
    assert probability_of(opinions, temperature=0.5, **options) == pytest.approx([4 / 14, 1 / 14, 9 / 14])
    options["member_temperature"] = 0.5
    assert probability_of(opinions, temperature=1.0, **options) == pytest.approx([4 / 14, 1 / 14, 9 / 14])


def test_boltzmann_vote_of_one_is_its_own_policy() -> None:
    """One member at τ = 1: addition and multiplication give exp(Q / τₘ); (ln 2, 0, ln 3) is (2, 1, 3) / 6."""
    for method in METHODS[2:]:
        found = probability_of([[LOG2, 0.0, LOG3]], method=method, temperature=1.0, member_temperature=1.0)
        assert found == pytest.approx([2 / 6, 1 / 6, 3 / 6])


def test_tied_votes_are_drawn_uniformly() -> None:
    """Of equally good actions a member votes for each as often: 3000 draws of three, within five deviations of 26."""
    vote = voting([[1.0, 0.0, 1.0, 1.0]], temperature=0.01)
    actions = [vote.act(0)[0] for _ in range(3000)]
    counts = [actions.count(action) for action in range(4)]
    assert counts[1] == 0
    assert all(abs(counts[action] - 1000) < 130 for action in (0, 2, 3))


def test_ties_without_chance_go_to_the_first() -> None:
    """What it thinks of actions draws nothing: a member with ties votes for the first, always."""
    vote = voting([[1.0, 2.0, 2.0], [3.0, 0.0, 3.0]])
    before = vote.stream.tolist()
    assert vote.action_values(0).tolist() == [1.0, 1.0, 0.0]
    assert vote.action_values(0).tolist() == [1.0, 1.0, 0.0]
    assert vote.stream.tolist() == before


@pytest.mark.parametrize("method", METHODS[1:])
def test_only_majority_draws_for_ties(method: str) -> None:
    """The other methods draw one number per action: that which chooses it."""
    vote, other = voting([[1.0, 1.0]] * 3, method=method), voting([[1.0, 2.0]] * 3, method=method)
    vote.act(0)
    other.act(0)
    assert vote.stream.tolist() == other.stream.tolist()


@pytest.mark.parametrize("method", METHODS)
def test_cold_and_hot(method: str) -> None:
    """As τ → 0 the preferred action is certain; as τ → ∞ all are alike. Neither overflows."""
    opinions = [[-100.0, 3.0, 2.0], [-1.0, 500.0, 400.0]]
    for temperature in (1e-3, 1e-6, 1e-12):
        assert probability_of(opinions, method=method, temperature=temperature) == [0.0, 1.0, 0.0]
    hot = probability_of(opinions, method=method, temperature=1e12, member_temperature=1e6)
    assert hot == pytest.approx([1 / 3] * 3)


@pytest.mark.parametrize("method", METHODS[2:])
@pytest.mark.parametrize("member_temperature", [1e-6, 1e-12, 1e-300])
def test_cold_members_that_disagree(method: str, member_temperature: float) -> None:
    """However cold the members, two that disagree symmetrically leave their actions alike, as the limit has it."""
    found = probability_of(
        [[100.0, -100.0, -300.0], [-100.0, 100.0, -300.0]],
        method=method,
        member_temperature=member_temperature,
        temperature=1.0,
    )
    assert found == pytest.approx([0.5, 0.5, 0.0])


values = st.lists(
    st.lists(st.floats(-1000, 1000) | st.sampled_from([0.0, 1.0, -1.0]), min_size=4, max_size=4), min_size=1, max_size=6
)
temperatures = st.floats(1e-3, 1e3)


@given(values, st.sampled_from(range(4)), temperatures, temperatures, st.integers(0, 2**64 - 1))
def test_probabilities_sum_to_one(
    opinions: list[list[float]], method: int, temperature: float, member_temperature: float, seed: int
) -> None:
    """Whatever the members think, π is a distribution, and more preferred actions are not less probable."""
    preference = np.empty(4)
    preferences(np.array(opinions), method, member_temperature, stream_of_seed(seed), True, preference)
    probability = preference.copy()
    boltzmann(probability, temperature)
    assert probability.sum() == pytest.approx(1.0)
    assert (probability >= 0.0).all()
    for one in range(4):
        for other in range(4):
            assert probability[one] <= probability[other] or preference[one] > preference[other]


@given(values, st.sampled_from([1, 2, 3]), st.permutations(range(4)))
def test_numbering_of_actions_does_not_matter(opinions: list[list[float]], method: int, order: list[int]) -> None:
    """Renumbered actions have renumbered preferences."""
    found = []
    for columns in (np.array(opinions), np.array(opinions)[:, order]):
        preference = np.empty(4)
        preferences(np.ascontiguousarray(columns), method, 50.0, stream_of_seed(1), True, preference)
        found.append(preference)
    np.testing.assert_allclose(found[0][order], found[1], rtol=1e-12, atol=1e-12)


@given(values, st.integers(0, 2**64 - 1), st.booleans())
def test_every_member_has_one_vote(opinions: list[list[float]], seed: int, draws: bool) -> None:
    """The majority's preferences are whole, sum to the number of members, and go to best actions only."""
    preference = np.empty(4)
    preferences(np.array(opinions), 0, 1.0, stream_of_seed(seed), draws, preference)
    assert preference.sum() == len(opinions)
    allowed = sum((np.array(one) == max(one)).astype(float) for one in opinions)
    assert (preference <= allowed).all()
    assert (preference == preference.round()).all()


def test_all_members_learn_everything() -> None:
    """Every member gets every step in its own view, and hears of the end."""
    space = spaces.MultiDiscrete([3, 3])
    views = [Representation(), Representation(exclude=(1,))]
    opinions = [Opinion([0.0, 1.0]) for _ in views]
    members = [Member(one, View(view, space)) for one, view in zip(opinions, views, strict=True)]
    vote = Voting(space, spaces.Discrete(2), 1, members)
    vote.learn(Transition(np.array([1, 2]), 1, 0.5, np.array([2, 0]), False, True, None))
    vote.end_episode()
    for one, seen, following in zip(opinions, ([1, 2], [1]), ([2, 0], [2]), strict=True):
        (step,) = one.seen
        assert step.observation.tolist() == seen
        assert step.next_observation.tolist() == following
        assert step[1:3] == (1, 0.5)
        assert step[4:] == (False, True, None)
        assert one.episodes == 1


def test_actions_count_from_the_first() -> None:
    """An action space that starts at 3 has the actions from 3 on."""
    assert {voting([[0.0, 9.0]], start=3).act(0)[0] for _ in range(5)} == {4}


def test_restored_vote_goes_on_identically() -> None:
    """State carries the stream and the members over."""
    vote, other = voting([[1.0, 1.0, 0.0]]), voting([[0.0, 0.0, 3.0]], seed=99)
    for _ in range(3):
        vote.act(0)
    other.restore(vote.state())
    assert [other.act(0)[0] for _ in range(50)] == [vote.act(0)[0] for _ in range(50)]


def test_members_are_required() -> None:
    """A vote of nobody is refused."""
    with pytest.raises(ValueError, match="members: found none, expected at least one learner"):
        Voting(SPACE, ACTIONS, 1)


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ("method", {"method": "consensus"}),
        ("temperature", {"temperature": 0.0}),
        ("temperature", {"temperature": -1.0}),
        ("temperature", {"temperature": math.inf}),
        ("member_temperature", {"member_temperature": math.nan}),
        ("weights", {"weights": [1.0]}),
    ],
)
def test_options_are_checked(field: str, options: dict[str, Any]) -> None:
    """Unknown methods and temperatures that are none are refused by name."""
    with pytest.raises(ValueError, match=field):
        VotingOptions(**options)


# The linear combination


def linear(*opinions: Sequence[float], **options: Any) -> Voting:
    """A linear combination of members that always think the same."""
    return voting(opinions, method="linear", **options)


def stepped(action: int, reward: float, terminated: bool) -> Transition:
    return Transition(0, action, reward, 1, terminated, False, None)


def test_linear_combination_by_hand() -> None:
    """Of 2, 1 and 1, 3 at first the means 1.5 and 2; with τ = 1 π ∝ e^1.5, e²."""
    combined = linear([2.0, 1.0], [1.0, 3.0], temperature=1.0)
    assert combined.action_values(0).tolist() == [1.5, 2.0]
    odds = math.exp(0.5)
    assert combined.act(0)[1].tolist() == pytest.approx([1 / (1 + odds), odds / (1 + odds)])


def test_weights_by_hand() -> None:
    """Action 0, whose values are 2 and 1: p = 1.5, and 2 is the best of the next state's.

    δ = −1 + 0.9 · 2 − 1.5 = −0.7, and w = ½ − 0.5 · 0.7 · (2, 1) / 5; at the end δ = −1 − 1.5, and (2, 1) / 4 less.
    """
    options = {"weight_learning_rate": 0.5, "discount": 0.9}
    going_on, ending = (linear([2.0, 1.0], [1.0, 3.0], start=5, **options) for _ in range(2))
    going_on.learn(stepped(5, -1.0, terminated=False))
    assert going_on.weights.tolist() == pytest.approx([0.36, 0.43])
    ending.learn(stepped(5, -1.0, terminated=True))
    assert ending.weights.tolist() == pytest.approx([0.0, 0.25])


def test_weights_find_the_member_that_is_right() -> None:
    """Every action ends the episode with the reward that the first member expects; the second one errs."""
    combined = linear([-3.0, -1.0, -2.0], [-1.0, -2.0, -5.0], weight_learning_rate=0.5)
    for step in range(600):
        combined.learn(stepped(step % 3, (-3.0, -1.0, -2.0)[step % 3], terminated=True))
    assert combined.weights.tolist() == pytest.approx([1.0, 0.0], abs=1e-6)


def test_members_learn_what_they_learn_anyway() -> None:
    """And nothing is learned by the weights where all members think that the action is worth nothing."""
    combined = linear([0.0, 1.0], [0.0, 2.0])
    combined.learn(stepped(0, -1.0, terminated=True))
    assert combined.weights.tolist() == [0.5, 0.5]
    assert [len(member.learner.seen) for member in combined.members] == [1, 1]  # type: ignore[attr-defined]


def test_weights_are_part_of_the_state() -> None:
    """Of a linear combination alone; another one goes on from them, one of votes does not need them."""
    combined, other = (linear([2.0, 1.0], [1.0, 3.0]) for _ in range(2))
    combined.learn(stepped(0, -1.0, terminated=True))
    other.restore(combined.state())
    assert other.weights.tolist() == combined.weights.tolist() != [0.5, 0.5]
    assert "weights" not in voting([[2.0, 1.0]]).state()
    with pytest.raises(TypeError, match="found a linear combination, expected a vote without weights"):
        combined.freeze()
