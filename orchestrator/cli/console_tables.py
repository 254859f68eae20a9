"""Result tables on the terminal."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from robogauntlet.orchestrator.cli.common import out, print_line
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.report import Report, facts
from robogauntlet.results.report.formatting import NOTHING, TextTable, is_folded, share, summary_table
from robogauntlet.results.report.section import load_sections
from robogauntlet.results.report.sections.rates import task_table
from robogauntlet.suites.episode import SuccessRule
from robogauntlet.support.text import visible

MAX_TASKS = 200
"""With more tasks, none is printed; the report has all of them."""
MAX_CONDITIONS = 4
"""With more conditions, only the first is printed per task; the report has all of them."""


def print_summary(report: Report) -> None:
    """Print success per task, simulator and condition, the findings, and the cost of merging, as in the report."""
    tables = report.tables
    if not tables.total.done:
        out.print("no episode has been played yet")
        return
    out.print()
    many = len(tables.conditions) > MAX_CONDITIONS
    shown = tables.conditions[:1] if many else tables.conditions
    where = f", {shown[0]}" if many else ""
    where += ", success at a single step" if report.document.suite.success_rule is SuccessRule.ONCE else ""
    if len({cell.task for cell in tables.cells}) <= MAX_TASKS:
        _print_table(task_table(tables, shown), f"Success rate with 95 % Wilson interval, per task{where}")
    if many:
        _print_table(_per_condition(tables), "Per condition, over all tasks and simulators")
    else:
        _print_table(_fitting(summary_table(tables)), "Per simulator")
    sections = [(section, report.data[section.name]) for section in load_sections() if section.name in report.data]
    findings = [sentence for section, data in sections for sentence in section.sentences(data)]
    findings += facts.left_out(tables)
    for finding in findings:
        print_line(f"- {finding}")
    if findings:
        out.print()
    for section, data in sections:
        for title, table in section.text_tables(data, report):
            _print_table(table, title)


def _print_table(table: TextTable, title: str) -> None:
    out.print(rich_table(table, title=title))
    out.print()


def _per_condition(tables: Tables) -> TextTable:
    """Conditions x policies, all tasks together."""
    total_of = {(total.condition, total.policy): total for total in tables.by_policy}
    rows = []
    for condition in tables.conditions:
        if is_folded(tables, condition):
            continue  # of a design; the report has them together
        totals = [total_of.get((condition, policy)) for policy in tables.policies]
        rows.append((str(condition), *(NOTHING if total is None else share(total.tally) for total in totals)))
    return TextTable(("condition", *tables.policies), tuple(rows), 1)


def _fitting(table: TextTable) -> TextTable:
    """The table; on a narrow terminal without its last two columns (mean of tasks, errors)."""
    if out.width >= 24 * len(table.header):
        return table
    return TextTable(table.header[:-2], tuple(row[:-2] for row in table.rows), table.labels)


def rich_table(table: TextTable, *, title: str) -> Table:
    """Return the table for the terminal. Its texts are shown as they are, unprintable characters as escapes."""
    drawn = Table(title=Text(visible(title)), title_justify="left", box=None, pad_edge=False)
    for i, name in enumerate(table.header):
        drawn.add_column(Text(visible(name)), justify="left" if i < table.labels else "right", no_wrap=True)
    for row in table.rows:
        drawn.add_row(*(Text(visible(cell)) for cell in row))
    return drawn
