"""The pytest plug-in: a fixture for the tests that `conformance_tests` makes.

Every pytest in the environment loads it, so it imports nothing else until such a test runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from robogauntlet.orchestrator.kit.adapter.runner import TaskChecker


@pytest.fixture(scope="session")
def robogauntlet_checker(request: pytest.FixtureRequest) -> Iterator[TaskChecker]:
    """Run checks of a task, its parameter, in one process; pytest ends that before another task's begins."""
    from robogauntlet.orchestrator.kit.adapter.runner import TaskChecker

    with closing(TaskChecker(request.param)) as checker:
        yield checker
