"""A first experiment file for an environment: commented, with the learners that come along and suit its spaces."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit

from apel.building import make_world
from apel.building.registry import environment_factory
from apel.configs import EnvironmentConfig
from apel.environments import World, close_environments
from apel.environments.factory import package_wanted
from apel.run.user_code import faults_of, in_a_line
from jobs.experiment.plan import Plan
from jobs.experiment.spec import validate
from jobs.experiment.validation import check
from jobs.experiment.yaml_schema import visible
from jobs.experiment.yaml_source import Source, SpecError, parse

_MAX_STEPS = 500
"""Of an episode, where nothing else limits it."""
_MAX_TEXT = 80  # characters of a space
_MAX_BINNED, _BINS, _FINITE = 3, 10, 1e3
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,79}")
_PLAIN_WORD = re.compile(r"[A-Za-z_][\w./-]*")
_NO_WORDS = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")


@dataclass(frozen=True)
class _Candidate:
    name: str
    fields: dict[str, Any]
    about: str


@dataclass(frozen=True)
class _Budget:
    """What the runs of a kind of learners take: tables are cheap, and perceptrons are compiled."""

    runs: int
    episodes: int
    steps: int


_TABLES, _PERCEPTRONS, _SLOW_NETWORKS = (
    _Budget(20, 1000, 100_000),
    _Budget(10, 5000, 100_000),
    _Budget(10, 2000, 50_000),
)
_FALLING = {"start": 1.0, "end": 0.05, "steps": 10_000}


def first_file(name: str, environment: str) -> str:
    """The text of an experiment file.

    Parameters
    ----------
    name:
        Of the experiment.
    environment:
        Gymnasium id or import path.

    Raises
    ------
    SpecError
        If the environment cannot be made, or no learner that comes along is for its spaces.
    """
    try:
        made = gymnasium_environment(environment)
        config = EnvironmentConfig(environment, max_episode_steps=None if _is_limited(made) else _MAX_STEPS)
        close_environments([made])
        world = make_world(config, 0)
    except ValueError as error:
        message = f"--env: {error}"
        raise SpecError(message) from error
    try:
        chosen, budget = _suiting(config, world)
        text = "\n".join(_lines(name, config, world, chosen, budget))
    finally:
        close_environments([world.environment])
    check(Plan.of(validate(parse(text, f"{name}.yaml"))))
    return text


def name_for(path: Path, environment: str) -> str:
    """A name for the experiment: that of its file, where it can be one."""
    return path.stem if _NAME.fullmatch(path.stem) else re.sub(r"[^A-Za-z0-9_.+-]+", "-", environment).strip("-.+_")


def gymnasium_environment(environment: str) -> gymnasium.Env[Any, Any]:
    """The environment with whatever it is wrapped in by its makers, to be looked at.

    Raises
    ------
    ValueError
        If it cannot be made.
    """
    factory = environment_factory(environment)
    try:
        with faults_of("environment"):
            made: gymnasium.Env[Any, Any] = _made(environment) if factory is None else factory()
    except Exception as error:
        told = error if isinstance(error, gymnasium.error.Error | ValueError) else in_a_line(error)
        message = f"{environment}: {told}{package_wanted(error, environment)}"
        raise ValueError(message) from error
    if not isinstance(made, gymnasium.Env):
        message = f"{environment}: found {type(made).__name__}, expected a gymnasium.Env"
        raise ValueError(message)
    return made


def _made(environment: str) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(environment, disable_env_checker=True)


def _is_limited(environment: Any) -> bool:
    while isinstance(environment, gymnasium.Wrapper):
        if isinstance(environment, TimeLimit):
            return True
        environment = environment.env
    return False


def _suiting(config: EnvironmentConfig, world: World) -> tuple[list[_Candidate], _Budget]:
    """The candidates that can be built: tables where they can, since they are cheap, or else networks."""
    reasons: list[str] = []
    networks = _network_budget(world)
    for candidates, budget in ((_tables(), _TABLES), (_networks(world, networks.steps), networks)):
        found = [one for one in candidates if _fits(one, config, reasons)]
        if found and budget is _TABLES:
            return found, budget
        if found:
            return [*found, *(one for one in _binned(world) if _fits(one, config, reasons))], budget
    space = world.environment
    message = (
        f"--env: {config.name}: found observations {space.observation_space} and actions {space.action_space}, for "
        f"which no shipped learner can be built here ({reasons[-1]}), expected others, or a learner of yours"
    )
    raise SpecError(message)


def _fits(candidate: _Candidate, config: EnvironmentConfig, reasons: list[str]) -> bool:
    content = {
        "name": "try", "runs": 1, "episodes": 1, "environment": _environment(config),
        "learners": {candidate.name: candidate.fields}, "arms": {candidate.name: {"learners": [candidate.name]}},
    }  # fmt: skip
    try:
        check(Plan.of(validate(Source("apel init", content))))
    except SpecError as error:
        reasons.append(str(error).removeprefix("apel init: "))
        return False
    return True


def _tables() -> Iterator[_Candidate]:
    common = {"discount": 0.99, "exploration": _FALLING}
    yield _Candidate("Q", {"type": "q_learning", **common}, "Q-learning with a table; ε falls over 10 000 steps")
    yield _Candidate("Q_fast", {"type": "q_learning", "learning_rate": 0.5, **common}, "the same with larger steps")
    about = "and planning with a model that it learns: few episodes, more computing"
    yield _Candidate("Dyna", {"type": "dyna_q", **common}, f"Q-learning {about}")


def _binned(world: World) -> Iterator[_Candidate]:
    space = world.environment.observation_space
    if isinstance(space, spaces.Box) and space.shape in [(n,) for n in range(1, _MAX_BINNED + 1)]:
        low, high = space.low.tolist(), space.high.tolist()
        if max(map(abs, (*low, *high))) < _FINITE:
            bins = [{"low": round(a, 4), "high": round(b, 4), "count": _BINS} for a, b in zip(low, high, strict=True)]
            fields = {"type": "q_learning", "discount": 0.99, "exploration": _FALLING, "representation": {"bins": bins}}
            yield _Candidate("Q_bins", fields, f"a table over {_BINS} bins of each variable")


def _network_budget(world: World) -> _Budget:
    """Images and continuous actions take many times as long as perceptrons and discrete ones."""
    is_slow = bool(_image_network(world)) or isinstance(world.environment.action_space, spaces.Box)
    return _SLOW_NETWORKS if is_slow else _PERCEPTRONS


def _networks(world: World, steps: int) -> Iterator[_Candidate]:
    network = _image_network(world)
    body = {"network": network} if network else {}
    dqn = {"type": "dqn", "discount": 0.99, "total_steps": steps, **body}
    yield _Candidate("DQN", dqn, "double DQN with dueling heads, as OpenAI Baselines has it")
    yield _Candidate("DQN_slow", {**dqn, "learning_rate": 1e-4}, "the same with smaller steps")
    if not network:
        wide = {"network": {"hidden": [256, 256], "activation": "relu"}}
        yield _Candidate("DQN_wide", {**dqn, **wide}, "the same with a wider network")
    yield _Candidate("DQN_prioritised", {**dqn, "prioritized": {}}, "the same, replaying what surprised it more often")
    yield _Candidate("ACER", {"type": "acer", "discount": 0.99, **body}, "actor-critic with experience replay")
    yield _Candidate("SAC", {"type": "sac", **body}, "soft actor-critic for discrete actions")
    for name, about in (("SAC", "soft actor-critic"), ("TD3", "twin delayed deterministic policy gradients")):
        fields = {"type": "stable_baselines", "algorithm": f"stable_baselines3:{name}", "total_timesteps": steps}
        if network:  # a million images, as theirs, have no room; no more are ever seen
            fields["buffer_size"] = steps
        if isinstance(world.environment.action_space, spaces.Box):
            yield _Candidate(f"{name}_SB3", fields, f"{about}, stable-baselines3's")


def _image_network(world: World) -> dict[str, Any]:
    space = world.environment.observation_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 3:
        return {}
    is_large = min(sorted(space.shape)[1:]) >= 36
    layers = [[32, 8, 4], [64, 4, 2], [64, 3, 1]] if is_large else [[16, 3, 1]]
    turned = {"layout": "channels_last"} if int(np.argmin(space.shape)) == 2 else {}
    return {"convolutions": layers, "hidden": [256], "activation": "relu", **turned}


def _environment(config: EnvironmentConfig) -> dict[str, Any]:
    limit = {} if config.max_episode_steps is None else {"max_episode_steps": config.max_episode_steps}
    return {"id": config.id, **limit}


def _lines(
    name: str, config: EnvironmentConfig, world: World, chosen: list[_Candidate], budget: _Budget
) -> Iterator[str]:
    seen = world.environment
    shapes = f"observations {_short(seen.observation_space)}, actions {_short(seen.action_space)}"
    yield f"# {config.name} ({shapes}),"
    yield "# and the shipped learners that suit it. `apel validate` checks this file, `apel run` plays it, and resumes"
    yield "# where it stopped. With `apel schema > apel.schema.json` and, as the first line,"
    yield "# `# yaml-language-server: $schema=apel.schema.json`, editors complete fields and options, and explain them."
    yield f"name: {_flow(name)}"
    yield f"runs: {budget.runs}  # seeds of each arm; of more, later, only the new ones are played"
    yield f"episodes: {budget.episodes}  # a run has at most so many,"
    yield f"steps: {budget.steps}  # and ends with the episode in which it reaches so many environment steps"
    yield ""
    yield "environment:"
    yield f"  id: {_flow(config.id)}"
    yield "  # options: {}  # what it takes when it is made"
    if config.max_episode_steps is not None:
        yield f"  max_episode_steps: {config.max_episode_steps}  # nothing else ends an episode for certain"
    yield ""
    yield "learners:"
    for one in chosen:
        yield f"  # {one.about}"
        yield f"  {one.name}: {_flow(one.fields)}"
    yield ""
    yield from _arms(chosen)
    yield from _criterion(config)
    yield ""
    yield "record: all  # every episode gets a row; `log` keeps thirteen a decade"
    yield "models: final  # keeps what was trained, for `apel export`, `apel evaluate` and `apel watch`"
    yield "plots:"
    yield "  - {kind: curves, name: returns, panels: [return], smooth: 10}"
    if len(chosen) > 1:
        yield "  - {kind: curves, name: selection, panels: [probability], arms: [ensemble], smooth: 10}"


def _arms(chosen: list[_Candidate]) -> Iterator[str]:
    yield "arms:"
    yield "  # Each learner by itself,"
    for one in chosen:
        yield f"  {one.name}: {{learners: [{one.name}]}}"
    if len(chosen) > 1:
        names = ", ".join(one.name for one in chosen)
        yield "  # and all together: one plays each episode, all learn from it, and the best one plays most."
        yield "  ensemble:"
        yield f"    learners: [{names}]"
        yield "    selector: {type: incumbent}  # rehearsal_share: 0.01 is how many episodes the others get at most"
        yield "  # APEL:"
        yield f"  #   learners: [{names}]"
        yield "  #   selector: {type: apel, decay: 0.01}  # larger ones adapt sooner (`apel design`)"


def _criterion(config: EnvironmentConfig) -> Iterator[str]:
    known = gymnasium.registry.get(str(config.id))
    threshold = None if known is None else known.reward_threshold
    if threshold is not None:
        yield ""
        yield "# When a run counts as trained: Gymnasium's threshold. It is played to its end all the same."
        yield f"criterion: {{measure: return, window: 100, at_least: {threshold}}}"
        yield "stop_when_met: false"


def _short(space: spaces.Space[Any]) -> str:
    """The space in a comment: one line, whatever NumPy's arrays or a space of the user's look like."""
    text = f"Box{space.shape}" if isinstance(space, spaces.Box) else visible(" ".join(str(space).split()))
    return text if len(text) <= _MAX_TEXT else f"{text[: _MAX_TEXT - 1]}…"


def _flow(value: Any) -> str:
    """A value as it stands within a line of YAML."""
    match value:
        case dict():
            return "{" + ", ".join(f"{key}: {_flow(inner)}" for key, inner in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_flow, value)) + "]"
        case str() if _PLAIN_WORD.fullmatch(value) and value.lower() not in _NO_WORDS:
            return value
    return json.dumps(value)
