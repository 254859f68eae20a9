"""Recordings without a simulator."""

import numpy as np

from robogauntlet.policies.training.dataset_writer import Attempt, DatasetWriter
from robogauntlet.policies.training.lerobot_format import Recording, encode_episode

SOURCE = {"task": "null/Reach", "noise": 0.1}


def recording(seed=0, steps=12, size=16, cameras=("third_person", "wrist"), **changes):
    generator = np.random.default_rng(seed)
    fields = {
        "seed": seed,
        "instruction": "reach the goal",
        "control_hz": 20.0,
        "states": generator.normal(size=(steps, 8)),
        "actions": generator.uniform(-1, 1, (steps, 7)),
        "success": np.arange(steps) >= steps - 5,
        "images": {
            camera: list(generator.integers(0, 256, (steps, size, size, 3), dtype=np.uint8)) for camera in cameras
        },
    }
    return Recording(**{**fields, **changes})


def write(folder, recordings, *, per_file=2, **source):
    """A dataset of these recordings, `per_file` episodes in each data file."""
    writer = DatasetWriter(folder, {**SOURCE, **source})
    for first in range(0, len(recordings), per_file):
        part = recordings[first : first + per_file]
        writer.commit([won(r) for r in part], [encode_episode(r) for r in part])
    return writer


def won(recording):
    return Attempt(recording.seed, "success", len(recording.actions))
