"""The commands that read results: show, figures, claims, design. Nothing is computed, and no Ray is needed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cluster.storage import Folder, joined
from jobs.analysis.report import write_report
from jobs.spec import Experiment
from jobs.spec_files import Group, shipped_galleries
from jobs.store import ResultStore
from jobs.terminal import summary_table

if TYPE_CHECKING:
    from jobs.analysis.claims import Verdict

_out = Console(soft_wrap=True, width=None if sys.stdout.isatty() else 120)


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    commands: dict[str, Callable[..., None]] = {"show": show, "figures": figures, "claims": claims, "design": design}
    for name, function in commands.items():
        app.command(name)(function)


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
