"""The commands that read experiments, and help to write them: list, validate, init, schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from jobs.analysis.pages.fitting_table import FittingTable
from jobs.cli.consoles import OUT, AsJson, print_for_programs
from jobs.cli.run_options import Overrides, Reference
from jobs.cli.user_modules import find_user_modules
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment, shipped_experiments, shipped_galleries
from jobs.experiment.validation import check
from jobs.experiment.ways import ways_of
from jobs.experiment.yaml_source import SpecError
from jobs.precautions import refuse_shadowing, refuse_shadowing_beside


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command("list")(list_experiments)
    app.command()(validate)
    app.command()(init)
    app.command()(schema)


def list_experiments(as_json: AsJson = False) -> None:
    """List the shipped experiments."""
    plans = [Plan.of(load_experiment(name)) for name in shipped_experiments()]
    galleries = shipped_galleries()
    if as_json:
        rows = [
            {
                "name": plan.experiment.name,
                "title": plan.experiment.title,
                "figures": list(plan.experiment.figures),
                "arms": list(plan.experiment.arms),
                "runs": plan.experiment.runs,
                "most_episodes": plan.num_episodes,
            }
            for plan in plans
        ]
        drawn = [{"name": name, "title": one.title, "figures": list(one.figures)} for name, one in galleries.items()]
        print_for_programs({"experiments": rows, "galleries": drawn})
        return
    shown = [
        [
            plan.experiment.name,
            ", ".join(plan.experiment.figures),
            str(len(plan.experiment.arms)),
            str(plan.experiment.runs),
            f"{plan.num_episodes / 1e6:,.1f} M",
            plan.experiment.title,
        ]
        for plan in plans
    ]
    for name, gallery in galleries.items():
        shown.append([name, ", ".join(gallery.figures), "-", "-", "-", f"{gallery.title} (apel figures {name})"])
    headings = ("name", "figures", "arms", "runs", "episodes", "what")
    OUT.print(
        FittingTable(headings, shown, names=("name", "figures", "what"), first_to_go=("figures", "what", "episodes"))
    )


def init(
    file: Annotated[Path, typer.Argument(help="The experiment file to write: a new .yaml.")],
    environment: Annotated[str, typer.Option("--env", metavar="ID", help="A Gymnasium id, or an import path.")],
) -> None:
    """Write a commented experiment for an environment, with the shipped learners that suit its spaces."""
    from jobs.experiment.first_file import first_file, name_for

    if file.suffix not in {".yaml", ".yml"} or not file.parent.is_dir():
        message = f"found the file {str(file)!r}, expected a .yaml in a folder that exists"
        raise SpecError(message)
    if file.exists():
        message = f"{file}: found a file that is there already, expected a new one: nothing is overwritten"
        raise SpecError(message)
    refuse_shadowing()
    find_user_modules()
    text = first_file(name_for(file, environment), environment)
    with file.open("x", encoding="utf-8") as written:
        written.write(f"{text}\n")
    OUT.print(f"wrote {file}: apel run {file}", highlight=False)
    arm = list(load_experiment(str(file)).arms)[-1]
    first = f"apel run {file} --arms {arm} --runs 1"
    OUT.print(f"to train one ensemble first: {first}", highlight=False, soft_wrap=True)


def schema() -> None:
    """Print the JSON schema of an experiment file, for editors: its fields, and the options of every learner and
    selector.
    """
    from jobs.experiment.schema import experiment_schema

    # Not by way of the console, which would break lines; and in ASCII, whatever the encoding of where it goes.
    typer.echo(json.dumps(experiment_schema(), indent=2))


def validate(spec: Reference, overrides: Overrides = None) -> None:
    """Check an experiment by building everything it names once, and say how it will be played."""
    refuse_shadowing_beside(spec)
    find_user_modules()
    experiment = load_experiment(spec, overrides or [])
    plan = Plan.of(experiment)
    trial = check(plan)
    arms = ", ".join(experiment.arms)
    line = f"{experiment.name} ({experiment.identity}) is valid: arms {arms}; {experiment.runs} runs"
    if trial.num_left:
        line += f"; of its many parts {trial.num_built} were built, {trial.num_left} are left for when their turn comes"
    OUT.print(line, highlight=False)
    for line in ways_of(plan):
        OUT.print(f"  {line}", highlight=False, markup=False, soft_wrap=True)
