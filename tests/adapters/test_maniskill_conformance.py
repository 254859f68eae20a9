"""ManiSkill's adapter keeps the contract, in the tasks below; `check adapter maniskill --all-tasks` checks all."""

import pytest

from robogauntlet.adapters.maniskill import SIMULATOR
from robogauntlet.orchestrator.kit import conformance_tests

pytestmark = pytest.mark.simulator
OF_ONE_ARM = ("objects-box", "objects-move", "table-height", "axis-object-position")
OF_ONE_ARM += ("arm-place", "arm-unreachable", "axis-robot-start")
MAY_SKIP = {f"TwoRobotPickCube-v1@TwoPandas:{check}" for check in OF_ONE_ARM}
MAY_SKIP |= {f"{task}:axis-resampled" for task in SIMULATOR.tasks}  # it has no stored states
OTHERS = ("TwoRobotPickCube-v1@TwoPandas", "PokeCube-v1", "RollBall-v1")

test_maniskill_keeps_the_contract = conformance_tests("maniskill", tasks=["PushCube-v1"], may_skip=MAY_SKIP)
test_maniskill_keeps_the_contract_in_others = pytest.mark.nightly(
    conformance_tests("maniskill", tasks=OTHERS, may_skip=MAY_SKIP)
)
test_maniskill_keeps_the_contract_with_other_robots = pytest.mark.nightly(
    conformance_tests(
        "maniskill", tasks=["PegInsertionSide-v1@Panda-joint-delta", "UnitreeG1TransportBox-v1@UnitreeG1"]
    )
)
