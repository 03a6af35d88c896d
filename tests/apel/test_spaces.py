"""Any action space and any observation space of Gymnasium: what is played, told, kept and refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.building import bank_of_learners, make_bank, make_learner
from apel.building.registry import LEARNERS, resolve
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.ensemble import Ensemble
from apel.environments import JointActions, World, environment_list, make_world
from apel.environments.environment_list import EnvironmentList
from apel.environments.probe import why_not_exact
from apel.environments.rendering import frames
from apel.experience.action_form import ActionForm
from apel.experience.observation_form import BorderError
from apel.experience.parts import parts_of, whole
from apel.experience.representations import Representation
from apel.learners import LockstepBank
from apel.learners.base import Played, StreakLimit
from apel.learners.supported_spaces import SB3_ALGORITHMS, SHIPPED, supported_spaces
from apel.run.criterion import Criterion
from apel.run.opening import open_book
from apel.selectors import Apel, Fixed
from tests.apel.any_spaces import ACTIONS, OBSERVATIONS, Anything, Whole
from tests.apel.rounds import assert_same_rows, ensemble_rows, make_banks, play_rounds

CODE = "tests.apel.any_spaces"
EPISODES = 3


def world_of(action: str = "Box", observation: str = "Box", seed: int = 1) -> World:
    return make_world(
        EnvironmentConfig(f"{CODE}:Anything", {"action": action, "observation": observation}), seed, Anything
    )


def bank_of(worlds: list[World], learner: str, **options: Any) -> tuple[LockstepBank, list[Any]]:
    made = [make_learner(LearnerConfig(f"{CODE}:{learner}", options), world, i, 0) for i, world in enumerate(worlds)]
    return bank_of_learners(made, environment_list(worlds), worlds, "return"), [one for one, _ in made]


def played(bank: LockstepBank, num_runs: int = 1) -> Played:
    runs = list(range(num_runs))
    book = open_book(Fixed(), 1, EPISODES, None, runs, [{}] * num_runs)
    return bank.play(runs, book, Fixed(), 0, StreakLimit(EPISODES, 10**5), record=True)


@pytest.mark.parametrize("kind", ACTIONS)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), count=st.integers(0, 4))
def test_actions_keep_their_form(kind: str, seed: int, count: int) -> None:
    """There and back, one by one and together, without a change; those drawn at random are actions."""
    space, form = ACTIONS[kind], ActionForm(ACTIONS[kind])
    drawn = form.sample(np.random.default_rng(seed), count) if count else form.room(0)
    own = form.uncounted(drawn)
    assert all(space.contains(one) for one in form.rows(own))
    np.testing.assert_array_equal(form.column(form.rows(own)), own)
    np.testing.assert_array_equal(form.counted(form.column(form.rows(own))), drawn)
    assert form.column([]).shape == form.room(0).shape
    if not form.is_discrete:
        assert all(np.array_equal(form.converted(one.tolist()), one) for one in form.rows(own))


@pytest.mark.parametrize("action", ACTIONS)
def test_who_acts_and_who_watches_are_told_the_same(action: str) -> None:
    """The environment's own actions and μ, as copies; of single numbers plain ones."""
    worlds = [world_of(action, seed=seed) for seed in (1, 2)]
    (acting, actors), (watching, watchers) = bank_of(worlds, "Watcher"), bank_of(worlds, "Watcher")
    batch = played(acting, 2).batch
    assert batch is not None
    assert watching.learn(batch) == ()
    for (_, _, trajectory), rewards in zip(batch.trajectories(), _rewards(batch), strict=True):
        assert trajectory.action.dtype == ActionForm(ACTIONS[action]).room(0).dtype
        assert [float(np.sum(one)) for one in trajectory.action] == rewards
    for actor, watcher in zip(actors, watchers, strict=True):
        assert len(actor.memory) == len(watcher.memory) == EPISODES * 5
        for one, other in zip(actor.memory, watcher.memory, strict=True):
            assert ACTIONS[action].contains(one.action)
            assert type(one.action) is type(other.action)
            np.testing.assert_array_equal(one.action, other.action)
            np.testing.assert_array_equal(one.probability, other.probability)
            assert np.ndim(one.probability) == (action == "Discrete")
            assert one.reward == float(np.sum(one.action))


def _rewards(batch: Any) -> list[list[float]]:
    return [trajectory.reward.tolist() for _, _, trajectory in batch.trajectories()]


@pytest.mark.parametrize("action", ["Box", "MultiDiscrete", "MultiBinary"])
def test_ensembles_and_shards_play_the_same(action: str) -> None:
    """Two learners in turn, greedily evaluated: rows of two runs side by side are those of each by itself."""
    learners = [LearnerConfig(f"{CODE}:Watcher"), LearnerConfig(f"{CODE}:Whole")]
    worlds, seeds = [world_of(action, "Dict", seed) for seed in (1, 2)], [1, 2]
    criterion = Criterion("return", 3, at_least=1e9, evaluation="greedy")
    rows, _ = ensemble_rows(learners, worlds, seeds, Apel(), 12, criterion=criterion)
    banks = make_banks(learners, worlds, seeds, evaluates=True)
    again = play_rounds(banks, worlds, seeds, Apel(), 12, criterion=criterion)
    assert not again.failures
    assert_same_rows(again.rows, rows)
    assert {row[1] for row in rows[0]} == {0, 1}


@pytest.mark.parametrize("observation", ["Dict", "finite Tuple"])
def test_parts_are_shown_one_by_one_as_together(observation: str) -> None:
    """To members of a vote, for one, which are asked for one observation at a time."""
    world = world_of("Discrete", observation)
    _, view = make_learner(LearnerConfig(f"{CODE}:Whole"), world, 0, 0)
    seen, _ = world.environment.reset(seed=1)
    one, (together,) = view(seen), view.batch(np.asarray(seen)[None])
    assert type(one) is type(together)
    assert OBSERVATIONS[observation].contains(one)
    np.testing.assert_equal(one, together)


MISTAKES: dict[str, tuple[str, Any, str]] = {
    "above": (
        "Box",
        [0.5, 5.000001],
        r"found the action .*, expected an element of Box.*5\.0000.* at \[1\] is not from 0",
    ),
    "below": ("Box", np.array([-1.1, 1]), r"-1\.1\d* at \[0\] is not from -1"),
    "no number": ("Box", [np.nan, 1.0], r"found no number at \[0\]"),
    "infinite": ("wide Box", [[np.inf, 0], [0, 0]], r"inf at \[0, 0\] is not finite"),
    "shape": ("Box", 0.5, r"it has the shape \(\), not \(2,\)"),
    "text": ("Box", "left", "it holds something that is no number"),
    "half": ("MultiDiscrete", [1.5, -4], "1.5 cannot be stored as int64 without loss"),
    "none of them": ("MultiDiscrete", [0, -4], r"0 at \[0\] is not from 1 to 3"),
    "three": ("MultiBinary", [[0, 1], [3, 0]], r"3 at \[1, 0\] is not from 0 to 1"),
    "a fraction of a byte": ("Box of bytes", [0.25, 1], "0.25 cannot be stored as uint8"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_wrong_action_ends_its_run(name: str) -> None:
    """Nothing is clipped or rounded to fit; what it said, and what was expected, is told of that run alone."""
    action, answer, message = MISTAKES[name]
    bank, _ = bank_of([world_of(action)], "Mistaken", answer=answer)
    (failure,) = played(bank).failures
    assert (failure.run, failure.episode, failure.part) == (0, 0, "learner")
    with pytest.raises(BorderError, match=message):
        raise BorderError(failure.error)


@pytest.mark.parametrize("mu", [-0.1, np.nan, np.inf, [0.5, 0.5], "likely"])
def test_a_wrong_density_ends_its_run(mu: Any) -> None:
    bank, _ = bank_of([world_of()], "Mistaken", answer=None, mu=mu)
    (failure,) = played(bank).failures
    assert "expected the density of the action: a finite number from 0 on, or None" in failure.error


def test_an_episode_with_a_step_of_unknown_density_is_told_none() -> None:
    worlds = [world_of()]
    (acting, _), (watching, (watcher,)) = bank_of(worlds, "Mistaken", answer=None), bank_of(worlds, "Watcher")
    batch = played(acting).batch
    assert batch is not None
    watching.learn(batch)
    assert [one.probability for one in watcher.memory] == [None] * 15


@pytest.mark.parametrize(
    "observation",
    [
        name
        for name, one in OBSERVATIONS.items()
        if not one.shape and len(one.shape or "") == 0 and isinstance(one, spaces.Dict | spaces.Tuple)
    ],
)
def test_whole_observations(observation: str) -> None:
    """A learner that takes parts sees what the environment said; another one the vector of the same."""
    worlds = [world_of("MultiBinary", observation)]
    (acting, (actor,)), (watching, (watcher,)) = bank_of(worlds, "Whole"), bank_of(worlds, "Watcher")
    assert actor.space == OBSERVATIONS[observation]
    batch = played(acting).batch
    assert batch is not None
    watching.learn(batch)
    space = worlds[0].environment.observation_space
    assert parts_of(space) == OBSERVATIONS[observation]
    for one, other in zip(actor.memory, watcher.memory, strict=True):
        assert OBSERVATIONS[observation].contains(one.observation)
        assert isinstance(other.observation, np.ndarray)
        _assert_same(whole(space, other.observation[None])[0], one.observation)
    said = OBSERVATIONS[observation]
    said.seed(int(np.random.default_rng(0).integers(9)))
    for _ in range(20):
        element = said.sample()
        flat = worlds[0].environment.get_wrapper_attr("observation")(element)
        _assert_same(whole(space, flat[None])[0], element)


def _assert_same(one: Any, other: Any) -> None:
    if isinstance(other, dict):
        assert one.keys() == other.keys()
        for name in other:
            _assert_same(one[name], other[name])
    elif isinstance(other, tuple):
        for mine, its in zip(one, other, strict=True):
            _assert_same(mine, its)
    else:
        np.testing.assert_array_equal(one, other)
        assert np.asarray(one).dtype == np.asarray(other).dtype


def test_whole_observations_have_no_features() -> None:
    config = LearnerConfig(f"{CODE}:Whole", representation=Representation(stack=2))
    with pytest.raises(
        ValueError, match="of a learner that sees whole observations, expected no exclude, bins or stack"
    ):
        make_learner(config, world_of("Box", "Dict"), 1, 0)


def test_goes_on_with_what_it_was(  # the beginning of the last episode is played again with its own actions
) -> None:
    """An unknown environment with actions of any kind is checked against its last episode."""
    for action in ACTIONS:
        assert why_not_exact(lambda action=action: world_of(action)) is None
        used, new = (EnvironmentList([world_of(action).environment]) for _ in range(2))
        run, random = np.zeros(1, dtype=np.int64), np.random.default_rng(3)
        used.reset(run, [5])
        for _ in range(3):
            used.step(run, used.actions.sample(random, 1))
        new.restore(used.state())


def test_films_play_real_actions() -> None:
    """A trajectory is played again for its pictures."""
    world = world_of("MultiDiscrete")
    bank, _ = bank_of([world], "Watcher")
    batch = played(bank).batch
    assert batch is not None
    world.environment.unwrapped.render = lambda: np.zeros((1, 1, 3), np.uint8)  # type: ignore[method-assign]
    (_, episode, trajectory), *_ = batch.trajectories()
    shown = list(frames(world, episode, trajectory))
    assert shown[-1].return_so_far == trajectory.undiscounted_return


OPTIONS: dict[str, dict[str, Any]] = {
    "dqn": {"network": {"hidden": [4]}, "head_hidden": [4], "replay_size": 50},
    "acer": {"network": {"hidden": [4]}, "replay_size": 5},
    "sac": {"network": {"hidden": [4]}, "replay_size": 50},
}


def config_of(name: str) -> LearnerConfig:
    """A small one of a shipped learner."""
    if name == "voting":
        return LearnerConfig(name, members=(LearnerConfig("dqn", OPTIONS["dqn"]),))
    if name in SB3_ALGORITHMS:
        options = {"algorithm": name, "buffer_size": 50, "policy_kwargs": {"net_arch": [4]}}
        return LearnerConfig("stable_baselines", options)
    return LearnerConfig(name, OPTIONS.get(name, {}))


@pytest.mark.parametrize("name", SHIPPED)
def test_learners_are_for_what_they_declare(name: str) -> None:
    """Each is built, and acts, for every kind of space that it declares, and is refused for every other one."""
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("sb3_contrib")
    for action in ("Discrete", "Box", "MultiDiscrete"):
        for observation in ("Box", "Discrete", "MultiDiscrete", "MultiBinary", "finite Tuple", "Dict"):
            world = world_of(action, observation)
            kind = {"Dict": "Box", "finite Tuple": "MultiDiscrete"}.get(observation, observation)
            fits = action in SHIPPED[name].actions and kind in SHIPPED[name].observations
            if fits and name != "voting":
                learner, view = make_learner(config_of(name), world, 1, 0)
                said, _ = world.environment.reset(seed=3)
                answer, _ = learner.act(view(said))
                assert world.environment.action_space.contains(np.asarray(answer) if action != "Discrete" else answer)
            elif not fits:
                with pytest.raises(
                    ValueError, match=r"found the (action|observation) space .*, expected .* or another"
                ):
                    make_bank([config_of(name)], [world], [1], 0, "return", with_probability=False)


def test_a_script_plays_it() -> None:
    """`Ensemble`, with classes instead of names."""
    ensemble = Ensemble(world_of("Box", "Tuple"), [LearnerConfig(Whole), LearnerConfig(Whole)], Apel(), 1, 4)
    assert len(list(ensemble.run())) == 4


def test_the_guide_s_table_is_what_learners_declare() -> None:
    """`docs/spaces.md` says of each learner which spaces it is for, and which observations it sees whole."""
    page = (Path(__file__).parents[2] / "docs" / "spaces.md").read_text(encoding="utf-8")
    for name, one in SHIPPED.items():
        config = config_of(name)
        kind = resolve(config.type, LEARNERS, "learner")
        assert supported_spaces(kind, config.options) == one
        plain = ", ".join(part for part in one.observations if part not in ("Dict", "Tuple"))
        seen = (
            supported_spaces(kind, {**config.options, "policy": "MultiInputPolicy"}) if name in SB3_ALGORITHMS else None
        )
        parts = f"{', '.join(seen.observations)} |" if seen else "|"
        assert f"| `{name}` | {', '.join(one.actions)} | {plain} | {parts}\n" in page
    assert page.count("\n| `") - page.count(".yaml` |") - 1 == len(SHIPPED)


@pytest.mark.parametrize("action", ["MultiDiscrete", "MultiBinary"])
def test_joint_actions(action: str) -> None:
    """Every combination has a number of its own, and learners of Discrete actions play with them."""
    environment = JointActions(Anything(action, "Discrete"))
    space = ACTIONS[action]
    taken = [environment.action(i) for i in range(int(environment.action_space.n))]
    assert all(space.contains(one) for one in taken)
    assert len({one.tobytes() for one in taken}) == len(taken) == (6 if action == "MultiDiscrete" else 16)
    config = EnvironmentConfig("joint", {"action": action, "observation": "Discrete"})
    world = make_world(config, 1, lambda **options: JointActions(Anything(**options)))
    assert len(list(Ensemble(world, [LearnerConfig("q_learning")] * 2, Apel(), 1, 4).run())) == 4


def test_actions_that_cannot_be_joined_are_refused() -> None:
    with pytest.raises(ValueError, match=r"found the action space Box.*, expected a MultiDiscrete or"):
        JointActions(Anything("Box"))
    many = Anything("MultiBinary")
    many.action_space = spaces.MultiBinary(17)
    with pytest.raises(ValueError, match="with 131072 combinations, expected at most 100000"):
        JointActions(many)
