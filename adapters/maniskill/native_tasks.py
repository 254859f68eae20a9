"""Tasks of ManiSkill with native numbers, as `.native` plays them."""

from __future__ import annotations

from dataclasses import dataclass

from robogauntlet.adapters.contract import ActionSpec, Number, TaskDescription
from robogauntlet.adapters.maniskill.tasks import ADJUSTS
from robogauntlet.suites.episode import AT, CAMERAS

CONTROL_HZ = 20.0
FIXED = dict.fromkeys(ADJUSTS, "its scene is ManiSkill's own")


@dataclass(frozen=True)
class Robot:
    """What acts."""

    action: int
    """Numbers of an action."""
    joints: int

    @property
    def spec(self) -> ActionSpec:
        """Bounds and names."""
        numbers = [Number(f"delta_{number}", -1.0, 1.0) for number in range(1, self.action + 1)]
        state = [f"{kind}_{number}" for kind in ("position", "velocity") for number in range(1, self.joints + 1)]
        return ActionSpec(0.0, 0.0, CONTROL_HZ, numbers=tuple(numbers), state=tuple(state))


ROBOTS = {
    "Panda-joint-delta": Robot(8, 9),
    "PandaStick": Robot(7, 7),
    "DClaw": Robot(9, 9),
    "TriFinger": Robot(9, 9),
    "UnitreeG1": Robot(25, 25),
}
"""By the end of a task's name."""
_TASKS = {
    "PegInsertionSide-v1@Panda-joint-delta": ("insert the peg into the hole in the box", 200),
    "PickSingleYCB-v1@Panda-joint-delta": ("pick up the object and hold it in the green ball", 200),
    "FMBAssembly1Easy-v1@Panda-joint-delta": ("assemble the parts on the red board", 500),
    "PushT-v1@PandaStick": ("push the red T onto the grey one", 200),
    "DrawTriangle-v1@PandaStick": ("draw over the outline of the triangle", 300),
    **{
        f"RotateValveLevel{level}-v1@DClaw": (f"turn the valve by {turn} turn", 150)
        for level, turn in enumerate(("a quarter", "half a", "half a", "half a", "one whole"))
    },
    **{f"TriFingerRotateCubeLevel{level}-v1@TriFinger": ("bring the cube to the goal", 250) for level in range(2)},
    "UnitreeG1PlaceAppleInBowl-v1@UnitreeG1": ("put the apple into the bowl", 200),
    "UnitreeG1TransportBox-v1@UnitreeG1": ("carry the box to the other table", 200),
}


def _described(task: str, instruction: str, horizon: int) -> TaskDescription:
    robot = task.partition(AT)[2]
    body = ROBOTS[robot].spec.body
    return TaskDescription(instruction, horizon, FIXED, CAMERAS[:1], robot=robot, native=body.native, state=body.state)


TASKS = {task: _described(task, *described) for task, described in _TASKS.items()}
