"""robosuite's adapter keeps the contract, in every task."""

import pytest

from robogauntlet.orchestrator.adapter_kit import conformance_tests

pytestmark = pytest.mark.simulator
MAY_SKIP = {"Door:table-height"}  # the door is as tall as the arm's reach

test_robosuite_keeps_the_contract = conformance_tests("robosuite", may_skip=MAY_SKIP)
