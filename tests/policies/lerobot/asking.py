"""Checkpoints of random weights that LeRobot makes, what they are asked, and what LeRobot answers itself."""

import subprocess
from pathlib import Path

import numpy as np

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies.contract import Query
from robogauntlet.suites.episode import Episode, Protocol, View, content_hash
from tests import ROOT
from tests.processes import environment_of

MAKING = Path(__file__).with_name("making.py")
VIEW = View(("third_person",), 32)
STEPS, CHUNK = 6, {"act": 3, "diffusion": 1, "smolvla": 3, "pi05": 3}
EPISODE = Episode("p", "d", "null/Reach", 3, Protocol(6, 8, VIEW))


def make(python, folder, *kinds):
    """Write the queries, a checkpoint of each kind, and LeRobot's actions; nothing is downloaded."""
    generator = np.random.default_rng(0)
    images = generator.integers(0, 256, (STEPS, 32, 32, 3), np.uint8)
    states = generator.normal(size=(STEPS, 8)).astype(np.float32)
    seeds = {kind: [-1 if step % length else _seed_at(step) for step in range(STEPS)] for kind, length in CHUNK.items()}
    np.savez(folder / "asked.npz", images=images, states=states, **seeds)
    offline = environment_of(ROOT, HF_HUB_OFFLINE="1")
    subprocess.run([python, MAKING, folder, *kinds], env=offline, check=True, capture_output=True)
    return folder


def answers(policy, made, kind):
    """Return the policy's actions and those of LeRobot, both (steps, numbers of an action)."""
    asked, other = np.load(made / "asked.npz"), Episode("p", "d", "null/Reach", 4, EPISODE.protocol)
    policy.reset([EPISODE, other])
    rows = []
    for step in range(0, STEPS, CHUNK[kind]):
        seen = Observation({"third_person": asked["images"][step]}, asked["states"][step].astype(np.float64), "reach")
        rows.append(policy.act([Query(EPISODE, step, seen)])[0].actions)
        policy.act([Query(other, step, seen)])  # another episode in between changes nothing
    policy.finish([EPISODE, other])
    return np.concatenate(rows), np.load(made / f"{kind}.npy").astype(np.float64)


def _seed_at(step):
    return int(content_hash([EPISODE.id, int(step)]), 16) % 2**63
