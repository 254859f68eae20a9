"""Result tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from robogauntlet.orchestrator.cli.common import out, print_line
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.report import Report, combinations, facts, failures
from robogauntlet.results.report.formatting import NOTHING, TextTable, is_folded, share, summary_table
from robogauntlet.results.report.merging_cost import compact_table, overall_table
from robogauntlet.suites.episode import Condition, SuccessRule
from robogauntlet.support.text import visible

MAX_TASKS = 200
"""With more tasks, none is printed; the report has all of them."""
MAX_CONDITIONS = 4
"""With more conditions, only the first is printed per task; the report has all of them."""


def print_summary(report: Report) -> None:
    """Print success per task, simulator and condition, the findings, and the cost of merging, as in the report."""
    tables, merging, findings = report.tables, report.merging, report.findings
    if not tables.total.done:
        out.print("no episode has been played yet")
        return
    out.print()
    many = len(tables.conditions) > MAX_CONDITIONS
    shown = tables.conditions[:1] if many else tables.conditions
    where = f", {shown[0]}" if many else ""
    where += ", success at a single step" if report.document.suite.success_rule is SuccessRule.ONCE else ""
    if len({cell.task for cell in tables.cells}) <= MAX_TASKS:
        _print_table(_per_task(tables, shown), f"Success rate with 95 % Wilson interval, per task{where}")
    if many:
        _print_table(_per_condition(tables), "Per condition, over all tasks and simulators")
    else:
        _print_table(_fitting(summary_table(tables)), "Per simulator")
    if report.combinations is not None:
        sentences = [combinations.sentences(one, report.combinations.axes) for one in report.combinations.policies]
        findings = (*(sentence for three in sentences for sentence in three), *findings)
    if report.failures is not None:
        findings = (*findings, *failures.sentences(report.failures))
    findings = (*findings, *facts.left_out(tables))
    for finding in findings:
        print_line(f"- {finding}")
    if findings:
        out.print()
    if merging is None:
        return
    for comparison in merging.routed:
        sides = f"expert ({merging.expert}), oracle-routed ({merging.oracle_routed}), routed ({comparison.policy})"
        _print_table(compact_table(comparison), f"Success of {sides}; accuracy of the router")
    _print_table(overall_table(merging), "Success lost over all tasks, on the same episodes")


def _print_table(table: TextTable, title: str) -> None:
    out.print(rich_table(table, title=title))
    out.print()


def _per_task(tables: Tables, conditions: Sequence[Condition]) -> TextTable:
    """Tasks x policies; a line per condition if there are several."""
    several = len(conditions) > 1
    cell_of = {(cell.task, cell.condition, cell.policy): cell for cell in tables.cells}
    lines = dict.fromkeys((cell.task, cell.condition) for cell in tables.cells if cell.condition in conditions)
    rows = []
    for task, condition in lines:
        cells = [cell_of.get((task, condition, policy)) for policy in tables.policies]
        counts = sorted({cell.tally.verdicts for cell in cells if cell is not None})
        rows.append(
            (
                task,
                *((str(condition),) if several else ()),
                *(NOTHING if cell is None else share(cell.tally) for cell in cells),
                "/".join(map(str, counts)),
                str(sum(cell.tally.errors for cell in cells if cell is not None)),
            )
        )
    header = ("task", *(("condition",) if several else ()), *tables.policies, "n", "errors")
    return TextTable(header, tuple(rows), 2 if several else 1)


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
