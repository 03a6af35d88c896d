"""Figures: every kind is drawn, from the rows that it asks for, and always alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pytest
from PIL import Image

from jobs.analysis.plotting import line_plots, style
from jobs.analysis.plotting.figures import draw_figures
from jobs.analysis.plotting.samples import Sample, samples, selected
from jobs.analysis.recorded_episodes import Curves, moving_mean
from jobs.experiment.figures import ArmPlot, LinePlot
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment, shipped_experiments
from jobs.experiment.yaml_source import SpecError
from jobs.results.storage import Folder
from jobs.results.store import ResultStore
from jobs.runner import Settings, run_experiment

SPEC = """
name: synthetic
runs: 8
episodes: 100
environment: {id: apel/Maze-v0, options: {optimal_length: [16, 18]}}
learners:
  Q_1: {type: q_learning, exploration: 0.4}
  Q_2: {type: q_learning, exploration: {before: 0.8, episode: 20, after: 0.01}}
arms:
  Q_1: {learners: [Q_1]}
  Q_2: {learners: [Q_2]}
  APEL: {learners: [Q_1, Q_2], selector: {type: apel, decay: 0.01}}
hindsight: {oracle: [Q_1, Q_2]}
sweep:
  decay: {arms.APEL.selector.decay: [0.0, 0.01, 0.1]}
  window: {criterion.window: [10, 20]}
criterion: {measure: length, window: 10, below: {factor: 1.1, info: optimal_length}, after: 20}
steady_state_episodes: 10
record: none
plots:
"""

EPISODES = """
  - {kind: curves, name: learners, arms: [APEL], panels: [return, length, concentration, probability],
     switch_episode: 30, theory: [growth_formula]}
  - {kind: curves, name: arms, panels: [return], smooth: 5}
"""


def write_spec(path: Path, plots: str) -> str:
    """The file of the synthetic experiment with these plots."""
    file = path / "synthetic.yaml"
    file.write_text(SPEC + plots)
    return str(file)


def synthetic(path: Path, plots: str) -> tuple[ResultStore, Experiment]:
    """Made-up rows of the synthetic experiment."""
    draws = np.random.default_rng(0)
    rows = []
    for arm, decays in (("Q_1", [None]), ("Q_2", [None]), ("APEL", [0.0, 0.01, 0.1]), ("oracle", [None])):
        for decay in decays:
            for window in (10, 20):
                label = f"window={window}" if decay is None else f"decay={decay}, window={window}"
                for run, time in enumerate(draws.integers(30, 120, 8)):
                    rows.append(
                        {
                            "arm": arm,
                            "sweep": label,
                            "run_index": run,
                            "train_time": min(int(time), 100),
                            "censored": bool(time > 100),
                            "adaptation_time": min(int(time), 100) - 20,
                            "steady_state": -float(time) * (10 if arm == "Q_2" else 1),
                            "decay": decay,
                            "window": window,
                        }
                    )
    store = ResultStore(Folder(str(path / "results")))
    store.write_table("runs.parquet", pa.Table.from_pylist(rows))
    return store, load_experiment(write_spec(path, plots))


def pictures(paths: list[str]) -> dict[str, bytes]:
    """Content by file name; every PNG shows something."""
    for path in paths:
        if path.endswith(".png"):
            assert np.asarray(Image.open(path).convert("L")).std() > 10
    return {Path(path).name: Path(path).read_bytes() for path in paths}


PLOTS = """
  - {kind: bars, name: upright, where: {window: [10], decay: [0.01]}}
  - {kind: bars, name: lying, metric: steady_state}
  - {kind: bars, name: panels, arms: [Q_1, Q_2, oracle, APEL], metric: adaptation_time}
  - {kind: distributions, name: distributions, arms: [oracle, Q_1], metric: adaptation_time}
  - {kind: survival, name: survival, arms: [Q_1, oracle]}
  - {kind: lines, name: over_decay, x: decay, x_scale: log, y_scale: log, metric: adaptation_time,
     arms: [APEL], theory: [adaptation_formula, adaptation_model]}
  - {kind: lines, name: level, x: decay, metric: steady_state, theory: [performance_formula, performance_model],
     returns: [-2.3, -100.0]}
  - {kind: lines, name: split, x: window, metric: train_time}
"""


def test_dollars_are_no_formula(tmp_path: Path) -> None:
    """A user's title and labels may hold any text; the numbers of a logarithmic axis are still drawn as powers."""
    hostile = r"$\undefined{$ and $x$"
    with style.pyplot() as plt:
        figure, axes = plt.subplots()
        axes.loglog([1, 1000], [1, 1000], label=hostile)
        axes.set_xlabel(hostile)
        axes.legend()
        style.title(figure, hostile)
        written = style.save(Folder(str(tmp_path)), figure, "hostile")
        assert all(Path(path).exists() for path in written)
        assert any("mathdefault" in label.get_text() for label in axes.get_xticklabels())


def test_every_kind_over_arms_is_drawn(tmp_path: Path) -> None:
    """PNG and SVG of every plot, byte for byte the same when drawn again."""
    store, experiment = synthetic(tmp_path, PLOTS)
    first = pictures(draw_figures(store, experiment))
    assert set(first) == {f"{plot.name}.{kind}" for plot in experiment.plots for kind in ("png", "svg")}
    assert b"<dc:date>" not in first["upright.svg"]
    some = [plot for plot in experiment.plots if plot.name in ("upright", "over_decay")]
    again = pictures(draw_figures(store, experiment.model_copy(update={"plots": some})))
    assert again.items() <= first.items()


def test_curves_are_drawn_of_recorded_episodes(small: Path, tmp_path: Path) -> None:
    """Of arms, of learners; nothing where no episodes were recorded."""
    small.write_text(small.read_text() + "plots:" + EPISODES)
    experiment = load_experiment(str(small))
    settings = Settings(results=str(tmp_path / "results"), placement="local")
    store = run_experiment(experiment, settings).store
    drawn = pictures(draw_figures(store, experiment))
    assert set(drawn) == {"learners.png", "learners.svg", "arms.png", "arms.svg"}
    store.folder.delete_folder("episodes")
    assert draw_figures(store, experiment) == []


def test_a_single_run_is_no_mean(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its curve is called what it is, without a spread that it does not have."""
    told: list[str] = []
    monkeypatch.setattr(style, "title", lambda _figure, _title, how: told.append(how))
    plots = "plots=[{kind: curves, name: returns, panels: [return], smooth: 5}]"
    experiment = load_experiment(str(small), [plots, "record=all", "runs=1"])
    store = run_experiment(experiment, Settings(results=str(tmp_path), placement="local")).store
    draw_figures(store, experiment)
    assert told == ["a single run, moving mean of 5 recorded episodes"]


def test_train_times_are_drawn_where_nothing_is_named(tmp_path: Path) -> None:
    """Bars and distributions; nothing where an experiment has no criterion either."""
    store, experiment = synthetic(tmp_path, " []")
    runs = store.runs()
    store.write_table("runs.parquet", runs.filter(pa.compute.equal(runs["arm"], "oracle")))
    drawn = pictures(draw_figures(store, experiment))
    assert {"train_time.png", "train_time_distribution.svg"} < set(drawn)
    assert draw_figures(store, experiment.model_copy(update={"criterion": None})) == []


@pytest.mark.parametrize(
    ("values", "names"), [([None, "x", "y"], ["None", "x", "y"]), ([None, 1, 2], ["None", "1", "2"])]
)
def test_null_is_a_place_of_its_own(tmp_path: Path, values: list[object], names: list[str]) -> None:
    """Of an arm that the axis touches, on the axis and among the variants; arms that it does not touch are level."""
    _, experiment = synthetic(tmp_path, " []")
    tags = [None, None, *values, *values]
    rows = {
        "arm": ["Q_1"] * 2 + ["Q_2"] * 6,
        "sweep": [str(tag) for tag in tags],
        "train_time": [5, 7, 10, 20, 30, 12, 22, 32],
        "censored": [False] * 8,
        "decay": tags,
        "window": [10] * 8,
    }
    places = []
    for x, other in (("decay", "window"), ("window", "decay")):
        plot = LinePlot(kind="lines", name="a", metric="train_time", x=x)
        swept = experiment.model_copy(update={"sweep": {x: [], other: []}})
        with style.pyplot() as plt:
            (axes,) = line_plots.draw(plt, pa.table(rows), plot, swept).axes
        labels = [line.get_label() for line in axes.get_lines() if not line.get_label().startswith("_")]
        places.append((labels, [label.get_text() for label in axes.get_xticklabels()]))
    assert places[0][1] == names
    assert len(places[1][0]) == 1 + len(names)


def test_rows_are_picked_and_ordered(tmp_path: Path) -> None:
    """`arms` orders; `where` compares numbers and text alike, and keeps rows without a value."""
    store, experiment = synthetic(tmp_path, " []")
    plot = ArmPlot(kind="bars", name="x", arms=["oracle", "APEL"], where={"decay": ["0.010", 0.1], "window": ["10"]})
    shown = samples(selected(store.runs(), plot, experiment), "adaptation_time")
    assert [one.label for one in shown] == [
        "oracle\nwindow=10",
        "APEL\ndecay=0.01, window=10",
        "APEL\ndecay=0.1, window=10",
    ]
    runs = store.runs().to_pandas()
    rows = runs[(runs["arm"] == "oracle") & (runs["window"] == 10)]
    assert shown[0].mean == pytest.approx(rows["adaptation_time"].mean())
    assert shown[0].num_censored == rows["censored"].sum()


@pytest.mark.parametrize("name", [*shipped_experiments()])
def test_colours_are_told_apart(name: str) -> None:
    """Arms of one figure differ, and so do the learners of one; a learner alone looks as it does in an ensemble."""
    experiment = load_experiment(name)
    palette = style.colours(experiment)
    shares_colours = bool(style.kinds(experiment))
    assert shares_colours or len(set(palette.values())) == len(palette)
    for arm, spec in experiment.arms.items():
        found = dict(zip(spec.learner_names, style.learner_colours(experiment, arm), strict=False))
        assert len(set(style.learner_colours(experiment, arm))) == min(len(spec.learner_names), len(style.COLOURS))
        if not shares_colours and len(found) == len(spec.learner_names):
            assert all(
                found[learner] == palette[learner] for learner in {"Q_full", "Q_red"} & set(found) & set(palette)
            )


@pytest.mark.parametrize(
    ("values", "spread"),
    [
        # Mean 40, deviation 20: three at the cap of 50, which no whisker may pass.
        ([50.0, 50.0, 50.0, 10.0], (20.0, 50.0)),
        # Mean 20, deviation 20: none took fewer than 10.
        ([10.0, 10.0, 10.0, 50.0], (10.0, 40.0)),
        ([7.0], (7.0, 7.0)),
    ],
)
def test_no_spread_beyond_the_runs(values: list[float], spread: tuple[float, float]) -> None:
    """Mean and standard deviation, but not beyond what any run has, such as a time above the cap."""
    sample = Sample("APEL", "", np.array(values), np.zeros(len(values), dtype=np.bool_))
    assert sample.spread == pytest.approx(spread)


def test_curves_know_of_runs_that_ended() -> None:
    """Then a mean is over those that are left, and the figure has to say so."""
    whole = {"run_index": [0, 0, 1, 1], "episode": [0, 1, 0, 1], "return": [1.0, 2.0, 3.0, 4.0]}
    assert not Curves(pa.table(whole)).has_ended_runs
    assert Curves(pa.table({name: column[:3] for name, column in whole.items()})).has_ended_runs


def test_moving_mean_is_of_each_run() -> None:
    """Of the last values, fewer at the beginning; what is unknown stays so and does not count."""
    values = np.array([[1.0, 3.0, 5.0, 7.0], [2.0, np.nan, 4.0, 8.0]])
    np.testing.assert_array_equal(moving_mean(values, 2), [[1.0, 2.0, 4.0, 6.0], [2.0, np.nan, 4.0, 6.0]])


@pytest.mark.parametrize(
    ("plot", "message"),
    [
        ("{kind: bars, name: a, arms: [Q_3]}", "plots.0.arms: found 'Q_3', expected one of ['APEL', 'Q_1'"),
        ("{kind: bars, name: a, where: {decays: [0.1]}}", "plots.0.where: found 'decays', expected one of ['decay'"),
        ("{kind: lines, name: a, metric: train_time, x: nu}", "plots.0.x: found 'nu', expected one of ['decay', 'wi"),
        ("{kind: lines, name: a, metric: adaptation_time, x: window, theory: [adaptation_model]}", "an axis of decays"),
        ("{kind: lines, name: a, metric: steady_state, x: decay, theory: [adaptation_model]}", "of what is drawn"),
        ("{kind: curves, name: a, panels: [concentration]}", "found concentration of 4 arms, expected exactly one arm"),
        (
            "{kind: curves, name: a, panels: [return], theory: [performance_model]}",
            "expected one of ['growth_formula']",
        ),
        ("{kind: bars, name: a}\n  - {kind: bars, name: a}", "plots.1.name: found 'a' for a second time"),
    ],
)
def test_what_cannot_be_drawn_is_refused(tmp_path: Path, plot: str, message: str) -> None:
    """One line, with the line of the file."""
    with pytest.raises(SpecError) as caught:
        load_experiment(write_spec(tmp_path, f"  - {plot}"))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert "synthetic.yaml:2" in str(caught.value)


def test_shipped_plots_can_be_drawn() -> None:
    """Names and axes of all of them are known."""
    assert all(load_experiment(name).plots for name in shipped_experiments())
