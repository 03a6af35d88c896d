"""Bad input ends in one clear message, the right exit code and no traceback, before Ray starts, and costs no result."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.command_line import call, printed
from tests.experiments import SMALL


@pytest.fixture(autouse=True)
def _no_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is refused here is refused before Ray is so much as imported."""
    monkeypatch.setitem(sys.modules, "cluster.launch", None)


BAD_FIELDS = {
    "learns_from": ("learners.Q_full.learns_from=mine", "learns_from: found 'mine', expected 'all' or 'own', or a map"),
    "a share of nothing": ("learners.Q_full.learns_from={own_share: 0}", "own_share: found 0, expected greater than 0"),
    "a share above 1": ("learners.Q_full.learns_from={own_share: 1.1}", "own_share: found 1.1, expected less than or"),
    "a share in words": ("learners.Q_full.learns_from={own_share: half}", "own_share: found 'half', expected a number"),
    "a share that is a truth": ("learners.Q_full.learns_from={own_share: true}", "found True, expected a number"),
    "a share by another name": ("learners.Q_full.learns_from={own: 0.5}", "learns_from.own: found a field that does"),
    "a share without a number": ("learners.Q_full.learns_from={}", "own_share: found nothing, expected this field"),
    "a share without a memory": (
        "learners.Q_full.learns_from={own_share: 0.5}",
        "q_learning: learns_from: found own_share, expected 'all' or 'own', or a learner that draws from a replay",
    ),
    "a floor for too many": (
        "arms.APEL.selector.acting_floor={steps: 0.6}",
        "arms.APEL.selector: acting_floor: found 0.6 of the steps for each of 2 learners, expected at most 0.5",
    ),
    "a floor that is a truth": (
        "arms.APEL.selector.acting_floor={steps: true}",
        "steps: found True, expected a number",
    ),
    "a floor that was": ("arms.APEL.selector.acting_floor={steps: 0.1, after: -1}", "after: found -1, expected"),
    "a floor of nothing": ("arms.APEL.selector.acting_floor={steps: 0}", "acting_floor"),
    "a floor of episodes": ("arms.APEL.selector.acting_floor={episodes: 0.1}", "acting_floor"),
    "unknown field": ("episodse=3", "episodse: found a field that does not exist here"),
    "unknown field, nested": ("environment.idd=x", "environment.idd: found a field that does not exist here"),
    "wrong type": ("episodes=many", "episodes: found 'many'"),
    "fraction for a count": ("runs=1.5", "runs: found 1.5"),
    "no runs": ("runs=0", "runs: found 0, expected greater than or equal to 1"),
    "negative seed": ("seed=-1", "seed: found -1"),
    "decay of 1": ("arms.APEL.selector.decay=1.0", "decay: found 1.0, expected less than 1"),
    "decay below 0": ("arms.APEL.selector.decay=-0.1", "decay: found -0.1"),
    "decay no number": ("arms.APEL.selector.decay=.nan", "decay: found nan"),
    "selector option unknown": ("arms.APEL.selector.nu=0.1", "found the option 'nu', which it does not have"),
    "no such selector": ("arms.APEL.selector.type=best", "found the selector 'best', expected one of"),
    "prior too short": ("arms.APEL.selector.prior=[1.0]", "found 1 concentrations, expected one per learner, 2"),
    "no such learner": ("arms.APEL.learners=[Q_full, Q_none]", "found 'Q_none', expected one of"),
    "no learner": ("arms.APEL.learners=[]", "arms.APEL.learners: found []"),
    "no arm": ("arms={}", "arms: found {}"),
    "several learners, no selector": ("arms.Q_full.learners=[Q_full, Q_red]", "found 2 learners and no selector"),
    "no such learner type": ("learners.Q_full.type=sarsa", "found the learner 'sarsa', expected one of"),
    "learning rate": ("learners.Q_full.learning_rate=0", "learning_rate: found 0, expected greater than 0"),
    "discount above 1": ("learners.Q_full.discount=1.01", "discount: found 1.01, expected less than or equal to 1"),
    "learner option unknown": ("learners.Q_full.gamma=1", "found the option 'gamma', which it does not have"),
    "feature unknown": ("learners.Q_red.representation.exclude=[z]", "found 'z', expected one of ['x', 'y'"),
    "no feature left": ("learners.Q_red.representation.exclude=[x, y, 2]", "expected at least one of"),
    "variable unknown": ("learners.Q_red.representation.exclude=[$lost]", "found '$lost', expected one of"),
    "a later run's draw is bad": ("variables.dropped=[x, z]", "found 'z', expected one of"),
    "variable without values": ("variables.dropped=[]", "variables.dropped: found []"),
    "import path, no module": ("learners.Q_full.type=nowhere.at:All", "importing 'nowhere.at' failed"),
    "import path, no name": ("learners.Q_full.type=tests.user_code:None_", "has no 'None_'"),
    "import path, no learner": ("learners.Q_full.type=tests.user_code:NOT_A_LEARNER", "not callable"),
    "not off-policy": ("learners.Q_full.type=tests.user_code:OnPolicy", "is not off-policy"),
    "no such environment": (
        "environment.id=Maze-v9",
        "Environment `Maze` doesn't exist. An id of another package has its module in front, module:Maze-v9",
    ),
    "environment option": ("environment.options.width=3", "unexpected keyword argument 'width'"),
    "impossible length": ("environment.options.optimal_length=[1, 2]", "none of 10000 mazes"),
    "length range reversed": ("environment.options.optimal_length=[9, 3]", "expected a number of moves or"),
    "box actions": ("environment={id: Pendulum-v1}", "expected Discrete, or another learner, such as stable_baselines"),
    "box observations for a table": ("environment={id: CartPole-v1}", "found the observation space Box"),
    "no limit to an episode": ("environment={id: CliffWalking-v1}", "give max_episode_steps"),
    "no such measure": ("performance=profit", "found the performance measure 'profit'"),
    "criterion without bound": ("criterion={measure: length, window: 5}", "expected exactly one"),
    "criterion with both": ("criterion={measure: length, window: 5, below: 3, at_least: 2}", "expected exactly one"),
    "criterion of what is not reported": ("criterion.below.info=best", "found 'best', expected one of those"),
    "window of 0": ("criterion.window=0", "criterion.window: found 0"),
    "window after the end": (
        "criterion.after=71",
        "criterion: found 80 episodes, expected at least 81: a window of 10 after episode 71",
    ),
    "negative switch": ("criterion.after=-1", "criterion.after: found -1"),
    "evaluation": ("criterion.evaluation=often", "criterion.evaluation: found 'often'"),
    "longer steady state than run": (
        "steady_state_episodes=81",
        "steady_state_episodes: found 81, expected at most the 80 episodes of a run",
    ),
    "no learners of a kind": ("arms.APEL.learners={Q_full: 0, Q_red: 1}", "arms.APEL.learners.Q_full: found 0"),
    "counted learner unknown": ("arms.APEL.learners={Q_none: 2}", "arms.APEL.learners: found 'Q_none', expected one"),
    "counted learners, no selector": ("arms.Q_full.learners={Q_full: 2}", "found 2 learners and no selector"),
    "members of one that has none": (
        "learners.Q_full.members=[Q_red]",
        "learners.Q_full: q_learning: found the option 'members', which it does not have",
    ),
    "vote of nobody": ("learners.Q_full={type: voting}", "learners.Q_full: voting: expected members"),
    "vote with a view": (
        "learners.Q_full={type: voting, members: [Q_red], representation: {exclude: [x]}}",
        "learners.Q_full: voting: expected members, each with a representation of its own",
    ),
    "no such vote": (
        "learners.Q_full={type: voting, members: [Q_red], method: acclamation}",
        "learners.Q_full: voting: method: found 'acclamation'",
    ),
    "hindsight of an unknown arm": ("hindsight={Best: [Q_full, UCB]}", "hindsight.Best: found 'UCB', expected one of"),
    "hindsight of nobody": ("hindsight={Best: []}", "hindsight.Best: found []"),
    "hindsight under a played name": ("hindsight={APEL: [Q_full]}", "hindsight.APEL: found the name of an arm that is"),
    "record": ("record=some", "record: found 'some', expected 'all', 'log' or 'none'"),
    "record every 0": ("record={every: 0}", "record.every: found 0"),
    "sweep over nothing": ("sweep={episodes: []}", "sweep.episodes: found []"),
    "sweep over nothing, named": ("sweep={cap: {episodes: []}}", "sweep: cap: found [0] values, expected equally many"),
    "sweep of unequal lists": (
        "sweep={cap: {episodes: [5, 6], arms.APEL.selector.decay: [0.1]}}",
        "sweep: cap: found [2, 1] values, expected equally many",
    ),
    "sweep of a value twice": ("sweep={episodes: [5, 6, 5]}", "expected the values of its first path to differ"),
    "sweep with a label twice": (
        "sweep={cap: {episodes: [5, 5], arms.APEL.selector.decay: [0.1, 0.2]}}",
        "sweep: cap: found ['5', '5'] as labels, expected the values of its first path to differ",
    ),
    "sweep of a bad value": ("sweep={episodes: [10, -1]}", "episodes: found -1"),
    "sweep of runs": ("sweep={runs: [1, 2]}", "expected a field that may differ between sweep points"),
    "path through a number": ("episodes.first=3", "expected a mapping"),
    "no value": ("episodes", "expected path=value"),
}


@pytest.mark.parametrize("name", BAD_FIELDS)
def test_bad_field(name: str, small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A field with a bad value is refused with what was found and what was expected, and nothing is written."""
    override, expected = BAD_FIELDS[name]
    results = tmp_path / "results"
    code, error = call(capsys, "run", str(small), "--results", str(results), "--set", override)
    assert code == 2
    assert error.startswith("error: ")
    assert expected in error
    assert "Traceback" not in error
    assert not results.exists()
    assert call(capsys, "validate", str(small), "--set", override)[0] == 2


BAD_FILES = {
    "no YAML": ("name: [", "found no valid YAML"),
    "a list": ("- name", "expected a mapping"),
    "empty": ("", "expected a mapping"),
    "duplicate arm": (SMALL.replace("  APEL: {", "  Q_full: {"), "arms.Q_full: found twice, expected once"),
    "duplicate learner": (SMALL.replace("  Q_red: {type", "  Q_full: {type"), "learners.Q_full: found twice"),
    "missing field": (SMALL.replace("episodes: 80", ""), "episodes: found nothing, expected this field"),
    "bad name": (SMALL.replace("name: small-maze", "name: ../up"), "name: found '../up'"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that is no experiment is refused, with its name and, where there is one, the line."""
    text, expected = BAD_FILES[name]
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    code, error = call(capsys, "run", str(path), "--results", str(tmp_path / "results"))
    assert code == 2
    assert str(path) in error
    assert expected in error
    assert "Traceback" not in error


def test_line_of_an_error(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An error names the line of the field."""
    small.write_text(SMALL.replace("window: 10", "window: -1"))
    line = 1 + SMALL[: SMALL.index("criterion:")].count("\n")
    code, error = call(capsys, "validate", str(small))
    assert (code, error.split(": ")[1]) == (2, f"{small}:{line}")


def test_option_of_an_error(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An error in what was given on the command line names the option, not a line of the file that is right."""
    code, error = call(capsys, "validate", str(small), "--set", "runs=7", "--set", "criterion.window=-1")
    assert code == 2
    assert error.startswith("error: --set criterion.window=-1: criterion.window: found -1, expected greater than")
    code, error = call(capsys, "validate", str(small), "--set", "criterion.window=[1")
    assert error.startswith("error: --set criterion.window=[1: found no valid YAML: ")


WITH_VOTES = SMALL.replace(
    "arms:",
    "  Vote: {type: voting, members: [Q_full]}\n  Council:\n    type: voting\n    members: [Q_full, Vote]\narms:",
)
AT_FIELDS = {
    "member unknown": (
        SMALL.replace("  Q_full: {type: q_learning}", "  Q_full:\n    type: voting\n    members: [Q_red, Q_none]"),
        "    members: [Q_red, Q_none]",
        "learners.Q_full.members: found 'Q_none', expected one of ['Q_full', 'Q_red']",
    ),
    "member nested": (
        WITH_VOTES,
        "    members: [Q_full, Vote]",
        "learners.Council.members: found 'Vote', expected learners without members",
    ),
    "member itself": (
        SMALL.replace("arms:", "  Vote: {type: voting, members: [Vote]}\narms:"),
        "  Vote: {type",
        "learners.Vote.members: found 'Vote', expected learners without members",
    ),
    "arm unknown": (SMALL + "hindsight:\n  Best: [UCB]\n", "  Best: [UCB]", "hindsight.Best: found 'UCB'"),
    "steady state": (
        SMALL + "steady_state_episodes: 81\n",
        "steady_state_episodes: 81",
        "steady_state_episodes: found 81",
    ),
}


@pytest.mark.parametrize("name", AT_FIELDS)
def test_line_of_a_field_that_does_not_fit_the_others(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An error that takes two fields to make names the line of the one to be changed."""
    text, field, expected = AT_FIELDS[name]
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    line = 1 + text[: text.index(field)].count("\n")
    code, error = call(capsys, "validate", str(path))
    assert code == 2
    assert error.startswith(f"error: {path}:{line}: {expected}")


BAD_CALLS = {
    "no such file": (["run", "nowhere.yaml"], "nowhere.yaml: found no readable file"),
    "no such experiment": (["run", "nothing"], "found the experiment 'nothing', expected a file (*.yaml) or one of"),
    "no such arm": (["run", "distractor-maze", "--arms", "APEL,Best"], "--arms: found 'Best', expected some of"),
    "until what": (["run", "distractor-maze", "--until", "good"], "--until: found 'good', expected decided"),
    "max runs alone": (["run", "distractor-maze", "--max-runs", "9"], "--max-runs: found it alone, expected it with"),
    "error alone": (["run", "distractor-maze", "--error", "0.1"], "--error: found it alone, expected it with --until"),
    "error none": (
        ["run", "distractor-maze", "--until", "decided", "--error", "nan"],
        "--error: found nan, expected a",
    ),
    "runs twice": (
        ["run", "distractor-maze", "--until", "decided", "--max-runs", "9", "--runs", "9"],
        "--max-runs: found it beside --runs",
    ),
    "until with a sweep": (
        ["run", "sensitivity-train-time", "--until", "decided"],
        "found a sweep, expected none with --until",
    ),
    "no such placement": (["run", "distractor-maze", "--placement", "cloud"], "expected actors, packed or local"),
    "shards of nothing": (["run", "distractor-maze", "--shard-size", "0"], "--shard-size"),
    "runs is a word": (["run", "distractor-maze", "--runs", "many"], "--runs"),
    "results that are none": (["show", "nowhere"], "found no runs.parquet"),
    "figures of nothing": (["figures", "nowhere"], "found no runs.parquet"),
}


@pytest.mark.parametrize("name", BAD_CALLS)
def test_bad_call(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A call that makes no sense is refused."""
    monkeypatch.chdir(tmp_path)
    arguments, expected = BAD_CALLS[name]
    code, error = call(capsys, *arguments)
    assert code == 2
    assert expected in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_results_below_a_file(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A results folder that cannot be written to is refused."""
    (tmp_path / "occupied").write_text("a file")
    code, error = call(capsys, "run", str(small), "--results", str(tmp_path / "occupied"))
    assert code == 2
    assert "found a results folder that cannot be written to" in error


def test_read_only_results(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file system that takes no writes, not even the superuser's, is refused: /proc is one."""
    code, error = call(capsys, "run", str(small), "--results", "/proc/results")
    assert code == 2
    assert "cannot be written to" in error


def test_bad_uri(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A results URI of an unknown kind is refused."""
    code, error = call(capsys, "run", str(small), "--results", "nosuch://bucket/results")
    assert code == 2
    assert "nosuch://bucket/results" in error


def test_earlier_results_stay(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A refused call leaves what was computed before as it was."""
    results = tmp_path / "results"
    printed(capsys, "run", str(small), "--placement", "local", "--results", str(results))
    before = {path: path.read_bytes() for path in results.rglob("*") if path.is_file()}
    assert before
    code, _ = call(capsys, "run", str(small), "--results", str(results), "--set", "runs=0", "--fresh")
    assert code == 2
    assert {path: path.read_bytes() for path in results.rglob("*") if path.is_file()} == before


def test_hindsight_of_arms_at_different_sweep_points(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The best of several arms is taken at each sweep point: an axis that only some of them have leaves no pairs."""
    settings = ("sweep={nu: {arms.APEL.selector.decay: [0.1, 0.2]}}", "hindsight={Best: [Q_full, APEL]}")
    code, error = call(capsys, "validate", str(small), "--set", settings[0], "--set", settings[1])
    assert code == 2
    assert "hindsight.Best: found Q_full at 1, APEL at 2 sweep points" in error


MEANT = {
    "criterion.below={factr: 1, info: optimal_length}": "criterion.below.factr: found a field that does "
    "not exist here; did you mean factor?",
    "criterion.measure=lenght": "found 'lenght', expected 'length' or 'return'; did you mean length?",
    "plots=[{kind: bar, name: x}]": "'lines', 'curves'; did you mean bars?",
    "arms.APEL.selector.decy=0.1": "found the option 'decy', which it does not have; did you mean decay?",
    "arms.APEL.selector.type=aple": "did you mean apel?",
    "arms.APEL.learners=[q_ful]": "expected one of ['Q_full', 'Q_red']; did you mean Q_full?",
    "learners.Q_full.type=qlearning": "did you mean q_learning?",
    "learners.Q_full.lerning_rate=0.1": "which it does not have; did you mean learning_rate?",
    "learners.Q_full.exploration={strt: 1, end: 1, steps: 3}": "which it does not have; did you mean start?",
    "learners.Q_full={type: 'tests.user_code:Walker', shar: 1}": "did you mean share?",
    "learners.Q_red.representation={exclud: [x]}": "exclud: found a field that does not exist here; did you mean ex",
    "learners.Q_red.representation.exclude=[distracter]": "did you mean distractor?",
    "learners.Q_red.representation.exclude=[$droped]": "did you mean dropped?",
    "environment.id=apel/Mase-v0": "Did you mean: `Maze`?",
    "environment.options.distractor=[10]": "did you mean distractors?",
    "performance=retrun": "did you mean return?",
    "hindsight={Best: [APLE]}": "did you mean APEL?",
    "criterion.below.info=optimal_lenght": "did you mean optimal_length?",
}


@pytest.mark.parametrize("override", MEANT)
def test_did_you_mean(override: str, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A name that is nearly right is told which one was meant, wherever it stands."""
    code, error = call(capsys, "validate", str(small), "--set", override)
    assert code == 2
    assert MEANT[override] in error


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["validate", "distractor-mase"], "did you mean distractor-maze?"),
        (["run", "distractor-maze", "--arms", "APLE"], "did you mean APEL?"),
        (["run", "distractor-maze", "--placement", "pakced"], "did you mean packed?"),
        (["reproduce", "--scale", "ful"], "did you mean full?"),
        (["figures", "theorie"], "did you mean theory?"),
        (["validat"], "Did you mean 'validate'"),
        (["run", "distractor-maze", "--placment", "local"], "--placement"),
    ],
)  # fmt: skip
def test_did_you_mean_of_commands(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The same of commands, options, and what they are given."""
    code, error = call(capsys, *words)
    assert code == 2
    assert expected in error


SWEPT = "sweep={learners.Q_full.learning_rate: [0.1, 0.2], cap: {episodes: [7, 9], criterion.below.plus: [0.5, 1]}}"
LOST = {
    "the field of an axis": ("learners.Q_full.learning_rate=0.5", "learners.Q_full.learning_rate", "learners.Q_full."),
    "a path of an axis": ("episodes=5", "episodes", "cap"),
    "within it": ("episodes.most=5", "episodes", "cap"),
    "around it": ("criterion.below={factor: 1, info: optimal_length, plus: 3}", "criterion.below.plus", "cap"),
}


@pytest.mark.parametrize("what", LOST)
def test_override_of_what_is_swept(what: str, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every sweep point would set it again: it would change the identity, and no run."""
    override, path, axis = LOST[what]
    start = ["episodes={}"] if what == "within it" else []
    words = [word for one in (*start, SWEPT, override) for word in ("--set", one)]
    code, error = call(capsys, "validate", str(small), *words)
    assert code == 2
    last = error.splitlines()[-1].removeprefix("error: ")
    assert last.startswith(f"--set {override}: found a value of {path}, which the axis '{axis}")
    assert last.endswith("or the sweep itself to be overridden (--set 'sweep={…}')")


@pytest.mark.parametrize(
    "override",
    ["criterion.below.plus=1", "criterion.below={factor: 1, info: optimal_length}", "learners.Q_red.learning_rate=0.5"],
)
def test_override_beside_what_is_swept(override: str, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever no point sets may be overridden, and so may the sweep."""
    swept = "sweep={learners.Q_full.learning_rate: [0.1, 0.2]}"
    printed(capsys, "validate", str(small), "--set", swept, "--set", override)
    printed(capsys, "validate", str(small), "--set", SWEPT, "--set", "sweep={episodes: [3, 4]}")
