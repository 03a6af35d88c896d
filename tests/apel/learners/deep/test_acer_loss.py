"""ACER's loss (Wang et al. 2017, Algorithm 2): by hand, against finite differences, and what must not flow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from apel.learners.deep.acer import loss_of
from apel.learners.deep.acer_options import PRESETS, AcerOptions, TrustRegion, acer_options
from apel.learners.deep.networks import NetworkOptions
from apel.learners.deep.retrace import acer_gradient
from apel.learners.deep.segments import SegmentBatch
from tests.apel.learners.deep.plain_acer import Rule, Segment, Surrogate, Table, softmax

NAN = math.nan
STATE_COUNT, ACTION_COUNT = 4, 3
REAL = ("reward", "behaviour", "outputs", "average", "gradient")
"""In double precision here, so that finite differences say something."""
LOSS_OPTIONS = AcerOptions(discount=0.9, truncation=1.0, entropy=0.05, critic=0.7, trust_region=None)


def random_segments(rng: np.random.Generator, count: int) -> list[Segment]:
    """Of lengths 4, 1, 2, 3, 4, …; every third with an unknown behaviour; every second terminated."""
    made = []
    for i in range(count):
        length = 1 + (i + 3) % 4
        behaviour = [None if i % 3 == 2 else rng.dirichlet(np.ones(ACTION_COUNT)).tolist() for _ in range(length)]
        made.append(
            Segment(
                states=rng.integers(STATE_COUNT, size=length + 1).tolist(),
                actions=rng.integers(ACTION_COUNT, size=length).tolist(),
                rewards=rng.normal(size=length).tolist(),
                behaviour=behaviour,
                terminated=i % 2 == 1,
            )
        )
    return made


def rule_of(options: AcerOptions) -> Rule:
    return Rule(
        discount=options.discount,
        truncation=options.truncation,
        bound=options.trust_region.bound if options.trust_region else None,
        entropy=options.entropy,
        critic=options.critic,
        huber=options.critic_loss == "huber",
        reward_scale=options.reward_scale,
        bootstraps_from_last=options.bootstrap == "last_state",
    )


def tables(rng: np.random.Generator, scale: float = 1.0) -> tuple[Table, Table]:
    """Logits and Q of every state and action."""
    return rng.normal(size=(STATE_COUNT, ACTION_COUNT)), scale * rng.normal(size=(STATE_COUNT, ACTION_COUNT))


def finite_differences(function: Callable[[Table], float], table: Table) -> Table:
    found = np.zeros_like(table)
    for place in np.ndindex(*table.shape):
        step = np.zeros_like(table)
        step[place] = 1e-5
        found[place] = (function(table + step) - function(table - step)) / 2e-5
    return found


def batch_of(segments: list[Segment], logits: Table, values: Table, average: Table) -> SegmentBatch:
    """Some segments of a run, with the outputs of tables."""
    num_actions = logits.shape[1]
    rows = sum(len(segment.states) for segment in segments)
    empty = SegmentBatch.empty(1, len(segments), rows, 1, num_actions)
    batch = empty._replace(**{name: getattr(empty, name).astype(np.float64) for name in REAL})
    begin = 0
    for j, segment in enumerate(segments):
        batch.terminated[0, j] = segment.terminated
        for t, state in enumerate(segment.states):
            batch.outputs[0, begin + t] = np.concatenate([logits[state], values[state]])
            batch.average[0, begin + t, :num_actions] = average[state]
        for t, action in enumerate(segment.actions):
            batch.action[0, begin + t], batch.reward[0, begin + t] = action, segment.rewards[t]
            known = segment.behaviour[t]
            batch.behaviour[0, begin + t] = NAN if known is None else known
        begin += len(segment.states)
        batch.begin[0, j + 1] = begin
    return batch


def gradients_of(
    options: AcerOptions, segments: list[Segment], logits: Any, values: Any, average: Any = None
) -> tuple[Table, Table]:
    """Of the tables: those of all rows in a state add up."""
    logits, values = np.asarray(logits, dtype=np.float64), np.asarray(values, dtype=np.float64)
    batch = batch_of(segments, logits, values, logits if average is None else average)
    acer_gradient(loss_of(options), batch, 1, len(segments))
    found = np.zeros((len(logits), 2 * logits.shape[1]))
    states = np.concatenate([segment.states for segment in segments])
    np.add.at(found, states, batch.gradient[0, : len(states)])
    return found[:, : logits.shape[1]], found[:, logits.shape[1] :]


@pytest.mark.parametrize(
    "options",
    [
        LOSS_OPTIONS,
        replace(LOSS_OPTIONS, truncation=0.4),
        replace(LOSS_OPTIONS, truncation=10.0, entropy=0.0),
        replace(LOSS_OPTIONS, critic_loss="huber", reward_scale=3.0),
        replace(LOSS_OPTIONS, bootstrap="last_state"),
        replace(LOSS_OPTIONS, trust_region=TrustRegion(bound=0.02)),
        replace(LOSS_OPTIONS, truncation=10.0, trust_region=TrustRegion(bound=1.0), critic=0.5),
    ],
    ids=["c=1", "c=0.4", "c=10", "huber", "last state", "tight trust region", "paper"],
)
def test_gradient_of_the_loss_is_that_of_the_surrogate(options: AcerOptions) -> None:
    """For tables, without a body, the loss's gradient in logits and Q is the surrogate's by finite differences.

    Five segments: of all lengths, terminated and not, with known and unknown behaviours.
    """
    rng = np.random.default_rng(11)
    segments, (logits, values), average = random_segments(rng, 5), tables(rng, scale=1.5), tables(rng)[0]
    found = gradients_of(options, segments, logits, values, average)
    surrogate = Surrogate(segments, logits, values, average, rule_of(options))
    expected = finite_differences(lambda moved: surrogate(moved, values), logits)
    np.testing.assert_allclose(found[0], expected, rtol=1e-5, atol=1e-7)
    expected = finite_differences(lambda moved: surrogate(logits, moved), values)
    np.testing.assert_allclose(found[1], expected, rtol=1e-5, atol=1e-7)
    free = Surrogate(segments, logits, values, average, replace(rule_of(options), bound=None))
    assert options.trust_region is None or abs(free(logits, values) - surrogate(logits, values)) > 1e-6


def test_gradient_of_the_loss_by_hand() -> None:
    """One state, one step, two actions with equal logits and Q = (1, 3): π = (½, ½), V = 2.

    a = 0 with μ = (¼, ¾), r = 4, terminated: Qret = 4, ρ = (2, 2/3), c = 1. The weights of ∇ log π are
    1 · (4 − 2) + ½ · ½ (1 − 2) = 1.75 for a and 0 for the other, so the logits' gradient is
    −1.75 (1 − ½, −½) = (−0.875, 0.875). The critic's is ½ (Q − Qret) = ½ (1 − 4) = −1.5, for a alone.
    """
    segment = Segment([0, 0], [0], [4.0], [[0.25, 0.75]], terminated=True)
    options = AcerOptions(truncation=1.0, entropy=0.0, critic=0.5, trust_region=None)
    logits, values = gradients_of(options, [segment], [[0.0, 0.0]], [[1.0, 3.0]])
    assert logits[0].tolist() == pytest.approx([-0.875, 0.875])
    assert values[0].tolist() == pytest.approx([-1.5, 0.0])


@pytest.mark.parametrize("trust_region", [None, TrustRegion(bound=0.02)])
def test_actor_and_critic_do_not_move_each_others_heads(trust_region: TrustRegion | None) -> None:
    """Targets, importance weights and V are numbers: the actor's part leaves Q alone, the critic's the policy."""
    rng = np.random.default_rng(5)
    segments, averages = random_segments(rng, 5), tables(rng)[0]
    logits, values = tables(rng)
    options = replace(LOSS_OPTIONS, trust_region=trust_region)
    actor = gradients_of(replace(options, critic=1e-300), segments, logits, values, averages)
    assert (np.abs(actor[0]) > 1e-6).any()
    assert (np.abs(actor[1]) < 1e-290).all()
    both = gradients_of(replace(options, critic=1.0), segments, logits, values, averages)
    np.testing.assert_array_equal(both[0], actor[0])
    assert (np.abs(both[1]) > 1e-6).any()


def test_policy_that_equals_its_average_is_still_bounded() -> None:
    """In the probabilities k = −1 where π = π_average: z is g less its mean excess, and its gradient is finite."""
    rng = np.random.default_rng(7)
    (logits, values), segments = tables(rng), random_segments(rng, 5)
    region = replace(LOSS_OPTIONS, trust_region=TrustRegion(bound=0.02))
    bound, free = (gradients_of(options, segments, logits, values, logits) for options in (region, LOSS_OPTIONS))
    # A vector along (1, 1, 1) does not move a policy: with π = π_average the trust region changes nothing.
    np.testing.assert_allclose(bound[0], free[0], atol=1e-12)


def test_mean_is_that_over_steps() -> None:
    """Segments of 2 and 4 steps together: a third of the one's gradient and two thirds of the other's."""
    rng = np.random.default_rng(9)
    (logits, values), segments = tables(rng), random_segments(rng, 4)
    short, long = (next(one for one in segments if len(one.actions) == count) for count in (2, 4))
    alone = [gradients_of(LOSS_OPTIONS, [one], logits, values) for one in (short, long)]
    together = gradients_of(LOSS_OPTIONS, [short, long], logits, values)
    for i in range(2):
        np.testing.assert_allclose(together[i], (2 * alone[0][i] + 4 * alone[1][i]) / 6, atol=1e-12)


def test_runs_of_a_call_do_not_touch_each_other() -> None:
    """Two runs side by side, of which one has fewer rows: each has the gradient that it has alone."""
    rng = np.random.default_rng(10)
    tabled = [(random_segments(rng, 2), *tables(rng)) for _ in range(2)]
    batches = [batch_of(segments, logits, values, logits) for segments, logits, values in tabled]
    rows = max(batch.outputs.shape[1] for batch in batches)

    def padded(array: Any) -> Any:
        missing = rows - array.shape[1]
        return np.pad(array, [(0, 0), (0, missing), *[(0, 0)] * (array.ndim - 2)]) if array.shape[1] > 3 else array

    both = SegmentBatch._make(np.concatenate([padded(array) for array in pair]) for pair in zip(*batches, strict=True))
    acer_gradient(loss_of(LOSS_OPTIONS), both, 2, 2)
    for i, batch in enumerate(batches):
        acer_gradient(loss_of(LOSS_OPTIONS), batch, 1, 2)
        np.testing.assert_array_equal(both.gradient[i, : batch.gradient.shape[1]], batch.gradient[0])


@pytest.mark.parametrize(
    ("bootstrap", "terminated", "target"),
    [
        # γ = ½, r = 1, V(x₀) = 0, V(x₁) = 2.
        ("next_state", False, 2.0),
        ("last_state", False, 1.0),
        ("next_state", True, 1.0),
        ("last_state", True, 1.0),
    ],
)
def test_bootstrap_by_hand(bootstrap: Any, terminated: bool, target: float) -> None:
    """After the last step counts V(x₁) of the state it led to; minimalRL takes V(x₀) of the state it was done in."""
    segment = Segment([0, 1], [1], [1.0], [[0.2, 0.3, 0.5]], terminated)
    values = np.zeros((STATE_COUNT, ACTION_COUNT))
    values[1] = 2.0
    options = replace(LOSS_OPTIONS, discount=0.5, critic=1.0, bootstrap=bootstrap)
    gradient = gradients_of(options, [segment], np.zeros_like(values), values)[1]
    # ∂ ½ (target − Q)² / ∂Q with Q = 0.
    assert gradient[0, 1] == pytest.approx(-target)


def test_deterministic_policies_give_finite_losses() -> None:
    """Logits of ± 200 against a greedy behaviour that disagrees: no infinity, no NaN."""
    segment = Segment([0, 1, 2], [2, 0], [1.0, -1.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], False)
    logits = np.full((STATE_COUNT, ACTION_COUNT), -200.0)
    logits[:, 1] = 200.0
    for trust_region in (None, TrustRegion()):
        options = replace(LOSS_OPTIONS, trust_region=trust_region)
        found = gradients_of(options, [segment], logits, np.ones_like(logits), -logits)
        assert all(np.isfinite(one).all() for one in found)


# The options.


def test_presets() -> None:
    """``minimalrl`` is seungeunrho/minimalRL's acer.py of 2019, with which the dissertation shares 2e-4, 256, 0.98."""
    assert acer_options("minimalrl") == AcerOptions(
        learning_rate=2e-4,
        adam_epsilon=1e-8,
        discount=0.98,
        rollout=10,
        truncation=1.0,
        trust_region=None,
        entropy=0.0,
        critic=1.0,
        critic_loss="huber",
        replay_ratio=1,
        batch_size=4,
        replay_size=6000,
        learning_starts=500,
        reward_scale=0.01,
        max_gradient_norm=None,
        bootstrap="last_state",
        network=NetworkOptions(hidden=(256,), activation="relu", initialisation="pytorch"),
    )
    paper = acer_options()
    assert (paper.learning_rate, paper.discount, paper.network.hidden) == (2e-4, 0.98, (256,))
    assert (paper.rollout, paper.truncation, paper.trust_region) == (20, 10.0, TrustRegion(bound=1.0, average=0.99))
    assert (paper.critic_loss, paper.critic, paper.replay_ratio, paper.bootstrap) == ("square", 0.5, 4, "next_state")


def test_presets_may_be_changed_in_part() -> None:
    """What is given beside a preset counts; data become options."""
    options = acer_options("minimalrl", rollout=7, trust_region={"bound": 0.5}, network={"hidden": [8]})
    assert (options.rollout, options.truncation, options.critic_loss) == (7, 1.0, "huber")
    assert options.trust_region == TrustRegion(bound=0.5, average=0.99)
    assert options.network.hidden == (8,)
    assert "rollout" in PRESETS["minimalrl"]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("preset", "deluxe"),
        ("learning_rate", 0.0),
        ("learning_rate", NAN),
        ("discount", 1.1),
        ("rollout", 0),
        ("truncation", 0.0),
        ("truncation", math.inf),
        ("trust_region", {"bound": 0.0}),
        ("trust_region", {"bound": 1.0, "average": 1.5}),
        ("entropy", -0.1),
        ("critic_loss", "absolute"),
        ("replay_ratio", -1),
        ("replay_count", "Poisson"),
        ("batch_size", 0),
        ("replay_size", 0),
        ("learning_starts", -1),
        ("reward_scale", 0.0),
        ("max_gradient_norm", 0.0),
        ("bootstrap", "first_state"),
        ("encoding", "binary"),
        ("network", {"hidden": [0]}),
        ("device", "tpu"),
        ("speed", 1.0),
    ],
)
def test_options_out_of_range_are_refused(option: str, value: Any) -> None:
    """Every number has a range, and nothing unknown is taken."""
    with pytest.raises(ValueError, match=option):
        acer_options(**{option: value})


def test_poisson_of_a_large_mean_is_refused() -> None:
    """Its distribution is summed from 0 on."""
    assert acer_options(replay_count="poisson", replay_ratio=100).replay_ratio == 100
    with pytest.raises(ValueError, match="replay_ratio: found 101 for poisson, expected at most 100"):
        acer_options(replay_count="poisson", replay_ratio=101)


def test_softmax_of_the_oracle() -> None:
    """The oracle's own policy: logits (0, ln 3) are (¼, ¾)."""
    assert softmax(np.array([0.0, math.log(3.0)])).tolist() == pytest.approx([0.25, 0.75])
