"""The success table for papers and slides, as LaTeX, Markdown or CSV: tasks in rows, policies in columns."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from robogauntlet.results.analysis.tables import Tables, Tally
from robogauntlet.results.report.formatting import (
    TextTable,
    aggregate_of,
    counted,
    escape_latex,
    markdown,
    percent,
    share,
    short_task,
    span,
    spreadsheet_cell,
)
from robogauntlet.suites.episode import Condition

ALL = "all"
"""Name of the rows over all tasks of a simulator, and over all simulators."""


class TableFormat(StrEnum):
    """Format of a printed table."""

    LATEX = "latex"
    MARKDOWN = "markdown"
    CSV = "csv"


@dataclass(frozen=True, slots=True)
class SuccessRow:
    """One task, all tasks of a simulator, or all simulators."""

    simulator: str
    task: str
    tallies: tuple[Tally | None, ...]
    """One per policy; None where the policy does not play the task."""


@dataclass(frozen=True, slots=True)
class SuccessTable:
    """Success of each policy under one condition: the tasks of each simulator, then all of them."""

    suite: str
    condition: Condition
    policies: tuple[str, ...]
    rows: tuple[SuccessRow, ...]


def success_table(suite: str, tables: Tables, condition: Condition) -> SuccessTable:
    """Return the table of a run under one of `tables.conditions`. Rates of several tasks are pooled over episodes."""
    cells = [cell for cell in tables.cells if cell.condition == condition]
    policies = tuple(dict.fromkeys(cell.policy for cell in cells))
    tallies = {(cell.task, cell.policy): cell.tally for cell in cells}

    def pooled(simulator: str | None) -> tuple[Tally | None, ...]:
        found = (aggregate_of(tables, name, simulator, condition.axis, condition.severity) for name in policies)
        return tuple(None if row is None else row.tally for row in found)

    rows = []
    for simulator in dict.fromkeys(cell.simulator for cell in cells):
        for task in dict.fromkeys(cell.task for cell in cells if cell.simulator == simulator):
            of_task = tuple(tallies.get((task, policy)) for policy in policies)
            rows.append(SuccessRow(simulator, short_task(task), of_task))
        rows.append(SuccessRow(simulator, ALL, pooled(simulator)))
    rows.append(SuccessRow(ALL, ALL, pooled(None)))
    return SuccessTable(suite, condition, policies, tuple(rows))


def render_table(table: SuccessTable, form: TableFormat) -> str:
    """Return the table as text that ends with a line break.

    LaTeX is a `table` that needs the package booktabs, its rates in percent. CSV has a rate and the ends of its
    95 % Wilson interval per policy, as shares in [0, 1], and empty fields where there is no rate.
    """
    return {TableFormat.LATEX: _latex, TableFormat.MARKDOWN: _markdown, TableFormat.CSV: _csv}[form](table)


def _markdown(table: SuccessTable) -> str:
    rows = tuple((row.simulator, row.task, *map(share, row.tallies)) for row in table.rows)
    return markdown(TextTable(("simulator", "task", *table.policies), rows, 2)) + "\n"


def _csv(table: SuccessTable) -> str:
    import pandas as pd

    header = [spreadsheet_cell(f"{policy} {name}") for policy in table.policies for name in ("rate", "low", "high")]
    lines = [
        (*map(spreadsheet_cell, (row.simulator, row.task)), *(x for tally in row.tallies for x in _numbers(tally)))
        for row in table.rows
    ]
    text: str = pd.DataFrame(lines, columns=["simulator", "task", *header]).to_csv(index=False, lineterminator="\n")
    return text


def _numbers(tally: Tally | None) -> tuple[float | None, ...]:
    if tally is None or tally.interval is None:
        return None, None, None
    return tally.rate, tally.interval.low, tally.interval.high


def _latex(table: SuccessTable) -> str:
    import pandas as pd

    names = pd.MultiIndex.from_tuples([(row.simulator, row.task) for row in table.rows])
    cells = [[_latex_cell(tally) for tally in row.tallies] for row in table.rows]
    styler = pd.DataFrame(cells, index=names, columns=list(table.policies)).style
    for axis in (0, 1):
        styler = styler.format_index(escape_latex, axis=axis)
    text: str = styler.to_latex(
        hrules=True,
        clines="skip-last;data",
        multirow_align="naive",
        column_format="ll" + "r" * len(table.policies),
        position="htbp",
        position_float="centering",
        label="tab:" + re.sub(r"[^A-Za-z0-9]", "-", table.suite),
        caption=_caption(table),
    )
    line = f"\\cline{{1-{2 + len(table.policies)}}}\n"  # booktabs has a rule of its own in its place
    text = text.replace(f"{line}\\bottomrule", "\\bottomrule").replace(line, "\\midrule\n")
    others = "".join(sorted({character for character in text if not character.isascii()}))
    note = (
        f"% has {others}: pdfLaTeX may need \\usepackage[T1]{{fontenc}}, other scripts need LuaLaTeX\n"
        if others
        else ""
    )
    return f"% needs \\usepackage{{booktabs}}\n{note}{text}"


def _latex_cell(tally: Tally | None) -> str:
    if tally is None or tally.rate is None:
        return "--"
    return escape_latex(f"{percent(tally.rate).removesuffix(' %')} {span(tally.interval)}")


def _caption(table: SuccessTable) -> str:
    episodes = counted(sum(tally.verdicts for tally in table.rows[-1].tallies if tally is not None), "episode")
    names = f"suite {escape_latex(table.suite)}, condition {escape_latex(str(table.condition))}"
    return f"Success rate (\\%) with 95\\,\\% Wilson interval: {names}, {episodes}."
