"""From an experiment to shards: nothing is lost, nothing is played twice."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jobs.experiment.plan import Plan, default_shard_size
from jobs.experiment.run_plans import draw_variables
from jobs.experiment.spec import Experiment, validate
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.sweep import ArmPoint, SweepPoint, arm_points
from jobs.experiment.yaml_source import SpecError, parse
from jobs.runner import Settings, run_experiment
from tests.experiments import SMALL


@cache
def experiment(*changes: tuple[str, str]) -> Experiment:
    """The small experiment with some text replaced."""
    text = SMALL
    for old, new in changes:
        text = text.replace(old, new)
    return validate(parse(text, "small.yaml"))


def points_of(swept: Experiment, arm: str) -> list[SweepPoint]:
    """The sweep points of an arm."""
    return [one.point for one in arm_points(swept) if one.arm == arm]


def labels_of(swept: Experiment, arm: str) -> list[str]:
    """Their labels."""
    return [point.label for point in points_of(swept, arm)]


@given(runs=st.integers(1, 40), size=st.none() | st.integers(1, 50), cpus=st.integers(1, 9), data=st.data())
def test_every_missing_run_is_in_one_shard(runs: int, size: int | None, cpus: int, data: st.DataObject) -> None:
    """The shards hold each run that is not finished exactly once, cut at multiples of the shard size."""
    small = experiment(("runs: 6", f"runs: {runs}"))
    plan = Plan.of(small)
    keys = list(plan.run_keys())
    finished = data.draw(st.sets(st.sampled_from(keys)))
    shards = plan.shards(num_cpus=cpus, shard_size=size, finished=finished)
    planned = [(shard.arm.arm, shard.arm.sweep, run.index) for shard in shards for run in shard.runs]
    assert len(planned) == len(set(planned))
    assert set(planned) == set(keys) - finished
    for shard in shards:
        if size is not None:
            assert len({run.index // size for run in shard.runs}) == 1


@given(
    runs=st.integers(1, 20),
    size=st.integers(1, 9),
    begun=st.lists(st.tuples(st.integers(0, 20), st.integers(0, 6)).map(lambda pair: (pair[0], sum(pair))), max_size=4),
    data=st.data(),
)
def test_what_was_begun_together_stays_together(
    runs: int, size: int, begun: list[tuple[int, int]], data: st.DataObject
) -> None:
    """Whatever checkpoints lie there, each run is in one shard, and the first of any overlapping ones is a shard."""
    plan = Plan.of(experiment(("runs: 6", f"runs: {runs}"))).only(["APEL"])
    finished = data.draw(st.sets(st.sampled_from(list(plan.run_keys()))))
    shards = plan.shards(num_cpus=1, shard_size=size, finished=finished, begun=lambda _arm, _sweep: begun)
    planned = [run.index for shard in shards for run in shard.runs]
    missing = {index for *_, index in set(plan.run_keys()) - finished}
    assert sorted(planned) == sorted(missing)
    whole = [(first, last) for first, last in sorted(begun) if set(range(first, last + 1)) <= missing]
    if whole:
        first, last = whole[0]
        assert list(range(first, last + 1)) in [[run.index for run in shard.runs] for shard in shards]


@given(runs=st.integers(1, 2000), cpus=st.integers(1, 256), learners=st.integers(1, 5), ensembles=st.integers(1, 30))
def test_default_shard_size_is_sensible(runs: int, cpus: int, learners: int, ensembles: int) -> None:
    """A shard has from 1 to 100 runs, and a learner alone gives every CPU something to do."""
    size = default_shard_size(runs, cpus, learners, ensembles)
    assert 1 <= size <= 100
    if learners == 1:
        assert -(-runs // size) >= min(cpus, runs)


@pytest.mark.parametrize(
    ("runs", "cpus", "learners", "ensembles", "size"),
    [
        (100, 2, 1, 2, 25),  # four shards for two CPUs
        (100, 2, 2, 2, 100),  # two ensembles, a CPU for each
        (100, 4, 2, 2, 50),
        (100, 4, 5, 1, 25),
        (1000, 1, 3, 1, 100),
        (1, 64, 1, 1, 1),
    ],
)
def test_default_shard_size(runs: int, cpus: int, learners: int, ensembles: int, size: int) -> None:
    """By hand: ⌈runs / shards⌉, of ⌈CPUs / ensembles⌉ shards for each ensemble, 2 · CPUs for a learner alone."""
    assert default_shard_size(runs, cpus, learners, ensembles) == size


def test_arms_share_what_is_drawn_for_a_run() -> None:
    """In each run all arms see the same seed, environment and variables; runs differ."""
    shards = Plan.of(experiment()).shards(num_cpus=1, shard_size=100)
    plans = [shard.runs for shard in shards]
    for runs in zip(*plans, strict=True):
        assert len({(run.seed, repr(run.environment), repr(run.variables)) for run in runs}) == 1
    assert len({run.seed for run in plans[0]}) == 6


def test_variables_are_drawn_uniformly() -> None:
    """Over 600 seeds each of three values comes about 200 times: within five standard deviations of 11.5."""
    small = experiment()
    drawn = [draw_variables(small, seed)["dropped"] for seed in range(600)]
    assert all(abs(drawn.count(value) - 200) < 58 for value in ("x", "y", "distractor"))


def test_appending_a_variable_moves_no_other() -> None:
    """A variable's stream is its own."""
    more = experiment(("  dropped: [x, y, distractor]", "  dropped: [x, y, distractor]\n  other: [1, 2, 3]"))
    for seed in range(30):
        assert draw_variables(more, seed)["dropped"] == draw_variables(experiment(), seed)["dropped"]


def test_repeated_learners_are_numbered() -> None:
    """Several copies of a learner have names of their own."""
    copies = experiment(("APEL: {learners: [Q_full, Q_red]", "APEL: {learners: [Q_full, Q_red, Q_full]"))
    (shard,) = Plan.of(copies).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    assert shard.arm.learner_names == ("Q_full#0", "Q_red", "Q_full#1")


def test_sweep_is_a_grid(small: Path) -> None:
    """Every combination of the swept values is a point, with a label; an arm has those of the axes that touch it."""
    swept = load_experiment(str(small), ["sweep={episodes: [5, 6], arms.APEL.selector.decay: [0.1, 0.2]}"])
    assert labels_of(swept, "Q_full") == ["episodes=5", "episodes=6"]
    assert labels_of(swept, "APEL") == [
        "episodes=5, arms.APEL.selector.decay=0.1",
        "episodes=5, arms.APEL.selector.decay=0.2",
        "episodes=6, arms.APEL.selector.decay=0.1",
        "episodes=6, arms.APEL.selector.decay=0.2",
    ]


def test_named_axis_sets_several_fields(small: Path) -> None:
    """The values of a named axis go together; its name is the label, and a column of the run rows."""
    axis = "{cap: {episodes: [5, 6], arms.APEL.selector.decay: [0.1, 0.2]}}"
    swept = load_experiment(str(small), [f"sweep={axis}", "arms.APEL.learners={Q_full: 2, Q_red: 1}"])
    points = points_of(swept, "APEL")
    assert [(point.label, point.values) for point in points] == [("cap=5", {"cap": 5}), ("cap=6", {"cap": 6})]
    assert [point.experiment.episodes for point in points] == [5, 6]
    selectors = [point.experiment.arms["APEL"].selector for point in points]
    assert [selector.options["decay"] for selector in selectors if selector] == [0.1, 0.2]
    assert points[0].experiment.arms["APEL"].learner_names == ["Q_full", "Q_full", "Q_red"]


def test_axis_that_does_not_touch_an_arm_is_not_its(small: Path) -> None:
    """An arm is played once, not once for every value that makes no difference to it."""
    swept = load_experiment(str(small), ["sweep={nu: {arms.APEL.selector.decay: [0.1, 0.2, 0.3]}}"])
    assert labels_of(swept, "SSBAS") == [""]
    assert len(arm_points(swept)) == 1 + 3 + 1


def test_axis_whose_values_are_alike_to_an_arm_still_sets_them(small: Path) -> None:
    """Values that do not differ for an arm, but differ from the file's, are its values at every sweep point."""
    axis = "{nu: {arms.APEL.selector.decay: [0.1, 0.2], episodes: [50, 50]}}"
    swept = load_experiment(str(small), [f"sweep={axis}"])
    for arm in ("Q_full", "APEL", "SSBAS"):
        assert {point.experiment.episodes for point in points_of(swept, arm)} == {50}
    as_in_the_file = load_experiment(str(small), [f"sweep={axis.replace('50', '80')}"])
    assert labels_of(as_in_the_file, "Q_full") == [""]
    assert [point.experiment.episodes for point in points_of(as_in_the_file, "Q_full")] == [80]


def test_axis_that_touches_an_arm_at_some_places_of_another(small: Path) -> None:
    """A learner that an arm holds at one sweep point only is swept there."""
    axes = "{arms.Q_full.learners: [[Q_full], [Q_red]], learners.Q_red.learning_rate: [0.1, 0.2]}"
    swept = load_experiment(str(small), [f"sweep={axes}"])
    points = [point.values for point in points_of(swept, "Q_full")]
    assert {"arms.Q_full.learners": ["Q_red"], "learners.Q_red.learning_rate": 0.2} in points
    assert len(set(labels_of(swept, "Q_full"))) == 4


def test_axis_of_a_member_touches_the_vote(small: Path) -> None:
    """What its members are is part of a learner, and of every arm that holds it."""
    vote = ("learners.V={type: voting, members: [Q_red]}", "arms.V={learners: [V]}", "arms.Q={learners: [Q_full]}")
    swept = load_experiment(str(small), [*vote, "sweep={rate: {learners.Q_red.learning_rate: [0.1, 0.2]}}"])
    assert labels_of(swept, "V") == ["rate=0.1", "rate=0.2"]
    assert labels_of(swept, "Q") == [""]
    (first, second) = Plan.of(swept).only(["V"]).shards(num_cpus=1, shard_size=100)
    for shard, rate in ((first, 0.1), (second, 0.2)):
        for run in shard.runs:
            (config,) = run.learners
            (member,) = config.members
            assert member.options == {"learning_rate": rate}
            assert member.representation.exclude == (run.variables["dropped"],)


def test_sweep_points_are_paired(small: Path) -> None:
    """Run i has the same seed, environment and variables at every sweep point."""
    swept = load_experiment(
        str(small), ["sweep={arms.APEL.selector.decay: [0.1, 0.2], learners.Q_red.discount: [1, 0.9]}"]
    )
    shards = Plan.of(swept).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    assert len(shards) == 4
    for runs in zip(*(shard.runs for shard in shards), strict=True):
        assert len({(run.index, run.seed, repr(run.environment), repr(run.variables)) for run in runs}) == 1


def test_counted_learners_are_told_apart() -> None:
    """{Q_full: 2, Q_red: 1} are three learners with names of their own, in the order of the file."""
    counted = experiment(("APEL: {learners: [Q_full, Q_red]", "APEL: {learners: {Q_red: 1, Q_full: 2}"))
    (shard,) = Plan.of(counted).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    assert shard.arm.learner_names == ("Q_red", "Q_full#0", "Q_full#1")
    assert [len(learner.representation.exclude) for learner in shard.runs[0].learners] == [1, 0, 0]


def test_no_two_shards_share_a_key(small: Path) -> None:
    """Arm, sweep point and first run tell all shards apart, over axes of every kind."""
    axes = "{n: {arms.APEL.learners: [{Q_full: 1, Q_red: 1}, {Q_full: 3, Q_red: 1}]}, episodes: [20, 30]}"
    swept = load_experiment(str(small), [f"sweep={axes}"])
    shards = Plan.of(swept).shards(num_cpus=1, shard_size=2)
    assert len({shard.key for shard in shards}) == len(shards) == 3 * (2 * 2 + 2 + 2)


def test_sweep_point_that_is_no_experiment_is_named(small: Path) -> None:
    """A combination of values that cannot be says which it is."""
    swept = load_experiment(str(small), ["sweep={steady_state_episodes: [10, 60], episodes: [50, 70]}"])
    with pytest.raises(SpecError, match=r"sweep point steady_state_episodes=60, episodes=50: steady_state_episodes: "):
        Plan.of(swept)


def test_an_option_that_run_seed_sets_has_no_other_value(small: Path) -> None:
    """In the file, by an override and at a sweep point: it would be heeded nowhere."""
    told = r"environment\.run_seed: found 'maze_seed', which options sets too, expected one of them"
    with pytest.raises(SpecError, match=f"small\\.yaml:.*: {told}"):
        load_experiment(str(small), ["environment.options.maze_seed=7"])
    swept = load_experiment(str(small), ["sweep={environment.options.maze_seed: [1, 2]}"])
    with pytest.raises(SpecError, match=f"sweep point environment.options.maze_seed=1: {told}"):
        Plan.of(swept)
    load_experiment(str(small), ["environment.options.maze_seed=7", "environment.run_seed=null"])


def test_unknown_arm_is_refused(small: Path) -> None:
    """A plan of some arms has these, in the order of the file; one that is not there is refused by its name."""
    plan = Plan.of(load_experiment(str(small)))
    assert [one.arm for one in plan.only(["SSBAS", "Q_full"]).arm_points] == ["Q_full", "SSBAS"]
    with pytest.raises(SpecError, match="--arms: found 'Best', expected some of Q_full, APEL, SSBAS"):
        plan.only(["APEL", "Best"])


def test_sizes_of_a_plan(small: Path) -> None:
    """By hand, of 6 runs: Q_full plays 6 · (5 + 7) episodes, APEL and SSBAS as many, each of two learners."""
    plan = Plan.of(load_experiment(str(small), ["sweep={episodes: [5, 7]}"]))
    assert plan.num_episodes == 6 * 12 * 3
    assert plan.num_learner_episodes == 6 * 12 * (1 + 2 + 2)
    assert plan.selectors == {"fixed", "apel", "ssbas"}


def test_plan_is_made_once(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever works on an experiment gets the plan: nothing works it out a second time."""
    made = []

    def counted(experiment: Experiment) -> tuple[ArmPoint, ...]:
        made.append(experiment.name)
        return arm_points(experiment)

    monkeypatch.setattr("jobs.experiment.plan.arm_points", counted)
    swept = load_experiment(str(small), ["sweep={episodes: [5, 7]}", "hindsight={Best: [Q_full, APEL]}"])
    outcome = run_experiment(swept, Settings(results=str(tmp_path), placement="local"))
    assert outcome.num_computed == 36
    assert made == ["small-maze"]
