"""Which runs may be played side by side: those whose entries, actions and tables have one shape."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from apel.environments.factory import World
from apel.experience.channels import form_of


def alike(worlds: Sequence[World]) -> list[list[int]]:
    """The positions of worlds whose arrays have the same shapes and types, in order; bounds and seeds may differ.

    Where variables of a run are options of its environment, runs of one arm may differ in shape.
    """
    kinds: dict[Hashable, list[int]] = {}
    for position, world in enumerate(worlds):
        kinds.setdefault(_shape(world), []).append(position)
    return list(kinds.values())


def _shape(world: World) -> Hashable:
    observed, acted, model = world.environment.observation_space, world.environment.action_space, world.model
    action = type(acted), acted.shape, str(acted.dtype), getattr(acted, "n", None)
    tables = model and (model.shape, model.features, model.num_distractors)
    try:
        entry = form_of(observed)
    except ValueError:  # of a space that is not supported, which is said where the learners are made
        return repr(observed), action, tables
    return entry.shape, str(entry.dtype), action, tables
