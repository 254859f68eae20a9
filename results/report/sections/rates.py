"""Success rates of policies: by simulator, and by task."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.analysis.tables import CellRow, Tables
from robogauntlet.results.report.blocks import Block, Legend, Paragraph, RateGroup, RatePlot, Rates, Terms
from robogauntlet.results.report.facts import DEFINITIONS, SUCCESS_OF_OTHERS
from robogauntlet.results.report.formatting import NOTHING, TextTable, aggregate_of, share, summary_table
from robogauntlet.results.report.section import Page, Section
from robogauntlet.suites.episode import Condition


def _rates(_: None, page: Page) -> Iterator[Block]:
    tables, shown = page.report.tables, page.report.shown
    if len(tables.conditions) > 1:
        yield Paragraph(
            f"The plot has the {shown} condition; the section on robustness has the perturbed ones.", is_of_plot=True
        )
    terms = ["success", "rate", "interval", "pooled"]
    terms += ["error"] if tables.total.errors else []
    terms += ["bounds"] if tables.total.errors or tables.total.missing else []
    success = {"success": SUCCESS_OF_OTHERS} if page.report.document.is_outcomes_only else {}
    yield Terms({term: DEFINITIONS[term] for term in terms} | success)
    rows = []
    for total in tables.by_policy:
        if total.condition == shown:
            of_simulator = (aggregate_of(tables, total.policy, name, *_key(shown)) for name in tables.simulators)
            rows.append((total, tuple(of_simulator)))
    yield Rates(tables.simulators, tuple(rows), summary_table(tables))


def _key(condition: Condition) -> tuple[str, int]:
    return condition.axis, condition.severity


def task_groups(tables: Tables, simulator: str, condition: Condition) -> dict[str, list[CellRow]]:
    """The cells of each task of a simulator under a condition."""
    tasks: dict[str, list[CellRow]] = {}
    for cell in tables.cells:
        if cell.simulator == simulator and cell.condition == condition:
            tasks.setdefault(cell.task, []).append(cell)
    return tasks


def task_table(tables: Tables, conditions: tuple[Condition, ...]) -> TextTable:
    """Tasks by policies: rates with intervals, numbers of episodes and errors; a line per condition, if several."""
    several = len(conditions) > 1
    cell_of = {(cell.task, cell.condition, cell.policy): cell for cell in tables.cells}
    lines = dict.fromkeys((cell.task, cell.condition) for cell in tables.cells if cell.condition in conditions)
    rows = []
    for task, condition in lines:
        cells = [cell_of.get((task, condition, policy)) for policy in tables.policies]
        counts = sorted({cell.tally.verdicts for cell in cells if cell is not None})
        rates = (NOTHING if cell is None else share(cell.tally) for cell in cells)
        errors = sum(cell.tally.errors for cell in cells if cell is not None)
        label = (task, str(condition)) if several else (task,)
        rows.append((*label, *rates, "/".join(map(str, counts)), str(errors)))
    header = ("task", *(("condition",) if several else ()), *tables.policies, "n", "errors")
    return TextTable(header, tuple(rows), 2 if several else 1)


def _tasks(_: None, page: Page) -> Iterator[Block]:
    tables, shown = page.report.tables, page.report.shown
    where = f", under the {shown} condition" if len(tables.conditions) > 1 else ""
    thin = ". The thin lines below span the bounds" if tables.total.errors or tables.total.missing else ""
    yield Paragraph(f"Markers are success rates and lines are 95 % intervals{where}{thin}.", is_of_plot=True)
    yield Legend(tables.policies)
    table: TextTable | None = task_table(tables, (shown,))
    for simulator in tables.simulators:
        tasks = task_groups(tables, simulator, shown)
        groups = [RateGroup(task, tuple((cell.policy, cell.tally) for cell in cells)) for task, cells in tasks.items()]
        has_results = any(cell.tally.verdicts for cells in tasks.values() for cell in cells)
        yield RatePlot(simulator, tuple(groups) if has_results else (), table, "success-by-task")
        table = None  # all simulators are in one


SECTIONS = (Section("rates", "Success rates", _rates), Section("tasks", "Success by task", _tasks))
