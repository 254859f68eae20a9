"""robosuite's adapter keeps the contract, in every task."""

import pytest

from orchestrator.conformance import gauntlet_conformance

pytestmark = pytest.mark.simulator
MAY_SKIP = {"Door:stage-height"}  # the door is as tall as the arm's reach

test_robosuite_keeps_the_contract = gauntlet_conformance("robosuite", may_skip=MAY_SKIP)
