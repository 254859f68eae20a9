"""ManiSkill's adapter keeps the contract, in three tasks; `adapters check maniskill --all-tasks` checks all."""

import pytest

from robogauntlet.orchestrator.adapter_kit import conformance_tests

pytestmark = pytest.mark.simulator
TASKS = ("PushCube-v1", "PlaceSphere-v1", "PokeCube-v1")

test_maniskill_keeps_the_contract = conformance_tests("maniskill", tasks=TASKS, may_skip=())
