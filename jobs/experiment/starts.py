"""What learners of an experiment begin with: agents that were exported before, known by their content."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

from apel.agents.content import AgentContent
from apel.agents.files import read_agent
from apel.configs import Start
from jobs.experiment.spec import Experiment
from jobs.experiment.yaml_source import SpecError

_FIELD = "start_from"
_MOST_AGENTS_KEPT = 8


def with_agents(experiment: Experiment) -> Experiment:
    """The experiment with the digests of the agents that it begins with, as they are now.

    Raises
    ------
    SpecError
        If one of them cannot be read.
    """
    found: dict[str, str] = {}
    for place, path in start_paths(experiment):
        try:
            found[path] = read_agent(path)[1]
        except (ValueError, OSError) as error:
            message = f"{experiment.where(*place)}: {error}"
            raise SpecError(message) from error
    return experiment if found == experiment.agents else experiment.model_copy(update={"agents": found})


def start_paths(experiment: Experiment) -> Iterator[tuple[tuple[str, ...], str]]:
    """Field and path of every agent that learners or arms begin with."""
    for kind, parts in (("learners", experiment.learners), ("arms", experiment.arms)):
        for name, part in parts.items():
            if part.start_from is not None:
                yield (kind, name, _FIELD), part.start_from


def start_of(experiment: Experiment, arm: str, name: str, numbered: str) -> Start | None:
    """What a learner of an arm, by its name in the file and by that in the arm, begins with.

    Its own agent goes before that of the arm. Of an agent with several learners it begins with the one of its name.

    Raises
    ------
    ValueError
        If the agent has no such learner, or is another one than when the experiment was loaded.
    """
    own = experiment.learners[name].start_from
    path = own if own is not None else experiment.arms[arm].start_from
    if path is None:
        return None
    digest = experiment.agents.get(path)
    if digest is None:
        message = f"start_from: {path}: found nothing noted of this agent, expected it: load_experiment notes it"
        raise ValueError(message)
    content = _agent(path, digest)
    wanted = next((one for one in (numbered, name) if one in content.names), None)
    if wanted is None and own is not None and len(content.names) == 1:
        (wanted,) = content.names
    if wanted is None:
        message = (
            f"start_from: found an agent with the learners {content.names} in {path}, expected {name!r} among them"
        )
        raise ValueError(message)
    return content.start(wanted, digest)


@lru_cache(maxsize=_MOST_AGENTS_KEPT)
def _agent(path: str, digest: str) -> AgentContent:
    try:
        content, found = read_agent(path)
    except OSError as error:
        message = f"start_from: {path}: {error}"
        raise ValueError(message) from error
    except ValueError as error:
        message = f"start_from: {error}"
        raise ValueError(message) from error
    if found != digest:
        message = f"start_from: {path}: found the agent {found[:12]}, expected {digest[:12]}, as when this was loaded"
        raise ValueError(message)
    return content


def with_paths(experiment: Experiment, path_of: Callable[[str], str]) -> Experiment:
    """The same experiment, with the same identity, whose agents lie elsewhere: ``path_of(digest)``."""
    moved = {path: path_of(digest) for path, digest in experiment.agents.items()}
    content = experiment.content()
    for part in (*content["learners"].values(), *content["arms"].values()):
        if part.get(_FIELD) is not None:
            part[_FIELD] = moved[part[_FIELD]]
    content["agents"] = {path_of(digest): digest for digest in experiment.agents.values()}
    return Experiment.model_validate(content)
