"""robosuite's adapter keeps the contract, in four tasks; `adapters check robosuite --all-tasks` checks all."""

import pytest

from robogauntlet.orchestrator.adapter_kit import conformance_tests

pytestmark = pytest.mark.simulator
TASKS = ("Lift", "Stack", "Door", "PickPlaceCan")
IN_BINS = ("objects-box", "objects-move", "table-props", "table-paint", "table-height")
IN_BINS += ("axis-object-position", "axis-table", "axis-distractors")
MAY_SKIP = {
    "Door:table-height",  # the door is as tall as the arm's reach
    *(f"PickPlaceCan:{check}" for check in IN_BINS),
}

test_robosuite_keeps_the_contract = conformance_tests("robosuite", tasks=TASKS, may_skip=MAY_SKIP)
