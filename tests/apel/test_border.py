"""What crosses the border of an environment or of a learner is in one form for all, copied, and checked."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from apel.building import bank_of_learners, make_bank, make_learner
from apel.building.registry import load
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.ensemble import Ensemble
from apel.environments import World, environment_list, make_world
from apel.environments.environment_list import ObservationWarning
from apel.experience.observation_form import BorderError, ObservationForm
from apel.learners import LockstepBank
from apel.learners.base import Failure, Played, StreakLimit
from apel.run.opening import open_book
from apel.selectors import Fixed
from tests.border_code import Answers, Forms, Learner, Odd, Wrong

CODE = "tests.border_code"
EPISODES = 3


def worlds_of(name: str, num_runs: int = 1, **options: Any) -> list[World]:
    config = EnvironmentConfig(f"{CODE}:{name}", options)
    return [make_world(config, seed, load(config.id)) for seed in range(num_runs)]


def bank_of(worlds: Sequence[World], learner: str, **options: Any) -> tuple[LockstepBank, list[Any]]:
    """A bank of a learner for each run, and the learners."""
    made = [make_learner(LearnerConfig(f"{CODE}:{learner}", options), world, i, 0) for i, world in enumerate(worlds)]
    return bank_of_learners(made, environment_list(worlds), worlds, "return"), [one for one, _ in made]


def played(bank: LockstepBank, num_runs: int = 1) -> Played:
    runs = list(range(num_runs))
    book = open_book(Fixed(), 1, EPISODES, None, runs, [{}] * num_runs)
    return bank.play(runs, book, Fixed(), 0, StreakLimit(EPISODES, 10**5), record=True)


def failures_of(bank: LockstepBank, num_runs: int = 1) -> list[tuple[int, int, str]]:
    """Run, episode and what was said of each failed run; the others have played all their episodes."""
    answer = played(bank, num_runs)
    failed: list[Failure] = list(answer.failures)
    whole = answer.episodes.run[~np.isin(answer.episodes.run, [one.run for one in failed])]
    assert sorted(whole.tolist()) == sorted(list(set(range(num_runs)) - {one.run for one in failed}) * EPISODES)
    return [(one.run, one.episode, one.error) for one in failed]


# Copies


@pytest.mark.parametrize("shared", [False, True])
def test_an_array_that_is_written_again_is_copied(shared: bool) -> None:
    """For the learner that acts and for those that watch; even if all environments share one array."""
    worlds = worlds_of("Reusing", 3, shared=shared)
    (acting, actors), (watching, watchers) = bank_of(worlds, "Hoarder"), bank_of(worlds, "Hoarder")
    batch = played(acting, 3).batch
    assert batch is not None
    assert watching.learn(batch) == ()
    for actor, watcher in zip(actors, watchers, strict=True):
        assert len(actor.memory) == len(watcher.memory) == EPISODES * 8
        assert (actor.num_wrong, watcher.num_wrong) == (0, 0)


def test_probabilities_that_are_written_again_are_copied() -> None:
    """Those who watch are told .1, .2, .3, .4, .5 of the five steps, as is the one who acts."""
    worlds = worlds_of("Forms", kind="int")
    (acting, (actor,)), (watching, (watcher,)) = bank_of(worlds, "Rewriting"), bank_of(worlds, "Rewriting")
    batch = played(acting).batch
    assert batch is not None
    watching.learn(batch)
    expected = [0.1, 0.2, 0.3, 0.4, 0.5] * EPISODES
    for learner in (actor, watcher):
        np.testing.assert_allclose([step.probability[1] for step in learner.memory], expected)


def test_what_a_learner_writes_into_what_it_is_shown_stays_with_it() -> None:
    """It sees the next step unchanged, and so do those who watch."""
    worlds = worlds_of("Reusing")
    (acting, (actor,)), (watching, (watcher,)) = bank_of(worlds, "Scaling"), bank_of(worlds, "Scaling")
    batch = played(acting).batch
    assert batch is not None
    watching.learn(batch)
    for learner in (actor, watcher):
        assert learner.num_wrong == 0
        assert [step.observation[0] for step in learner.memory] == [0, 1, 2, 3, 4, 5, 6, 7] * EPISODES
    assert batch.observation.ravel().tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 8] * EPISODES
    assert batch.probability is not None
    assert (batch.probability == 0.5).all()


def test_members_of_a_vote_do_not_write_into_each_others_observations() -> None:
    """Each member is shown a copy."""

    class Writing(Learner):
        def action_values(self, observation: Any) -> Any:
            seen.append(float(observation[0]))
            observation[0] = 99.0
            return np.zeros(2)

    seen: list[float] = []
    member = LearnerConfig(f"{CODE}:Writing")
    world = worlds_of("Reusing")[0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{CODE}.Writing", Writing, raising=False)
        ensemble = Ensemble(world, [LearnerConfig("voting", members=(member, member))], Fixed(), 1, 1)
        ensemble.run_episode()
    assert seen == [float(i // 2) for i in range(16)]


# One form


@pytest.mark.parametrize("kind", Forms.kinds)
def test_who_acts_and_who_watches_see_one_form(kind: str) -> None:
    """That of the space: its type and shape; plain numbers where it has no dimensions."""
    worlds = worlds_of("Forms", kind=kind)
    (acting, (actor,)), (watching, (watcher,)) = bank_of(worlds, "Hoarder"), bank_of(worlds, "Hoarder")
    batch = played(acting).batch
    assert batch is not None
    watching.learn(batch)
    space, said = Forms.kinds[kind]
    expected = [np.asarray(said(at)).astype(space.dtype) for at in range(5)] * EPISODES
    for learner in (actor, watcher):
        for step, value in zip(learner.memory, expected, strict=True):
            seen = step.observation
            if space.shape:
                assert (type(seen), seen.dtype, seen.shape) == (np.ndarray, space.dtype, space.shape)
            else:
                assert type(seen) is (int if isinstance(space, spaces.Discrete) else float)
            assert space.contains(np.asarray(seen, dtype=space.dtype)) or isinstance(space, spaces.Discrete)
            np.testing.assert_array_equal(seen, value)


SPACES = st.sampled_from(
    [
        spaces.Box(-1, 1, (3,), np.float32),
        spaces.Box(-np.inf, np.inf, (2, 2), np.float64),
        spaces.Box(0, 255, (2, 3), np.uint8),
        spaces.Box(-5, 5, (2,), np.int16),
        spaces.Discrete(7, start=-3),
        spaces.MultiDiscrete([3, 1, 5]),
        spaces.MultiDiscrete(np.array([[3, 2], [1, 5]])),
        spaces.MultiBinary(4),
        spaces.MultiBinary([2, 2]),
        spaces.Box(-2, 2, (), np.float32),
    ]
)


@given(SPACES, st.integers(0, 2**31 - 1))
def test_every_element_of_a_space_keeps_its_value(space: spaces.Space[Any], seed: int) -> None:
    """As it is sampled, as nested lists, and as numbers of the widest type."""
    space.seed(seed)
    element, form = space.sample(), ObservationForm(space)
    for said in (element, np.asarray(element).tolist(), np.asarray(element, dtype=np.float64)):
        found = form.checked(said)
        assert (found.dtype, found.shape) == (space.dtype, space.shape)
        np.testing.assert_array_equal(found, element)


ARRAYS = arrays.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_]),
    st.sampled_from([(), (1,), (2,), (3,), (2, 2)]),
)
NESTED = st.recursive(
    st.none() | st.floats() | st.integers() | st.text(max_size=3), lambda children: st.lists(children, max_size=3)
)


@given(SPACES, ARRAYS | NESTED)
def test_whatever_is_said_is_an_element_or_refused(space: spaces.Space[Any], said: Any) -> None:
    """Nothing else is raised, and nothing else comes out."""
    form = ObservationForm(space)
    try:
        found = form.checked(said)
    except BorderError:
        return
    assert (found.dtype, found.shape) == (space.dtype, space.shape)
    close = np.clip(found, *bounds) if (bounds := _bounds(space)) else found
    np.testing.assert_allclose(found, close, rtol=2e-5, atol=2e-6)


def _bounds(space: spaces.Space[Any]) -> tuple[Any, Any] | None:
    match space:
        case spaces.Box():
            return space.low, space.high
        case spaces.Discrete():
            return space.start, space.start + space.n - 1
        case spaces.MultiDiscrete():
            return space.start, space.start + space.nvec - 1
    return 0, 1


@pytest.mark.parametrize(
    ("value", "is_inside"),
    [(1.0, True), (1.00001, True), (1.0001, False), (-1.00001, True), (-1.1, False), (np.inf, False)],
)
def test_bounds_give_way_by_what_rounding_may_do(value: float, is_inside: bool) -> None:
    """A hundred-thousandth of the bound; where a bound is 0, a millionth."""
    form = ObservationForm(spaces.Box(-1, 1, (1,), np.float32))
    assert (len(form.outside(np.array([[value]], np.float32), terminal=[False])) == 0) == is_inside
    assert len(ObservationForm(spaces.Box(0, 1, (1,))).outside(np.array([[-1e-6]], np.float32), terminal=[False])) == 0
    assert len(ObservationForm(spaces.Box(0, 1, (1,))).outside(np.array([[-1e-4]], np.float32), terminal=[False])) == 1


# Refusals


@pytest.mark.parametrize("kind", Wrong.kinds)
def test_a_wrong_observation_ends_its_run_alone(kind: str) -> None:
    """With what was found, what was expected, and at which step; the other runs play all their episodes."""
    worlds = [worlds_of("Wrong", kind=kind, wrong=run)[0] for run in range(4)]
    bank, _ = bank_of(worlds, "Learner")
    (run, episode, said), (other, _, _) = failures_of(bank, 4)
    assert (run, other, episode) == (0, 2, 0)
    assert said.startswith("ValueError: step 3: found the observation ")
    assert "expected an element of Box(-1.0, 1.0, (2,), float32)" in said
    assert "\n" not in said


def test_a_wrong_first_observation_is_one_of_the_reset() -> None:
    bank, _ = bank_of(worlds_of("Wrong", kind="nan", where=0), "Learner")
    ((_, _, said),) = failures_of(bank)
    assert said == (
        "ValueError: reset: found the observation array([0.1, nan], dtype=float32), expected an element of "
        "Box(-1.0, 1.0, (2,), float32): found no number at [1]"
    )


@pytest.mark.parametrize(("kind", "fails"), [("beyond", False), ("nan", True), ("shape", True), ("text", True)])
def test_the_end_of_an_episode_may_lie_beyond_the_bounds(kind: str, fails: bool) -> None:
    """To leave them is what ends many episodes; but it has to be an array of numbers."""
    bank, _ = bank_of(worlds_of("Wrong", kind=kind, ending=True), "Learner")
    assert bool(failures_of(bank)) == fails


@pytest.mark.parametrize(("kind", "fails"), [("beyond", False), ("nan", False), ("shape", True), ("text", True)])
def test_an_experiment_may_only_warn(kind: str, fails: bool) -> None:
    """Once a run, of what lies outside of the space; what is no array of its shape fails all the same."""
    config = EnvironmentConfig(f"{CODE}:Wrong", {"kind": kind}, observations="warn")
    bank, _ = bank_of([make_world(config, 1, Wrong)], "Learner")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert bool(failures_of(bank)) == fails
    assert [one.category for one in caught] == ([] if fails else [ObservationWarning])


def test_only_what_is_unknown_is_checked() -> None:
    """Gymnasium's own environments keep to their spaces; a wrapper around them may not."""

    class Doubled(gymnasium.ObservationWrapper[Any, Any, Any]):
        def observation(self, observation: Any) -> Any:
            return observation * 1000

    def failed(made: Any) -> bool:
        return bool(failures_of(bank_of([make_world(EnvironmentConfig("x", {}), 1, made)], "Learner")[0]))

    assert not failed(lambda: gymnasium.make("MountainCar-v0"))
    assert failed(lambda: Doubled(gymnasium.make("MountainCar-v0")))


LARGER = {"reward none", "reward nan", "reward inf", "reward array", "reward text", "reward complex"}
NO_ENDS = {"end none", "end array", "end text", "end float"}


@pytest.mark.parametrize("kind", [*Answers.rewards, *Answers.ends])
def test_rewards_and_ends_are_plain_or_refused(kind: str) -> None:
    """Numbers and truth values of NumPy's are taken; everything else ends the run, with the step."""
    found = failures_of(bank_of(worlds_of("Answers", kind=kind), "Learner")[0])
    if kind not in LARGER | NO_ENDS:
        assert found == []
        return
    ((_, episode, said),) = found
    assert episode == 0
    what = "the reward" if kind in LARGER else "truncated ="
    assert said.startswith(f"ValueError: step 1: found {what} ")


@pytest.mark.parametrize("limit", [None, 4])
@pytest.mark.parametrize("kind", ["four", "nothing"])
def test_step_of_another_interface(kind: str, limit: int | None) -> None:
    """One clear message, also where a wrapper of Gymnasium's stumbles over it first."""
    config = EnvironmentConfig(f"{CODE}:Answers", {"kind": kind}, max_episode_steps=limit)
    bank, _ = bank_of([make_world(config, 1, Answers)], "Learner")
    ((_, _, said),) = failures_of(bank)
    if kind == "four" or limit is None:
        assert said.startswith("ValueError: step 1: step() returned ")
        assert "expected the five of Gymnasium's" in said


@pytest.mark.parametrize("limit", [None, 4])
@pytest.mark.parametrize("kind", ["reset alone", "reset pair", "reset three"])
def test_reset_of_another_interface_is_refused_when_a_world_is_made(kind: str, limit: int | None) -> None:
    """Before anything is played."""
    config = EnvironmentConfig(f"{CODE}:Answers", {"kind": kind}, max_episode_steps=limit)
    with pytest.raises(ValueError, match=r"reset\(\) returned .*expected the two of Gymnasium's"):
        make_world(config, 1, Answers)


def test_runs_may_have_spaces_of_different_bounds() -> None:
    """Each is held against its own: seven cells here, two there."""

    def made(count: int) -> Any:
        forms = Forms("int")
        forms.observation_space = spaces.Discrete(count)
        return forms

    worlds = [make_world(EnvironmentConfig("x", {"count": count}), 1, made) for count in (7, 2, 6)]
    ((run, episode, said),) = failures_of(bank_of(worlds, "Learner")[0], 3)
    assert (run, episode) == (1, 0)
    assert said.startswith("ValueError: step 2: found the observation 2, expected an element of Discrete(2)")


class Parts(gymnasium.Env[Any, Any]):
    """Observations with parts."""

    observation_space = spaces.Dict(
        {"cell": spaces.Discrete(4), "rest": spaces.Tuple([spaces.Box(0, 1, (2,), np.float32), spaces.MultiBinary(2)])}
    )
    action_space = spaces.Discrete(2)

    def __init__(self, said: Any) -> None:
        self._said = said

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return {"cell": 0, "rest": (np.zeros(2, np.float32), np.zeros(2, np.int8))}, {}

    def step(self, action: Any) -> Any:
        return self._said, 0.0, False, True, {}


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"cell": 3, "rest": ([0.5, 1], [True, False])}, None),
        ({"cell": np.int8(3), "rest": [(0.5, 1), np.array([1.0, 0.0])]}, None),
        ({"cell": -1, "rest": ([0.5, 1], [1, 0])}, r"cell: found the observation array\(-1\), .*-1 is not from 0 to 3"),
        ({"cell": 3, "rest": ([0.5], [1, 0])}, r"rest: 0: found the observation \[0.5\], .*shape"),
        ({"cell": 3, "rest": ([0.5, 7.0], [1, 0])}, "7.0 at .* is not from 0.0 to 1.0"),
        ({"cell": 3}, "it has no 'rest'"),
        ({"cell": 3, "rest": 4}, "it is no tuple of 2"),
        (3, "it has no 'cell'"),
    ],
)
def test_parts_of_an_observation_have_their_forms(said: Any, message: str | None) -> None:
    """Before they are made one vector, in which −1 of four values would be the last of them."""
    worlds = [make_world(EnvironmentConfig("x", {"said": said}), 1, Parts)]
    answer = played(bank_of(worlds, "Learner")[0])
    if message is None:
        assert answer.batch is not None
        assert answer.batch.observation[1].tolist() == [0, 0, 0, 1, 0.5, 1, 1, 0]
    else:
        (failure,) = answer.failures
        assert failure.error.startswith("ValueError: step 1: ")
        assert re.search(message, failure.error)


# Learners

TAKEN = {"int", "np.int64", "np.bool", "bool", "0-d", "list of two", "one-hot", "list", "float32"}


@pytest.mark.parametrize("kind", Odd.kinds)
def test_what_a_learner_answers_is_taken_without_loss_or_refused(kind: str) -> None:
    """In one line, of the run whose learner it was."""
    found = failures_of(bank_of(worlds_of("Forms", kind="int"), "Odd", kind=kind)[0])
    if kind in TAKEN:
        assert found == []
        return
    ((_, episode, said),) = found
    assert episode == 0
    assert said.startswith("ValueError: ")
    assert "expected" in said
    assert "\n" not in said


def test_a_script_is_told_the_same() -> None:
    """An ensemble raises what a shard reports."""
    config = LearnerConfig(f"{CODE}:Odd", {"kind": "too large"})
    ensemble = Ensemble(worlds_of("Forms", kind="int")[0], [config], Fixed(), 1, 1)
    with pytest.raises(ValueError, match=r"found the action 7, expected one of Discrete\(2\)"):
        ensemble.run_episode()


@pytest.mark.parametrize("kind", ["number", "bytes as floats", "bool list"])
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("dqn", {"head_hidden": [], "learning_starts": 4, "batch_size": 4}),
        ("acer", {"preset": "minimalrl"}),
        ("sac", {"learning_starts": 4, "batch_size": 4}),
    ],
)
def test_deep_learners_take_every_plain_space(name: str, options: dict[str, Any], kind: str) -> None:
    """A Box without dimensions and bytes that are said as floating-point numbers included."""
    worlds = [worlds_of("Forms", kind=kind)[0] for _ in range(2)]
    config = LearnerConfig(name, {"network": {"hidden": [4]}, **options})
    bank = make_bank([config] * 2, worlds, [1, 2], 0, "return", with_probability=True)
    assert isinstance(bank, LockstepBank)
    assert failures_of(bank, 2) == []


def test_one_wrong_observation_ends_one_run_of_a_deep_learner() -> None:
    """Not the shard of which it is one."""
    worlds = [worlds_of("Wrong", kind="text", wrong=run)[0] for run in range(3)]
    options = {"network": {"hidden": [4]}, "head_hidden": [], "learning_starts": 4, "batch_size": 4}
    bank = make_bank([LearnerConfig("dqn", options)] * 3, worlds, [1, 2, 3], 0, "return", with_probability=True)
    assert isinstance(bank, LockstepBank)
    assert [(run, episode) for run, episode, _ in failures_of(bank, 3)] == [(0, 0), (2, 0)]
