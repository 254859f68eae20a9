"""What a convention of external policies sets, in options of `.server_options`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from robogauntlet.policies.remote import libero
from robogauntlet.suites.episode import CAMERAS

DROID_STEP, DROID_HZ = 0.2, 15.0
"""Change of a joint's target for a velocity of 1 (rad), and control steps per second, of DROID's robots
(`robot_ik_solver.py`)."""
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "libero": libero.OPTIONS,
    "so101": {"joints": 5, "joint_scale": math.pi / 180.0, "gripper_open": 100.0, "gripper_closed": 0.0},
    "aloha": {"joints": 6, "arms": 2, "gripper_open": 1.0, "gripper_closed": 0.0, "resize": "crop"},
    "droid": {
        **{"joints": 7, "velocity_scale": DROID_STEP * DROID_HZ},
        **{"gripper_open": 0.0, "gripper_closed": 1.0, "gripper_threshold": 0.5},
    },
}
"""Convention to the options that it sets."""
DROID_CAMERAS = "observation/exterior_image_1_left", "observation/wrist_image_left"
OPENPI_KEYS: Mapping[str, Mapping[str, Any]] = {
    "droid": {
        "cameras": dict(zip(CAMERAS, DROID_CAMERAS, strict=True)),
        "proprioception": {"observation/joint_position": tuple(range(7)), "observation/gripper_position": (7,)},
        **{"image_size": 224, "execute": 8},
    },
}
"""Convention to what its policies get behind openpi's servers (`droid_policy.py`, `examples/droid/main.py`), unless
options say something else."""
