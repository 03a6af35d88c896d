"""What users' code does that no program should, and what becomes of it: a story, and nothing that is lost."""

from __future__ import annotations

import io
import json
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from apel.run.user_code import faults_of, in_a_line, is_interruption
from tests.command_line import call

QUITS = """
import sys
import gymnasium

class Quits(gymnasium.Env):
    observation_space = gymnasium.spaces.Discrete(3)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, how="sys.exit()", chance=0.1):
        self.how, self.chance = how, chance

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        if self.np_random.random() < self.chance:
            exec(self.how)
        return 1, 1.0, True, False, {}
"""
LEARNER = """
import sys
from apel.learners import QLearning

class Bye(QLearning):
    ended, when, seeds = 0, "end_episode", []

    def __init__(self, observation_space, action_space, seed, when="end_episode"):
        super().__init__(observation_space, action_space, seed)
        self.when = when
        Bye.seeds += [seed] if seed not in Bye.seeds else []
        if when == "init" and seed != Bye.seeds[0]:
            sys.exit("no more of them")

    def end_episode(self):
        super().end_episode()
        self.ended += 1
        if self.when == "end_episode" and self.ended == 3:
            sys.exit("bye")

    def state(self):
        if self.when == "state" and self.ended > 0:
            sys.exit("nothing to keep")
        return super().state()

def measure(trajectory):
    return sys.exit("immeasurable") if len(trajectory) else 0.0

class Rule:
    fields = {}

    def select(self, state, rng):
        return 0

    def observe(self, state, selected, performance):
        raise SystemExit(3)
"""
SPEC = """
name: quits
runs: 3
episodes: 50
environment: {id: "MODULE:Quits", options: {how: HOW, chance: CHANCE}}
learners:
  A: {type: q_learning}
  B: {type: q_learning}
arms:
  both: {learners: [A, B], selector: {type: uniform}}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of a user's, in which commands are called; its modules are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    before, path = set(sys.modules), list(sys.path)
    yield tmp_path
    sys.path[:] = path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def write(folder: Path, spec: str = SPEC, *, how: str = "sys.exit()", chance: float = 0.1, **modules: str) -> None:
    for name, text in ({"quits": QUITS} | modules).items():
        (folder / f"{name}.py").write_text(text)
    text = spec.replace("MODULE", "quits").replace("HOW", json.dumps(how)).replace("CHANCE", str(chance))
    (folder / "spec.yaml").write_text(text)


def run(capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str]:
    return call(capsys, "run", "spec.yaml", "--placement", "local", "--quiet", *options)


def story(folder: Path, name: str = "quits") -> tuple[list[dict[str, object]], str]:
    """What failures/ says: the runs, and all its texts."""
    places = list(folder.glob(f"results/{name}/*/failures"))
    assert len(places) == 1
    texts = "\n".join(file.read_text() for file in sorted(places[0].glob("*.txt")))
    return json.loads((places[0] / "index.json").read_text()), texts


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ("sys.exit()", "SystemExit at"),
        ("sys.exit('no window')", "SystemExit: no window"),
        ("raise KeyboardInterrupt", "KeyboardInterrupt at"),
        ("raise GeneratorExit('gone')", "GeneratorExit: gone"),
        ("import asyncio; raise asyncio.CancelledError", "CancelledError at"),
        ("raise type('Own', (BaseException,), {})(4)", "Own: 4"),
        ("raise MemoryError", "MemoryError at"),
    ],
)
def test_environment_that_ends_the_program(
    folder: Path, capsys: pytest.CaptureFixture[str], how: str, told: str
) -> None:
    """Whatever it raises, `SystemExit` and its like too, is a failed run with its story: what, where, seed, episode."""
    write(folder, how=how)
    code, error = run(capsys)
    assert code == 1
    assert told in error
    assert "3 run(s) failed" in error
    assert "(run 0), learner" in error
    assert f"in the environment: {folder}/quits.py" in error or "in the environment: <string>" in error
    runs, texts = story(folder)
    assert [one["run_index"] for one in runs] == [0, 1, 2]
    assert {one["part"] for one in runs} == {"environment"}
    assert f'File "{folder}/quits.py", line 18, in step' in texts
    assert "apel/learners" not in texts


def test_rows_of_other_runs_are_kept(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run that ends in the middle takes none of the others with it."""
    write(folder, chance=0.02)
    code, error = run(capsys, "--runs", "8")
    kept = pq.read_table(next(folder.glob("results/quits/*/runs.parquet")))
    assert code == 1
    assert 0 < kept.num_rows < 8
    assert f"{8 - kept.num_rows} run(s) failed" in error


@pytest.mark.parametrize(
    ("field", "value", "part", "told"),
    [
        ("learners.A", "{type: 'bye:Bye'}", "learner", "SystemExit: bye"),
        ("learners.A", "{type: 'bye:Bye', when: state}", "learner", "SystemExit: nothing to keep"),
        ("performance", "'bye:measure'", "performance", "SystemExit: immeasurable"),
        ("arms.both.selector", "{type: 'bye:Rule'}", "selector", "SystemExit: 3"),
    ],
)
def test_other_parts_that_end_the_program(
    folder: Path, capsys: pytest.CaptureFixture[str], field: str, value: str, part: str, told: str
) -> None:
    """Learners, measures and selectors likewise; the story says which part it was."""
    write(folder, chance=0.0, bye=LEARNER)
    code, error = run(capsys, "--set", f"{field}={value}", "--checkpoint-seconds", "0", "--checkpoint-episodes", "1")
    assert code == 1
    assert told in error
    runs, texts = story(folder)
    assert {one["part"] for one in runs} == {part}
    assert f'File "{folder}/bye.py"' in texts


def test_learner_that_cannot_be_made_for_some_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Runs whose learners cannot be made fail alone, at once; the others are played."""
    write(folder, chance=0.0, bye=LEARNER)
    code, error = run(capsys, "--set", "learners.A={type: 'bye:Bye', when: init}", "--set", "arms.both={learners: [A]}")
    assert code == 1
    assert "2 run(s) failed: SystemExit: no more of them at seed" in error
    assert pq.read_table(next(folder.glob("results/quits/*/runs.parquet"))).num_rows == 1


@pytest.mark.parametrize(
    "text", ["import sys\nsys.exit(0)\n", "import sys\nsys.exit('later')\n", "raise KeyboardInterrupt\n", "1 / 0\n"]
)
@pytest.mark.parametrize("field", ["environment.id", "learners.A.type", "performance", "arms.both.selector.type"])
def test_module_that_exits_where_it_is_imported(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, field: str
) -> None:
    """That is bad input, whoever names the module: one message, exit code 2, nothing stored."""
    write(folder, leaves=text)
    code, error = run(capsys, "--set", f"{field}=leaves:Thing")
    assert code == 2
    assert "importing 'leaves' failed" in error
    assert len(error.splitlines()) == 1
    assert not (folder / "results").exists()


def test_tracebacks_of_users_code(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The message shows file, line and function of the user's code, and its text; the rest lies in failures/."""
    broken = (Path(__file__).parent.parent / "cases" / "learner-raises" / "broken.py").read_text()
    spec = (Path(__file__).parent.parent / "cases" / "learner-raises" / "broken.yaml").read_text()
    write(folder, spec, broken=broken)
    code, error = run(capsys)
    assert code == 1
    place = f'{folder}/broken.py:21, in _helper: return target["missing_key"]'
    assert f"in the learner: {place}" in error
    assert "2 run(s) failed: KeyError: 'missing_key' at seed" in error
    assert "full tracebacks: " in error
    runs, texts = story(folder, "broken")
    assert len(runs) == 2
    assert texts.count("Traceback (most recent call last)") == 1  # of the first one of this kind
    assert "line 17, in learn" in texts


def test_failures_are_of_the_last_session(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What failed and was mended leaves no story behind."""
    write(folder)
    assert run(capsys, "--set", "environment.options.chance=0.1")[0] == 1
    place = next(folder.glob("results/quits/*"))
    assert (place / "failures" / "index.json").exists()
    quits = QUITS.replace("exec(self.how)", "pass")
    (folder / "quits.py").write_text(quits)
    del sys.modules["quits"]
    assert run(capsys)[0] == 0
    mended = [one for one in folder.glob("results/quits/*") if one != place]
    assert len(mended) == 1
    assert not (mended[0] / "failures").exists()


def test_debugger(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """``--debug`` plays the first failing run here, and leaves a debugger in the user's line."""
    write(folder)
    monkeypatch.setattr(sys, "stdin", io.StringIO("p self.how\nq\n"))
    code, error = call(capsys, "run", "spec.yaml", "--debug", "--set", "environment.options.how=1 / 0")
    assert code == 1
    assert "ZeroDivisionError: division by zero; here is Python's debugger" in error
    assert not (folder / "results").exists()
    code, error = call(capsys, "run", "spec.yaml", "--debug", "--log", "tensorboard")
    assert (code, "--log: found 'tensorboard' with --debug" in error) == (2, True)


def test_our_own_interruption_goes_through() -> None:
    """A signal's handler raises for the user who sent it: no run fails of that."""

    def handle(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, handle)
    try:
        with pytest.raises(KeyboardInterrupt) as caught, faults_of("learner"):
            signal.raise_signal(signal.SIGTERM)
        assert is_interruption(caught.value)
    finally:
        signal.signal(signal.SIGTERM, before)


def test_errors_in_a_line() -> None:
    """Of an error without a message its name is told, and one whose message fails is told of nevertheless."""

    class MuteError(Exception):
        def __str__(self) -> str:
            raise OSError

    assert in_a_line(SystemExit()) == "SystemExit"
    assert in_a_line(SystemExit(3)) == "SystemExit: 3"
    assert in_a_line(MuteError()) == "MuteError: (its message cannot be had: OSError)"
