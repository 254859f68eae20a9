"""robosuite's adapter keeps the contract, in three tasks; `adapters check robosuite --all-tasks` checks all."""

import pytest

from robogauntlet.orchestrator.adapter_kit import conformance_tests

pytestmark = pytest.mark.simulator
TASKS = ("Lift", "Door", "PickPlaceCan")
MAY_SKIP = {"Door:table-height"}  # the door is as tall as the arm's reach

test_robosuite_keeps_the_contract = conformance_tests("robosuite", tasks=TASKS, may_skip=MAY_SKIP)
