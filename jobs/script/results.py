"""What comes of an experiment without a file: its rows as data frames, its table, its figure."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

from jobs.analysis.answer import DEFAULT_ERROR
from jobs.analysis.plotting import curve_plots, style
from jobs.analysis.stored_summary import stored_summary
from jobs.cli.consoles import TextConsole, print_note
from jobs.experiment.figures import CurvePlot
from jobs.experiment.spec import Experiment
from jobs.progress.terminal import summary_table
from jobs.results.episodes import COLUMNS, read_episodes
from jobs.results.storage import Folder
from jobs.results.store import ResultStore

if TYPE_CHECKING:
    import pandas as pd

    from apel.agents import Agent
    from jobs.analysis.answer.comparison import Answer

Panel = Literal["return", "length", "probability", "concentration"]
_WIDTH = 10_000


class ScriptStore(ResultStore):
    """The results of an experiment whose classes and functions are here."""

    def __init__(self, folder: Folder, experiment: Experiment) -> None:
        super().__init__(folder, print_note)
        self._experiment = experiment

    def experiment(self) -> Experiment:
        """The experiment with its classes and functions, where the file has only their names."""
        self.runs()
        return self._experiment


@dataclass(frozen=True)
class Comparison:
    """An answer for each task that was played: what `apel compare` prints, and, as ``answers``, all of its numbers."""

    answers: tuple[Answer, ...]

    def __repr__(self) -> str:
        """In words."""
        from jobs.analysis.answer.words import answer_lines

        return "\n".join(answer_lines(self.answers))


class Results:
    """Results as they are stored: read when they are asked for, and from then on kept.

    Attributes
    ----------
    experiment:
        What was run.
    path:
        The folder of its files, which every command that reads results takes (``apel show PATH``).
    """

    def __init__(self, store: ResultStore, experiment: Experiment) -> None:
        self.experiment, self.path = experiment, store.folder.location()
        self._store = ScriptStore(store.folder, experiment)

    @cached_property
    def runs(self) -> pd.DataFrame:
        """A row for every run: its arm, index and seed, what it took, and what it returned in its last tenth."""
        return self._store.runs().to_pandas()

    @cached_property
    def episodes(self) -> pd.DataFrame:
        """A row for every recorded episode: arm, run, who was selected, return, length; and, one value for each learner
        of the arm, probabilities, estimates and concentrations.
        """
        import pandas as pd
        import pyarrow as pa

        tables = {arm: read_episodes(self._store.folder, arm, list(COLUMNS)) for arm in self.experiment.arms}
        frames = [table.to_pandas().assign(arm=arm) for arm, table in tables.items() if table is not None]
        nothing = pa.schema([("arm", pa.string()), *COLUMNS.items()]).empty_table().to_pandas()
        together = pd.concat(frames or [nothing], ignore_index=True)
        return together[["arm", *COLUMNS]].sort_values(["arm", "sweep", "run_index", "episode"], ignore_index=True)

    def plot(self, *panels: Panel, smooth: int = 5) -> Any:
        """Curves over the episodes: mean ± standard deviation over the runs, in a figure of matplotlib's.

        Parameters
        ----------
        panels:
            What is drawn, ``return`` by default: of all arms, or, where it has a value for each learner, of the
            ensemble.
        smooth:
            Episodes of which a moving mean is drawn.
        """
        ensembles = [name for name, arm in self.experiment.arms.items() if len(arm.learner_names) > 1]
        arms = ensembles[:1] if set(panels) & set(curve_plots.PER_LEARNER) else []
        plot = CurvePlot(kind="curves", name="curves", panels=list(panels) or ["return"], smooth=smooth, arms=arms)
        with style.apart() as plt:
            return curve_plots.draw(plt, self._store.folder, self._store.runs(), plot, self.experiment)

    def compare(self, error: float = DEFAULT_ERROR) -> Comparison:
        """Which arm to use, and how sure that is (`apel compare`); ``error`` is the probability of calling an arm the
        best that is not.
        """
        from jobs.analysis.answer.comparison import compare

        return Comparison(tuple(compare(self._store, error)))

    def agent(self, run: int = 0, arm: str | None = None, *, evaluations: int = 10) -> Agent:
        """The trained learners of a run, which is played again here for that, and held against its stored episodes;
        unless they were kept (``models`` of `jobs.run`).

        Parameters
        ----------
        run:
            Which of the arm's runs.
        arm:
            Default: the ensemble.
        evaluations:
            Greedy episodes of each of several learners, by which the best one is told, who acts; 0: it is told by what
            the selector knew at the end.

        Raises
        ------
        SpecError
            If there is no such run or arm.
        """
        from jobs.agents.exporting import agent_of, with_scores
        from jobs.films.scenes import Wish, find_scene

        scene = find_scene(self._store, Wish(arm, run=run))
        agent = agent_of(self._store, scene, None, lambda _: None, trust=True).agent
        return with_scores(agent, evaluations, trust=True) if evaluations and len(agent.names) > 1 else agent

    def __repr__(self) -> str:
        """The table of results, and where they are."""
        text = io.StringIO()
        console = TextConsole(file=text, width=_WIDTH)
        console.print(summary_table(stored_summary(self._store), self._store.manifest()))
        lines = [line.rstrip() for line in text.getvalue().splitlines()]
        return "\n".join([*filter(None, lines), self.path])
