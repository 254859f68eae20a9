"""RoboGauntlet's plug-in of pytest: what tests made by `orchestrator.conformance.gauntlet_conformance` run on.

Every pytest in the environment loads it, so it imports nothing until such a test is run.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from orchestrator.conformance.examining import Examinations


@pytest.fixture(scope="session")
def gauntlet_examinations() -> Iterator[Examinations]:
    """What plays the checks: a process for each task, one at a time."""
    from orchestrator.conformance.examining import Examinations

    examinations = Examinations()
    yield examinations
    examinations.close()
