"""What policies that were trained on LIBERO's own data expect, and what their answers mean. Arrays only.

As OpenVLA's, OpenVLA-OFT's and openpi's evaluations prepare it (experiments/robot/libero/libero_utils.py,
examples/libero/main.py): images as the simulator gives them, bottom row first, turned by half; the tool's pose in the
world's frame; actions as shares of the controller's largest offset.
"""

from __future__ import annotations

import numpy as np

from adapters.contract import FloatArray, Image
from policies.contract import PolicyMismatch

BASES = {
    "tabletop": (-0.66, 0.0, 0.912),
    "floor": (-0.6, 0.0, 0.0),
    "kitchen": (-0.66, 0.0, 0.912),
    "livingroom": (-0.51, 0.0, 0.42),
    "study": (-0.75, 0.0, 0.912),
}
"""Where the robot stands in the world (m), by scene."""
SCENES = {"spatial": "tabletop", "goal": "tabletop", "object": "floor"}
"""Suites that have one scene only; in the others a task's name says it."""
TRANSLATION, ROTATION = 0.0131, 0.118
"""What an action of 1 is in `adapters.contract`'s units (m, rad): what the tool moves in steady motion when it is given
LIBERO's offset of 5 cm and 0.5 rad."""

OPTIONS = {"turn": "left-right", "rotation": "axis-angle", "translation_scale": TRANSLATION, "rotation_scale": ROTATION}
"""What this convention says of a card. LIBERO's images are upside down, and a half turn of what is upside down is
upright and mirrored."""


def base_of(task: str) -> FloatArray:
    """Where the robot stands in the world of a task (`libero/...`), shape (3,), m.

    Raises:
        PolicyMismatch: The task is none of LIBERO's.
    """
    simulator, _, name = task.partition("/")
    suite, _, rest = name.partition("-")
    words = rest.split("-")
    scene = SCENES.get(suite, words[1].rstrip("0123456789") if len(words) > 1 else "")
    if simulator != "libero" or scene not in BASES:
        raise PolicyMismatch(f"convention libero: expected a task of LIBERO, got {task}")
    return np.array(BASES[scene])


def native_image(image: Image) -> Image:
    """An upright image (height, width, 3) as those policies are given it: left and right exchanged.

    LIBERO's images are upside down, and a half turn of what is upside down is upright and mirrored.
    """
    return np.ascontiguousarray(image[:, ::-1])


def native_proprioception(task: str, proprioception: FloatArray) -> FloatArray:
    """Our eight numbers as those policies are given them: position in the world, axis-angle, both fingers' joints."""
    fingers = proprioception[6:] * [1.0, -1.0]
    return np.concatenate([proprioception[:3] + base_of(task), proprioception[3:6], fingers])
