"""`robogauntlet check adapter`: check that an adapter fulfils its contract."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator
from robogauntlet.orchestrator.cli.common import err, fail, out, print_line
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.kit.adapter import CHECKS
from robogauntlet.orchestrator.kit.adapter.check import Check
from robogauntlet.orchestrator.kit.adapter.runner import MAX_TASKS, TIME_LIMIT_S, checks_for, default_tasks, run_checks
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted

MARKS = {Level.OK: "ok", Level.FAILED: "FAILED", Level.SKIPPED: "-"}
OUTCOMES = {Level.OK: "passed", Level.FAILED: "failed", Level.SKIPPED: "skipped"}


def check(
    name: Annotated[str, typer.Argument(help="Name of the simulator, such as mysim.")],
    task: Annotated[
        list[str] | None, typer.Option(help=f"Only this task. Repeatable; by default at most {MAX_TASKS} tasks.")
    ] = None,
    all_tasks: Annotated[
        bool, typer.Option("--all-tasks", help="Run every check on every task of the simulator.")
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(help="Only this check, or checks that begin with this, such as action. Repeatable."),
    ] = None,
    time_limit: Annotated[float, typer.Option(help="Time limit of a check (s).", min=1.0)] = TIME_LIMIT_S,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
) -> None:
    """Check an adapter against its contract.

    Each task is checked in a separate process.     Exit code 1 if a check failed.
    """
    simulator = _find(name)
    wanted = checks_for(_tasks(simulator, task, all_tasks), _checks(only), every=all_tasks)
    began = time.perf_counter()
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, TextColumn("{task.fields[doing]}"), console=err, transient=True) as progress:
        bar = progress.add_task(name, total=sum(map(len, wanted.values())), doing="")
        finished: set[tuple[str, str]] = set()
        lock = threading.Lock()

        def on_finding(finding: Finding) -> None:
            with lock:
                finished.add((finding.task, finding.topic))
                progress.update(bar, completed=len(finished), doing=f"{finding.task} {finding.topic}")

        findings = run_checks(wanted, limit_s=time_limit, on_finding=on_finding)
    if as_json:
        print(json.dumps([_document(finding) for finding in findings], indent=1))
    else:
        _show(wanted, findings, time.perf_counter() - began)
    if any(finding.level is Level.FAILED for finding in findings):
        raise typer.Exit(1)


def _find(name: str) -> Simulator:
    for plugin in catalog.broken_plugins():
        if plugin.name == name:
            raise BadInput(f"simulator {name}: {plugin.reason}")
    simulator = catalog.find(name)
    if reason := EnvironmentResolver().missing_reason(simulator):
        raise BadInput(f"{name}: {reason}")
    if not simulator.tasks:
        raise BadInput(f"{name}: expected a simulator with tasks, this one declares none")
    return simulator


def _tasks(simulator: Simulator, wanted: Sequence[str] | None, every: bool) -> list[str]:
    known = [f"{simulator.name}/{task}" for task in simulator.tasks]
    if not wanted:
        return known if every else default_tasks(simulator)
    full = [task if "/" in task else f"{simulator.name}/{task}" for task in wanted]
    for task in full:
        if task not in known:
            raise BadInput(f"unknown task '{task}'{did_you_mean(task, known)}")
    return list(dict.fromkeys(full))


def _checks(only: Sequence[str] | None) -> list[Check]:
    for beginning in only or ():
        if not any(name.startswith(beginning) for name in CHECKS):
            raise BadInput(f"unknown check '{beginning}'{did_you_mean(beginning, CHECKS)}")
    return [check for name, check in CHECKS.items() if not only or name.startswith(tuple(only))]


def _document(finding: Finding) -> dict[str, Any]:
    return {
        "check": finding.topic,
        "task": finding.task,
        "outcome": OUTCOMES[finding.level],
        "expected": finding.expected,
        "seen": finding.text,
        "look": finding.look,
        "seconds": finding.numbers.get("seconds", 0.0),
    }


def _show(wanted: Mapping[str, Sequence[Check]], findings: Sequence[Finding], seconds: float) -> None:
    """Print a table of checks and tasks, the reasons of skipped checks, and the failures."""
    table = Table("check", box=None, pad_edge=False)
    for task in wanted:
        table.add_column(task.partition("/")[2], no_wrap=True)
    table.add_column("promise")
    worst: dict[tuple[str, str], Level] = {}
    for finding in findings:
        worst.setdefault((finding.topic, finding.task), finding.level)
    checks = list(dict.fromkeys(check for checks in wanted.values() for check in checks))
    for check in checks:
        marks = [MARKS[worst[check.name, task]] if check in checks else "" for task, checks in wanted.items()]
        table.add_row(check.name, *marks, check.promise)
    out.print(table)
    skipped: dict[tuple[str, str], list[str]] = {}
    for finding in findings:
        if finding.level is Level.SKIPPED:
            skipped.setdefault((finding.task, finding.text), []).append(finding.topic)
    out.print()
    for (task, reason), names in skipped.items():
        print_line(f"{task}: {', '.join(names)}: skipped: {reason}")
    for finding in findings:
        if finding.level is Level.FAILED:
            fail(f"{finding.task}: {finding}")
    numbers = ", ".join(f"{list(worst.values()).count(level)} {outcome}" for level, outcome in OUTCOMES.items())
    out.print(
        f"{counted(len(checks), 'check')} on {counted(len(wanted), 'task')} in {seconds:.0f} s: {numbers}", markup=False
    )
