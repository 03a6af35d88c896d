"""The commands that read results: show, figures, claims, design, watch. No Ray is needed, and nothing is computed, but
for `watch`, which plays one run again.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cluster.storage import Folder, joined
from jobs.analysis.report import write_report
from jobs.spec import Experiment
from jobs.spec_files import Group, shipped_galleries
from jobs.store import ResultStore
from jobs.terminal import episode_bar, summary_table

if TYPE_CHECKING:
    from jobs.analysis.claims import Verdict

_out = Console(soft_wrap=True, width=None if sys.stdout.isatty() else 120)


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    commands: tuple[Callable[..., None], ...] = (show, figures, claims, design, watch)
    for function in commands:
        app.command(function.__name__)(function)


def show(results: Annotated[str, typer.Argument(help="The folder of an experiment's results.")]) -> None:
    """Show the table of results, from the files alone."""
    store = ResultStore.at(results)
    _out.print(summary_table(store.summary(), store.manifest()))


def figures(
    results: Annotated[str, typer.Argument(help="The folder of an experiment's results, or a gallery: theory, …")],
) -> None:
    """Draw the figures and write the report, from the files alone; of a gallery, draw it below results/."""
    from jobs.analysis.figures import draw_gallery

    if gallery := shipped_galleries().get(results):
        for path in draw_gallery(gallery, Folder(f"results/{gallery.name}")):
            _out.print(path, highlight=False)
        return
    store = ResultStore.at(results)
    for path in (*draw(store, store.experiment()), write_report(store)):
        _out.print(path, highlight=False)


def claims(
    results: Annotated[
        list[str] | None, typer.Argument(help="Folders of results, or of an experiment's. Default: results.")
    ] = None,
    output: Annotated[str | None, typer.Option(help="Folder or URI for claims.parquet and claims.md.")] = None,
) -> None:
    """Hold what the dissertation claims against the results, from the files alone."""
    from jobs.analysis.claims import evaluate, found_stores, shipped_claims
    from jobs.ledger import write_ledger

    verdicts = evaluate(shipped_claims(), found_stores(results or ["results"]))
    _show_verdicts(verdicts)
    if output is not None:
        for path in write_ledger(ResultStore.at(output).folder, verdicts):
            _out.print(path, highlight=False)


def design(
    adapt_within: Annotated[float | None, typer.Option(metavar="EPISODES", help="Wanted adaptation time.")] = None,
    rise_within: Annotated[float | None, typer.Option(metavar="EPISODES", help="Wanted rise time, to 90 %.")] = None,
    explore: Annotated[float | None, typer.Option(metavar="P", help="Wanted share of any but the best.")] = None,
    performance: Annotated[float | None, typer.Option(metavar="G", help="Wanted mean return; needs returns.")] = None,
    best_return: Annotated[float | None, typer.Option(help="Return of the best learner.")] = None,
    other_return: Annotated[list[float] | None, typer.Option(help="Of each other one, or one for all others.")] = None,
    learners: Annotated[int, typer.Option(min=2, help="Number of learners.")] = 2,
) -> None:
    """Find APEL's decay ν for one of four criteria, and what to expect of it."""
    from jobs.design import Request, advice
    from jobs.design import design as design_decay
    from jobs.design_table import design_table

    others = tuple(other_return or ())
    rows = design_decay(Request(adapt_within, rise_within, explore, performance, best_return, others, learners))
    _out.print(design_table(rows))
    for line in advice(rows, learners):
        _out.print(line, highlight=False)


def watch(
    results: Annotated[str, typer.Argument(help="The folder of an experiment's results.")],
    arm: Annotated[str | None, typer.Option(help="Default: the first with several learners.")] = None,
    sweep: Annotated[str | None, typer.Option(metavar="LABEL", help="Sweep point. Default: the first.")] = None,
    run: Annotated[int, typer.Option(min=0, help="Which of the arm's runs.")] = 0,
    episode: Annotated[
        int | None, typer.Option(help="From 0; counted from the end where negative. Default: the run's last.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="A .gif, or an .mp4. Default: ARM-runRUN-episodeEPISODE.gif, here."),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(min=1.0, max=50.0, help="Pictures per second. Default: the environment's, up to 30.")
    ] = None,
    max_frames: Annotated[int, typer.Option(min=2, help="Of a longer episode every n-th step is shown.")] = 500,
) -> None:
    """Film one episode of a trained ensemble.

    Results hold no learners, but a run is the same whenever it is played: it is played again, here and without Ray.

    That takes as long as the run took up to that episode, with deep learners minutes; a bar shows how far it is.

    The replay is held against the stored episodes; the results are left as they are.
    """
    from cluster.local import compile_for, not_compiled
    from jobs.scenes import Wish, find_scene
    from jobs.watching import FilmOptions, film_scene

    store = ResultStore.at(results)
    scene = find_scene(store, Wish(arm, sweep, run, episode))
    if not_compiled([scene.arm.selector.type]):
        _out.print("compiling, this once: about half a minute", highlight=False)
        compile_for([scene.arm.selector.type])
    with episode_bar(_out, scene.label, scene.episode + 1) as told:
        film = film_scene(store, scene, FilmOptions(output, fps, max_frames), told)
    _out.print(film.path, highlight=False, markup=False)
    what = f"{scene.label} · episode {scene.episode:,}: {film.learner} played, return {film.episode_return:.6g}"
    _out.print(f"{what}, {film.length:,} steps", highlight=False, markup=False)
    if film.every > 1:
        _out.print(f"every {film.every} steps are one picture; --max-frames takes more", highlight=False)
    if not film.num_checked:
        _out.print("no episode of this run up to here was recorded, with which to compare", highlight=False)


def draw(store: ResultStore, experiment: Experiment) -> list[str]:
    """Draw the figures that an experiment declares; returns where they are."""
    from jobs.analysis.figures import draw_figures

    return draw_figures(store, experiment)


def write_and_show_reproduction(results: str, stores: list[ResultStore], group: Group) -> None:
    """Write the pages of a reproduction, and show its ledger."""
    from jobs.analysis.reproduction_folder import write_reproduction

    folder = Folder(joined(results, "reproduction" if group == "tabular" else f"reproduction-{group}"))
    _show_verdicts(write_reproduction(folder, stores, group))
    for name in ("claims.parquet", "claims.md", "tables/", "figures/", "report.html"):
        _out.print(folder.location(name), highlight=False)


def _show_verdicts(verdicts: Sequence[Verdict]) -> None:
    from jobs.analysis.claims import count_line
    from jobs.ledger import verdict_table

    _out.print(verdict_table(verdicts))
    _out.print(count_line(verdicts), highlight=False)
