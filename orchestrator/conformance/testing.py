"""The checks as tests of pytest: a package's own tests hold its adapter to the contract.

In a test file:

    from orchestrator.conformance import gauntlet_conformance

    test_mysim_keeps_the_contract = gauntlet_conformance("mysim")
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import pytest

from adapters import catalog
from orchestrator.conformance.examining import Examinations, checks_of, default_tasks
from orchestrator.conformance.findings import Outcome
from orchestrator.conformance.registry import CHECKS
from suites.plugins import nearest


def gauntlet_conformance(
    simulator: str,
    *,
    tasks: Sequence[str] | None = None,
    all_tasks: bool = False,
    may_skip: Collection[str] | None = None,
) -> Callable[..., None]:
    """A test for each task and check of an adapter; assign it to a name that begins with `test`.

    Args:
        simulator: Name of its entry point.
        tasks: Which tasks, by their names in the simulator; None for three at most, evenly spread.
        all_tasks: Every check on every task; else some checks are played on the first task only.
        may_skip: Checks that may be skipped, each as `TASK:check`, so that none is lost unnoticed; None for any.

    Raises:
        AdapterError: There is no such simulator.
        ValueError: There is no such task.
    """
    found = catalog.find(simulator)
    for task in tasks or ():
        if task not in found.tasks:
            raise ValueError(f"unknown task '{task}' of {simulator}{nearest(task, found.tasks)}")
    chosen = list(found.tasks) if all_tasks else tasks
    full = default_tasks(found) if chosen is None else [f"{simulator}/{task}" for task in chosen]

    wanted = checks_of(full, CHECKS.values(), every=all_tasks)
    pairs = [pytest.param(task, check.name, id=f"{task}-{check.name}") for task in wanted for check in wanted[task]]

    @pytest.mark.parametrize(("gauntlet_task", "gauntlet_check"), pairs)
    def conforms(gauntlet_examinations: Examinations, gauntlet_task: str, gauntlet_check: str) -> None:
        findings = gauntlet_examinations.of(gauntlet_task).play(CHECKS[gauntlet_check])
        failed = [str(finding) for finding in findings if finding.outcome is Outcome.FAILED]
        if failed:
            pytest.fail("\n".join(failed), pytrace=False)
        if findings[0].outcome is Outcome.SKIPPED:
            if may_skip is not None and f"{gauntlet_task.partition('/')[2]}:{gauntlet_check}" not in may_skip:
                pytest.fail(
                    f"{gauntlet_check}: expected it to be played; seen: skipped: {findings[0].seen}", pytrace=False
                )
            pytest.skip(findings[0].seen)

    return conforms
