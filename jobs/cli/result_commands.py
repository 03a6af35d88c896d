"""The commands that read results: show, compare, figures, claims, design, watch. No Ray is needed, and nothing is
played, but for `watch`, which plays one run again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from apel.numerics.near_names import did_you_mean
from jobs.analysis.answer import DEFAULT_ERROR
from jobs.cli.consoles import OUT, AsJson, print_for_programs, print_note
from jobs.cli.user_modules import find_user_modules
from jobs.experiment.plan import Plan
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import Group, shipped_galleries
from jobs.experiment.yaml_source import SpecError
from jobs.progress.observers import told_if_it_lasts
from jobs.progress.terminal import TerminalObserver, episode_bar, summary_table
from jobs.results.finding import results_at
from jobs.results.places import joined
from jobs.results.storage import Folder
from jobs.results.store import ResultStore
from jobs.rounds import refuse_error

if TYPE_CHECKING:
    from jobs.films.scenes import Scene
    from jobs.films.watching import Film
    from jobs.reproduction.claims.judging import Verdict


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    commands: tuple[Callable[..., None], ...] = (show, compare, figures, claims, design, watch)
    for function in commands:
        app.command(function.__name__)(function)


def show(
    results: Annotated[str, typer.Argument(help="The folder of an experiment's results.")], as_json: AsJson = False
) -> None:
    """Show the table of results, from the files alone."""
    from jobs.analysis.stored_summary import stored_summary

    store = results_at(results, print_note)
    summary = stored_summary(store)
    if as_json:
        print_for_programs(summary.to_pylist())
    else:
        OUT.print(summary_table(summary, store.manifest()))


def compare(
    results: Annotated[str, typer.Argument(help="The folder of an experiment's results.")],
    error: Annotated[
        float | None,
        typer.Option(min=0.0001, max=0.5, help="Probability of naming a wrong arm as the best.", show_default="0.05"),
    ] = None,
    arms: Annotated[str | None, typer.Option(help="Only these arms, separated by commas.")] = None,
    as_json: AsJson = False,
) -> None:
    """Say which arm to use, and how sure that is, from the files alone."""
    from jobs.analysis.answer.comparison import compare as compare_results
    from jobs.analysis.answer.words import answer_json, answer_lines

    store = results_at(results, print_note)
    named = None if arms is None else arms.split(",")
    if named is not None:
        Plan.of(store.experiment()).only(named)  # refuses those that the experiment does not have
    answers = compare_results(store, DEFAULT_ERROR if error is None else error, named)
    if error is not None:
        for answer in answers:
            refuse_error(len(answer.costs), error)
    if as_json:
        OUT.print_json(answer_json(store.experiment(), answers), ensure_ascii=True)
        return
    for line in answer_lines(answers):
        OUT.print(line, highlight=False)


def figures(
    results: Annotated[str, typer.Argument(help="The folder of an experiment's results, or a gallery: theory, …")],
) -> None:
    """Draw the figures and write the report, from the files alone; or draw a gallery below results/."""
    from jobs.analysis.pages.report import write_report
    from jobs.reproduction.gallery import draw_gallery

    galleries = shipped_galleries()
    if gallery := galleries.get(results):
        for path in draw_gallery(gallery, Folder(f"results/{gallery.name}")):
            OUT.print(path, highlight=False)
        return
    if (meant := did_you_mean(results, galleries)) and not Path(results).exists():
        message = f"found no folder {results!r}, expected that of an experiment's results, or a gallery{meant}"
        raise SpecError(message)
    store = results_at(results, print_note)
    for path in (*draw(store, store.experiment()), write_report(store)):
        OUT.print(path, highlight=False)


def claims(
    results: Annotated[
        list[str] | None,
        typer.Argument(help="Folders of results, or of experiments, or of single ones. Default: results."),
    ] = None,
    output: Annotated[str | None, typer.Option(help="Folder or URI for claims.parquet and claims.md.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Also list claims whose experiment has no results.")] = False,
    as_json: AsJson = False,
) -> None:
    """Check the dissertation's claims against the results, from the files alone."""
    from jobs.reproduction.claims.claim_files import judged_experiments, shipped_claims
    from jobs.reproduction.claims.judging import evaluate
    from jobs.reproduction.claims.ledger import claims_table, write_ledger
    from jobs.reproduction.claims.stored_results import found_stores

    held = shipped_claims()
    verdicts = evaluate(held, found_stores(results or ["results"]), judged_experiments(held))
    written = [] if output is None else write_ledger(ResultStore.at(output).folder, verdicts)
    if as_json:
        print_for_programs(claims_table(verdicts).to_pylist())
        return
    _show_verdicts(verdicts, every=every)
    for path in written:
        OUT.print(path, highlight=False)


def design(
    adapt_within: Annotated[float | None, typer.Option(metavar="EPISODES", help="Adaptation time to aim for.")] = None,
    rise_within: Annotated[
        float | None, typer.Option(metavar="EPISODES", help="Rise time to aim for, to 90 %.")
    ] = None,
    explore: Annotated[
        float | None, typer.Option(metavar="P", help="Share of episodes to spare for all but the best.")
    ] = None,
    performance: Annotated[
        float | None, typer.Option(metavar="G", help="Mean return to aim for; needs the two below.")
    ] = None,
    best_return: Annotated[float | None, typer.Option(help="Return of the best learner.")] = None,
    other_return: Annotated[
        list[float] | None, typer.Option(help="Return of each other learner, or one for all of them.")
    ] = None,
    learners: Annotated[int, typer.Option(min=2, max=1000, help="Number of learners.")] = 2,
    win_probability: Annotated[
        float, typer.Option(metavar="P", help="Probability that the best learner beats another one.")
    ] = 1.0,
    floor: Annotated[float, typer.Option(metavar="P", help="Smallest share of the episodes for each learner.")] = 0.0,
    as_json: AsJson = False,
) -> None:
    """Find APEL's decay ν for one of four goals, and what to expect from it."""
    from jobs.cli.design import Request, advice
    from jobs.cli.design import design as design_decay
    from jobs.cli.design_table import design_table

    others = tuple(other_return or ())
    wish = adapt_within, rise_within, explore, performance, best_return, others
    rows = design_decay(Request(*wish, learners, win_probability, floor))
    if as_json:
        print_for_programs([asdict(row) for row in rows])
        return
    first, *others_said = advice(rows, learners)
    OUT.print(first, highlight=False)
    OUT.print(design_table(rows))
    for line in others_said:
        OUT.print(line, highlight=False)


def watch(
    results: Annotated[
        str, typer.Argument(metavar="RESULTS|AGENT", help="The folder of an experiment's results, or of an agent.")
    ],
    arm: Annotated[str | None, typer.Option(help="Default: the first with several learners.")] = None,
    sweep: Annotated[str | None, typer.Option(metavar="LABEL", help="Sweep point. Default: the first.")] = None,
    run: Annotated[int, typer.Option(min=0, help="Which of the arm's runs.")] = 0,
    episode: Annotated[
        int | None, typer.Option(help="From 0; negative numbers count from the end. Default: the last one.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="A .gif or .mp4. Default: ARM-runRUN-episodeEPISODE.gif, here."),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(min=1.0, max=50.0, help="Frames per second. Default: the environment's, up to 30.")
    ] = None,
    max_frames: Annotated[int, typer.Option(min=2, help="Of longer episodes only every n-th step is shown.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode that an agent plays.")] = 0,
    explore: Annotated[bool, typer.Option("--explore", help="Let an agent explore as it did in training.")] = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run code that the results or the agent name and APEL does not ship.")
    ] = False,
) -> None:
    """Film one episode of a trained ensemble, from results, or played now by an exported agent.

    A run is the same whenever it is played: to show an episode it is played again, here and without Ray.

    That takes as long as the run took up to that episode, with deep learners minutes; a bar shows how far it is.

    The replay is held against the stored episodes; the results are left as they are.

    What the experiment names beyond what is shipped, such as learners of your own, is run only with --trust.
    """
    from cluster.compiling import compile_for, not_compiled
    from jobs.cli.agent_commands import is_agent, watch_agent
    from jobs.films.scenes import Wish, find_scene
    from jobs.films.trust import refuse_foreign_code
    from jobs.films.watching import FilmOptions, film_scene
    from jobs.results.provenance import of_changed_sources

    if is_agent(results):
        wish = Wish(arm, sweep, run, episode)
        watch_agent(results, wish, FilmOptions(output, fps, max_frames), seed, explore=explore, trust=trust)
        return
    for name, is_given in (("--seed", seed != 0), ("--explore", explore)):
        if is_given:
            message = f"{name}: found it with {results}, which are results, expected it with an agent alone"
            raise SpecError(message)
    store = results_at(results, print_note)
    if trust:
        find_user_modules()
    else:
        refuse_foreign_code(store)
    for message in of_changed_sources(store.experiment()):
        print_note(message)
    scene = find_scene(store, Wish(arm, sweep, run, episode))
    parts = [scene.arm.selector.name, *(one.type for one in scene.run.learners if isinstance(one.type, str))]
    if not_compiled(parts):
        with told_if_it_lasts(TerminalObserver(OUT).compiling):
            compile_for(parts)
    with episode_bar(OUT, scene.label, scene.episode + 1) as told:
        film = film_scene(store, scene, FilmOptions(output, fps, max_frames), told)
    _tell_film(scene, film)


def draw(store: ResultStore, experiment: Experiment) -> list[str]:
    """Draw the figures that an experiment declares; returns where they are."""
    from jobs.analysis.plotting.figures import draw_figures

    return draw_figures(store, experiment)


def write_and_show_reproduction(results: str, stores: list[ResultStore], group: Group) -> None:
    """Write the pages of a reproduction, and show its ledger."""
    from jobs.reproduction.folder import write_reproduction

    folder = Folder(joined(results, "reproduction" if group == "tabular" else f"reproduction-{group}"))
    _show_verdicts(write_reproduction(folder, stores, group))
    for name in ("claims.parquet", "claims.md", "tables/", "figures/", "report.html"):
        OUT.print(folder.location(name), highlight=False)


def _show_verdicts(verdicts: Sequence[Verdict], *, every: bool = True) -> None:
    from jobs.reproduction.claims.ledger import (
        DOUBTFUL,
        corrected_count_line,
        count_line,
        source_lines,
        verdict_table,
    )

    shown = [one for one in verdicts if every or one.ruling != "missing"]
    OUT.print(verdict_table(shown))
    if left_out := len(verdicts) - len(shown):
        OUT.print(f"{left_out} claims without results are left out; --all shows them", highlight=False)
    for line in source_lines(verdicts):
        OUT.print(line, highlight=False, markup=False)
    OUT.print(count_line(verdicts), highlight=False)
    OUT.print(f"{DOUBTFUL} {corrected_count_line(verdicts)}", highlight=False, markup=False)


def _tell_film(scene: Scene, film: Film) -> None:
    OUT.print(film.path, highlight=False, markup=False)
    what = f"{scene.label} · episode {scene.episode:,}: {film.learner} played, return {film.episode_return:.6g}"
    OUT.print(f"{what}, {film.length:,} steps", highlight=False, markup=False)
    if film.every > 1:
        OUT.print(f"every {film.every} steps make one frame; raise --max-frames for more", highlight=False)
    if not film.num_checked:
        OUT.print("no episode up to here was recorded, so there is nothing to check against", highlight=False)
