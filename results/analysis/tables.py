"""Tables of a run: rates per cell, per simulator and per policy, worker time, missing episodes and errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from robogauntlet.results.analysis import timing
from robogauntlet.results.analysis.timing import AnswerTiming, PhaseTiming
from robogauntlet.results.record import CELL, Status
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.results.statistics.rates import Interval, RateBounds, rate, rate_bounds, wilson_intervals
from robogauntlet.suites.episode import Condition

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    *("episode_id", "simulator", "task", "policy", "policy_digest", "axis", "severity", "seed"),
    *("status", "success_once", "steps", "error", *timing.COLUMNS, *timing.ANSWER_COLUMNS),
)
"""Fields of the record that the tables need."""
CATEGORIES = ("simulator", "task", "policy", "policy_digest", "axis", "status", "error", "worker")
"""Fields with few different values, which are read as pandas categories."""
EXAMPLES = 3
"""Number of episode ids per error message."""


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts and rates of a set of planned episodes."""

    planned: int
    """Episodes that the suite asks for."""
    done: int
    """Episodes with a row, whether success, failure or error."""
    successes: int
    failures: int
    errors: int
    """Episodes that could not be played; excluded from rates."""
    missing: int
    """Planned episodes without a row."""
    rate: float | None
    """successes / (successes + failures), or None if there is neither."""
    interval: Interval | None
    """Wilson interval of the rate, 95 %."""
    bounds: RateBounds | None
    """The rate if all errors and missing episodes fail, and if all succeed; None without such episodes."""
    success_once: float | None
    """Share of (successes + failures) in which the task's predicate was true after at least one step."""
    mean_steps: float | None
    """Control steps per success or failure; None if not known."""
    mean_seconds: float | None
    """Wall time per success or failure, without building, loading and waiting (s)."""

    @property
    def verdicts(self) -> int:
        """Episodes that count in the rate."""
        return self.successes + self.failures


class _UnderCondition:
    """A row about one condition."""

    __slots__ = ()
    axis: str
    severity: int

    @property
    def condition(self) -> Condition:
        """The axis and severity."""
        return Condition(self.axis, self.severity)


@dataclass(frozen=True, slots=True)
class CellRow(_UnderCondition):
    """One policy on one task under one condition."""

    simulator: str
    task: str
    policy: str
    policy_digest: str
    axis: str
    severity: int
    tally: Tally


@dataclass(frozen=True, slots=True)
class Aggregate(_UnderCondition):
    """One policy under one condition over the tasks of one simulator, or over all tasks."""

    policy: str
    simulator: str | None
    """None for all simulators together."""
    axis: str
    severity: int
    tally: Tally
    """Pooled: episodes have equal weight. For fixed tasks the Wilson interval is then conservative."""
    task_mean: float | None
    """Mean of the tasks' rates: tasks have equal weight."""
    tasks: int
    """Tasks with a rate."""


@dataclass(frozen=True, slots=True)
class NotRun(_UnderCondition):
    """A cell with planned episodes that have no row."""

    simulator: str
    task: str
    policy: str
    axis: str
    severity: int
    missing: int
    reason: str


@dataclass(frozen=True, slots=True)
class ErrorGroup:
    """Errors with one message."""

    message: str
    count: int
    simulators: tuple[str, ...]
    tasks: tuple[str, ...]
    policies: tuple[str, ...]
    examples: tuple[str, ...]
    """Ids of some of the episodes."""


@dataclass(frozen=True)
class Tables:
    """The numbers of a report."""

    cells: tuple[CellRow, ...]
    """In the order of the plan; cells with rows that are not in the plan come last, with 0 planned."""
    by_simulator: tuple[Aggregate, ...]
    """Per (policy, simulator, condition)."""
    by_policy: tuple[Aggregate, ...]
    """Per (policy, condition), over all simulators, clean first."""
    total: Tally
    timing: tuple[PhaseTiming, ...]
    """Per simulator with rows."""
    episodes_per_hour: float | None
    """Rows per hour of the run's elapsed time."""
    skipped: tuple[tuple[str, str], ...]
    """(simulator, reason) of those that could not run here."""
    not_run: tuple[NotRun, ...]
    errors: tuple[ErrorGroup, ...]
    """Most frequent message first."""
    answers: tuple[AnswerTiming, ...] = ()
    """Per policy whose answering times are known."""

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Conditions that occur, clean first, then in the order of the plan."""
        found = dict.fromkeys(cell.condition for cell in self.cells)
        return tuple(sorted(found, key=lambda condition: condition != Condition()))

    @cached_property
    def combinations(self) -> int:
        """Number of conditions that combine axes."""
        return sum(condition.is_combination for condition in self.conditions)

    @cached_property
    def aggregates(self) -> Mapping[tuple[str, str | None, str, int], Aggregate]:
        """By policy, simulator (None for all of them), axis and severity."""
        rows = (*self.by_policy, *self.by_simulator)
        return {(row.policy, row.simulator, row.axis, row.severity): row for row in rows}

    @cached_property
    def policies(self) -> tuple[str, ...]:
        """Policies that occur, in the order of the plan."""
        return tuple(dict.fromkeys(cell.policy for cell in self.cells))

    @cached_property
    def simulators(self) -> tuple[str, ...]:
        """Simulators that occur, in the order of the plan."""
        return tuple(dict.fromkeys(cell.simulator for cell in self.cells))


def build_tables(document: RunDocument, frame: pd.DataFrame) -> Tables:
    """Compute the tables of a run from its plan and its rows with the columns `COLUMNS`."""
    cells = _cells(document, _sums(frame))
    return Tables(
        cells=tuple(_cell_rows(cells)),
        by_simulator=tuple(_aggregates(cells, ["policy", "simulator", "axis", "severity"])),
        by_policy=tuple(_aggregates(cells, ["policy", "axis", "severity"])),
        total=_tallies(cells.assign(all=0).groupby("all")[_COUNTS].sum())[0] if len(cells) else _EMPTY,
        timing=timing.phase_timing(frame),
        episodes_per_hour=3600 * len(frame) / document.elapsed_s if document.elapsed_s > 0 else None,
        skipped=tuple(document.skipped.items()),
        not_run=tuple(_not_run(document, cells)),
        errors=_error_groups(frame),
        answers=timing.answer_timing(frame),
    )


_EMPTY = Tally(0, 0, 0, 0, 0, 0, None, None, None, None, None, None)
_COUNTS = ["planned", "missing", "successes", "failures", "errors", "once", "steps", "seconds"]


def _sums(frame: pd.DataFrame) -> pd.DataFrame:
    """Per cell key: counts of each status, and sums over the episodes with a verdict."""
    status = frame["status"].astype(str)
    verdict = status.isin([Status.SUCCESS, Status.FAILURE])
    values = frame[["simulator", "policy", *CELL]].assign(
        successes=(status == Status.SUCCESS).astype("int64"),
        failures=(status == Status.FAILURE).astype("int64"),
        errors=(~verdict).astype("int64"),
        once=(frame["success_once"].astype(bool) & verdict).astype("int64"),
        steps=frame["steps"].astype("int64").where(verdict, 0),
        seconds=frame["wall_s"].astype(float).where(verdict, 0.0),
    )
    sums = values.groupby(list(CELL), observed=True, sort=False).agg(
        **{name: (name, "sum") for name in _COUNTS[2:]}, simulator=("simulator", "first"), policy=("policy", "first")
    )
    return sums.reset_index()


def _cells(document: RunDocument, sums: pd.DataFrame) -> pd.DataFrame:
    """Merge plan and counts: one line per cell, in the order of the plan."""
    import pandas as pd

    plan = pd.DataFrame([cell.model_dump() for cell in document.plan], columns=list(PlannedCell.model_fields))
    for part in (plan, sums):
        part[["simulator", "policy", *CELL[:3]]] = part[["simulator", "policy", *CELL[:3]]].astype(object)
        part["severity"] = part["severity"].astype("int64")
    joined = plan.merge(sums, on=list(CELL), how="outer", suffixes=("", "_row"), sort=False)
    for name in ("policy", "simulator"):
        joined[name] = joined[name].fillna(joined.pop(f"{name}_row"))
    # An outer merge sorts by key; the order of the plan is the order of the suite file.
    order = {cell: place for place, cell in enumerate(plan[["policy", *CELL]].itertuples(index=False, name=None))}
    place = [order.get(cell, len(order)) for cell in joined[["policy", *CELL]].itertuples(index=False, name=None)]
    joined = joined.iloc[sorted(range(len(joined)), key=place.__getitem__)].reset_index(drop=True)
    counts = [name for name in _COUNTS if name not in ("missing", "seconds")]
    joined[counts] = joined[counts].fillna(0).astype("int64")
    joined["seconds"] = joined["seconds"].fillna(0.0).astype(float)
    done = joined[["successes", "failures", "errors"]].sum(axis=1)
    joined["missing"] = (joined["planned"] - done).clip(lower=0)
    return joined


def _tallies(counts: pd.DataFrame) -> list[Tally]:
    """One tally per line of `_COUNTS`."""
    lines = [dict(zip(_COUNTS, line, strict=True)) for line in counts[_COUNTS].itertuples(index=False, name=None)]
    verdicts = [line["successes"] + line["failures"] for line in lines]
    intervals = wilson_intervals([line["successes"] for line in lines], verdicts)
    return [_tally(line, n, interval) for line, n, interval in zip(lines, verdicts, intervals, strict=True)]


def _tally(line: dict[str, Any], verdicts: int, interval: Interval | None) -> Tally:
    successes, failures, errors, missing = (int(line[key]) for key in ("successes", "failures", "errors", "missing"))
    gaps = errors + missing
    return Tally(
        planned=int(line["planned"]),
        done=int(verdicts) + errors,
        successes=successes,
        failures=failures,
        errors=errors,
        missing=missing,
        rate=rate(successes, int(verdicts)),
        interval=interval,
        bounds=rate_bounds(successes, failures, gaps) if gaps else None,
        success_once=rate(int(line["once"]), int(verdicts)),
        mean_steps=float(line["steps"] / verdicts) if verdicts and line["steps"] else None,
        mean_seconds=float(line["seconds"] / verdicts) if verdicts and line["seconds"] else None,
    )


def _cell_rows(cells: pd.DataFrame) -> list[CellRow]:
    names = cells[["simulator", "task", "policy", "policy_digest", "axis", "severity"]]
    return [CellRow(**key, tally=tally) for key, tally in zip(names.to_dict("records"), _tallies(cells), strict=True)]


def _aggregates(cells: pd.DataFrame, by: list[str]) -> list[Aggregate]:
    groups = cells.groupby(by, sort=False)
    tallies = _tallies(groups[_COUNTS].sum())
    rates = cells.assign(rate=cells["successes"] / (cells["successes"] + cells["failures"]).where(lambda n: n > 0))
    aggregates = []
    for (key, group), tally in zip(rates.groupby(by, sort=False), tallies, strict=True):
        names = dict(zip(by, key, strict=True))
        known = group.dropna(subset=["rate"])
        aggregates.append(
            Aggregate(
                policy=names["policy"],
                simulator=names.get("simulator"),
                axis=names["axis"],
                severity=int(names["severity"]),
                tally=tally,
                task_mean=float(known["rate"].mean()) if len(known) else None,
                tasks=len(known),
            )
        )
    place = {policy: number for number, policy in enumerate(cells["policy"].unique())}
    return sorted(aggregates, key=lambda row: (place[row.policy], row.condition != Condition()))


def _not_run(document: RunDocument, cells: pd.DataFrame) -> list[NotRun]:
    otherwise = f"run {document.status}" + (f": {document.reason}" if document.reason else "")
    columns = ["simulator", "task", "policy", "axis", "severity", "missing"]
    lines = cells.loc[cells["missing"] > 0, columns].to_dict("records")
    return [NotRun(**line, reason=document.skipped.get(line["simulator"], otherwise)) for line in lines]


def _error_groups(frame: pd.DataFrame) -> tuple[ErrorGroup, ...]:
    errors = frame.loc[frame["status"].astype(str) == Status.ERROR]
    if errors.empty:
        return ()
    errors = errors.assign(error=errors["error"].astype(object).fillna("no message"))
    groups = [
        ErrorGroup(
            message=str(message),
            count=len(group),
            simulators=_distinct(group["simulator"]),
            tasks=_distinct(group["task"]),
            policies=_distinct(group["policy"]),
            examples=tuple(group["episode_id"].astype(str).iloc[:EXAMPLES]),
        )
        for message, group in errors.groupby("error", sort=False)
    ]
    return tuple(sorted(groups, key=lambda group: (-group.count, group.message)))


def _distinct(column: pd.Series) -> tuple[str, ...]:
    return tuple(sorted(map(str, column.unique())))
