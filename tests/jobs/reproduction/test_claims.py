"""The ledger: verdicts at the edges, what is missing or misnamed, and the claims that are shipped."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console
from scipy import stats
from typer.testing import CliRunner

from jobs.analysis.statistics.bootstrap import Estimate
from jobs.cli.main import app
from jobs.experiment.figures import check_roles
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment, shipped_experiments, shipped_texts
from jobs.experiment.yaml_source import SpecError
from jobs.reproduction.claims import claim_files
from jobs.reproduction.claims.claim import Claim
from jobs.reproduction.claims.claim_files import judged_experiments, read_claims, shipped_claims
from jobs.reproduction.claims.judging import Verdict, evaluate, rule
from jobs.reproduction.claims.ledger import (
    claims_markdown,
    claims_table,
    corrected_count_line,
    count_line,
    source_lines,
    verdict_table,
)
from jobs.reproduction.claims.stored_results import found_stores
from jobs.reproduction.claims.theories import setting_of
from jobs.results.store import ResultStore, StoreError
from tests.jobs.reproduction.ledger import DIFFERENCE, claim

REPRODUCTION = Path(__file__).parents[3] / "docs" / "reproduction"
SHARE = {"of": "share", "metric": "train_time", "arms": ["APEL"], "censored": True}


def judge(claims: list[Claim], stores: list[ResultStore]) -> list[Verdict]:
    """Verdicts on claims about shipped experiments."""
    return evaluate(claims, stores, judged_experiments(claims))


def stored(
    root: Path, name: str, rows: dict[str, list[Any]], folder: str = "one", overrides: Sequence[str] = ()
) -> ResultStore:
    """Results with just the rows of interest."""
    store = ResultStore.at(str(root / name / folder))
    store.folder.write("spec.yaml", load_experiment(name, overrides).to_yaml().encode())
    store.write_table("runs.parquet", pa.table(rows))
    return store


def two_arms(num_runs: int = 20, faster: float = 5.0, num_censored: int = 0) -> dict[str, list[Any]]:
    """SSBAS takes 100, 101, … episodes and APEL fewer; the first runs of APEL are censored."""
    times = 100.0 + np.arange(num_runs)
    censored = [index < num_censored for index in range(num_runs)]
    return {
        "arm": ["APEL"] * num_runs + ["SSBAS"] * num_runs,
        "sweep": [""] * 2 * num_runs,
        "run_index": [*range(num_runs)] * 2,
        "train_time": [*(times - faster), *times],
        "censored": censored + [False] * num_runs,
    }


@pytest.mark.parametrize(
    ("direction", "threshold", "interval", "expected"),
    [
        ("below", 0, (-2, -1), "holds"),
        ("below", 0, (-2, 0), "undecided"),
        ("below", 0, (0, 0), "fails"),
        ("below", 0, (0, 2), "fails"),
        ("above", 0, (1, 2), "holds"),
        ("above", 0, (0, 2), "undecided"),
        ("above", 0, (-2, 0), "fails"),
        ("between", (1, 2), (1, 2), "holds"),
        ("between", (1, 2), (1, 2.1), "undecided"),
        ("between", (1, 2), (2.1, 3), "fails"),
        ("between", (1, 2), (0, 0.9), "fails"),
        ("above", 0, (-np.inf, np.inf), "undecided"),
    ],
)
def test_rule(direction: str, threshold: Any, interval: tuple[float, float], expected: str) -> None:
    one = claim(direction=direction, threshold=threshold)
    estimate = Estimate(sum(interval) / 2, *map(float, interval))
    assert rule(one, estimate, 100) == expected
    assert rule(one, estimate, 19) == "undecided"


@pytest.mark.parametrize(
    ("direction", "value", "num_runs", "expected"),
    [
        ("every", 1.0, 100, "holds"),
        ("every", 0.99, 100, "fails"),
        ("none", 0.0, 100, "holds"),
        ("none", 0.01, 100, "fails"),
        ("none", 0.0, 2, "undecided"),
        ("none", 0.5, 2, "fails"),
    ],
)
def test_rule_of_all_runs(direction: str, value: float, num_runs: int, expected: str) -> None:
    one = claim(direction=direction, threshold=None, statistic=SHARE)
    assert rule(one, Estimate(value, 0.0, 1.0), num_runs) == expected


def test_a_verdict(tmp_path: Path) -> None:
    (verdict,) = judge([claim()], [stored(tmp_path, "distractor-maze", two_arms(num_censored=2))])
    assert verdict.ruling == "holds"
    assert verdict.estimate == pytest.approx((-5, -5, -5))
    assert (verdict.num_runs, verdict.num_censored) == (20, 2)
    assert verdict.note == "2 of 20 runs at the cap: their times are lower bounds"
    (row,) = claims_table([verdict]).to_pylist()
    assert (row["verdict"], row["value"], row["threshold_low"], row["threshold_high"]) == ("holds", -5, None, 0)
    page = claims_markdown([verdict])
    assert "1 claims: 1 holds, 0 fails, 0 undecided, 0 missing. After Holm's correction over the 1 " in page
    assert "| APEL is faster \\| than SSBAS. |" in page


def test_verdicts_after_correction(tmp_path: Path) -> None:
    """Of 20 differences with the mean −1 those of the first vary by s = 2.1 (t = 2.13), of the second by a tenth of it.

    The smaller p counts twice, the other once. That a share of the runs is none is certain, or not, and is no test.
    """
    spread = np.linspace(-1, 1, 20) / np.linspace(-1, 1, 20).std(ddof=1)
    rows = {key: values * 2 for key, values in two_arms().items()}
    rows["arm"] = [arm for arm in ("APEL", "SSBAS", "Q_red", "Q_full") for _ in range(20)]
    rows["train_time"] = [*(99 + 2.1 * spread), *[100.0] * 20, *(99 + 0.21 * spread), *[100.0] * 20]
    certain = claim(id="two", statistic=DIFFERENCE | {"arms": ["Q_red", "Q_full"]})
    none = claim(id="three", statistic=SHARE, direction="none", threshold=None)
    verdicts = judge([claim(), certain, none], [stored(tmp_path, "distractor-maze", rows)])
    assert [verdict.ruling for verdict in verdicts] == ["holds", "holds", "holds"]
    first, second, third = verdicts
    assert first.p_value == pytest.approx(2 * stats.t.sf(20**0.5 / 2.1, 19), rel=0.2)
    assert first.corrected_p_value == first.p_value
    assert second.p_value is not None
    assert second.corrected_p_value == 2 * second.p_value < 1e-4
    assert (third.p_value, third.corrected_p_value) == (None, None)


def test_what_is_doubtful_has_a_star() -> None:
    """And is counted as undecided after the correction."""
    verdicts = [
        Verdict(claim(), "fails", Estimate(1.0, 0.5, 1.5), 100, p_value=0.03, corrected_p_value=0.06),
        Verdict(claim(id="two"), "holds", Estimate(-1.0, -1.5, -0.5), 100, p_value=1e-9, corrected_p_value=2e-9),
        Verdict(claim(id="three"), "missing"),
    ]
    assert count_line(verdicts) == "3 claims: 1 holds, 1 fails, 0 undecided, 1 missing"
    assert corrected_count_line(verdicts).endswith(
        "the 2 that an interval decides: 1 holds, 0 fails, 1 undecided, 1 missing"
    )
    assert claims_table(verdicts)["corrected_verdict"].to_pylist() == ["undecided", "holds", "missing"]
    shown = io.StringIO()
    Console(file=shown, width=200).print(verdict_table(verdicts))
    assert [line.split()[:6] for line in shown.getvalue().splitlines()[3:5]] == [
        ["one", "1", "0.5", "to", "1.5", "<"],
        ["two", "-1", "-1.5", "to", "-0.5", "<"],
    ]
    assert "fails* 0.06" in re.sub(" +", " ", shown.getvalue())
    assert "holds < 0.0001" in re.sub(" +", " ", shown.getvalue())
    assert "| fails | 0.06 | undecided | open |" in claims_markdown(verdicts)


def test_shares(tmp_path: Path) -> None:
    store = stored(tmp_path, "distractor-maze", two_arms(num_censored=2))
    statistics = [SHARE, SHARE | {"below": 97.0}, SHARE | {"censored": False, "below": 97.0}]
    claims = [claim(direction="none", threshold=None, statistic=statistic) for statistic in statistics]
    # Censored are runs 0 and 1; 95 and 96 are below 97, which are these two.
    assert [verdict.estimate.value for verdict in judge(claims, [store]) if verdict.estimate] == [0.1, 0.1, 0.1]


def test_points_and_pools(tmp_path: Path) -> None:
    """Two runs, decays 0.01 and 0.1, two switch points: pooled means 150 and 15; SSBAS knows no decay."""
    times = {(0.01, 1000): 100, (0.01, 5000): 200, (0.1, 1000): 10, (0.1, 5000): 20}
    keys = [(run, decay, switch) for run in range(2) for decay, switch in times]
    rows = {
        "arm": ["APEL"] * 8 + ["SSBAS"] * 4,
        "sweep": [f"{decay} {switch}" for _, decay, switch in keys] + ["1000", "5000"] * 2,
        "run_index": [run for run, _, _ in keys] + [0, 0, 1, 1],
        "decay": [decay for _, decay, _ in keys] + [None] * 4,
        "switch_episode": [switch for _, _, switch in keys] + [1000, 5000] * 2,
        "adaptation_time": [times[decay, switch] for _, decay, switch in keys] + [300, 400] * 2,
        "censored": [False] * 12,
    }
    store = stored(tmp_path, "adaptation-time", rows)
    pooled = {"of": "mean", "metric": "adaptation_time", "arms": ["APEL"], "axis": "decay", "pool": ["switch_episode"]}
    against = {"of": "difference", "metric": "adaptation_time", "arms": ["SSBAS", "APEL"], "where": {"decay": 0.1}}
    claims = [
        claim(experiment="adaptation-time", statistic=pooled | {"over": "growth", "values": [0.1, 0.01]}),
        claim(experiment="adaptation-time", statistic=against | {"over": "largest", "axis": "switch_episode"}),
    ]
    found = judge(claims, [store])
    assert [verdict.estimate.value for verdict in found if verdict.estimate] == pytest.approx([150 / 15, 400 - 20])
    ambiguous = claim(experiment="adaptation-time", statistic={**against, "where": {}})
    with pytest.raises(SpecError, match="claim one: found several rows of a run of SSBAS"):
        judge([ambiguous], [store])


def test_runs_in_which_another_arm_gets_there(tmp_path: Path) -> None:
    """Q_red meets the cap in the last two runs of four: APEL takes 1 and 2 episodes in the others, 3 and 4 there."""
    rows = {
        "arm": ["APEL"] * 4 + ["Q_red"] * 4,
        "sweep": [""] * 8,
        "run_index": [*range(4)] * 2,
        "train_time": [1.0, 2.0, 3.0, 4.0, 2.0, 4.0, 5000.0, 5000.0],
        "censored": [False] * 6 + [True] * 2,
    }
    store = stored(tmp_path, "distractor-maze", rows)
    alone = {"of": "mean", "metric": "train_time", "arms": ["APEL"]}
    claims = [claim(statistic=alone | {"given": {"arm": "Q_red", "censored": censored}}) for censored in (False, True)]
    able, unable = judge(claims, [store])
    assert able.estimate
    assert unable.estimate
    assert (able.num_runs, able.estimate.value, unable.num_runs, unable.estimate.value) == (2, 1.5, 2, 3.5)
    assert [str(one.statistic) for one in claims] == [
        "mean of train_time: APEL; where Q_red gets there",
        "mean of train_time: APEL; where Q_red meets the cap",
    ]
    never = claim(statistic=alone | {"given": {"arm": "APEL", "censored": True}})
    assert judge([never], [store])[0].ruling == "missing"
    with pytest.raises(SpecError, match="claim one: found arm 'red', expected some of"):
        judge([claim(statistic=alone | {"given": {"arm": "red", "censored": True}})], [store])


def test_recorded_episodes(tmp_path: Path) -> None:
    """Concentrations of the second learner are 10 · run + episode: windows 0–1 and 4–5 of run 0 and 1."""
    rows = {key: values[:2] for key, values in two_arms(2).items()}
    store = stored(tmp_path, "selection-behaviour", rows)
    keys = [(run, episode) for run in range(2) for episode in range(6)]
    table = {
        "sweep": [""] * 12,
        "run_index": [run for run, _ in keys],
        "episode": [episode for _, episode in keys],
        "concentration": [[1.0, 10.0 * run + episode] for run, episode in keys],
    }
    store.write_table("episodes/arm=APEL/000000-000001.parquet", pa.table(table))
    of = {"of": "mean", "metric": "concentration", "learner": 1, "arms": ["APEL"]}
    claims = [
        claim(experiment="selection-behaviour", statistic=of | {"episodes": [[0, 1]]}),
        claim(experiment="selection-behaviour", statistic=of | {"episodes": [[0, 1], [4, 5]], "over": "rise"}),
        claim(
            experiment="selection-behaviour",
            statistic=of | {"episodes": {"first": 0, "last": 5, "every": 5}, "over": "slope"},
        ),
    ]
    found = [verdict.estimate.value for verdict in judge(claims, [store]) if verdict.estimate]
    assert found == pytest.approx([5.5, 4, 1])


def test_what_is_missing(tmp_path: Path) -> None:
    rows = {key: values[:10] for key, values in two_arms().items()}
    found = judge([claim(), claim(experiment="steady-state")], [stored(tmp_path, "distractor-maze", rows)])
    assert [verdict.ruling for verdict in found] == ["missing", "missing"]
    assert [verdict.note for verdict in found] == ["distractor-maze: no runs of SSBAS", "steady-state: no results"]
    assert count_line(found).endswith("2 missing")
    assert claims_table(found)["value"].to_pylist() == [None, None]


@pytest.mark.parametrize(
    ("statistic", "message"),
    [
        (DIFFERENCE | {"arms": ["APEL", "SBAS"]}, "claim one: found arm 'SBAS', expected some of Q_full, Q_red, APEL"),
        (DIFFERENCE | {"metric": "time"}, "claim one: found column 'time', expected some of arm"),
        (DIFFERENCE | {"where": {"decoy": 1}}, "claim one: found column 'decoy'"),
    ],
)
def test_misnamed(tmp_path: Path, statistic: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError, match=message):
        judge([claim(statistic=statistic)], [stored(tmp_path, "distractor-maze", two_arms())])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mean,", "means,", r"mine.yaml:6: statistic.of: Input should be"),
        ("arms: [APEL]", "arms: [APEL, SSBAS]", r"mine.yaml:6: statistic: arms: found 2, expected 1 for mean"),
        ("threshold: 1", "threshold: [1, 2]", r"mine.yaml:2: : threshold: found \(1.0, 2.0\), expected a number"),
        ("direction: above", "direction: over", r"mine.yaml:7: direction"),
        ("threshold: 1", "treshold: 1", r"mine.yaml:8: treshold"),
        ("metric: train_time", "metric: train_time, over: slope", r"over: expected with an axis"),
        (
            "metric: train_time",
            "metric: train_time, axis: n, over: excess",
            "values: expected for excess, the first of them",
        ),
        (
            "direction:",
            "experiment: steady-state\n    direction:",
            r"mine.yaml:7: experiment: .* beside the file",
        ),
    ],
)
def test_claims_that_are_not_valid(old: str, new: str, message: str) -> None:
    text = """claims:
  - id: one
    source: "Fig. 4.7"
    text: Something.
    expected: open
    statistic: {of: mean, metric: train_time, arms: [APEL]}
    direction: above
    threshold: 1
"""
    assert len(read_claims(text, "mine.yaml", "mine")) == 1
    with pytest.raises(SpecError, match=message):
        read_claims(text.replace(old, new), "mine.yaml", "mine")


def test_results_are_found(tmp_path: Path) -> None:
    """Below a root, an experiment's folder, or one of an identity; the newest last."""
    older = stored(tmp_path / "results", "distractor-maze", two_arms(faster=-5), "older")
    newer = stored(tmp_path / "results", "distractor-maze", two_arms(), "newer")
    os.utime(tmp_path / "results/distractor-maze/older/runs.parquet", (1, 1))
    for location in ("results", "results/distractor-maze"):
        found = found_stores([str(tmp_path / location)])
        assert [store.folder.path() for store in found] == [older.folder.path(), newer.folder.path()]
    (found_one,) = found_stores([str(tmp_path / "results/distractor-maze/older")])
    assert found_one.folder.path() == older.folder.path()
    with pytest.raises(StoreError, match="nowhere: found no results"):
        found_stores([str(tmp_path / "nowhere")])


def test_all_at_the_cap_decides_nothing(tmp_path: Path) -> None:
    """A difference of 0 between caps is no difference of 0; where a run got there, it is judged."""
    capped = two_arms(num_runs=20)
    capped["train_time"], capped["censored"] = [5000.0] * 40, [True] * 40
    (verdict,) = judge([claim()], [stored(tmp_path, "distractor-maze", capped)])
    assert (verdict.ruling, verdict.estimate) == ("undecided", (0, 0, 0))
    assert verdict.note.endswith("all are the cap, beyond which nothing is known")
    capped["train_time"] = [4000.0] * 20 + [5000.0] * 20
    capped["censored"] = [False] * 20 + [True] * 20
    (verdict,) = judge([claim()], [stored(tmp_path, "distractor-maze", capped, "two")])
    assert verdict.ruling == "holds"


@pytest.mark.parametrize(
    ("direction", "threshold", "expected"),
    [
        ("above", 4000, "holds"), ("above", 6000, "undecided"), ("below", 4000, "fails"), ("below", 6000, "undecided"),
        ("between", [3000, 4000], "fails"), ("between", [4000, 6000], "undecided"),
        ("between", [6000, 7000], "undecided"),
    ],
)  # fmt: skip
def test_a_mean_of_caps_is_a_lower_bound(tmp_path: Path, direction: str, threshold: Any, expected: str) -> None:
    """Of runs that all took at least 5000 episodes nothing is known that lies beyond."""
    capped = two_arms(num_runs=20)
    capped["train_time"], capped["censored"] = [5000.0] * 40, [True] * 40
    statistic = {"of": "mean", "metric": "train_time", "arms": ["APEL"]}
    stated = claim(statistic=statistic, direction=direction, threshold=threshold)
    (verdict,) = judge([stated], [stored(tmp_path, "distractor-maze", capped)])
    assert verdict.ruling == expected
    assert (verdict.p_value is None) == (expected == "undecided")


DECAY = ["arms.APEL.selector.decay=0.5"]


def test_another_setting_of_the_same_name_is_not_judged(tmp_path: Path) -> None:
    """Neither replaces nor spoils a verdict, wherever it lies and however new it is; alone it leaves it missing."""
    shipped = stored(tmp_path, "distractor-maze", two_arms(), "07d952f82b2f")
    other = stored(tmp_path, "distractor-maze", two_arms(faster=-5), "other", DECAY)
    alone = judge([claim()], [shipped])
    assert [verdict.ruling for verdict in alone] == ["holds"]
    for stores in ([shipped, other], [other, shipped]):
        assert judge([claim()], stores) == alone
    assert judge([claim()], found_stores([str(tmp_path)])) == alone
    (missing,) = judge([claim()], [other])
    identity = load_experiment("distractor-maze", DECAY).identity
    assert (missing.ruling, missing.folder) == ("missing", "")
    assert missing.note == f"distractor-maze: no results of 07d952f82b2f; of another setting: {identity}"
    assert source_lines([missing, missing]) == [missing.note]


def test_a_setting_that_is_as_it_was_played(tmp_path: Path) -> None:
    """The manifest says what the rows are of, whatever is written into the experiment's file afterwards."""
    store = stored(tmp_path, "distractor-maze", two_arms())
    store.write_manifest({"experiment": "distractor-maze", "identity": "0123456789ab"})
    assert [verdict.ruling for verdict in judge([claim()], [store])] == ["missing"]


def test_fewer_runs_are_of_the_same_experiment(tmp_path: Path) -> None:
    """They are judged as far as they go; where there are more of them elsewhere, those are."""
    few = stored(tmp_path, "distractor-maze", two_arms(2), "few", ["runs=2"])
    many = stored(tmp_path, "distractor-maze", two_arms(20), "many", ["runs=20", "title=Twenty"])
    (verdict,) = judge([claim()], [few])
    assert (verdict.ruling, verdict.num_runs, verdict.folder) == ("undecided", 2, few.folder.location())
    for stores in ([few, many], [many, few]):
        (verdict,) = judge([claim()], stores)
        assert (verdict.ruling, verdict.num_runs, verdict.folder) == ("holds", 20, many.folder.location())


def test_hindsight_is_that_of_the_shipped_experiment(tmp_path: Path) -> None:
    """It is no part of an identity, so that rows of another choice may be stored: they are picked anew."""
    metrics = {"train_time": [None] * 15, "adaptation_time": [None] * 15, "censored": [False] * 15}
    rows = {
        "arm": ["Q_norm"] * 5 + ["Q_bad"] * 5 + ["oracle"] * 5,
        "sweep": [""] * 15,
        "run_index": [*range(5)] * 3,
        "steady_state": [-2.0] * 5 + [-90.0] * 10,
        "chosen": [None] * 10 + ["Q_bad"] * 5,
        **metrics,
    }
    statistic = {"of": "mean", "metric": "steady_state", "arms": ["oracle"]}
    one = claim(experiment="tournament-steady-state", statistic=statistic)
    (verdict,) = judge(
        [one], [stored(tmp_path, "tournament-steady-state", rows, overrides=["hindsight.oracle=[Q_bad]"])]
    )
    assert verdict.estimate == (-2, -2, -2)


def test_ledger_says_which_folder(tmp_path: Path) -> None:
    """On the terminal once per experiment, on the page and in the file with each verdict."""
    store = stored(tmp_path, "distractor-maze", two_arms())
    found = judge([claim(), claim(id="two", experiment="steady-state")], [store])
    folder = store.folder.location()
    assert source_lines(found) == [f"distractor-maze: {folder}"]
    assert claims_table(found)["folder"].to_pylist() == [folder, None]
    one, two = claims_markdown(found).splitlines()[-2:]
    assert one.endswith(f"| {folder} |")
    assert two.endswith("| steady-state: no results | - |")


def test_command(tmp_path: Path) -> None:
    """Claims that fail are findings: the command is done all the same. Bad input ends it as everywhere."""
    stored(tmp_path / "results", "distractor-maze", two_arms(faster=-5))
    output = tmp_path / "ledger"
    found = CliRunner().invoke(app, ["claims", str(tmp_path / "results"), "--output", str(output)])
    assert found.exit_code == 0, found.output
    assert sorted(path.name for path in output.iterdir()) == ["claims.md", "claims.parquet"]
    rows = {row["id"]: row["verdict"] for row in pq.read_table(output / "claims.parquet").to_pylist()}
    assert rows["train-time-apel-below-ssbas"] == "fails"
    assert len(rows) == len(shipped_claims())
    assert f"distractor-maze: {tmp_path / 'results' / 'distractor-maze' / 'one'}" in found.output.splitlines()
    assert "steady-state" not in found.output
    left_out = f"{sum(verdict == 'missing' for verdict in rows.values())} claims without results are left out"
    assert left_out in found.output
    every = CliRunner().invoke(app, ["claims", str(tmp_path / "results"), "--all"])
    assert "missing" in every.output
    assert "left out" not in every.output
    nowhere = CliRunner().invoke(app, ["claims", str(tmp_path / "nowhere")])
    assert isinstance(nowhere.exception, StoreError)  # exit code 2


def test_ledger_is_in_the_order_of_the_printed_one() -> None:
    """That of ``docs/reproduction``, which is of the tabular experiments, with the identities of today."""
    printed = pq.read_table(REPRODUCTION / "claims.parquet", columns=["id", "experiment", "identity"]).to_pylist()
    tabular = shipped_experiments("tabular")
    claims = [one for one in shipped_claims() if one.experiment in tabular]
    assert [(one.id, one.experiment) for one in claims] == [(row["id"], row["experiment"]) for row in printed]
    assert {row["experiment"]: row["identity"] for row in printed} == {
        name: experiment.identity for name, experiment in judged_experiments(claims).items()
    }


def test_ledger_and_claims_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """A claim that is in no place of the ledger, in a file twice, or gone from its file is refused."""
    texts = shipped_texts("claims.yaml")

    def holding(name: str, text: str) -> None:
        monkeypatch.setattr(claim_files, "shipped_texts", lambda _: {**texts, name: text})

    holding("ceiling-ties", texts["ceiling-ties"].replace("id: ties-kept-apart", "id: ties-apart"))
    with pytest.raises(SpecError, match="found otherwise than in the files of claims: ties-apart, ties-kept-apart"):
        shipped_claims()
    holding("steady-state", texts["ceiling-ties"])
    with pytest.raises(SpecError, match=r"ceiling-ties/claims\.yaml: id: .* beside steady-state, too"):
        shipped_claims()


def test_shipped_claims_name_what_is_shipped() -> None:
    """A renamed experiment, arm, axis or value breaks this."""
    experiments = {name: load_experiment(name) for name in shipped_experiments()}
    claims = shipped_claims()
    assert len(claims) >= 90
    for one in claims:
        experiment, statistic = experiments[one.experiment], one.statistic
        given = [statistic.given.arm] if statistic.given else []
        assert {*statistic.arms, *given} <= {*experiment.arms, *experiment.hindsight}, one.id
        points = [at.point.values for at in Plan.of(experiment).arm_points if at.arm in statistic.arms]
        assert {statistic.axis, *statistic.pool} - {None} <= set().union(*points), one.id
        for axis, value in [*statistic.where.items(), *((statistic.axis, value) for value in statistic.values or [])]:
            assert value in [values.get(axis) for values in points], f"{one.id}: {axis} {value}"
        if statistic.windows:
            assert statistic.windows[-1][1] < experiment.episodes, one.id
            assert experiment.record != "none", one.id
        if statistic.theory:
            axis = np.array(statistic.values if statistic.axis and statistic.values else [0.01])
            assert setting_of(experiment, statistic.selection, axis, statistic.since).decays.min() > 0, one.id
        if statistic.parts or statistic.switch:
            assert experiment.record == "all", one.id
        if statistic.switch:
            learners = {arm: spec.learner_names for arm, spec in experiment.arms.items()}
            check_roles(one.id, statistic.switch, learners)
