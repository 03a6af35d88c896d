"""The same rows from an experiment with all that the tabular experiments use: votes, Dyna-Q, policies frozen as by
ESBAS, greedy evaluation after a switch, steady states, counted learners, an axis of one arm, and an oracle.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.losing import assert_goes_on
from tests.same_rows import assert_same, episode_rows, play, run_rows

MIXED = """
name: mixed-maze
runs: 4
episodes: 26
environment:
  id: apel/Maze-v0
  run_seed: maze_seed
  options: {size: 4, distractors: [3], max_steps: 60}
variables:
  dropped: [x, y, distractor]
learners:
  Q: {type: q_learning, exploration: {before: 0.5, episode: 6, after: 0.05}}
  Dyna: {type: dyna_q, planning_steps: 4, representation: {exclude: [$dropped]}, tie_breaking: first}
  Generic: {type: "apel.learners.tabular.dyna_q:DynaQ", planning_steps: 2}
  Vote: {type: voting, method: boltzmann_addition, temperature: 0.4, members: [Q, Dyna]}
arms:
  Q: {learners: [Q]}
  Dyna: {learners: [Dyna]}
  Vote: {learners: [Vote]}
  Frozen: {learners: {Q: 2, Vote: 1}, selector: {type: "tests.apel.freezing:FreezingApel", decay: 0.1}}
  Mixed: {learners: [Generic, Vote, Dyna], selector: {type: apel}}
criterion:
  measure: length
  window: 3
  after: 6
  evaluation: greedy
  below: {factor: 1.5, info: optimal_length, plus: 1}
stop_when_met: false
steady_state_episodes: 7
sweep:
  nu: {arms.Frozen.selector.decay: [0.0, 0.3], arms.Frozen.selector.prior: [[1, 1, 1], [1, 2, 4]]}
hindsight:
  Best: [Vote, Dyna]
record: all
"""


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of the experiment."""
    path = tmp_path_factory.mktemp("mixed") / "mixed.yaml"
    path.write_text(MIXED)
    return path


@pytest.fixture(scope="module")
def reference(mixed: Path) -> Path:
    """All runs of an arm in one shard, in this process."""
    return play(mixed, mixed.parent / "reference", placement="local", shard_size=100)


@pytest.mark.parametrize(("shard_size", "streak"), [(1, 50), (100, 1), (3, 4)])
def test_shards_and_streaks_change_no_row(
    mixed: Path, reference: Path, tmp_path: Path, shard_size: int, streak: int
) -> None:
    """However runs are cut into shards, and streaks into rounds."""
    execution = Execution(streak_episodes=streak)
    folder = play(mixed, tmp_path / "cut", placement="local", shard_size=shard_size, execution=execution)
    assert_same(reference, folder)


@pytest.mark.ray
@pytest.mark.parametrize(
    ("placement", "shard_size", "streak", "arms"),
    [("actors", 3, 1, ("Frozen", "Mixed")), ("packed", 1, 50, ())],
)
def test_placement_changes_no_row(
    ray_session: None,
    mixed: Path,
    reference: Path,
    tmp_path: Path,
    placement: str,
    shard_size: int,
    streak: int,
    arms: tuple[str, ...],
) -> None:
    """Ray actors give the rows that this process gives."""
    execution = Execution(streak_episodes=streak)
    how = {"placement": placement, "shard_size": shard_size, "execution": execution}
    assert_same(reference, play(mixed, tmp_path / "ray", arms=arms or None, **how), *arms)


@pytest.mark.parametrize("arm", ["Vote", "Frozen", "Mixed"])
@pytest.mark.parametrize("rounds", [1, 5, 13])
def test_goes_on_from_the_checkpoint(mixed: Path, arm: str, rounds: int) -> None:
    """A shard that is lost in mid-epoch ends with the rows, train times and steady states of an undisturbed one."""
    shard = Plan.of(load_experiment(str(mixed), ["runs=2"])).only([arm]).shards(num_cpus=1, shard_size=100)[-1]
    assert_goes_on(shard, rounds)


def test_columns_follow_from_the_rows(reference: Path) -> None:
    """The steady state is the mean of the last returns, the adaptation time the train time from the switch on."""
    runs, episodes = run_rows(reference), episode_rows(reference)
    played = runs[runs["arm"] != "Best"]
    assert len(played) == 4 * (3 + 2 + 1)
    for row in played.itertuples():
        mine = (
            (episodes["arm"] == row.arm) & (episodes["sweep"] == row.sweep) & (episodes["run_index"] == row.run_index)
        )
        rows = episodes[mine]
        total = 0.0
        for one in rows["return"].tolist()[-7:]:
            total += one
        assert len(rows) == row.episodes == 26
        assert row.steady_state == total / 7
        assert row.steps == rows["length"].sum()
    assert (played["adaptation_time"] == played["train_time"] - 6).all()
    assert (played["train_time"] >= 6 + 3).all()
    assert played["censored"].nunique() == 2
    assert (played.loc[played["censored"], "train_time"] == 26).all()


def test_stopped_runs_have_no_steady_state(mixed: Path, tmp_path: Path) -> None:
    """A run that stops early was never in its last episodes; one that meets its criterion at the cap was."""
    stopped = run_rows(play(mixed, tmp_path, "stop_when_met=true", placement="local"))
    assert stopped["steady_state"].isna().equals(stopped["episodes"] < 26)
    assert stopped["steady_state"].isna().nunique() == 2
    assert (stopped["episodes"] == stopped["train_time"]).all()


def test_evaluation_changes_no_training_row(mixed: Path, reference: Path, tmp_path: Path) -> None:
    """A greedy criterion decides only when a run counts as trained; without any the episodes are the same."""
    for number, override in enumerate(("criterion=null", "criterion.evaluation=training")):
        folder = play(mixed, tmp_path / str(number), override, placement="local")
        pd.testing.assert_frame_equal(episode_rows(folder), episode_rows(reference), check_exact=True)
        assert not run_rows(folder)["train_time"].equals(run_rows(reference)["train_time"])
        assert run_rows(folder)["steady_state"].equals(run_rows(reference)["steady_state"])


def test_axis_of_one_arm(reference: Path) -> None:
    """The axis labels the arm that it touches, and is a column; all sweep points share mazes, seeds and variables."""
    runs = run_rows(reference)
    swept = runs[runs["arm"] == "Frozen"]
    assert set(zip(swept["sweep"], swept["nu"], strict=True)) == {("nu=0.0", 0.0), ("nu=0.3", 0.3)}
    others = runs[runs["arm"] != "Frozen"]
    assert (others["sweep"] == "").all()
    assert others["nu"].isna().all()
    for _, same_run in runs.groupby("run_index"):
        for column in ("seed", "dropped", "optimal_length"):
            assert same_run[column].nunique() == 1
    episodes = episode_rows(reference)
    frozen = episodes[(episodes["arm"] == "Frozen") & (episodes["episode"] == 0)]
    priors = {"nu=0.0": (1.0, 1.0, 1.0), "nu=0.3": (1.0, 2.0, 4.0)}
    assert all(row.concentration == priors[row.sweep] for row in frozen.itertuples())


def test_oracle_is_the_best_row_of_each_run(reference: Path) -> None:
    """Each row of the oracle is one of its arms' rows under another name, none is worse than the other arm's."""
    runs = run_rows(reference)
    best = runs[runs["arm"] == "Best"].set_index("run_index")
    assert sorted(best.index) == [0, 1, 2, 3]
    sources = {arm: runs[runs["arm"] == arm].set_index("run_index") for arm in ("Vote", "Dyna")}
    for index, row in best.iterrows():
        taken = sources[row["chosen"]].loc[index]
        columns = [name for name in best.columns if name not in ("arm", "chosen")]
        assert row[columns].equals(taken[columns])
        keys = [(one.loc[index, "train_time"], -one.loc[index, "steady_state"]) for one in sources.values()]
        assert (row["train_time"], -row["steady_state"]) == min(keys)
    assert runs.loc[runs["arm"] != "Best", "chosen"].isna().all()


def test_oracle_changes_nothing_else(mixed: Path, reference: Path, tmp_path: Path) -> None:
    """Without the oracle all other rows are the same."""
    runs = run_rows(reference)
    without = run_rows(play(mixed, tmp_path / "without", "hindsight={}", placement="local"))
    others = runs[runs["arm"] != "Best"].drop(columns="chosen").reset_index(drop=True)
    pd.testing.assert_frame_equal(others, without, check_exact=True)


def test_resumed_job_has_the_same_oracle(mixed: Path, reference: Path, tmp_path: Path) -> None:
    """Arm by arm and run by run: the oracle counts the runs that all its arms have finished."""
    first = run_rows(play(mixed, tmp_path / "resumed", "runs=2", placement="local", arms=("Vote", "Q")))
    assert "Best" not in set(first["arm"])
    second = run_rows(play(mixed, tmp_path / "resumed", "runs=3", placement="local", arms=("Dyna",)))
    assert second.loc[second["arm"] == "Best", "run_index"].tolist() == [0, 1]
    assert_same(reference, play(mixed, tmp_path / "resumed", placement="local"))
    stored = pd.read_parquet(next((tmp_path / "resumed").rglob("runs.parquet")))
    pd.testing.assert_frame_equal(stored, pd.read_parquet(reference / "runs.parquet"))
