"""The pytest plug-in: a fixture for the tests that `conformance_tests` makes.

Every pytest in the environment loads it, so it imports nothing else until such a test runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from robogauntlet.orchestrator.kit.adapter.runner import TaskChecker


@pytest.fixture(scope="session")
def robogauntlet_checker() -> Iterator[Callable[[str], TaskChecker]]:
    """Return the checker of a task, whose process stays until another task is asked for.

    It has no parameter: pytest 9 ends a parametrised fixture after each test of a list of parameter sets.
    """
    from robogauntlet.orchestrator.kit.adapter.runner import TaskChecker

    checkers: dict[str, TaskChecker] = {}
    with ExitStack() as stack:

        def checker_of(task: str) -> TaskChecker:
            if task not in checkers:
                checkers.clear()
                stack.close()
                checkers[task] = stack.enter_context(closing(TaskChecker(task)))
            return checkers[task]

        yield checker_of
