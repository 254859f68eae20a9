"""`gauntlet adapters check`: does an adapter keep what policies, perturbations and reports rely on?"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from adapters import catalog
from adapters.contract import AdapterError, Simulator
from orchestrator.cli.shared import BadInput, err, fail, homes_here, out
from orchestrator.conformance.examining import MOST_TASKS, checks_of, default_tasks, examine
from orchestrator.conformance.findings import Check, Finding, Outcome
from orchestrator.conformance.processes import TIME_LIMIT_S
from orchestrator.conformance.registry import CHECKS
from suites.plugins import nearest

MARKS = {Outcome.PASSED: "ok", Outcome.FAILED: "FAILED", Outcome.SKIPPED: "-"}


def check(
    name: Annotated[str, typer.Argument(help="Of the simulator, such as mysim.")],
    task: Annotated[
        list[str] | None, typer.Option(help=f"Only this task. Repeatable; by default {MOST_TASKS} at most.")
    ] = None,
    all_tasks: Annotated[bool, typer.Option("--all-tasks", help="Every check on every task of the simulator.")] = False,
    only: Annotated[
        list[str] | None, typer.Option(help="Only this check, or those that begin so, such as action. Repeatable.")
    ] = None,
    time_limit: Annotated[float, typer.Option(help="For each check (s).", min=1.0)] = TIME_LIMIT_S,
    as_json: Annotated[bool, typer.Option("--json", help="Print all findings as JSON.")] = False,
) -> None:
    """Check an adapter against its contract, each task in a process of its own. Exit code 1 if a check failed."""
    simulator = _found(name)
    wanted = checks_of(_tasks(simulator, task, all_tasks), _checks(only), every=all_tasks)
    began = time.perf_counter()
    with _progress() as progress:
        bar = progress.add_task(name, total=sum(map(len, wanted.values())), doing="")
        seen: set[tuple[str, str]] = set()
        alone = threading.Lock()

        def told(finding: Finding) -> None:
            with alone:
                seen.add((finding.task, finding.check))
                progress.update(bar, completed=len(seen), doing=f"{finding.task} {finding.check}")

        findings = examine(wanted, limit_s=time_limit, told=told)
    failed = [finding for finding in findings if finding.outcome is Outcome.FAILED]
    if as_json:
        print(json.dumps([asdict(finding) for finding in findings], indent=1))
    else:
        _show(wanted, findings, time.perf_counter() - began)
    if failed:
        raise typer.Exit(1)


def _found(name: str) -> Simulator:
    for plugin in catalog.broken_plugins():
        if plugin.name == name:
            raise BadInput(f"simulator {name}: {plugin.reason}")
    try:
        simulator = catalog.find(name)
    except AdapterError as error:
        raise BadInput(str(error)) from None
    if reason := homes_here().missing_reason(simulator):
        raise BadInput(f"{name}: {reason}")
    if not simulator.tasks:
        raise BadInput(f"{name}: expected a simulator with tasks, it declares none")
    return simulator


def _tasks(simulator: Simulator, wanted: Sequence[str] | None, every: bool) -> list[str]:
    known = [f"{simulator.name}/{task}" for task in simulator.tasks]
    if not wanted:
        return known if every else default_tasks(simulator)
    full = [task if "/" in task else f"{simulator.name}/{task}" for task in wanted]
    for task in full:
        if task not in known:
            raise BadInput(f"unknown task '{task}'{nearest(task, known)}")
    return list(dict.fromkeys(full))


def _checks(only: Sequence[str] | None) -> list[Check]:
    for beginning in only or ():
        if not any(name.startswith(beginning) for name in CHECKS):
            raise BadInput(f"unknown check '{beginning}'{nearest(beginning, CHECKS)}")
    return [found for name, found in CHECKS.items() if not only or name.startswith(tuple(only))]


def _progress() -> Progress:
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    return Progress(*columns, TextColumn("{task.fields[doing]}"), console=err, transient=True)


def _show(wanted: Mapping[str, Sequence[Check]], findings: Sequence[Finding], seconds: float) -> None:
    """A row for each check, a column for each task; then what failed, and why what was skipped was."""
    table = Table("check", box=None, pad_edge=False)
    for task in wanted:
        table.add_column(task.partition("/")[2], no_wrap=True)
    table.add_column("promise")
    worst: dict[tuple[str, str], Outcome] = {}
    for finding in findings:
        worst.setdefault((finding.check, finding.task), finding.outcome)
    checks = list(dict.fromkeys(check for checks in wanted.values() for check in checks))
    for found in checks:
        marks = [MARKS[worst[found.name, task]] if found in checks else "" for task, checks in wanted.items()]
        table.add_row(found.name, *marks, found.promise)
    out.print(table)
    skipped: dict[tuple[str, str], list[str]] = {}
    for finding in findings:
        if finding.outcome is Outcome.SKIPPED:
            skipped.setdefault((finding.task, finding.seen), []).append(finding.check)
    out.print()
    for (task, reason), names in skipped.items():
        out.print(f"{task}: {', '.join(names)}: skipped: {reason}", markup=False, soft_wrap=True)
    failed = [finding for finding in findings if finding.outcome is Outcome.FAILED]
    for finding in failed:
        fail(f"{finding.task}: {finding}")
    counts = {outcome: sum(found is outcome for found in worst.values()) for outcome in Outcome}
    numbers = ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
    out.print(f"{len(checks)} checks on {len(wanted)} tasks in {seconds:.0f} s: {numbers}", markup=False)
