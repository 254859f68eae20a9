"""Tools for authors of adapters and policies: checks, files to begin with, and the pytest plug-in.

A package tests its adapter with one assignment in a test file:

    from robogauntlet.orchestrator.kit import conformance_tests

    test_mysim_keeps_the_contract = conformance_tests("mysim")
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robogauntlet.orchestrator.kit.adapter.runner import TaskChecker


def conformance_tests(
    simulator: str,
    *,
    tasks: Sequence[str] | None = None,
    all_tasks: bool = False,
    may_skip: Collection[str] | None = None,
) -> Callable[..., None]:
    """Make a pytest test for each task and check of an adapter; assign it to a name that begins with `test`.

    Every pytest in the environment imports this module with the plug-in, so all other imports are in the function.

    Args:
        simulator: Name of its entry point.
        tasks: Names of tasks in the simulator; None for at most three, evenly spread.
        all_tasks: Run every check on every task; by default some checks run on the first task only.
        may_skip: Checks that may be skipped, each as `TASK:check`; None for any. Another skipped check fails.

    Raises:
        AdapterError: The simulator does not exist.
        ValueError: A task does not exist.
    """
    import pytest

    from robogauntlet.adapters import catalog
    from robogauntlet.orchestrator.kit.adapter import CHECKS
    from robogauntlet.orchestrator.kit.adapter.runner import checks_for, default_tasks
    from robogauntlet.orchestrator.kit.finding import Level
    from robogauntlet.suites.plugins import did_you_mean

    declared = catalog.find(simulator)
    for task in tasks or ():
        if task not in declared.tasks:
            raise ValueError(f"unknown task '{task}' of {simulator}{did_you_mean(task, declared.tasks)}")
    chosen = list(declared.tasks) if all_tasks else tasks
    names = default_tasks(declared) if chosen is None else [f"{simulator}/{task}" for task in chosen]
    planned = checks_for(names, CHECKS.values(), every=all_tasks)
    pairs = [pytest.param(task, check.name, id=f"{task}-{check.name}") for task in planned for check in planned[task]]

    @pytest.mark.parametrize(("robogauntlet_task", "robogauntlet_check"), pairs)
    def conforms(
        robogauntlet_checker: Callable[[str], TaskChecker], robogauntlet_task: str, robogauntlet_check: str
    ) -> None:
        findings = robogauntlet_checker(robogauntlet_task).run(CHECKS[robogauntlet_check])
        failed = [str(finding) for finding in findings if finding.level is Level.FAILED]
        if failed:
            pytest.fail("\n".join(failed), pytrace=False)
        if findings[0].level is Level.SKIPPED:
            reason = findings[0].text
            task = robogauntlet_task.partition("/")[2]
            if may_skip is not None and f"{task}:{robogauntlet_check}" not in may_skip:
                pytest.fail(f"{robogauntlet_check}: expected it to run; seen: skipped: {reason}", pytrace=False)
            pytest.skip(reason)

    return conforms
