"""The conventions of policies that were trained on LIBERO's own data. Arrays only.

They are those of the evaluations of OpenVLA, OpenVLA-OFT and openpi (experiments/robot/libero/libero_utils.py,
examples/libero/main.py): images as the simulator gives them, bottom row first, turned by 180 degrees; the tool's pose
in the world frame; actions as shares of the controller's largest offset.
"""

from __future__ import annotations

import re

import numpy as np

from robogauntlet.adapters.catalog import original, simulators
from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import axis_angle, axis_angle_as_signed
from robogauntlet.policies.contract import PolicyMismatch

BASES = {
    "tabletop": (-0.66, 0.0, 0.912),
    "floor": (-0.6, 0.0, 0.0),
    "kitchen": (-0.66, 0.0, 0.912),
    "livingroom": (-0.51, 0.0, 0.42),
    "study": (-0.75, 0.0, 0.912),
}
"""Position of the robot's base in the world (m), by scene."""
SCENES = {"spatial": "tabletop", "goal": "tabletop", "object": "floor"}
"""LIBERO suites with a single scene; in the others the scene is part of the task's name."""
_SUITE = re.compile(r"libero_(spatial|object|goal|10|90)(?![a-z0-9])")
TRANSLATION, ROTATION = 0.0131, 0.118
"""An action of 1 in the units of `adapters.contract` (m, rad): the tool's steady motion per step under LIBERO's offset
of 5 cm and 0.5 rad."""

OPTIONS = {"turn": "left-right", "rotation": "axis-angle", "translation_scale": TRANSLATION, "rotation_scale": ROTATION}
"""Options that this convention sets. LIBERO's images are upside down; turned by 180 degrees they are upright and
mirrored."""


def base_of(task: str) -> FloatArray:
    """Return the base's position (3,), m, in the world of a task of LIBERO, or of one of which it is a variant.

    Raises:
        PolicyMismatch: It is a task of another simulator.
    """
    simulator, _, name = original(task).partition("/")
    suite, _, rest = name.partition("-")
    words = rest.split("-")
    scene = SCENES.get(suite, words[1].rstrip("0123456789") if len(words) > 1 else "")
    if simulator != "libero" or scene not in BASES:
        raise PolicyMismatch(f"convention libero: expected a task of LIBERO, got {task}")
    return np.array(BASES[scene])


def native_proprioception(
    task: str, proprioception: FloatArray, hand_quaternion: FloatArray | None = None
) -> FloatArray:
    """Convert our proprioception (8,) to LIBERO's: position in the world, axis-angle, both finger joints.

    The evaluations apply `quat2axisangle` to MuJoCo's quaternion of the hand (4,), xyzw, whose sign depends on the
    angles of all joints. Without it, the axis-angle is that of the branch around pointing down, which is another in
    poses farther than a right angle from it.
    """
    turn = proprioception[3:6] if hand_quaternion is None else axis_angle_as_signed(hand_quaternion)
    return np.concatenate([proprioception[:3] + base_of(task), turn, proprioception[6:] * [1.0, -1.0]])


def own_proprioception(task: str, native: FloatArray) -> FloatArray:
    """Convert LIBERO's proprioception (8,) to ours: the inverse of `native_proprioception`, on our branch."""
    from scipy.spatial.transform import Rotation  # takes 0.2 s, in commands that ask no server

    turn = axis_angle(Rotation.from_rotvec(native[3:6]).as_quat())
    return np.concatenate([native[:3] - base_of(task), turn, native[6:] * [1.0, -1.0]])


def task_of(suite: str, number: object, instruction: object) -> str | None:
    """Return the task (`libero/...`) that LIBERO knows by a suite, `libero_goal`, and its number there.

    The suites of LIBERO-Plus and LIBERO-Pro begin with the same names. A task of theirs, or one of LIBERO's whose
    instruction is another, is `libero/goal-NUMBER`, which tells the scene if its suite has a single one. None for the
    suites of other benchmarks.
    """
    match = _SUITE.match(suite)
    if match is None:
        return None
    begin = f"{match[1]}-{number}"
    tasks = simulators().get("libero")
    for name, task in tasks.tasks.items() if tasks else ():
        if name.startswith(f"{begin}-") and task.instruction == instruction:
            return f"libero/{name}"
    return f"libero/{begin}"
