"""Taking stock: which of the stored run rows are those of this very experiment, each run's once.

Run rows lie in parts, one per shard. What does not fit (damaged, another experiment's or another shard's, a copy) is
put away, and its runs are played again: they come to the same rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import pyarrow as pa
import pyarrow.compute as pc

from apel.numerics.seeding import run_seeds
from jobs.experiment.plan import Plan, RunKey
from jobs.results.episodes import check_episodes
from jobs.results.labels import DamageError, check_columns, expect, label_of, parse_table
from jobs.results.storage import Folder
from jobs.results.tables import RUN_KEY, RUN_TYPES

_MOST_RUNS = 10_000_000


@dataclass
class Stock:
    """What lies in ``parts/``, by file name."""

    fit: dict[str, pa.Table] = field(default_factory=dict)
    unfit: dict[str, str] = field(default_factory=dict)
    """With the reason."""

    @cached_property
    def keys(self) -> set[RunKey]:
        """The runs whose rows are stored."""
        return {key for table in self.fit.values() for key in _keys(table)}


def take_stock(folder: Folder, plan: Plan, *, with_episodes: bool) -> Stock:
    """See which parts fit the plan; ``with_episodes``: and whether the episodes that belong to them do."""
    stock, wanted = Stock(), _Wanted(plan)
    files = set(folder.names("episodes")) if with_episodes else set()
    seen: dict[RunKey, str] = {}
    for name in folder.names("parts"):
        try:
            table = _checked(folder, name, wanted)
            if files:
                _check_its_episodes(folder, name, table, files)
            _check_once(table, seen, stock)
        except DamageError as error:
            stock.unfit[name] = str(error)
        else:
            stock.fit[name] = table
            seen |= dict.fromkeys(_keys(table), name)
    return stock


def put_away(folder: Folder, stock: Stock, say: Callable[[str], None]) -> None:
    """Move what does not fit out of the way, and say so."""
    for name, reason in stock.unfit.items():
        folder.move(f"parts/{name}", f"damaged/parts/{name}")
        if name not in stock.fit and folder.exists(f"episodes/{name}"):
            folder.move(f"episodes/{name}", f"damaged/episodes/{name}")
        say(f"parts/{name}: {reason}: put into damaged/; runs that are missing are played again")


def check_once(table: pa.Table) -> None:
    """Refuse a table that has a run twice.

    Raises
    ------
    DamageError
        The message says which.
    """
    counted = table.group_by(list(RUN_KEY), use_threads=False).aggregate([([], "count_all")])
    for row in counted.filter(pc.greater(counted["count_all"], 1)).slice(length=1).to_pylist():
        message = f"found run {row['run_index']} of {row['arm']!r} {row['count_all']} times, expected it once"
        raise DamageError(message)


def check_seeds(table: pa.Table, seed: int) -> None:
    """Refuse rows of a run that the experiment with this seed does not have.

    Raises
    ------
    DamageError
        If there is one.
    """
    _check_seeds(table, _Seeds(seed))


def _checked(folder: Folder, name: str, wanted: _Wanted) -> pa.Table:
    table = parse_table(folder.read(f"parts/{name}"))
    label = label_of(table)
    if label is not None:
        expect(label, identity=wanted.identity, file=name)
    check_columns(table, RUN_TYPES)
    for arm, sweep, _ in _keys(table):
        if (arm, sweep) not in wanted.places or not name.startswith(f"arm={arm}/"):
            message = f"found rows of the arm {arm!r} at the sweep point {sweep!r}, which do not belong there"
            raise DamageError(message)
    _check_seeds(table, wanted.seeds)
    return table


def _check_seeds(table: pa.Table, seeds: _Seeds) -> None:
    for arm, _, index, seed in zip(*(table[column].to_pylist() for column in (*RUN_KEY, "seed")), strict=True):
        expected = seeds.of(index) if index is not None and 0 <= index < _MOST_RUNS else None
        if expected is None or seed != expected:
            message = f"found run {index} of {arm!r} with the seed {seed}, expected {expected or 'no such run'}"
            raise DamageError(message)


def _check_its_episodes(folder: Folder, name: str, table: pa.Table, files: set[str]) -> None:
    label = label_of(table)
    if not label or not label.get("episodes"):
        return
    if name not in files:
        message = "found no file of its episodes, expected one"
        raise DamageError(message)
    try:
        check_episodes(folder.read(f"episodes/{name}"), label["episodes"])
    except DamageError as error:
        message = f"its episodes: {error}"
        raise DamageError(message) from error


def _check_once(table: pa.Table, seen: dict[RunKey, str], stock: Stock) -> None:
    """Refuse a second row of a run. Where they differ, nobody knows which is right: neither is taken."""
    check_once(table)
    keys = _keys(table)
    others = sorted({seen[key] for key in keys if key in seen})
    for other in others:
        if other in stock.fit and not _agree(table, stock.fit[other]):
            stock.unfit[other] = "found other rows of the same runs in another file"
            del stock.fit[other]
    if others:
        message = f"found runs that {others[0]} holds too, expected every one once"
        raise DamageError(message)


def _agree(one: pa.Table, other: pa.Table) -> bool:
    rows = dict(zip(_keys(one), map(repr, one.to_pylist()), strict=True))
    return all(rows.get(key, row) == row for key, row in zip(_keys(other), map(repr, other.to_pylist()), strict=True))


def _keys(table: pa.Table) -> list[RunKey]:
    return list(zip(*(table[column].to_pylist() for column in RUN_KEY), strict=True))


class _Wanted:
    """What rows of a plan say of themselves."""

    def __init__(self, plan: Plan) -> None:
        self.identity = plan.experiment.identity
        self.places = {(one.arm, one.point.label) for one in plan.arm_points}
        self.seeds = _Seeds(plan.experiment.seed)


class _Seeds:
    """The seeds of an experiment's runs, drawn as far as they are asked for."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._drawn: list[int] = []

    def of(self, index: int) -> int:
        if index >= len(self._drawn):
            self._drawn = run_seeds(self._seed, max(index + 1, 2 * len(self._drawn)))
        return self._drawn[index]
