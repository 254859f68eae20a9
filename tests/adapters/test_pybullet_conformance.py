"""PyBullet's adapter keeps the contract, in every task; `make test` plays one."""

import pytest

from robogauntlet.adapters.pybullet import SIMULATOR
from robogauntlet.orchestrator.kit import conformance_tests

pytestmark = pytest.mark.simulator
MAY_SKIP = {
    "PandaReach-v3:camera-place",  # its gripper is blocked
    "PandaPush-v3:camera-place",
    "PandaReach-v3:dynamics",  # there is nothing in it but a goal in the air
    "PandaReach-v3:axis-dynamics",
    "PandaReach-v3:table-height",
    *(f"{task}:culling" for task in SIMULATOR.tasks),  # it always draws all shapes
    *(f"{task}:axis-resampled" for task in SIMULATOR.tasks),  # it has no stored states
}

test_pybullet_keeps_the_contract = conformance_tests("pybullet", tasks=["PandaPush-v3"], may_skip=MAY_SKIP)
test_pybullet_keeps_the_contract_in_others = pytest.mark.nightly(
    conformance_tests("pybullet", tasks=["PandaReach-v3", "PandaPickAndPlace-v3"], may_skip=MAY_SKIP)
)
