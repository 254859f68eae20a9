"""Numbers and tables as text, for the terminal, `report.md` and `report.html`."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from robogauntlet.results.analysis.routing import Rate
from robogauntlet.results.analysis.tables import Aggregate, CellRow, Tables, Tally
from robogauntlet.results.analysis.timing import PHASES, PhaseTiming
from robogauntlet.results.statistics.rates import Estimate, Interval, RateBounds
from robogauntlet.suites.episode import Condition
from robogauntlet.support.durations import format_duration
from robogauntlet.support.text import counted as counted, visible

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
FORMULA_IN_TEXT = re.compile(r"""([;|\t\r\n])(?=[\s"']*[=+\-@])""")
"""Where another separator than the comma would begin a cell with a formula."""
"""First characters of a text that a spreadsheet takes for a formula."""
MANY_COMBINATIONS = 20
"""Combinations of axes beyond which tables have one row for all of them; `cells.csv` has each."""
NOTHING = "–"
"""Shown where there is no value."""


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of texts, which Markdown or the terminal shows."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    labels: int
    """Leading columns that name the row (left-aligned); the others are numbers (right-aligned)."""


def percent(value: float | None) -> str:
    """0.8236 as `82 %`; a rate near 0 or 1 is never rounded to it."""
    if value is None:
        return NOTHING
    if 0 < value < 0.01 or 0.99 < value < 1:
        return f"{100 * value:.1f} %" if 0.001 <= value <= 0.999 else ("<0.1 %" if value < 0.5 else ">99.9 %")
    return f"{100 * value:.0f} %"


def span(interval: Interval | None) -> str:
    """An interval in percent: `[74, 89]`."""
    return NOTHING if interval is None else f"[{100 * interval.low:.0f}, {100 * interval.high:.0f}]"


def bounds(value: RateBounds | None) -> str:
    """Bounds of a rate: `80–84 %`, with one more digit if they are close."""
    if value is None:
        return NOTHING
    digits = 0 if value.high - value.low >= 0.015 else 1
    return f"{100 * value.low:.{digits}f}–{100 * value.high:.{digits}f} %"


def seconds(value: float | None) -> str:
    """A time with a fitting unit: `4.2 ms`, `7.31 s`, `12 min 5 s`, `3 h 20 min`."""
    if value is None:
        return NOTHING
    if value >= 59.995:
        return format_duration(value)
    if value >= 0.9995 or value == 0:
        return f"{value:.3g} s"
    return f"{1000 * value:.3g} ms"


def count(value: float | None) -> str:
    """A whole number with thousands separators."""
    return NOTHING if value is None else f"{value:,.0f}"


def rate(estimate: Estimate | None) -> str:
    """`82 % [74, 89]`."""
    if estimate is None or math.isnan(estimate.value):
        return NOTHING
    return percent(estimate.value) + (f" {span(estimate.interval)}" if estimate.interval else "")


def share(value: Tally | Rate | None) -> str:
    """`82 % [74, 89]`."""
    return NOTHING if value is None or value.rate is None else f"{percent(value.rate)} {span(value.interval)}"


def number(estimate: Estimate | None) -> str:
    """`0.82 [0.74, 0.89]`."""
    if estimate is None or math.isnan(estimate.value):
        return NOTHING
    ends = estimate.interval
    return f"{estimate.value:.2f}" + (f" [{ends.low:.2f}, {ends.high:.2f}]" if ends else "")


def points(estimate: Estimate | None) -> str:
    """A difference of rates in percentage points: `+4.0 [-1.2, 9.0]`."""
    if estimate is None:
        return NOTHING
    value, interval = round(100 * estimate.value, 1) + 0.0, estimate.interval
    ends = [] if interval is None else [f"{round(100 * end, 1) + 0.0:.1f}" for end in (interval.low, interval.high)]
    return f"{value:+.1f} [{', '.join(ends)}]" if ends else f"{value:+.1f}"


def difference(estimate: Estimate | None) -> str:
    """A difference of rates with its unit: `+4.0 [-1.2, 9.0] points`."""
    return NOTHING if estimate is None else f"{points(estimate)} points"


def p_value(value: float) -> str:
    """`0.031`, or `<0.001`."""
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def aggregate_of(tables: Tables, policy: str, simulator: str | None, axis: str, severity: int) -> Aggregate | None:
    """The aggregate of that policy, simulator (None: all) and condition."""
    wanted = (policy, simulator, axis, severity)
    return tables.aggregates.get(wanted)


def summary_table(tables: Tables) -> TextTable:
    """Policies (and conditions, if there are several) x simulators: pooled rate with its Wilson interval."""
    several = len(tables.conditions) > 1
    header = ("policy", *(("condition",) if several else ()), *tables.simulators, "all", "mean of tasks", "errors")
    rows = []
    for total in tables.by_policy:
        if is_folded(tables, total.condition):
            continue
        label = (total.policy, str(total.condition)) if several else (total.policy,)
        found = [aggregate_of(tables, total.policy, name, total.axis, total.severity) for name in tables.simulators]
        rates = (share(None if row is None else row.tally) for row in (*found, total))
        rows.append((*label, *rates, percent(total.task_mean), count(total.tally.errors)))
    for policy in tables.policies if tables.combinations > MANY_COMBINATIONS else ():
        cells = [cell for cell in tables.cells if cell.policy == policy and cell.condition.is_combination]
        of_each = ([cell for cell in cells if cell.simulator == name] for name in tables.simulators)
        rates = (_pooled_rate(group) for group in (*of_each, cells))
        errors = sum(cell.tally.errors for cell in cells)
        rows.append((policy, _all_combinations(tables), *rates, NOTHING, count(errors)))
    return TextTable(header, tuple(rows), 2 if several else 1)


def is_folded(tables: Tables, condition: Condition) -> bool:
    """Whether tables show this condition in a row with others."""
    return condition.is_combination and tables.combinations > MANY_COMBINATIONS


def _all_combinations(tables: Tables) -> str:
    return f"{tables.combinations} combinations"


def _pooled_rate(cells: Sequence[CellRow]) -> str:
    """A rate without interval: combinations share start states."""
    verdicts = sum(cell.tally.verdicts for cell in cells)
    return percent(sum(cell.tally.successes for cell in cells) / verdicts if verdicts else None)


def task_table(tables: Tables, simulator: str) -> TextTable:
    """One simulator's cells with counts, rate, interval and bounds."""
    several = len(tables.conditions) > 1
    cells = [cell for cell in tables.cells if cell.simulator == simulator]
    header = ("task", "policy", *(("condition",) if several else ()), "planned", "done", "success", "failure", "error")
    header += ("missing", "rate", "interval", "bounds", "success once", "mean steps", "mean time")
    rows = [_task_row(cell, several) for cell in cells if not is_folded(tables, cell.condition)]
    folded = [cell for cell in cells if is_folded(tables, cell.condition)]
    for task, policy in dict.fromkeys((cell.task, cell.policy) for cell in folded):
        of_pair = [cell for cell in folded if (cell.task, cell.policy) == (task, policy)]
        rows.append(_folded_row(of_pair, _all_combinations(tables)))
    return TextTable(header, tuple(rows), 3 if several else 2)


def _folded_row(cells: Sequence[CellRow], label: str) -> tuple[str, ...]:
    """A task's row over many conditions, without means and intervals."""
    names = ("planned", "done", "successes", "failures", "errors", "missing")
    counts = (count(sum(getattr(cell.tally, name) for cell in cells)) for name in names)
    return (short_task(cells[0].task), cells[0].policy, label, *counts, _pooled_rate(cells), *[NOTHING] * 5)


def _task_row(cell: CellRow, several: bool) -> tuple[str, ...]:
    tally = cell.tally
    return (
        short_task(cell.task),
        cell.policy,
        *((str(cell.condition),) if several else ()),
        *map(count, (tally.planned, tally.done, tally.successes, tally.failures, tally.errors, tally.missing)),
        percent(tally.rate),
        span(tally.interval),
        bounds(tally.bounds if tally.done else None),
        percent(tally.success_once),
        count(tally.mean_steps),
        seconds(tally.mean_seconds),
    )


def timing_table(timing: Sequence[PhaseTiming]) -> TextTable:
    """Worker time per simulator and phase."""
    header = ("simulator", "workers", *PHASES, "total", "busy", "episodes per hour of a worker")
    rows = []
    for line in timing:
        times = (*(line.seconds(phase) for phase in PHASES), line.total_s)
        shown = (percent(line.busy_share), count(line.episodes_per_worker_hour))
        rows.append((line.simulator, count(line.workers), *map(seconds, times), *shown))
    return TextTable(header, tuple(rows), 1)


def short_task(task: str) -> str:
    """`maniskill/PushCube-v1` as `PushCube-v1`."""
    return task.partition("/")[2] or task


def aligned(table: TextTable) -> str:
    """A table as lines of text with aligned columns."""
    widths = [max(map(len, column)) for column in zip(table.header, *table.rows, strict=True)]

    def line(row: Sequence[str]) -> str:
        sides = [str.ljust] * table.labels + [str.rjust] * (len(row) - table.labels)
        return "  ".join(pad(cell, width) for pad, cell, width in zip(sides, row, widths, strict=True)).rstrip()

    return "\n".join(map(line, (table.header, *table.rows)))


def markdown(table: TextTable) -> str:
    """A table in GitHub's Markdown, with its texts escaped."""
    rules = ["---"] * table.labels + ["---:"] * (len(table.header) - table.labels)
    lines = [[escape(cell) for cell in table.header], rules, *([escape(cell) for cell in row] for row in table.rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def spreadsheet_cell(value: Any) -> Any:
    """A value for a CSV file: a text that a spreadsheet would compute gets a leading apostrophe; others stay.

    What would be a cell of its own for a spreadsheet with another separator than the comma is treated alike.
    """
    if not isinstance(value, str):
        return value
    return FORMULA_IN_TEXT.sub(r"\1'", f"'{value}" if value.startswith(FORMULA_STARTS) else value)


def escape(text: str) -> str:
    """Escape text for Markdown, on one line, unprintable characters as escapes."""
    text = visible(" ".join(text.split())).replace("\\", "\\\\").replace("&", "&amp;").replace("<", "&lt;")
    for character in "|`*_":
        text = text.replace(character, "\\" + character)
    return text.replace("](", "]\\(")


def words(name: str) -> tuple[str, ...]:
    """The words of a name, between which a line may break: `PickCube-v1` as `Pick`, `Cube-`, `v1`."""
    return tuple(re.split(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[-_/@])", name))


_LATEX: dict[str, str | int | None] = {
    **{character: "\\" + character for character in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"},
}


def escape_latex(text: str) -> str:
    """Escape text for LaTeX, including the characters that its default font encoding draws as others.

    Unprintable characters, at which LaTeX stops, are shown as escapes.
    """
    return visible(" ".join(text.split())).translate(str.maketrans(_LATEX))
