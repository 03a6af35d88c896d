"""ACER's loss (Wang et al. 2017, Algorithm 2): by hand, against finite differences, and what must not flow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from apel.learners.deep.acer import PRESETS, AcerOptions, SegmentBatch, TrustRegion, acer_loss, acer_options
from apel.learners.deep.networks import NetworkOptions
from tests.apel.deep.plain_acer import Rule, Segment, Surrogate, Table, softmax
from tests.apel.deep.tables import actor_critic_tables, one_hot, rows_of

NAN = math.nan
STATE_COUNT, ACTION_COUNT, LONGEST = 4, 3, 4
LOSS_OPTIONS = AcerOptions(discount=0.9, truncation=1.0, entropy=0.05, critic=0.7, trust_region=None)


def real(numbers: Any) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


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


def batch_of(runs: list[list[Segment]], longest: int = LONGEST, junk: float = 0.0) -> SegmentBatch:
    """The tensors of some segments of each run; ``junk`` stands where there is no step."""
    shape = (len(runs), len(runs[0]))
    states = np.zeros((*shape, longest + 1), dtype=np.int64)
    states[:] = int(abs(junk)) % STATE_COUNT
    action = np.full((*shape, longest), int(abs(junk)) % ACTION_COUNT)
    reward, behaviour = np.full((*shape, longest), junk), np.full((*shape, longest, ACTION_COUNT), abs(junk))
    length = np.zeros(shape, dtype=np.int64)
    terminated = np.zeros(shape, dtype=np.bool_)
    for place in np.ndindex(*shape):
        segment = runs[place[0]][place[1]]
        steps = len(segment.actions)
        states[place][: steps + 1] = segment.states
        action[place][:steps] = segment.actions
        reward[place][:steps] = segment.rewards
        known = [[NAN] * ACTION_COUNT if one is None else one for one in segment.behaviour]
        behaviour[place][:steps] = known
        length[place], terminated[place] = steps, segment.terminated
    return SegmentBatch(
        observation=one_hot(states, STATE_COUNT),
        action=torch.as_tensor(action),
        reward=torch.as_tensor(reward),
        behaviour=torch.as_tensor(behaviour),
        length=torch.as_tensor(length),
        terminated=torch.as_tensor(terminated),
        mask=torch.as_tensor((np.arange(longest) < length[..., None]).astype(np.float64)),
    )


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


def gradients_of(
    options: AcerOptions, batch: SegmentBatch, rows: Tensor, average: Tensor | None
) -> tuple[Tensor, list[Tensor]]:
    """The losses of the runs, and the gradients of the tables and biases: logits, its bias, Q, its bias."""
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    moving = rows.clone().requires_grad_()
    loss = acer_loss(network, moving, average, batch, options)
    (gradient,) = torch.autograd.grad(loss.sum(), moving)
    return loss.detach(), network.layout.unpack(gradient)


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

    Two runs with five segments each: of all lengths, terminated and not, with known and unknown behaviours.
    """
    rng = np.random.default_rng(11)
    runs = [random_segments(rng, 5) for _ in range(2)]
    policies_and_values = [tables(rng, scale=1.5) for _ in runs]
    averages = [tables(rng) for _ in runs]
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    rows, average = rows_of(network, *policies_and_values), rows_of(network, *averages)
    found = gradients_of(options, batch_of(runs), rows, average)[1]
    active = 0
    for run, (logits, values) in enumerate(policies_and_values):
        surrogate = Surrogate(runs[run], logits, values, averages[run][0], rule_of(options))
        expected = finite_differences(lambda moved, q=values, s=surrogate: s(moved, q), logits)
        np.testing.assert_allclose(found[0][run].numpy(), expected, rtol=1e-5, atol=1e-7)
        expected = finite_differences(lambda moved, p=logits, s=surrogate: s(p, moved), values)
        np.testing.assert_allclose(found[2][run].numpy(), expected, rtol=1e-5, atol=1e-7)
        # Every state has the same bias.
        torch.testing.assert_close(found[1][run], found[0][run].sum(0))
        torch.testing.assert_close(found[3][run], found[2][run].sum(0))
        free = Surrogate(runs[run], logits, values, averages[run][0], replace(rule_of(options), bound=None))
        active += abs(free(logits, values) - surrogate(logits, values)) > 1e-6
    assert active == 2 or options.trust_region is None


def test_gradient_of_the_loss_by_hand() -> None:
    """One state, one step, two actions with equal logits and Q = (1, 3): π = (½, ½), V = 2.

    a = 0 with μ = (¼, ¾), r = 4, terminated: Qret = 4, ρ = (2, 2/3), c = 1. The weights of ∇ log π are
    1 · (4 − 2) + ½ · ½ (1 − 2) = 1.75 for a and 0 for the other, so the logits' gradient is
    −1.75 (1 − ½, −½) = (−0.875, 0.875). The critic's is ½ (Q − Qret) = ½ (1 − 4) = −1.5, for a alone.
    """
    network = actor_critic_tables(1, 2)
    batch = SegmentBatch(
        observation=torch.ones(1, 1, 2, 1, dtype=torch.float64),
        action=torch.tensor([[[0]]]),
        reward=real([[[4.0]]]),
        behaviour=real([[[[0.25, 0.75]]]]),
        length=torch.tensor([[1]]),
        terminated=torch.tensor([[True]]),
        mask=real([[[1.0]]]),
    )
    rows = rows_of(network, ([[0.0, 0.0]], [[1.0, 3.0]])).requires_grad_()
    options = AcerOptions(truncation=1.0, entropy=0.0, critic=0.5, trust_region=None)
    (gradient,) = torch.autograd.grad(acer_loss(network, rows, None, batch, options).sum(), rows)
    logits, _, values, _ = network.layout.unpack(gradient)
    assert logits[0].tolist() == [pytest.approx([-0.875, 0.875])]
    assert values[0].tolist() == [pytest.approx([-1.5, 0.0])]


@pytest.mark.parametrize("trust_region", [None, TrustRegion(bound=0.02)])
def test_actor_and_critic_do_not_move_each_others_heads(trust_region: TrustRegion | None) -> None:
    """Targets, importance weights and V are numbers: the actor's part leaves Q alone, the critic's the policy."""
    rng = np.random.default_rng(5)
    batch = batch_of([random_segments(rng, 5)])
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    rows, average = rows_of(network, tables(rng)), rows_of(network, tables(rng))
    options = replace(LOSS_OPTIONS, trust_region=trust_region)
    # The critic's weight has to be positive: whatever the actor's part adds to Q would drown this one.
    actor = gradients_of(replace(options, critic=1e-300), batch, rows, average)[1]
    assert all((variable.abs() > 1e-6).any() for variable in actor[:2])
    assert all((variable.abs() < 1e-290).all() for variable in actor[2:])
    both = gradients_of(replace(options, critic=1.0), batch, rows, average)[1]
    assert torch.equal(both[0], actor[0])
    assert torch.equal(both[1], actor[1])
    assert (both[2].abs() > 1e-6).any()


def test_average_policy_gets_no_gradient() -> None:
    """The average network moves after the updates, never by them."""
    rng = np.random.default_rng(6)
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    rows, average = (rows_of(network, tables(rng)).requires_grad_() for _ in range(2))
    options = replace(LOSS_OPTIONS, trust_region=TrustRegion(bound=0.02))
    loss = acer_loss(network, rows, average, batch_of([random_segments(rng, 5)]), options)
    assert torch.autograd.grad(loss.sum(), average, allow_unused=True) == (None,)


def test_policy_that_equals_its_average_is_still_bounded() -> None:
    """In the probabilities k = −1 where π = π_average: z is g less its mean excess, and its gradient is finite."""
    rng = np.random.default_rng(7)
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    rows = rows_of(network, tables(rng))
    batch = batch_of([random_segments(rng, 5)])
    bound = gradients_of(replace(LOSS_OPTIONS, trust_region=TrustRegion(bound=0.02)), batch, rows, rows)[1]
    free = gradients_of(LOSS_OPTIONS, batch, rows, rows)[1]
    # A vector along (1, 1, 1) does not move a policy: with π = π_average the trust region changes nothing.
    torch.testing.assert_close(bound[0], free[0])


def test_steps_that_are_not_there_count_for_nothing() -> None:
    """Whatever stands in the padding, loss and gradient are the same, bit for bit."""
    rng = np.random.default_rng(8)
    runs = [random_segments(rng, 4) for _ in range(2)]
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    rows, average = rows_of(network, tables(rng), tables(rng)), rows_of(network, tables(rng), tables(rng))
    for options in (LOSS_OPTIONS, replace(LOSS_OPTIONS, trust_region=TrustRegion(bound=0.02), critic_loss="huber")):
        loss, gradient = gradients_of(options, batch_of(runs, junk=0.0), rows, average)
        other_loss, other_gradient = gradients_of(options, batch_of(runs, longest=4, junk=-7.0), rows, average)
        assert torch.equal(loss, other_loss)
        assert all(torch.equal(one, other) for one, other in zip(gradient, other_gradient, strict=True))
        longer, longer_gradient = gradients_of(options, batch_of(runs, longest=9, junk=5.0), rows, average)
        torch.testing.assert_close(loss, longer)
        for one, other in zip(gradient, longer_gradient, strict=True):
            torch.testing.assert_close(one, other)


def test_loss_is_the_mean_over_steps() -> None:
    """A segment of three steps weighs three times as much as one of one step, and runs are apart from each other."""
    rng = np.random.default_rng(9)
    four = random_segments(rng, 4)
    segments_of_lengths = {len(one.actions): one for one in four}
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    table = tables(rng)
    rows = rows_of(network, table)
    single = {n: gradients_of(LOSS_OPTIONS, batch_of([[one]]), rows, None) for n, one in segments_of_lengths.items()}
    loss, gradient = gradients_of(
        LOSS_OPTIONS, batch_of([[segments_of_lengths[1], segments_of_lengths[3]]]), rows, None
    )
    torch.testing.assert_close(loss, (single[1][0] + 3.0 * single[3][0]) / 4.0)
    torch.testing.assert_close(gradient[0], (single[1][1][0] + 3.0 * single[3][1][0]) / 4.0)
    two = gradients_of(
        LOSS_OPTIONS,
        batch_of([[segments_of_lengths[2]], [segments_of_lengths[4]]]),
        rows_of(network, table, table),
        None,
    )
    torch.testing.assert_close(two[0], torch.cat([single[2][0], single[4][0]]))


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
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    values = np.zeros((STATE_COUNT, ACTION_COUNT))
    values[1] = 2.0
    rows = rows_of(network, (np.zeros_like(values), values))
    options = replace(LOSS_OPTIONS, discount=0.5, critic=1.0, bootstrap=bootstrap)
    gradient = gradients_of(options, batch_of([[segment]]), rows, None)[1]
    # ∂ ½ (target − Q)² / ∂Q with Q = 0.
    assert float(gradient[2][0, 0, 1]) == pytest.approx(-target)


def test_deterministic_policies_give_finite_losses() -> None:
    """Logits of ± 200 against a greedy behaviour that disagrees: no infinity, no NaN, in single precision."""
    segment = Segment([0, 1, 2], [2, 0], [1.0, -1.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], False)
    network = actor_critic_tables(STATE_COUNT, ACTION_COUNT)
    logits = np.full((STATE_COUNT, ACTION_COUNT), -200.0)
    logits[:, 1] = 200.0
    rows = rows_of(network, (logits, np.ones_like(logits))).float()
    average = rows_of(network, (-logits, np.ones_like(logits))).float()
    batch = SegmentBatch(*[part.float() if part.is_floating_point() else part for part in batch_of([[segment]])])
    for trust_region in (None, TrustRegion()):
        options = replace(LOSS_OPTIONS, trust_region=trust_region)
        loss, gradient = gradients_of(options, batch, rows, average)
        assert loss.isfinite().all()
        assert all(variable.isfinite().all() for variable in gradient)


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


def test_softmax_of_the_oracle() -> None:
    """The oracle's own policy: logits (0, ln 3) are (¼, ¾)."""
    assert softmax(np.array([0.0, math.log(3.0)])).tolist() == pytest.approx([0.25, 0.75])
