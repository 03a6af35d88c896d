"""The answer in words, on one screen of 80 columns."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from statistics import NormalDist
from typing import Any

from jobs.analysis.answer.comparison import Answer, Cost, Inside, Placed, Ranking, Verdict
from jobs.analysis.answer.measures import Kind
from jobs.analysis.statistics.bootstrap import Estimate
from jobs.analysis.statistics.sequential import first_look, least_error
from jobs.experiment.spec import Experiment

_WIDTH = 80
_NAME, _LEAST_NAME = 18, 10
_MOST_ROWS, _MOST_ENSEMBLES = 8, 2
_MOST_RUNS = 10_000
_POWER = 0.8
_HEADS: dict[Kind, str] = {"return": "return", "area": "area", "episodes": "episodes", "steps": "steps"}
_SELECTED = (
    "Late return: mean over the last tenth, in the episodes that a learner played. The selector picks who plays, so a "
    "learner that rarely played was seen only when it looked good."
)
_OF: dict[Kind, str] = {
    "return": "It returns {value} in the last tenth of a run{interval}",
    "area": "It returns {value} over the whole of a run{interval}",
    "episodes": "It meets the criterion after {value} episodes{interval}",
    "steps": "It meets the criterion after {value} steps{interval}",
}


def answer_json(experiment: Experiment, answers: Sequence[Answer]) -> str:
    """The same, and all that did not fit on the screen, as JSON."""
    content = {
        "experiment": experiment.name,
        "identity": experiment.identity,
        "answers": [{**_plain(answer), "words": " ".join(_advice(answer))} for answer in answers],
    }
    return json.dumps(content)


def _plain(value: Any) -> Any:
    """Dataclasses and named tuples as dictionaries."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Estimate):
        return value._asdict()
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, tuple | list) else value


def answer_lines(answers: Sequence[Answer]) -> list[str]:
    """What `apel compare` prints."""
    lines: list[str] = []
    for answer in answers:
        if lines:
            lines.append("")
        lines += [f"{answer.task}:"] if answer.task else []
        lines += _answer(answer)
    return lines


def _answer(answer: Answer) -> list[str]:
    lines = _wrapped(" ".join(_advice(answer)))
    if answer.rankings and len(answer.rankings[0].places) > 1:
        lines += ["", *_table(answer.rankings)]
    shown = answer.inside[:_MOST_ENSEMBLES]
    for inside in shown:
        lines += ["", *_inside_table(inside, _MOST_ROWS // len(shown))]
    if shown:
        lines += _wrapped(_SELECTED)
    said = [*_cost_sentences(answer.costs), *(f"{_capital(note)}." for note in answer.notes)]
    return [*lines, "", *_wrapped(" ".join(said))] if said else lines


def _advice(answer: Answer) -> Iterator[str]:
    if answer.verdict is None or not answer.rankings:
        yield "Nothing can be compared here."
        return
    ranking, verdict = answer.rankings[0], answer.verdict
    chosen = verdict.best or verdict.left[0]
    place = next(one for one in ranking.places if one.name == chosen)
    value, interval = _number(place.estimate.value), _interval(place.estimate, place.num_runs)
    is_alone = len(ranking.places) == 1
    advice = "Use" if verdict.best else "If you have to choose now, use"
    yield f"Only {chosen} has results." if is_alone else f"{advice} {chosen}."
    yield f"{_OF[ranking.kind].format(value=value, interval=interval)}."
    if place.num_at_cap:
        yield f"{place.num_at_cap} of {place.num_runs} runs did not get there, and count as if they did at their end."
    if not is_alone:
        yield from _decided(verdict) if verdict.best else _undecided(verdict, ranking)
    elif answer.inside:
        first = answer.inside[0].learners[0].place
        share = f"{_share(first.probability_best)} of resamples agree" if first.num_runs > 1 else "in a single run"
        yield f"Of its learners {first.name} returned most at the end ({share})."


def _decided(verdict: Verdict) -> Iterator[str]:
    if verdict.gap:
        name = min(verdict.gap, key=lambda other: verdict.gap[other].value)
        gap = verdict.gap[name]
        if gap.value > 0:
            yield f"It is better than {name}, the next, by {_number(gap.value)}{_ends(gap)}, run by run."
    yield f"That it is the best was decided after {verdict.num_runs} runs, at an error of {_percent(verdict.error)}."


def _undecided(verdict: Verdict, ranking: Ranking) -> Iterator[str]:
    others, count = list(verdict.left[1:]), len(ranking.places)
    yield f"But it cannot be told apart from {_named(others)} at an error of {_percent(verdict.error)}:"
    if verdict.error <= (least := least_error(count)):
        yield f"no number of runs decides between {count} with less than {_percent(least)}."
        return
    fewest = first_look(count, verdict.error)
    if verdict.num_runs < fewest:
        yield f"{_runs(verdict.num_runs)} cannot decide between {count}; it takes at least {fewest}."
        return
    known = [name for name in others if name in verdict.gap]
    if not known:
        yield "they have no run in common."
        return
    name = min(known, key=lambda other: verdict.gap[other].value)
    gap = verdict.gap[name]
    yield f"it is better than {name} by {_number(gap.value)}{_ends(gap)}, run by run."
    needed = max(_runs_needed(verdict, other, count) for other in known)
    if needed > _MOST_RUNS:
        yield f"To tell them apart would take more than {_MOST_RUNS:,} runs: the difference is that small."
    elif needed > verdict.num_runs:
        yield f"About {needed:,} runs would tell, if the differences are what they seem."
    else:
        yield "A few more runs may tell."


def _runs_needed(verdict: Verdict, name: str, num_candidates: int) -> float:
    """By the normal approximation, with a power of 80 %, and the error that is spent by one of the later looks."""
    gap, deviation = verdict.gap[name].value, verdict.deviation[name]
    if gap <= 0:
        return math.inf
    quantile = NormalDist().inv_cdf(1 - verdict.error / (4 * (num_candidates - 1))) + NormalDist().inv_cdf(_POWER)
    needed = (quantile * deviation / gap) ** 2
    if needed > _MOST_RUNS:
        return math.inf
    digits = max(0, len(str(int(needed))) - 2)
    return math.ceil(needed / 10**digits) * 10**digits


def _table(rankings: Sequence[Ranking]) -> list[str]:
    """Candidates by the first measure, with the means of the others."""
    first, *others = rankings
    heads = ["arm", _HEADS[first.kind], "95 % interval", "P(best)", "P(5 %)"]
    rows = []
    for place in first.places[:_MOST_ROWS]:
        row = _cells(place)
        for other in others:
            same = [one for one in other.places if one.name == place.name]
            row.append(f"{_number(same[0].estimate.value)} ({other.places.index(same[0]) + 1})" if same else "-")
        rows.append(row)
    lines = _columns([*heads, *(_HEADS[other.kind] for other in others)], rows)
    left_out = len(first.places) - len(rows)
    return [*lines, f"and {left_out} more: --json shows them"] if left_out > 0 else lines


def _inside_table(inside: Inside, num_rows: int) -> list[str]:
    heads = [f"in {_cut(inside.ensemble)}", "late return", "95 % interval", "P(best)", "P(5 %)", "episodes", "runs"]
    rows = [
        [*_cells(one.place), f"{one.num_episodes:,}", str(one.place.num_runs)] for one in inside.learners[:num_rows]
    ]
    return _columns(heads, rows)


def _cells(place: Placed) -> list[str]:
    # Resamples of a single run all agree, which says nothing.
    likely = (place.probability_best, place.probability_near)
    shares = [_share(one) if place.num_runs > 1 else "-" for one in likely]
    return [_cut(place.name), _number(place.estimate.value), _range(place), *shares]


def _cost_sentences(costs: Sequence[Cost]) -> Iterator[str]:
    total = sum(cost.steps for cost in costs)
    runs = sum(cost.num_runs for cost in costs)
    yield f"It took {_steps(total)} environment steps in {_runs(runs)}."
    for cost in [cost for cost in costs if cost.alone is not None][:_MOST_ENSEMBLES]:
        assert cost.alone is not None  # noqa: S101 - chosen so
        ratio = cost.alone / cost.steps if cost.steps else math.nan
        how = "took" if cost.is_measured else "would at that pace take"
        each = f"its {cost.num_learners} learners, each alone, {how} {_steps(cost.alone)}"
        yield f"{cost.name} took {_steps(cost.steps)}; {each} ({ratio:.2g} times as many)."


def _columns(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table whose first column is of names: they are cut where it is too wide, and the last columns left out, but no
    number is.

    >>> _columns(["in an ensemble", "return"], [["a learner", "1,234"]])
    [' in an ensemble  return', ' a learner        1,234']
    """
    widths = [max(len(line[place]) for line in (heads, *rows)) for place in range(len(heads))]
    while (excess := sum(widths) + 2 * len(widths) - 1 - _WIDTH) > 0:
        if widths[0] > _LEAST_NAME:
            widths[0] = max(_LEAST_NAME, widths[0] - excess)
        else:
            widths.pop()
    lines = []
    for line in (heads, *rows):
        cells = [cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=False)]
        lines.append(f" {'  '.join([_cut(line[0], widths[0]).ljust(widths[0]), *cells])}".rstrip())
    return lines


def _wrapped(text: str) -> list[str]:
    whole = text.replace(" %", "\u00a0%")  # a number and its unit stay on one line
    lines = textwrap.wrap(whole, _WIDTH, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\u00a0", " ") for line in lines]


def _number(value: float) -> str:
    """With about three digits that count.

    >>> _number(3558.9), _number(-80.42), _number(0.04567), _number(12_345_678.0)
    ('3,559', '-80.4', '0.0457', '12.3 M')
    """
    return _steps(value) if abs(value) >= 1000 else f"{value:.3g}"


def _steps(number: float) -> str:
    if abs(number) < 1e6:
        return f"{number:,.0f}"
    return f"{number / 1e6:,.3g} M" if abs(number) < 1e9 else f"{number / 1e6:,.0f} M"


def _range(place: Placed) -> str:
    if place.num_runs < 2:
        return "-"
    return f"{_number(place.estimate.low)} to {_number(place.estimate.high)}"


def _interval(estimate: Estimate[float], num_runs: int) -> str:
    if num_runs < 2:
        return ""
    return f" (95 % interval {_number(estimate.low)} to {_number(estimate.high)}, {num_runs} runs)"


def _ends(estimate: Estimate[float]) -> str:
    return f" ({_number(estimate.low)} to {_number(estimate.high)})"


def _share(share: float) -> str:
    """As per cent; certainty only where every resample agrees.

    >>> _share(1.0), _share(0.9996), _share(0.5), _share(0.0004), _share(0.0)
    ('100 %', '>99 %', '50 %', '<1 %', '0 %')
    """
    if 0.0 < share < 0.01:
        return "<1 %"
    return ">99 %" if 0.99 < share < 1.0 else f"{100 * share:.0f} %"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _runs(number: int) -> str:
    return f"{number:,} run{'s' if number != 1 else ''}"


def _named(names: Sequence[str]) -> str:
    if len(names) > 4:
        return f"{', '.join(names[:3])} and {len(names) - 3} more"
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _cut(name: str, width: int = _NAME) -> str:
    return name if len(name) <= width else f"{name[: width - 1]}…"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
