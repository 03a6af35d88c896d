"""``--log``: names and import paths of those who are told how a job goes on, and what each of them needs."""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from apel.building.registry import load
from apel.run.user_code import faults_of, in_a_line
from jobs.experiment.yaml_source import SpecError
from jobs.progress.job_observer import JobInfo, JobObserver
from jobs.progress.mlflow import MlflowRuns
from jobs.progress.tensorboard import EventFiles
from jobs.progress.wandb import Mode, WandbRuns
from jobs.results.places import has_credentials, redacted

_PACKAGES = {"tensorboard": "tensorboardX", "mlflow": "mlflow", "wandb": "wandb"}
EXPECTED = "tensorboard[:DIR], mlflow[:URI], wandb, or an import path package.module:Observer"
_IMPORT_PATH = re.compile(r"([A-Za-z_]\w*(?:\.\w+)*):[A-Za-z_]\w*")
_MLFLOW_SCHEMES = ("http", "https", "sqlite", "postgresql", "mysql", "mssql", "databricks")
_MLFLOW_URI = "MLFLOW_TRACKING_URI"
_ANSWER_SECONDS = 10.0


def check_words(words: list[str]) -> None:
    """Refuse what names no logger, whether its package is there or not.

    Raises
    ------
    SpecError
        With what was found.
    """
    for word in words:
        name, colon, target = word.partition(":")
        if name not in _PACKAGES and not _IMPORT_PATH.fullmatch(word):
            message = f"--log: found {word!r}, expected {EXPECTED}"
        elif name in _PACKAGES and colon and (not target.strip() or not target.isprintable()):
            message = f"--log: found {word!r}, expected {name}, or something after the colon"
        elif name == "wandb" and colon:
            message = f"--log: found {word!r}, expected wandb: WANDB_PROJECT and WANDB_DIR say the rest"
        elif words.count(word) > 1:
            message = f"--log: found {word!r} twice, expected each once"
        elif name == "mlflow" and has_credentials(target):
            message = (
                f"--log: found credentials in {redacted(target)}, expected none: Ray shows the command to all who can "
                f"see its dashboard; set {_MLFLOW_URI}, or MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD"
            )
        else:
            continue
        raise SpecError(message)


def own_module(word: str) -> str | None:
    """The top-level module of an observer of one's own; None for a logger by name.

    >>> own_module("board.lights:Lights"), own_module("mlflow:http://board")
    ('board', None)
    """
    return None if word.partition(":")[0] in _PACKAGES else word.partition(":")[0].partition(".")[0]


def observer_of(word: str, job: JobInfo) -> JobObserver:
    """The observer of one word after ``--log``, ready to begin; nothing is written yet.

    Raises
    ------
    SpecError
        If its package is not installed, it cannot be loaded, has not the three methods, or has nowhere to write to.
    """
    name, _, target = word.partition(":")
    if name not in _PACKAGES:
        return _own(word)
    _expect_installed(name, _PACKAGES[name])
    makers: dict[str, Callable[[str, JobInfo], JobObserver]] = {
        "tensorboard": _tensorboard, "mlflow": _mlflow, "wandb": _wandb,
    }  # fmt: skip
    return makers[name](target, job)


def _own(path: str) -> JobObserver:
    try:
        found = load(path)
        with faults_of(""):
            observer = found()
    except ValueError as error:
        message = f"--log: {error}"
        raise SpecError(message) from error
    except Exception as error:
        message = f"--log {path}: found {in_a_line(error)} on making it without arguments, expected an observer"
        raise SpecError(message) from error
    missing = [name for name in ("begin", "progress", "end") if not callable(getattr(observer, name, None))]
    if missing:
        message = (
            f"--log {path}: found a {type(observer).__name__} without {', '.join(missing)}, "
            "expected one with the methods begin, progress and end"
        )
        raise SpecError(message)
    return observer


def _expect_installed(name: str, package: str) -> None:
    # A folder called wandb in the working directory, such as wandb itself makes, is found as a namespace.
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        message = f"--log {name}: found no {package}, expected it to be installed: pip install 'apel[{name}]'"
        raise SpecError(message)


def _beside_the_results(name: str, job: JobInfo, otherwise: str) -> str:
    """The folder of the results, where it is one of this machine."""
    if "://" in job.results:
        message = f"--log {name}: found results at {job.results}, where it cannot write, expected {otherwise}"
        raise SpecError(message)
    return job.results


def _tensorboard(target: str, job: JobInfo) -> EventFiles:
    return EventFiles(target or f"{_beside_the_results('tensorboard', job, 'tensorboard:DIR')}/tensorboard")


def _wandb(_: str, job: JobInfo) -> WandbRuns:
    mode = os.environ.get("WANDB_MODE", "offline")
    if mode not in get_args(Mode):
        message = f"--log wandb: found WANDB_MODE={mode}, expected one of {', '.join(get_args(Mode))}"
        raise SpecError(message)
    if mode in ("online", "shared"):
        _expect_login()
    return WandbRuns(os.environ.get("WANDB_DIR") or _beside_the_results("wandb", job, "WANDB_DIR"), mode)  # type: ignore[arg-type]


def _expect_login() -> None:
    import wandb

    try:
        is_there = wandb.login(prompt=False)
    except Exception as error:
        message = f"--log wandb: found {in_a_line(error)}, expected a login: `wandb login`, or WANDB_API_KEY"
        raise SpecError(message) from error
    if not is_there:
        message = "--log wandb: found WANDB_MODE=online and no login, expected one: `wandb login`, or WANDB_API_KEY"
        raise SpecError(message)


def _mlflow(target: str, job: JobInfo) -> MlflowRuns:
    uri = target or os.environ.get(_MLFLOW_URI, "")
    if not uri and job.job:
        message = f"--log mlflow: found no {_MLFLOW_URI} on the cluster, expected it, or mlflow:URI"
        raise SpecError(message)
    uri = uri or "sqlite:///mlflow.db"
    if uri.partition(":")[0].partition("+")[0] not in _MLFLOW_SCHEMES:
        message = (
            f"--log mlflow: found {redacted(uri)!r}, expected the URI of a tracking server or database, such as "
            f"http://HOST:5000 or sqlite:///mlflow.db ({', '.join(_MLFLOW_SCHEMES)})"
        )
        raise SpecError(message)
    if uri.startswith("http"):
        _expect_answer(uri)
    elif not uri.startswith("databricks"):
        _expect_installed("mlflow", "sqlalchemy")
    if uri.startswith("sqlite:///"):
        _expect_folder(uri.removeprefix("sqlite:///"))
    return MlflowRuns(uri)


def _expect_answer(uri: str) -> None:
    import requests

    try:
        requests.get(f"{uri.rstrip('/')}/health", timeout=_ANSWER_SECONDS)
    except requests.exceptions.SSLError:
        return  # somebody is there; whom to trust is MLflow's own business
    except requests.exceptions.RequestException as error:
        message = (
            f"--log mlflow: found no answer at {redacted(uri)} ({type(error).__name__}), expected a server of MLflow"
        )
        raise SpecError(message) from error


def _expect_folder(database: str) -> None:
    if not Path(database).parent.is_dir():
        message = f"--log mlflow: found no folder {str(Path(database).parent)!r}, expected one for the database"
        raise SpecError(message)
