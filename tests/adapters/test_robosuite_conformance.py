"""robosuite's adapter keeps the contract, in the tasks below; `check adapter robosuite --all-tasks` checks all."""

import pytest

from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.orchestrator.kit import conformance_tests

pytestmark = pytest.mark.simulator
BY_JOINTS = ("Stack@DROID-joint-velocity", "TwoArmLift@TwoPandas-joint-position", "Lift@UR5e-joint-position")
OTHERS = (
    "TwoArmLift@TwoPandas",
    "Lift@Kinova3",
    "Door",
    "PickPlaceCan",
    "Wipe",
    "TwoArmPegInHole@TwoPandas",
    "TwoArmTransport@TwoPandas",
    *BY_JOINTS,
)
IN_BINS = ("objects-box", "objects-move", "table-props", "table-paint", "table-height")
IN_BINS += ("axis-object-position", "axis-table", "axis-distractors")
OF_ONE_ARM = ("objects-box", "objects-move", "table-height", "axis-object-position")
OF_ONE_ARM += ("arm-place", "arm-unreachable", "axis-robot-start")
OF_DIRT = ("objects-box", "objects-move", "table-height", "axis-object-position", "dynamics", "axis-dynamics")
WITHOUT_TABLE = ("table-props", "table-paint", "axis-table", "axis-distractors")
MAY_SKIP = {
    *(f"{task}:axis-resampled" for task in SIMULATOR.tasks),  # it has no stored states
    # The door is as tall as the arm's reach, and its table fills a tenth of the image.
    *(f"Door:{check}" for check in ("table-height", "table-props", "table-paint", "axis-table", "axis-distractors")),
    *(f"PickPlaceCan:{check}" for check in IN_BINS),
    *(f"{task}:{check}" for task in OTHERS if task.startswith("TwoArm") for check in OF_ONE_ARM),
    *(f"TwoArm{task}@TwoPandas:{check}" for task in ("PegInHole", "Transport") for check in WITHOUT_TABLE),
    "TwoArmTransport@TwoPandas:goal",
    *(f"Wipe:{check}" for check in OF_DIRT),
    *(f"{task}:{check}" for task in ("Wipe", "TwoArmPegInHole@TwoPandas") for check in ("goal", "camera-place")),
}

test_robosuite_keeps_the_contract = conformance_tests("robosuite", tasks=["Lift"], may_skip=MAY_SKIP)
test_robosuite_keeps_the_contract_in_others = pytest.mark.nightly(
    conformance_tests("robosuite", tasks=OTHERS, may_skip=MAY_SKIP)
)
