"""Figure 4.6 of made-up results: rows, tables, figure, report and claims say what was planted."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from jobs.analysis.pages.report import write_report
from jobs.analysis.plotting.figures import draw_figures
from jobs.analysis.plotting.step_plots import mean_curve, panels_of
from jobs.analysis.recorded_episodes import read_curves
from jobs.analysis.switching.runs import SwitchData
from jobs.analysis.switching.table import cells, switch_table
from jobs.experiment.figures import CurvePlot, SwitchRoles
from jobs.experiment.plan import Plan
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.validation import check
from jobs.experiment.yaml_source import SpecError
from jobs.reproduction.claims.judging import MIN_RUNS, Verdict, evaluate, rule
from jobs.results.store import ResultStore
from jobs.runner import Settings, run_experiment
from tests.jobs.analysis.switching.overtaking import PLOT, SPEC, Scale, write_results
from tests.jobs.reproduction.ledger import claim

# Some 1,300 episodes a run, of 40 steps on average.
SMALL = Scale(runs=6, steps=50_000, overtakes=20_000, latency=(40, 500, 100_000))
ROLES = SwitchRoles(early="Q", late="DQN", window=50)
ENSEMBLES = ["APEL", "SSBAS", "SSBAS_normalised"]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[ResultStore, Experiment]:
    """Of ensembles that are quick, slow, and never there."""
    return write_results(tmp_path_factory.mktemp("overtaking"), SMALL)


def switch_data(store: ResultStore, experiment: Experiment, roles: SwitchRoles = ROLES) -> SwitchData:
    learners = {arm: spec.learner_names for arm, spec in experiment.arms.items()}
    return SwitchData(store.folder, [(arm, "") for arm in experiment.arms], learners, roles)


def test_rows_of_runs(results: tuple[ResultStore, Experiment]) -> None:
    """One per run and ensemble; delays are those planted, within a window; who never switches is censored."""
    data = switch_data(*results)
    rows = data.rows()
    assert rows["arm"].tolist() == [arm for arm in ENSEMBLES for _ in range(6)]
    by_arm = {arm: rows[rows["arm"] == arm] for arm in ENSEMBLES}
    # All ensembles are held against the same crossovers.
    assert len({tuple(each["crossover_step"]) for each in by_arm.values()}) == 1
    slower = by_arm["SSBAS"]["delay"].to_numpy() - by_arm["APEL"]["delay"].to_numpy()
    assert slower.mean() == pytest.approx(500 - 40, abs=150)
    last = by_arm["SSBAS_normalised"]
    assert last["censored"].all()
    assert last["switch_episode"].isna().all()
    assert (last["delay"] == last["episodes"] - last["episode_at_crossover"]).all()
    assert not rows[rows["arm"] != "SSBAS_normalised"]["censored"].any()


def test_table_of_all_runs(results: tuple[ResultStore, Experiment]) -> None:
    """Every ensemble in episodes, steps and by mean curves; every pair in episodes and steps, run by run."""
    data = switch_data(*results)
    rows = data.rows()
    table = switch_table(rows, data)
    assert len(table) == 3 * 3 + 3 * 2
    delays = rows.pivot_table(index="run_index", columns="arm", values="delay")
    in_episodes = table[table["unit"] == "episodes"].set_index(["arm", "minus"])
    assert in_episodes.loc[("APEL", ""), "median"] == delays["APEL"].median()
    pair = in_episodes.loc[("SSBAS", "APEL")]
    difference = delays["SSBAS"] - delays["APEL"]
    assert (pair["median"], pair["mean"]) == pytest.approx((difference.median(), difference.mean()))
    assert 0 < pair["mean_low"] <= pair["mean"] <= pair["mean_high"]
    assert in_episodes["censored"].tolist() == [0, 0, 6, 0, 6, 6]
    means = table[table["reading"] == "mean curves"].set_index("arm")
    assert means.loc["APEL", "mean"] < means.loc["SSBAS", "mean"]
    assert np.isnan(means.loc["SSBAS_normalised", "mean"])


def test_table_without_a_crossover(results: tuple[ResultStore, Experiment]) -> None:
    """Roles the wrong way round: Q is not above DQN in the end of any run, and there is no number to give."""
    data = switch_data(*results, SwitchRoles(early="DQN", late="Q"))
    table = switch_table(data.rows(), data)
    by_run = table[table["reading"] == "runs"]
    assert (by_run["runs"] == 0).all()
    assert by_run["without_crossover"].dropna().tolist() == [6] * len(by_run)
    assert table["mean"].isna().all()
    text = cells(switch_table(data.rows()).astype(object).where(lambda frame: frame.notna(), None).to_dict("records"))
    assert text[0] == ["APEL, in episodes", "0", "6", "0", "-", "-", "-", "-"]


def test_learners_alone_are_needed(results: tuple[ResultStore, Experiment]) -> None:
    """Ensembles without one of them, or in whose place nothing is recorded yet, have no rows."""
    store, experiment = results
    learners = {arm: spec.learner_names for arm, spec in experiment.arms.items()}
    for points in ([("Q", ""), ("APEL", "")], [("Q", ""), ("DQN", "other"), ("APEL", "")]):
        assert SwitchData(store.folder, points, learners, ROLES).rows().empty


def test_mean_curve_is_over_all_runs(results: tuple[ResultStore, Experiment]) -> None:
    """Up to where the first run ends; the last point is the mean of what each run had come to."""
    store, _ = results
    curves = read_curves(store.folder, "Q", "", ["return", "length"])
    assert curves is not None
    values = curves.values("return")
    steps, band = mean_curve(values, curves)
    assert steps[-1] == curves.num_steps.min()
    last = [row[np.searchsorted(ends[np.isfinite(ends)], steps[-1], side="right") - 1]
            for row, ends in zip(values, curves.ends, strict=True)]  # fmt: skip
    assert band.value[-1] == pytest.approx(np.mean(last))
    assert (band.low <= band.value).all()
    assert (band.value <= band.high).all()


def test_figure_tables_and_report(results: tuple[ResultStore, Experiment]) -> None:
    """A figure of all panels, and two tables beside it, of which the one of all runs is on the page."""
    store, experiment = results
    written = draw_figures(store, experiment)
    names = [Path(path).name for path in written]
    assert names == ["overtaking.png", "overtaking.svg", "overtaking_switch.csv", "overtaking_switch_runs.csv"]
    assert np.asarray(Image.open(written[0]).convert("L")).std() > 10
    table = pd.read_csv(written[2])
    assert table.columns.tolist()[:8] == [
        "arm",
        "minus",
        "sweep",
        "reading",
        "unit",
        "runs",
        "without_crossover",
        "censored",
    ]
    assert len(pd.read_csv(written[3])) == 3 * 6
    store.write_table(
        "summary.parquet", pa.table({"arm": ["Q"], "sweep": [""], "runs": [6], "episodes": [1], "steps": [1]})
    )
    page = Path(write_report(store)).read_text()
    assert page.count('<img src="data:image/svg+xml;base64,') == 1
    assert "<td class='name'>SSBAS − APEL, in episodes</td>" in page


def test_figure_without_a_switch(results: tuple[ResultStore, Experiment], tmp_path: Path) -> None:
    """Of two ensembles' learners, without marks and tables."""
    store, _ = results
    spec = tmp_path / "plots.yaml"
    plots = PLOT.replace("learners_of: [APEL]", "learners_of: [APEL, SSBAS]").partition(", switch:")[0] + "}"
    spec.write_text(SPEC + plots)
    names = [Path(path).name for path in draw_figures(store, load_experiment(str(spec)))]
    assert names == ["overtaking.png", "overtaking.svg"]


def test_figure_of_arms_that_are_not_there_yet(results: tuple[ResultStore, Experiment], tmp_path: Path) -> None:
    """Of a job that was interrupted before any of them ended: there is none."""
    store, _ = results
    spec = tmp_path / "plots.yaml"
    late = SPEC.replace("arms:\n", "arms:\n  late: {learners: [Q]}\n")
    spec.write_text(late + "\n  - {kind: curves, name: overtaking, clock: steps, panels: [return], arms: [late]}")
    assert draw_figures(store, load_experiment(str(spec))) == []


def test_figure_of_what_was_played(small: Path, tmp_path: Path) -> None:
    """Rows as the program writes them, where selectors know no probability (null), and runs end after other steps."""
    text = small.read_text().replace("  APEL: {", "  Q_red: {learners: [Q_red]}\n  APEL: {", 1)
    plot = PLOT.replace("learners_of: [APEL]", "learners_of: [APEL, SSBAS]")
    small.write_text(text + "plots:" + plot.replace("early: Q", "early: Q_red").replace("late: DQN", "late: Q_full"))
    experiment = load_experiment(str(small))
    store = run_experiment(experiment, Settings(results=str(tmp_path / "results"), placement="local")).store
    plot, curves = experiment.plots[0], read_curves(store.folder, "SSBAS", "", ["probability", "concentration"])
    assert isinstance(plot, CurvePlot)
    assert curves is not None
    shown = panels_of(plot, {("SSBAS", ""): curves})
    assert shown == [("return", None), ("probability", "SSBAS")]  # it has no concentration
    table = pd.read_csv(draw_figures(store, experiment)[2])
    assert set(table["arm"]) == {"APEL", "SSBAS"}
    counted = table[(table["unit"] == "episodes") & table["minus"].isna()]
    assert (counted["runs"] + counted["without_crossover"] == experiment.runs).all()


def test_steps_of_a_part_of_the_episodes_are_refused(tmp_path: Path) -> None:
    """In the figure and in the ledger: nobody knows at which step an episode ended."""
    store, experiment = write_results(tmp_path, Scale(runs=2, steps=4000, overtakes=1000))
    file = next((tmp_path / "results/episodes/arm=APEL").iterdir())
    table = pq.read_table(file)
    pq.write_table(table.filter(pa.compute.not_equal(table["episode"], 5)), file)
    with pytest.raises(SpecError, match=r"overtaking: figure overtaking over steps: found 2 of 2 runs .* record: all"):
        draw_figures(store, experiment)
    for statistic in (DELAY, RETURN | {"of": "mean", "arms": ["APEL"]}):
        with pytest.raises(SpecError, match=r"claim one: found .* not recorded, expected record: all"):
            evaluate([about(statistic)], [store], {"overtaking": experiment})


DELAY = {
    "of": "mean",
    "metric": "switch_delay",
    "arms": ["APEL"],
    "switch": {"early": "Q", "late": "DQN", "window": 50},
}
RETURN = {"of": "difference", "metric": "return", "arms": ["DQN", "Q"], "parts": [[0.9, 1]]}


def about(statistic: dict[str, Any], threshold: float = 0.0, direction: str = "above") -> Any:
    return claim(experiment="overtaking", statistic=statistic, direction=direction, threshold=threshold)


def verdict(results: tuple[ResultStore, Experiment], statistic: dict[str, Any], **fields: Any) -> Verdict:
    (found,) = evaluate([about(statistic, **fields)], [results[0]], {"overtaking": results[1]})
    return found


def test_claims_on_delays(results: tuple[ResultStore, Experiment]) -> None:
    """The numbers of the rows; censored runs count with their bound, and the note says so."""
    rows = switch_data(*results).rows()
    delays = rows.pivot_table(index="run_index", columns="arm", values=["delay", "delay_share", "delay_steps"])
    for metric in ("delay", "delay_share", "delay_steps"):
        found = verdict(results, DELAY | {"metric": f"switch_{metric}"})
        assert found.estimate is not None
        assert found.estimate.value == pytest.approx(delays[metric]["APEL"].mean())
    later = verdict(results, DELAY | {"of": "difference", "arms": ["SSBAS", "APEL"]})
    assert (later.ruling, later.num_censored, later.note) == ("undecided", 0, "6 runs are too few to decide")
    assert later.estimate is not None
    assert rule(later.claim, later.estimate, MIN_RUNS) == "holds"
    never = verdict(results, DELAY | {"arms": ["SSBAS_normalised"]})
    assert (never.num_runs, never.num_censored) == (6, 6)
    assert never.note == "6 of 6 runs at the cap: their times are lower bounds; 6 runs are too few to decide"
    assert str(later.claim.statistic) == "difference of switch_delay: SSBAS, APEL; Q to DQN"


def test_claims_on_parts_of_the_steps(results: tuple[ResultStore, Experiment]) -> None:
    """The mean over the episodes that end in the part of the run's own steps; several parts are an axis."""
    store, _ = results
    at_end = verdict(results, RETURN)
    expected = []
    for arm in ("DQN", "Q"):
        curves = read_curves(store.folder, arm, "", ["return", "length"])
        assert curves is not None
        inside = curves.ends > 0.9 * curves.num_steps[:, None]
        expected.append(np.nanmean(np.where(inside, curves.values("return"), np.nan), axis=1).mean())
    assert at_end.estimate is not None
    assert at_end.estimate.value == pytest.approx(expected[0] - expected[1])
    assert rule(at_end.claim, at_end.estimate, MIN_RUNS) == "holds"
    early = verdict(results, RETURN | {"parts": [[0, 0.1]]}, direction="below")
    assert early.estimate is not None
    assert rule(early.claim, early.estimate, MIN_RUNS) == "holds"
    rise = verdict(results, RETURN | {"parts": [[0, 0.1], [0.9, 1]], "over": "rise"})
    assert rise.estimate is not None
    assert rise.estimate.value == pytest.approx(at_end.estimate.value - early.estimate.value)
    assert str(at_end.claim.statistic) == "difference of return: DQN, Q; 90 to 100 % of the steps"


def test_claims_on_what_is_not_there(results: tuple[ResultStore, Experiment]) -> None:
    """No crossover is a missing result; an arm that is no ensemble of the two, or a role of no learner, is misnamed."""
    turned = verdict(results, DELAY | {"switch": {"early": "DQN", "late": "Q"}})
    assert (turned.ruling, turned.note) == ("missing", "overtaking: no run in which Q stays above DQN in the end")
    with pytest.raises(SpecError, match=r"claim one: switch.late: found 'DQQ', expected one of"):
        verdict(results, DELAY | {"switch": {"early": "Q", "late": "DQQ"}})
    with pytest.raises(
        SpecError, match=r"claim one: switch.early: found 'APEL' of 2 learners, expected an arm of a sin"
    ):
        verdict(results, DELAY | {"switch": {"early": "APEL", "late": "DQN"}})
    assert verdict(results, DELAY | {"arms": ["Q"]}).note.startswith("overtaking: no recorded episodes of Q beside")


@pytest.mark.parametrize(
    ("statistic", "message"),
    [
        (DELAY | {"switch": None}, "switch: expected for"),
        (RETURN | {"switch": DELAY["switch"]}, "switch: expected for"),
        (RETURN | {"parts": []}, "episodes: expected for"),
        (RETURN | {"episodes": [[0, 9]]}, "parts: found beside episodes, expected one of them"),
        (RETURN | {"parts": [[0.5, 1], [0, 0.5]], "over": "rise"}, "episodes: expected windows in order"),
        (RETURN | {"parts": [[0, 2]]}, "less than or equal to 1"),
    ],
)
def test_statistics_that_say_nothing(statistic: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        about(statistic)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("early: Q", "early: R", "switch.early: found 'R', expected one of ['APEL', 'DQN'"),
        ("late: DQN", "late: Q", "switch.late: found 'Q' in both roles, expected two different arms"),
        ("early: Q", "early: APEL", "switch.early: found 'APEL' of 2 learners, expected an arm of a single one"),
        ("learners: [Q, DQN]", "learners: {Q: 2}", "switch: found no ensemble of DQN and Q, expected one with both"),
        ("learners_of: [APEL]", "learners_of: [APEX]", "learners_of: found 'APEX', expected one of ['APEL'"),
        ("learners_of: [APEL],", "", "panels: found probability of 5 arms, expected exactly one arm"),
        ("clock: steps", "clock: episodes", "learners_of: found with clock: episodes, expected only with clock: steps"),
        (
            "smooth: 1",
            "switch_episode: 1",
            "switch_episode: found with clock: steps, expected only with clock: episodes",
        ),
        ("record: all", "record: log", "clock: found steps where not every episode is recorded, expected record: all"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_a_run(tmp_path: Path, old: str, new: str, message: str) -> None:
    """One line, with the line of the file."""
    file = tmp_path / "wrong.yaml"
    file.write_text((SPEC + PLOT).replace(old, new))
    with pytest.raises(SpecError) as caught:
        check(Plan.of(load_experiment(str(file))))
    assert re.search(rf"wrong.yaml:\d+: plots.0.{re.escape(message)}", str(caught.value))
    assert len(str(caught.value).splitlines()) == 1
