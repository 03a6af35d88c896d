"""From an experiment to shards: nothing is lost, nothing is played twice."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from jobs.plan import all_run_keys, arm_points, default_shard_size, draw_variables, plan_shards
from jobs.spec import Experiment, load_experiment, validate
from jobs.yaml_source import parse
from tests.conftest import SMALL


def experiment(*changes: tuple[str, str]) -> Experiment:
    """The small experiment with some text replaced."""
    text = SMALL
    for old, new in changes:
        text = text.replace(old, new)
    return validate(parse(text, "small.yaml"))


@given(runs=st.integers(1, 40), size=st.none() | st.integers(1, 50), cpus=st.integers(1, 9), data=st.data())
def test_every_missing_run_is_in_one_shard(runs: int, size: int | None, cpus: int, data: st.DataObject) -> None:
    """The shards hold each run that is not finished exactly once, cut at multiples of the shard size."""
    small = experiment(("runs: 6", f"runs: {runs}"))
    keys = list(all_run_keys(small, None))
    finished = data.draw(st.sets(st.sampled_from(keys)))
    shards = plan_shards(small, size, None, finished, cpus)
    planned = [(shard.arm.arm, shard.arm.sweep, run.index) for shard in shards for run in shard.runs]
    assert len(planned) == len(set(planned))
    assert set(planned) == set(keys) - finished
    for shard in shards:
        if size is not None:
            assert len({run.index // size for run in shard.runs}) == 1


@given(runs=st.integers(1, 2000), cpus=st.integers(1, 256), learners=st.integers(1, 5), ensembles=st.integers(1, 30))
def test_default_shard_size_is_sensible(runs: int, cpus: int, learners: int, ensembles: int) -> None:
    """A shard has from 1 to 100 runs, and a learner alone gives every CPU something to do."""
    size = default_shard_size(runs, cpus, learners, ensembles)
    assert 1 <= size <= 100
    if learners == 1:
        assert -(-runs // size) >= min(cpus, runs)


def test_arms_share_what_is_drawn_for_a_run() -> None:
    """In each run all arms see the same seed, environment and variables; runs differ."""
    shards = plan_shards(experiment(), 100, None, set(), 1)
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
    (shard,) = plan_shards(copies, 100, ["APEL"], set(), 1)
    assert shard.arm.learner_names == ("Q_full#0", "Q_red", "Q_full#1")


def test_sweep_is_a_grid(small: Path) -> None:
    """Every combination of the swept values is a point, with a label; an arm has those of the axes that touch it."""
    swept = load_experiment(str(small), ["sweep={episodes: [5, 6], arms.APEL.selector.decay: [0.1, 0.2]}"])
    points = arm_points(swept, None)
    assert [point.label for point, arm in points if arm == "Q_full"] == ["episodes=5", "episodes=6"]
    assert [point.label for point, arm in points if arm == "APEL"] == [
        "episodes=5, arms.APEL.selector.decay=0.1",
        "episodes=5, arms.APEL.selector.decay=0.2",
        "episodes=6, arms.APEL.selector.decay=0.1",
        "episodes=6, arms.APEL.selector.decay=0.2",
    ]


def test_named_axis_sets_several_fields(small: Path) -> None:
    """The values of a named axis go together; its name is the label, and a column of the run rows."""
    axis = "{cap: {episodes: [5, 6], arms.APEL.selector.decay: [0.1, 0.2]}}"
    swept = load_experiment(str(small), [f"sweep={axis}", "arms.APEL.learners={Q_full: 2, Q_red: 1}"])
    points = [point for point, arm in arm_points(swept, ["APEL"])]
    assert [(point.label, point.values) for point in points] == [("cap=5", {"cap": 5}), ("cap=6", {"cap": 6})]
    assert [point.experiment.episodes for point in points] == [5, 6]
    selectors = [point.experiment.arms["APEL"].selector for point in points]
    assert [selector.options["decay"] for selector in selectors if selector] == [0.1, 0.2]
    assert points[0].experiment.arms["APEL"].learner_names == ["Q_full", "Q_full", "Q_red"]


def test_axis_that_does_not_touch_an_arm_is_not_its(small: Path) -> None:
    """An arm is played once, not once for every value that makes no difference to it."""
    swept = load_experiment(str(small), ["sweep={nu: {arms.APEL.selector.decay: [0.1, 0.2, 0.3]}}"])
    assert [point.label for point, arm in arm_points(swept, ["SSBAS"])] == [""]
    assert len(arm_points(swept, None)) == 1 + 3 + 1
