"""The pytest plug-in: a fixture for the tests that `conformance_tests` makes.

Every pytest in the environment loads it, so it imports nothing else until such a test runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from robogauntlet.orchestrator.kit.adapter.runner import TaskCheckers


@pytest.fixture(scope="session")
def robogauntlet_checks() -> Iterator[TaskCheckers]:
    """Run checks in one process per task, one task at a time."""
    from robogauntlet.orchestrator.kit.adapter.runner import TaskCheckers

    checkers = TaskCheckers()
    yield checkers
    checkers.close()
