"""ManiSkill's adapter keeps the contract, in every task."""

import pytest

from robogauntlet.orchestrator.adapter_kit import conformance_tests

pytestmark = pytest.mark.simulator

test_maniskill_keeps_the_contract = conformance_tests("maniskill", may_skip=())
