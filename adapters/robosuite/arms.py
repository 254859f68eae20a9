"""The arms that play robosuite's tasks: `Lift@UR5e` is Lift with a UR5e. A new one is an entry of `ARMS`.

robosuite's Sawyer is not among them: two shapes of its model overlap and hold its first joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robogauntlet.adapters.contract import Moves
from robogauntlet.suites.episode import AT

PANDA = "Panda"
"""The arm of tasks that name none."""
TWO_PANDAS = "TwoPandas"
"""Two of them, which face each other."""
DROID = "DROID"
"""The Panda and gripper with which the DROID data set was collected, see `droid`. By joints only."""
BY_JOINTS = {"-joint-position": Moves.TARGETS, "-joint-velocity": Moves.VELOCITIES}
"""End of the name of an arm, or of two, whose actions are of joints, to what they are."""
FRANKA_HAND = "PandaGripper"
"""robosuite's name of the hand whose fingers are slides: their joint positions are distances from the middle."""


@dataclass(frozen=True)
class Arm:
    """An arm of robosuite and its gripper."""

    title: str
    gripper: str = "default"
    """robosuite's name of the gripper; by default the one that it mounts on this arm."""
    pads: tuple[Sequence[str], Sequence[str]] | None = None
    """Shapes at the fingertips of both sides, where robosuite names them wrongly."""
    joints: int = 7
    robot: str = ""
    """robosuite's name of the arm, if it is another."""

    def fingertips(self, gripper: Any) -> tuple[Sequence[str], Sequence[str]] | None:
        """Return the shapes at the fingertips of both sides of robosuite's gripper; None if its fingers are slides."""
        if self.gripper == FRANKA_HAND:
            return None
        shapes = gripper.important_geoms
        return self.pads or (shapes["left_fingerpad"], shapes["right_fingerpad"])


ARMS: Mapping[str, Arm] = {
    PANDA: Arm("Franka Panda", FRANKA_HAND),
    "UR5e": Arm("UR5e, Robotiq 2F-85", joints=6),
    "Kinova3": Arm("Kinova Gen3, Franka hand", FRANKA_HAND),
    "IIWA": Arm("KUKA LBR iiwa, Franka hand", FRANKA_HAND),
    "Jaco": Arm("Kinova Jaco, Franka hand", FRANKA_HAND),
    "XArm7": Arm(
        "UFACTORY xArm7, its own gripper",
        pads=(
            ["gripper0_right_left_finger_pad_1", "gripper0_right_left_finger_pad_2"],
            ["gripper0_right_right_finger_pad_1", "gripper0_right_right_finger_pad_2"],
        ),
    ),
}

MOVED_BY_JOINTS: Mapping[str, Arm] = {
    DROID: Arm("Franka Panda, Robotiq 2F-85", "Robotiq85Gripper", robot=PANDA),
    "UR5e": ARMS["UR5e"],
    TWO_PANDAS: ARMS[PANDA],
}
"""Those that are offered with the ends `BY_JOINTS` too."""


def name_with(task: str, arm: str) -> str:
    """Return the name of a task with an arm."""
    return task if arm == PANDA else f"{task}{AT}{arm}"


def split_arm(name: str) -> tuple[str, str, Moves]:
    """Return the task and the arm of a name, and what actions are."""
    task, _, arm = name.partition(AT)
    for end, moves in BY_JOINTS.items():
        if arm.endswith(end):
            return task, arm.removesuffix(end), moves
    return task, arm or PANDA, Moves.TOOL
