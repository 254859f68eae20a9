"""The arms that play robosuite's tasks: `Lift@UR5e` is Lift with a UR5e. A new one is an entry of `ARMS`.

robosuite's Sawyer is not among them: two shapes of its model overlap and hold its first joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robogauntlet.suites.episode import AT

PANDA = "Panda"
"""The arm of tasks that name none."""
TWO_PANDAS = "TwoPandas"
"""Two of them, which face each other."""
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

    def fingertips(self, gripper: Any) -> tuple[Sequence[str], Sequence[str]] | None:
        """Return the shapes at the fingertips of both sides of robosuite's gripper; None if its fingers are slides."""
        if self.gripper == FRANKA_HAND:
            return None
        shapes = gripper.important_geoms
        return self.pads or (shapes["left_fingerpad"], shapes["right_fingerpad"])


ARMS: Mapping[str, Arm] = {
    PANDA: Arm("Franka Panda", FRANKA_HAND),
    "UR5e": Arm("UR5e, Robotiq 2F-85"),
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


def name_with(task: str, arm: str) -> str:
    """Return the name of a task with an arm."""
    return task if arm == PANDA else f"{task}{AT}{arm}"


def split_arm(name: str) -> tuple[str, str]:
    """Return the task and the arm of a name."""
    task, _, arm = name.partition(AT)
    return task, arm or PANDA
