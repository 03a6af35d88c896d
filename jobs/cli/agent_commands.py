"""The commands that deal with trained agents: export, evaluate."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from jobs.cli.consoles import OUT, print_note
from jobs.cli.user_modules import find_user_modules
from jobs.experiment.yaml_source import SpecError
from jobs.progress.observers import told_if_it_lasts
from jobs.progress.terminal import TerminalObserver, episode_bar
from jobs.results.finding import results_at
from jobs.results.store import ResultStore

if TYPE_CHECKING:
    from apel.agents import Agent
    from jobs.agents.exporting import Exported
    from jobs.films.scenes import Scene, Wish
    from jobs.films.watching import FilmOptions

Format = Literal["agent", "onnx", "sb3"]
Arm = Annotated[str | None, typer.Option(help="Default: the first with several learners.")]
Sweep = Annotated[str | None, typer.Option(metavar="LABEL", help="Sweep point. Default: the first.")]
Run = Annotated[int, typer.Option(min=0, help="Which of the arm's runs.")]
Trust = Annotated[
    bool, typer.Option("--trust", help="Run code that the results or the agent name and APEL does not ship.")
]


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    commands: tuple[Callable[..., None], ...] = (export, evaluate)
    for function in commands:
        app.command(function.__name__)(function)


def export(
    results: Annotated[str, typer.Argument(help="The folder of an experiment's results.")],
    destination: Annotated[Path, typer.Argument(help="A new folder; for the other formats, an .onnx or a .zip file.")],
    arm: Arm = None,
    sweep: Sweep = None,
    run: Run = 0,
    learner: Annotated[
        str | None, typer.Option(help="Export only this one. Default: all; for the other formats, the best.")
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help="As trained once the run had reached this many steps. Default: at its end."),
    ] = None,
    evaluations: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="Greedy episodes of each, to find the best learner; with 0, ask the selector."
        ),
    ] = 10,
    form: Annotated[
        Format, typer.Option("--format", help="An APEL agent, ONNX, or the format of stable-baselines3.")
    ] = "agent",
    trust: Trust = False,
) -> None:
    """Export the trained learners of a run, as a folder of arrays and JSON that `apel.load` reads.

    They come from the models that the experiment has kept (`models: final`). Where it has kept none, the run is played
    again, as `apel watch` does, and held against the stored episodes.
    """
    from jobs.agents.destinations import check_destination, write_export
    from jobs.agents.exporting import refuse_other_learner, with_scores
    from jobs.films.scenes import Wish

    check_destination(destination, form)
    store, scene = _opened(results, Wish(arm, sweep, run), trust=trust)
    refuse_other_learner(list(scene.arm.learner_names), learner)
    exported = _exported(store, scene, steps, trust=trust)
    agent = exported.agent if learner is None else exported.agent.only(learner)
    if evaluations and len(agent.names) > 1:
        with _refused():
            agent = with_scores(agent, evaluations, trust=trust)
    with _refused():
        write_export(agent, destination, form)
    _tell(destination, scene.label, exported, agent)


def evaluate(
    target: Annotated[str, typer.Argument(metavar="AGENT|RESULTS", help="The folder of an agent, or of results.")],
    environment: Annotated[
        str | None, typer.Option(metavar="ID", help="Default: the one it was trained in, as it was in its run.")
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, max=1_000_000, help="Episodes of each learner.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed from which those of the episodes are derived.")] = 0,
    arm: Arm = None,
    sweep: Sweep = None,
    run: Run = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, with the return of every episode.")] = False,
    trust: Trust = False,
) -> None:
    """Play episodes with each learner of an agent and with their ensemble, both greedily and as in training.

    Nothing is learned. All play the same episodes, whose seeds are none of the training's.
    """
    from jobs.agents.evaluation_table import evaluation_json, evaluation_table
    from jobs.films.scenes import Wish

    agent = _agent(target, Wish(arm, sweep, run), trust=trust)
    with _refused():
        evaluation = agent.evaluate(environment, episodes, seed=seed)
    if as_json:
        typer.echo(json.dumps(evaluation_json(evaluation, agent)))
        return
    OUT.print(evaluation_table(evaluation))
    for line in _remarks(evaluation, agent):
        OUT.print(line, highlight=False, markup=False)


def is_agent(target: str) -> bool:
    """Whether a folder is that of an agent."""
    from apel.agents.files import AGENT_FILE

    return Path(target, AGENT_FILE).is_file()


def watch_agent(folder: str, wish: Wish, options: FilmOptions, seed: int, *, explore: bool, trust: bool) -> None:
    """Film an episode that an agent plays, see `apel watch`."""
    from jobs.agents.watching import film_agent

    agent = _agent(folder, wish, trust=trust)
    with _refused():
        film = film_agent(agent, agent.environment(), options, seed=seed, explore=explore)
    OUT.print(film.path, highlight=False, markup=False)
    played = f"{film.learner} played, return {film.episode_return:.6g}, {film.length:,} steps"
    OUT.print(played, highlight=False, markup=False)


def _remarks(evaluation: Any, agent: Agent) -> list[str]:
    lines = [f"the best is {agent.best}, by {agent.content.score_name}"] if len(agent.names) > 1 else []
    if cut := evaluation.num_cut:
        lines.append(f"{cut} episodes did not end, and were cut off")
    return lines


def _agent(target: str, wish: Wish, *, trust: bool) -> Agent:
    """That of a folder, or of a run of results."""
    from apel.agents import load

    if not is_agent(target):
        store, scene = _opened(target, wish, trust=trust)
        return _exported(store, scene, None, trust=trust).agent
    _refuse_choice(target, wish)
    if trust:
        find_user_modules()
    with _refused():
        return load(target, trust=trust)


def _refuse_choice(agent: str, wish: Wish) -> None:
    """What picks among results would be without effect on an agent, which is of one run."""
    for one in fields(wish):
        if (found := getattr(wish, one.name)) != one.default:
            message = f"--{one.name}: found {found!r} with {agent}, which is an agent, expected it with results alone"
            raise SpecError(message)


def _opened(results: str, wish: Wish, *, trust: bool) -> tuple[ResultStore, Scene]:
    from jobs.films.scenes import find_scene
    from jobs.films.trust import refuse_foreign_code
    from jobs.results.provenance import of_changed_sources

    store = results_at(results, print_note)
    if trust:
        find_user_modules()
    else:
        refuse_foreign_code(store)
    for message in of_changed_sources(store.experiment()):
        print_note(message)
    return store, find_scene(store, wish)


def _exported(store: ResultStore, scene: Scene, steps: int | None, *, trust: bool) -> Exported:
    from cluster.compiling import compile_for, not_compiled
    from jobs.agents.exporting import agent_of

    if not_compiled([scene.arm.selector.name]):
        with told_if_it_lasts(TerminalObserver(OUT).compiling):
            compile_for([scene.arm.selector.name])
    with episode_bar(OUT, scene.label, scene.num_episodes) as told:
        return agent_of(store, scene, steps, told, trust=trust)


def _tell(destination: Path, label: str, exported: Exported, agent: Agent) -> None:
    origin = agent.content.origin
    how = "kept with the results" if exported.was_kept else f"played again, {exported.num_checked:,} episodes compared"
    OUT.print(destination, highlight=False, markup=False)
    what = f"{label} after {origin['episodes']:,} episodes, {origin['steps']:,} steps: {how}"
    OUT.print(what, highlight=False, markup=False)
    if len(agent.names) > 1:
        OUT.print(f"{agent.best} is the best of {', '.join(agent.names)}", highlight=False, markup=False)


class _refused:  # noqa: N801 - it is used like a function
    """What cannot be made, played or written is bad input, like a field of an experiment file."""

    def __enter__(self) -> None:
        return

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, ValueError) and not isinstance(error, SpecError):
            raise SpecError(str(error)) from error
