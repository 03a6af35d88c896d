"""The models that an experiment has kept beside its rows."""

from __future__ import annotations

import re

from apel.agents.content import AgentContent, unpack_agent
from apel.numerics.state_trees import StateError
from cluster.checkpoint import CheckpointError, unseal
from cluster.models import FINAL, mark_of
from cluster.shard import ArmPlan, RunPlan
from jobs.experiment.yaml_source import SpecError
from jobs.results.sinks import MODELS, model_label, model_name
from jobs.results.storage import Folder
from jobs.results.storage_faults import StoreError

_STEPS = re.compile(r"-(\d{12})\.npz$")


def kept_model(folder: Folder, arm: ArmPlan, run: RunPlan, steps: int | None) -> AgentContent | None:
    """What is kept of a run at its end, or after so many ``steps``; None where nothing is.

    Raises
    ------
    StoreError
        If what is kept is damaged, or another run's.
    """
    name = model_name(arm.arm, arm.sweep, run.index, FINAL if steps is None else mark_of(steps))
    if not folder.exists(name):
        return None
    try:
        return unpack_agent(unseal(folder.read(name), model_label(arm, run, name)))
    except (CheckpointError, StateError) as error:
        message = f"{folder.location(name)}: {error}: without the file, `apel export` plays the run again"
        raise StoreError(message) from error


def refuse_steps_not_kept(folder: Folder, arm: ArmPlan, run: RunPlan, steps: int) -> None:
    """Where models of a run are kept, see that those after so many steps are among them, before anything is played.

    Raises
    ------
    SpecError
        If there are others; the message names them.
    """
    start = model_name(arm.arm, arm.sweep, run.index, "").removesuffix(".npz")
    names = [f"{MODELS}/{name}" for name in folder.names(MODELS)]
    found = [int(match[1]) for name in names if name.startswith(start) and (match := _STEPS.search(name))]
    if found and steps not in found:
        message = f"--steps: found {steps}, expected one of those that are kept: {', '.join(map(str, found))}"
        raise SpecError(message)
