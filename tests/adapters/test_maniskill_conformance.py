"""ManiSkill's adapter keeps the contract, in every task."""

import pytest

from orchestrator.conformance import gauntlet_conformance

pytestmark = pytest.mark.simulator

test_maniskill_keeps_the_contract = gauntlet_conformance("maniskill", may_skip=())
